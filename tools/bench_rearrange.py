"""Measure `clmorph.rearrange`: times, gaps, likeness, and POT's BSP-OT given the same time.

``python tools/bench_rearrange.py --sizes 64 128 256`` prints a table. At 64 pixels a side and below
the cost is compared with that of SciPy's exact solver. POT (``pip install pot``, 0.9.7 or newer)
gets as many plans as fit into the time of clmorph; without POT its column is empty.
"""

import argparse
import time

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from skimage import data
from skimage.transform import resize

import clmorph

PHOTOGRAPHS = ("astronaut", "chelsea", "coffee")
PAIRS = (
    ("astronaut", "chelsea"), ("chelsea", "coffee"), ("astronaut", "astronaut mirrored"),
    ("coffee", "coffee mirrored"),
)  # fmt: skip
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: Longest side at which the exact solver is run.
EXACT = 64
#: The weight of color; the default of `clmorph.rearrange`.
WEIGHT = 2.0


def picture(name: str, side: int) -> np.ndarray:
    base, _, mirrored = name.partition(" ")
    image = resize(getattr(data, base)() / 255.0, (side, side), order=1, anti_aliasing=True)
    return np.asarray(image[:, ::-1] if mirrored else image, np.float32)


def luminance_error(image: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean(((image - other) @ LUMINANCE) ** 2)))


def bsp_ot(source: np.ndarray, target: np.ndarray, seconds: float) -> tuple[float, float]:
    """Return the cost that BSP-OT reaches in about these seconds, and the seconds it took."""
    from ot.bsp import compute_bspot_bijection

    began = time.perf_counter()
    compute_bspot_bijection(source, target, n_plans=2)
    each = (time.perf_counter() - began) / 2
    count = max(2, round(seconds / each))
    began = time.perf_counter()
    _, order, _ = compute_bspot_bijection(source, target, n_plans=count)
    taken = time.perf_counter() - began
    return float(np.square(source - target[order]).sum(axis=1).mean() / 2), taken


def measure(names: tuple[str, str], side: int, device: str) -> None:
    a, b = (picture(name, side) for name in names)
    operations = clmorph.get_backend(device)
    clmorph.rearrange(a[:8, :8], b[:8, :8], backend=operations)  # builds the kernels
    began = time.perf_counter()
    found = clmorph.rearrange(a, b, size=None, color_weight=WEIGHT, backend=operations)
    seconds = time.perf_counter() - began
    clouds = [clmorph.lift(image, WEIGHT).points for image in (a, b)]
    exact = ""
    if side <= EXACT:
        cost = cdist(*clouds, "sqeuclidean") / 2
        optimum = cost[linear_sum_assignment(cost)].mean()
        exact = f"{found.cost / optimum - 1:.2%}"
    try:
        rival, taken = bsp_ot(*clouds, seconds)
        pot = f"{rival / found.lower_bound - 1:.2%} in {taken:.1f} s"
    except ImportError:
        pot = ""
    likeness = luminance_error(found[-1], b) / luminance_error(a, b)
    print(
        f"| {' to '.join(names)} | {side} | {seconds:.1f} s | {found.cost:.5f} | "
        f"{found.cost / found.lower_bound - 1:.2%} | {exact} | {pot} | {likeness:.2f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--device", default="auto")
    given = parser.parse_args()
    print(
        "| pictures | side | time | cost | above the bound | above the optimum | "
        "BSP-OT above the bound | luminance error |\n|---|---|---|---|---|---|---|---|"
    )
    for side in given.sizes:
        for names in PAIRS:
            measure(names, side, given.device)


if __name__ == "__main__":
    main()
