"""Draw barycenters of three shapes: ``python tools/draw_barycenters.py out.png``.

The shapes, as even densities on a grid, stand in the corners of a triangle. Between them are their
debiased barycenters with a fixed support, by the weights of the places. Dark is much mass.
"""

import numpy as np
from drawing import parser
from drawn_pictures import logo
from PIL import Image

import clmorph

#: Side of a shape's grid, enlargement and distance of the panels, in pixels.
SIDE, ZOOM, GAP = 64, 2, 8
#: Number of panels along a side of the triangle, and blur in image sides.
PANELS, BLUR = 5, 0.02


def densities() -> list[np.ndarray]:
    """Return the shapes as densities of mass 1, each (SIDE, SIDE)."""
    inside = [(logo(name, SIDE) < 1).any(axis=2) for name in ("star", "ring", "bars")]
    return [shape / shape.sum() for shape in inside]


def panel(density: np.ndarray) -> np.ndarray:
    """Return a density as a gray picture."""
    gray = 255 * (1 - np.minimum(1.0, density / np.quantile(density[density > 0], 0.98)))
    return np.kron(np.rint(gray).astype(np.uint8), np.ones((ZOOM, ZOOM), np.uint8))


def main() -> None:
    given = parser(__doc__).parse_args()
    backend = clmorph.get_backend(given.device)
    shapes = densities()
    cells = clmorph.density(np.ones((SIDE, SIDE))).points
    measures = [clmorph.WeightedPoints(cells, shape.ravel()) for shape in shapes]
    step = ZOOM * SIDE + GAP
    picture = np.full((step * PANELS - GAP, step * PANELS - GAP), 255, np.uint8)
    for row in range(PANELS):
        for column in range(row + 1):
            last = PANELS - 1
            weights = np.array([last - row, row - column, column]) / last
            if weights.max() == 1:
                mean = shapes[int(weights.argmax())]
            else:
                found = clmorph.barycenter(
                    measures, weights, support=cells, fixed=True, blur=BLUR, tol=0.01,
                    backend=backend,
                )  # fmt: skip
                mean = found.weights.reshape(SIDE, SIDE)
                print(f"{weights.round(2).tolist()}: {found.status} in {found.n_iter} iterations")
            top = row * step
            left = (PANELS - 1 - row) * step // 2 + column * step
            picture[top : top + ZOOM * SIDE, left : left + ZOOM * SIDE] = panel(mean)
    Image.fromarray(picture).save(given.output, optimize=True)


if __name__ == "__main__":
    main()
