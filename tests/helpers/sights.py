"""Pictures with faces, with things seen twice, and with neither, of scikit-image's wheel."""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates
from skimage import data

#: Pictures of scikit-image without any face.
FACELESS = (
    "brick.png", "cell.png", "chelsea.png", "coffee.png", "coins.png", "grass.png", "gravel.png",
    "horse.png", "hubble_deep_field.jpg", "ihc.png", "logo.png", "moon.png", "page.png",
    "retina.jpg", "rocket.jpg", "text.png",
)  # fmt: skip


def photograph(name):
    """Return a picture of scikit-image's wheel, (H, W, 3) in [0, 1]."""
    return np.asarray(Image.open(Path(data.__file__).parent / name).convert("RGB")) / 255.0


def without_faces(rng, count):
    """Yield pictures without a face: whole ones, and parts of them of random place and size."""
    for number in range(count):
        picture = photograph(FACELESS[number % len(FACELESS)])
        if number >= len(FACELESS):
            side = int(rng.uniform(0.3, 0.9) * min(picture.shape[:2]))
            top, left = (int(rng.integers(each - side + 1)) for each in picture.shape[:2])
            picture = picture[top : top + side, left : left + side]
        yield picture


def seen_again(picture, rng, strength=0.1):
    """Return a picture from another view and in another light, and the map of places to it.

    The map is projective: (n, 2) places of the picture to those of the view.
    """
    height, width = picture.shape[:2]
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], float)
    moved = corners + rng.uniform(-strength, strength, (4, 2)) * (width, height)
    rows = []
    for (x, y), (u, v) in zip(corners, moved, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    matrix = np.append(np.linalg.solve(rows, moved.ravel()), 1.0).reshape(3, 3)

    def mapped(places, matrix=matrix):
        found = np.column_stack((places, np.ones(len(places)))) @ matrix.T
        return found[:, :2] / found[:, 2:]

    y, x = np.mgrid[:height, :width]
    back = mapped(np.stack((x.ravel(), y.ravel()), axis=1), np.linalg.inv(matrix))
    view = np.stack(
        [map_coordinates(picture[..., k], back.T[::-1], order=1, mode="nearest") for k in range(3)],
        axis=-1,
    ).reshape(picture.shape)
    return np.clip(view**1.3 + rng.normal(0, 0.02, view.shape), 0, 1), mapped
