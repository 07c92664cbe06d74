"""Compare `clmorph.assignment` with SciPy's exact solver, in cost and in time.

    python tools/bench_assignment.py [--device intel] [--sizes 4096 10000] [--repeats 1]

Points are uniform in 5D and in 2D, and pixels of two of scikit-image's pictures in position and
color. The time of SciPy includes that of the matrix of costs; the time of clmorph includes
everything but a first small problem, which builds the kernels. `--gap 0.005 --sides 64 128 256`
proves gaps for pictures alone, without SciPy.

couplr 1.6 (R) publishes, on other hardware, 7.3 s for a certified assignment of 6,667 points to
13,333; `--rectangular` runs a problem of this size.
"""

import argparse
import time

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from skimage import data
from skimage.transform import resize

import clmorph


def pictures(n: int) -> tuple[np.ndarray, np.ndarray]:
    side = round(n**0.5)
    made = [
        resize(each[: min(each.shape[:2]), : min(each.shape[:2])], (side, side), anti_aliasing=True)
        for each in (data.astronaut(), data.coffee())
    ]
    first, second = (clmorph.lift(each, color_weight=2.0).points for each in made)
    return first, second


def compared(name: str, x: np.ndarray, y: np.ndarray, device: str, repeats: int) -> None:
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        found = clmorph.assignment(x, y, backend=device)
        times.append(time.perf_counter() - began)
    began = time.perf_counter()
    costs = cdist(x, y, "sqeuclidean") / 2 / len(x)
    cost = costs[linear_sum_assignment(costs)].sum()
    theirs = time.perf_counter() - began
    print(
        f"{name:>10} {len(x):6} x {len(y):6}: {min(times):7.1f} s, SciPy {theirs:7.1f} s, ratio "
        f"{theirs / min(times):5.1f}; cost {found.cost:.9g}, relative difference "
        f"{found.cost / cost - 1:+.1e}, proven gap {found.gap:.1e}",
        flush=True,
    )


def proven(side: int, gap: float, device: str) -> None:
    """Print how long a gap between two pictures takes."""
    clouds = pictures(side * side)
    began = time.perf_counter()
    found = clmorph.assignment(*clouds, gap=gap, backend=device)
    seconds = time.perf_counter() - began
    print(f"pictures {side}²: {seconds:7.1f} s, proven gap {found.gap:.2e}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--sizes", type=int, nargs="*", default=[4096, 10_000])
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--rectangular", action="store_true")
    parser.add_argument("--gap", type=float, default=0.005, help="of --sides")
    parser.add_argument("--sides", type=int, nargs="*", default=[], help="of pictures")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    clmorph.assignment(rng.random((300, 5)), rng.random((300, 5)), backend=options.device)
    for side in options.sides:
        proven(side, options.gap, options.device)
    for n in [] if options.sides else options.sizes:
        for dimension in (5, 2):
            clouds = rng.random((n, dimension)), rng.random((n, dimension))
            compared(f"uniform {dimension}D", *clouds, options.device, options.repeats)
        compared("pictures", *pictures(n), options.device, options.repeats)
    if options.rectangular:
        clouds = rng.random((6_667, 5)), rng.random((13_333, 5))
        compared("uniform 5D", *clouds, options.device, options.repeats)


if __name__ == "__main__":
    main()
