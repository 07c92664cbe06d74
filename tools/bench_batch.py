r"""Compare many small problems at once with a loop, and with other libraries, in one run.

    pip install -e ".[cpu,bench]"
    python tools/bench_batch.py --points 64 256 1024

Each problem is between crops of two photographs, color weight 2, blur 0.05, reach 0.3 or balanced.
Every contestant has a process of its own in each round, is run once to warm up (compilation is not
counted) and then timed; the least time of the rounds counts. Each library stops by its own rule,
with its defaults. Error: the sum of |pi 1 - r|_1 and |pi^T 1 - c|_1, as a share of the mass,
against the marginals r and c of the converged solutions; the mean over the problems. For every
peer, clmorph is timed at the loosest tolerance that is at least as exact: first without
certificates, which are made when they are asked for and which the others do not have, then with
them. POT has a batch solver for balanced problems alone (`--reach inf`); its method "log_sinkhorn"
took 60 times as long as "sinkhorn" and is left out. `--python` is an interpreter that has the other
libraries, if this one has not; `--older` is one that has an earlier version of clmorph, whose loop
is timed beside the others.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

BLUR, REACH, COLOR_WEIGHT = 0.05, 0.3, 2.0
EPSILON = BLUR**2
TOLERANCES = 1.0, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4
#: Number of problems for each number of points, and of those that the loop solves.
COUNTS, LOOPED = {64: 256, 256: 64, 1024: 16}, 16
#: A contestant is timed so often, or for so many seconds, in each round.
REPEATS, SECONDS = 7, 2.0


def problems(n: int, count: int):
    """Return points (count, n, 5) of sources and of targets."""
    from skimage import data
    from skimage.transform import resize

    from clmorph.measures.lift import lift

    side, rng = round(n**0.5), np.random.default_rng(0)
    sides = []
    for picture in (data.astronaut(), data.chelsea()):
        crops = []
        for _ in range(count):
            size = int(rng.integers(80, 250))
            y, x = (int(rng.integers(0, length - size)) for length in picture.shape[:2])
            crop = resize(
                picture[y : y + size, x : x + size] / 255, (side, side), anti_aliasing=True
            )
            crops.append(lift(crop, COLOR_WEIGHT).points)
        sides.append(np.array(crops))
    return sides


# --- contestants: functions that solve all problems and return a function for their marginals ---


def marginals(x, y, f, g):
    """Return both marginals of the plans of potentials, for uniform weights."""
    rows, columns = [], []
    for own_x, own_y, own_f, own_g in zip(x, y, f, g, strict=True):
        cost = 0.5 * ((own_x[:, None] - own_y) ** 2).sum(axis=2)
        plan = np.exp((own_f[:, None] + own_g - cost) / EPSILON) / cost.size
        rows.append(plan.sum(axis=1))
        columns.append(plan.sum(axis=0))
    return np.array(rows), np.array(columns)


def clmorph_batch(device: str, tol: float, reach):
    """Return ours; certificates are made as well, as a loop makes them."""
    import clmorph

    operations = clmorph.get_backend(device)

    def solve(x, y):
        weights = np.full(x.shape[:2], 1 / x.shape[1])
        found = clmorph.sinkhorn_batch(
            (weights, x), (weights, y), BLUR, reach, tol, backend=operations
        )
        return lambda: (
            np.array([each.row_mass for each in found]),
            np.array([each.column_mass for each in found]),
        )

    def with_certificates(x, y):
        made = solve(x, y)()
        return lambda: made

    return {"batch": solve, "certified": with_certificates}


def clmorph_loop(device: str, tol: float, reach):
    """Return the loop over single problems, of which it solves a part."""
    import clmorph

    operations = clmorph.get_backend(device)

    def solve(x, y):
        weights = np.full(x.shape[1], 1 / x.shape[1])
        found = [
            clmorph.sinkhorn(
                (weights, own_x), (weights, own_y), BLUR, reach, tol, backend=operations
            )
            for own_x, own_y in zip(x[:LOOPED], y[:LOOPED], strict=True)
        ]
        return lambda: (
            np.array([each.row_mass for each in found]),
            np.array([each.column_mass for each in found]),
        )

    return {"loop": solve}


def ott(reach):
    """OTT-JAX, one program for all problems by `jax.vmap`, float32; see `bench_solver.ott`."""
    import jax
    import jax.numpy as jnp
    from ott.geometry.pointcloud import PointCloud
    from ott.problems.linear.linear_problem import LinearProblem
    from ott.solvers.linear.sinkhorn import Sinkhorn

    tau = 1.0 if reach is None else reach**2 / (reach**2 + EPSILON)
    shrink = 0.0 if reach is None else EPSILON / reach**2

    def one(x, y, a):
        problem = LinearProblem(PointCloud(x, y, epsilon=2 * EPSILON), a, a, tau_a=tau, tau_b=tau)
        out = Sinkhorn()(problem)
        return out.f, out.g

    run = jax.jit(jax.vmap(one, in_axes=(0, 0, None)))

    def solve(x, y):
        n = x.shape[1]
        weights = jnp.full(n, n ** (-1.0 - shrink), jnp.float32)
        f, g = (
            np.asarray(each, float) / 2 + EPSILON * np.log(n)
            for each in run(jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32), weights)
        )
        return lambda: marginals(x, y, f, g)

    return {"OTT-JAX, vmap": solve}


def pot(method: str):
    """POT's batch solver, whose regularization is ours for uniform weights."""
    from ot.batch import dist_batch, solve_batch

    def solve(x, y):
        plan = solve_batch(0.5 * dist_batch(x, y), EPSILON, method=method).plan
        return lambda: (plan.sum(axis=2), plan.sum(axis=1))

    return {f"POT batch, {method}": solve}


def contestant(name: str, tol: float, reach):
    """Return the functions of a contestant, by their names."""
    kind, _, which = name.partition(" ")
    if kind == "clmorph":
        return clmorph_batch(which, tol, reach)
    if kind in ("loop", "older"):
        return clmorph_loop(which, tol, reach)
    return ott(reach) if kind == "ott" else pot(which)


# --- one contestant in a process of its own -------------------------------------------------------


def measure(name: str, tol: float, reach, file: str) -> None:
    """Solve, print seconds a problem, and leave the marginals in a file."""
    data = np.load(file)
    x, y = data["x"], data["y"]
    seconds = {}
    for title, solve in contestant(name, tol, reach).items():
        result, times = solve(x, y), []
        while len(times) < REPEATS and sum(times) < SECONDS:
            began = time.perf_counter()
            result = solve(x, y)
            times.append(time.perf_counter() - began)
        rows, columns = result()
        seconds[title] = min(times) / len(rows)
    np.savez(f"{file}.out.npz", rows=rows, columns=columns)
    print(json.dumps(seconds))


def in_own_process(name: str, tol: float, reach, file: Path, python: str, truth) -> dict:
    """Run `measure` in a process of its own; return seconds and the error."""
    command = [python, "-W", "ignore", __file__, "--measure", name, str(tol), str(reach), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
        return {"failed": lines[-1][:80]}
    result = {"seconds": json.loads(done.stdout.strip().splitlines()[-1])}
    if truth is not None:
        found = np.load(f"{file}.out.npz")
        off = sum(
            np.abs(found[side] - truth[side][: len(found[side])]).sum(axis=1)
            for side in ("rows", "columns")
        )
        mass = sum(truth[side][: len(found["rows"])].sum(axis=1) for side in ("rows", "columns"))
        result["error"] = float(np.mean(off / mass))
    return result


def best(runs: list[dict]) -> dict:
    """Return a contestant's least times over the rounds."""
    if any("failed" in run for run in runs):
        return next(run for run in runs if "failed" in run)
    titles = runs[0]["seconds"]
    least = {title: min(run["seconds"][title] for run in runs) for title in titles}
    return runs[0] | {"seconds": least}


def line(*cells) -> str:
    """Return one line of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def compare(n: int, reach, devices: list[str], python: str, rounds: int, older: str | None) -> None:
    """Print the table of one size."""
    count = COUNTS.get(n, max(4, 16384 // n))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "points.npz"
        x, y = problems(n, count)
        np.savez(file, x=x, y=y)
        in_own_process(f"clmorph {devices[0]}", 1e-6, reach, file, sys.executable, None)
        truth = dict(np.load(f"{file}.out.npz"))
        peers = ["ott", *(["pot sinkhorn"] if reach is None else [])]
        ours = [(f"clmorph {device}", tol) for device in devices for tol in TOLERANCES]
        entries = [(peer, 0.0) for peer in peers] + ours
        loops = ["loop", *(["older"] if older else [])]
        entries += [(f"{kind} {device}", 1e-3) for device in devices for kind in loops]
        interpreters = {"clmorph": sys.executable, "loop": sys.executable, "older": older}
        runs: dict = {entry: [] for entry in entries}
        for _ in range(rounds):
            for name, tol in entries:
                own = interpreters.get(name.split()[0]) or python
                runs[name, tol].append(in_own_process(name, tol, reach, file, own, truth))
    found = {entry: best(each) for entry, each in runs.items()}
    what = "balanced" if reach is None else f"reach {reach:g}"
    print(f"\n{count} problems of {n} x {n} points, {what}\n")
    columns = [f"clmorph, {device}: ms (ratio), with certificates" for device in devices]
    print(line("contestant", "ms a problem", "error", *columns))
    print(line(*["---"] * (3 + len(devices))))
    for peer in peers:
        theirs = found[peer, 0.0]
        if "failed" in theirs:
            print(line(peer, theirs["failed"], *[""] * (1 + len(devices))))
            continue
        (title, seconds), cells = next(iter(theirs["seconds"].items())), []
        for device in devices:
            exact = [found[f"clmorph {device}", tol] for tol in TOLERANCES]
            fit = [run for run in exact if run.get("error", np.inf) <= theirs["error"]]
            cells.append("not as exact")
            if fit:
                times = (fit[0]["seconds"][kind] for kind in ("batch", "certified"))
                cells[-1] = ", ".join(f"{1e3 * own:.3g} ({seconds / own:.1f}×)" for own in times)
        print(line(title, f"{1e3 * seconds:.3g}", f"{theirs['error']:.1e}", *cells))
    for kind, device in [(kind, device) for device in devices for kind in loops]:
        loop, batch = found[f"{kind} {device}", 1e-3], found[f"clmorph {device}", 1e-3]
        if "failed" in loop or "failed" in batch:
            print(line(device, loop.get("failed", "") + batch.get("failed", ""), ""))
            continue
        alone, own = loop["seconds"]["loop"], batch["seconds"]
        cells = [""] * len(devices)
        cells[devices.index(device)] = ", ".join(
            f"{1e3 * own[way]:.3g} ({alone / own[way]:.1f}×)" for way in ("batch", "certified")
        )
        version = "clmorph" if kind == "loop" else "the older clmorph"
        name = f"loop over {version}.sinkhorn, {device}, tol 10⁻³"
        print(line(name, f"{1e3 * alone:.3g}", f"{batch['error']:.1e}", *cells))
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--devices", nargs="+", help="parts of names; all usable ones if not given")
    parser.add_argument("--reach", type=float, nargs="+", default=[REACH, np.inf])
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--older", help="an interpreter with an earlier version of clmorph")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--measure", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        name, tol, reach, file = options.measure
        measure(name, float(tol), None if reach == "None" else float(reach), file)
        return
    devices = options.devices
    if devices is None:
        from clmorph.backends.opencl.devices.find import find_devices

        devices = [device.index for device in find_devices() if device.usable]
    for n in options.points:
        for reach in options.reach:
            own = reach if np.isfinite(reach) else None
            compare(n, own, devices, options.python, options.rounds, options.older)


if __name__ == "__main__":
    main()
