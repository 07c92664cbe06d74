"""Compare `clmorph.assignment` with SciPy's exact solver, in cost and in time.

    python tools/bench_assignment.py [--device intel] [--sizes 4096 10000] [--repeats 1]

Points are uniform in 2D, 3D and 5D, and pixels of two of scikit-image's pictures in position and
color; `--hard` adds heavy tails, few places with many points, and far groups of other sizes. The
time of SciPy includes that of the matrix of costs; the time of clmorph includes everything but a
first small problem, which builds the kernels. Both are seconds, and those of processors, which
other work on the machine changes less. `--gap 0.005 --sides 64 256`
proves gaps for eight pairs of pictures alone, without SciPy.

couplr 1.6 (R) publishes, on other hardware, 7.3 s for a certified assignment of 6,667 points to
13,333; `--rectangular` runs a problem of this size.
"""

import argparse
import time

import numpy as np
from benching import OF_KERNELS, KernelClock, profiled
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from skimage import data
from skimage.color import gray2rgb
from skimage.transform import resize

import clmorph
from clmorph.backends.interface import Operations

#: Unlike pictures of scikit-image: portraits, things, a drawing, textures, and a page.
PAIRS = [
    ("astronaut", "coffee"), ("chelsea", "rocket"), ("retina", "brick"), ("coins", "page"),
    ("astronaut", "page"), ("retina", "rocket"), ("moon", "chelsea"), ("horse", "gravel"),
]  # fmt: skip


def pictures(n: int, names: tuple[str, str] = PAIRS[0]) -> tuple[np.ndarray, np.ndarray]:
    side, made = round(n**0.5), []
    for name in names:
        whole = getattr(data, name)() * 1.0
        whole = gray2rgb(whole) if whole.ndim == 2 else whole
        cut = whole[: min(whole.shape[:2]), : min(whole.shape[:2])] / whole.max()
        small = resize(cut, (side, side), anti_aliasing=True)
        made.append(clmorph.lift(small, color_weight=2.0).points)
    return made[0], made[1]


def hard(n: int, rng: np.random.Generator) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return clouds that take long."""
    centers = 10 * rng.random((5, 2))
    first, second = (centers[rng.integers(0, 5, n)] + 0.01 * rng.random((n, 2)) for _ in range(2))
    return {
        "tails": (rng.standard_normal((n, 3)), rng.standard_normal((n, 3)) ** 3),
        "places": (rng.integers(0, 8, (n, 2)) * 1.0, rng.integers(0, 8, (n, 2)) * 1.0),
        "groups": (first, second),
    }


def clocks() -> np.ndarray:
    """Return the seconds of a clock and of the processors."""
    return np.array([time.perf_counter(), time.process_time()])


def compared(name: str, x: np.ndarray, y: np.ndarray, backend: Operations, repeats: int) -> None:
    times = []
    for _ in range(repeats):
        clock, began = KernelClock(backend), clocks()
        found = clmorph.assignment(x, y, backend=backend)
        times.append(clocks() - began)
    ours = np.min(times, axis=0)
    began = clocks()
    costs = cdist(x, y, "sqeuclidean") / 2 / len(x)
    cost = costs[linear_sum_assignment(costs)].sum()
    theirs = clocks() - began
    print(
        f"{name:>10} {len(x):6} x {len(y):6}: {ours[0]:.2f} s ({ours[1]:.2f} s of processors), "
        f"SciPy {theirs[0]:.2f} s ({theirs[1]:.2f} s), ratios {theirs[0] / ours[0]:.1f} "
        f"({theirs[1] / ours[1]:.1f}); relative difference of costs "
        f"{found.cost / cost - 1:+.1e}, proven gap {found.gap:.1e}"
        f"{told(clock)}",
        flush=True,
    )


def told(clock: KernelClock) -> str:
    """Return what kernels took, for the end of a line."""
    cells = zip(OF_KERNELS, clock.cells(), strict=True)
    return "".join(f"; {title} {cell}" for title, cell in cells if cell)


def proven(names: tuple[str, str], side: int, gap: float, backend: Operations) -> None:
    """Print how long a gap between two pictures takes."""
    clouds = pictures(side * side, names)
    clock, began = KernelClock(backend), clocks()
    found = clmorph.assignment(*clouds, gap=gap, backend=backend)
    wall, own = clocks() - began
    print(
        f"{' and '.join(names)} {side}²: {wall:.1f} s ({own:.1f} CPU seconds), proven gap "
        f"{found.gap:.2e}{told(clock)}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--sizes", type=int, nargs="*", default=[4096, 10_000])
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--rectangular", action="store_true")
    parser.add_argument("--hard", action="store_true", help="clouds that take long, too")
    parser.add_argument("--gap", type=float, default=0.005, help="of --sides")
    parser.add_argument("--sides", type=int, nargs="*", default=[], help="of pictures")
    options = parser.parse_args()
    rng, backend = np.random.default_rng(0), profiled(options.device)
    clmorph.assignment(rng.random((300, 5)), rng.random((300, 5)), backend=backend)
    for side in options.sides:
        for names in PAIRS:
            proven(names, side, options.gap, backend)
    for n in [] if options.sides else options.sizes:
        for dimension in (2, 3, 5):
            clouds = rng.random((n, dimension)), rng.random((n, dimension))
            compared(f"uniform {dimension}D", *clouds, backend, options.repeats)
        compared("pictures", *pictures(n), backend, options.repeats)
        for name, clouds in hard(n, rng).items() if options.hard else ():
            compared(name, *clouds, backend, options.repeats)
    if options.rectangular:
        clouds = rng.random((6_667, 5)), rng.random((13_333, 5))
        compared("uniform 5D", *clouds, backend, options.repeats)


if __name__ == "__main__":
    main()
