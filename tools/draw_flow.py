"""Draw gradient flows of the Sinkhorn divergence: ``python tools/draw_flow.py out.png``.

First row: 10,000 points, drawn at random from a star, flow into those of a ring; a point keeps its
color. Second row: the colors of the pixels of a photograph flow, as points in color space, into the
colors of another one, which stands at the end of the row. Each step moves a point x_i by
-rate / a_i times the derivative of the divergence by x_i.
"""

from collections.abc import Iterator

import numpy as np
from drawing import parser, square
from drawn_pictures import logo
from PIL import Image

import clmorph

#: Points of the first row, side of a panel in pixels, and side of the photographs.
COUNT, SIDE, PHOTO = 10_000, 240, 100
#: Steps after which a panel is drawn, for both rows.
SHOWN = (0, 2, 5, 10, 25)
RATE = 0.25


def flow(
    points: np.ndarray, target: np.ndarray, blur: float, steps: int, backend
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield points (N, D) before every step of a flow to those of a target, and the divergence."""
    weights = np.full(len(points), 1 / len(points))
    theirs = np.full(len(target), 1 / len(target))
    for _ in range(steps + 1):
        loss = clmorph.sinkhorn_divergence(
            (weights, points), (theirs, target), blur, tol=1e-3, backend=backend, gradient=True
        )
        yield points, loss.value
        points = points - RATE * loss.gradient.source_points / weights[:, None]


def sampled(name: str, rng: np.random.Generator) -> np.ndarray:
    """Return random points of the foreground of a drawn picture: (COUNT, 2), x and y in [0, 1]."""
    inside = np.argwhere((logo(name, 256) < 1).any(axis=2))
    chosen = inside[rng.integers(len(inside), size=COUNT)] + rng.random((COUNT, 2))
    return chosen[:, ::-1] / 256


def panel(points: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Draw points as dots on white: (SIDE, SIDE, 3) bytes."""
    sums = np.zeros((SIDE, SIDE, 4))
    x, y = np.clip(points * SIDE, 0, SIDE - 1).astype(int).T
    np.add.at(sums, (y, x), np.column_stack((colors, np.ones(len(colors)))))
    covered = np.minimum(sums[..., 3:], 1.0)
    mean = sums[..., :3] / np.maximum(sums[..., 3:], 1.0)
    return np.rint(255 * (mean * covered + (1 - covered))).astype(np.uint8)


def points_row(backend) -> np.ndarray:
    """Return the first row of the drawing."""
    rng = np.random.default_rng(0)
    source, target = sampled("star", rng), sampled("ring", rng)
    angle = 2 * np.pi * source[:, :1] + np.array([0.0, 2.1, 4.2])
    colors = np.hstack((0.5 + 0.4 * np.cos(angle[:, :2]), source[:, 1:]))
    panels = []
    for number, (points, loss) in enumerate(flow(source, target, 0.03, SHOWN[-1], backend)):
        if number in SHOWN:
            print(f"points, step {number}: divergence {loss:.3g}")
            panels.append(panel(points, colors))
    return np.hstack([*panels, panel(target, np.full((COUNT, 3), 0.35))])


def colors_row(backend) -> np.ndarray:
    """Return the second row of the drawing."""
    cuts = {"chelsea": (75, 0, 300), "coffee": (100, 0, 400)}
    source, target = (square(name, cut, PHOTO) / 255 for name, cut in cuts.items())
    steps, panels = SHOWN[-1], []
    both = source.reshape(-1, 3), target.reshape(-1, 3)
    for number, (colors, loss) in enumerate(flow(*both, 0.05, steps, backend)):
        if number in SHOWN:
            print(f"colors, step {number}: divergence {loss:.3g}")
            panels.append(colors.reshape(source.shape))
    row = np.hstack([*panels, target])
    picture = Image.fromarray(np.rint(255 * np.clip(row, 0, 1)).astype(np.uint8))
    return np.asarray(picture.resize((SIDE * (len(SHOWN) + 1), SIDE), Image.Resampling.BICUBIC))


def main() -> None:
    given = parser(__doc__).parse_args()
    backend = clmorph.get_backend(given.device)
    rows = np.vstack([points_row(backend), colors_row(backend)])
    Image.fromarray(rows).save(given.output, optimize=True)


if __name__ == "__main__":
    main()
