"""Count the solver's iterations on pairs of pictures: ``python tools/bench_iterations.py``.

Prints a Markdown table: for each blur and reach the worst over five pairs at 64 x 64, from a
cold start to a residual of 1e-3 epsilon, beside the plain iteration from zero. One iteration
is both updates; the two softmins that certify the result are not counted.
"""

import argparse

import numpy as np
from plain_options import COLOR_WEIGHT
from skimage import data
from skimage.transform import resize

from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.select import get_backend
from clmorph.cli.demo import demo_images
from clmorph.images.pixels import as_rgb
from clmorph.measures.lift import lift
from clmorph.measures.measure import Measure
from clmorph.transport._solver.problem import Problem
from clmorph.transport.sinkhorn import sinkhorn

SIDE = 64
#: blur, reach, and the most iterations that are accepted.
CASES = (
    (0.05, 0.3, 45),
    (0.05, 1.0, 100),
    (0.05, None, 170),
    (0.02, 0.3, 110),
    (0.01, 0.3, 220),
)


def photograph(name: str) -> np.ndarray:
    """Return the middle of a picture that comes with scikit-image."""
    pixels = as_rgb(getattr(data, name)())
    side = min(pixels.shape[:2])
    top, left = ((length - side) // 2 for length in pixels.shape[:2])
    square = pixels[top : top + side, left : left + side]
    return resize(square, (SIDE, SIDE), anti_aliasing=True)


def sprites() -> tuple[np.ndarray, np.ndarray]:
    """Return the demo's cat and an apple of 16 x 16 blocks."""
    cat = resize(demo_images()[0], (SIDE, SIDE), order=0, anti_aliasing=False)
    y, x = np.mgrid[:16, :16]
    apple = np.ones((16, 16, 3))
    apple[12:] = 0.3, 0.55, 0.25
    apple[(y - 8.5) ** 2 + (x - 7.5) ** 2 < 32] = 0.85, 0.15, 0.12
    apple[(y - 6) ** 2 + (x - 5) ** 2 < 3] = 1.0, 0.75, 0.7
    apple[1:4, 7:9] = 0.4, 0.25, 0.1
    return cat, np.kron(apple, np.ones((SIDE // 16, SIDE // 16, 1)))


def pairs() -> dict[str, tuple[Measure, Measure]]:
    """Return the five pairs, lifted."""
    cat, apple = sprites()
    photos = {name: photograph(name) for name in ("chelsea", "astronaut", "coffee", "rocket")}
    images = {
        "demo": (cat, photos["chelsea"]),
        "astronaut to chelsea": (photos["astronaut"], photos["chelsea"]),
        "coffee to astronaut": (photos["coffee"], photos["astronaut"]),
        "rocket to coffee": (photos["rocket"], photos["coffee"]),
        "sprites": (cat, apple),
    }
    return {name: (lift(a, COLOR_WEIGHT), lift(b, COLOR_WEIGHT)) for name, (a, b) in images.items()}


def plain_iterations(pair: tuple[Measure, Measure], device: str, blur: float, reach) -> str:
    """Count iterations of f = Delta T(g), g = Delta T(f) from zero."""
    rho = np.inf if reach is None else reach**2
    problem, epsilon = Problem.between(get_backend(device), *pair, (rho, rho)), blur**2
    source, target = problem.damping(epsilon)
    g, f, most = np.zeros(len(problem.b)), None, 1500
    for number in range(most):
        f_new = source * problem.softmin_rows(g, epsilon, True)
        if f is not None and np.abs(f_new - f).max() <= 1e-3 * epsilon:
            return str(number)
        f, g = f_new, target * problem.softmin_columns(f_new, epsilon, True)
    return f"over {most}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plain", action="store_true", help="count the plain iteration too")
    options = parser.parse_args()
    devices = [device for device in find_devices() if device.usable]
    names = [f"{device.platform} {device.driver}" for device in devices]
    columns = ["blur", "reach", "at most", *names, "mean"]
    if options.plain:
        columns.append("plain iteration")
    print("| " + " | ".join(columns) + " |")
    print("|---" * len(columns) + "|")
    measures = pairs()
    for blur, reach, limit in CASES:
        worst, counts = [], []
        for device in devices:
            results = [
                sinkhorn(*pair, blur, reach, backend=device.index) for pair in measures.values()
            ]
            assert all(result.converged for result in results)
            counts += [result.n_iter for result in results]
            worst.append(max(result.n_iter for result in results))
        cells = [blur, "balanced" if reach is None else reach, limit, *worst]
        cells.append(f"{np.mean(counts):.0f}")
        if options.plain:
            cells.append(plain_iterations(measures["demo"], devices[0].index, blur, reach))
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
