"""Images with fewer or more pixels over the same extent."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.records import Affine

Float32 = NDArray[np.float32]
_Real = TypeVar("_Real", np.float32, np.float64)


def reduced(image: NDArray[_Real], shape: tuple[int, ...]) -> NDArray[_Real]:
    """Return an image (H, W) or (H, W, C) with fewer pixels, each the mean of its area."""
    if image.shape[:2] == shape:
        return image
    height, width = image.shape[:2]
    down, along = (_areas(many, few) for many, few in zip((height, width), shape, strict=True))
    rows = down.astype(image.dtype) @ image.reshape(height, -1)
    rows = rows.reshape(shape[0], width, -1).swapaxes(0, 1).reshape(width, -1)
    small = (along.astype(image.dtype) @ rows).reshape(shape[1], shape[0], *image.shape[2:])
    return np.ascontiguousarray(small.swapaxes(0, 1))


def _areas(many: int, few: int) -> Any:
    """Return the share of each of many pixels in each of few along a side, a sparse matrix."""
    from scipy.sparse import csr_array

    edges = np.linspace(0, many, few + 1)
    pixels = np.floor(edges[:-1, None]).astype(int) + np.arange(-(-many // few) + 1)
    shares = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
    shares = np.maximum(shares, 0.0) * (few / many)
    starts = pixels.shape[1] * np.arange(few + 1)
    # Beyond the last pixel all shares are 0.
    found = (shares.ravel(), np.minimum(pixels, many - 1).ravel(), starts)
    return csr_array(found, shape=(few, many))


class Enlarged:
    """An image (h, w) in float32 on a canvas, linear between its pixels and constant outside.

    `way` says where the canvas, of a `shape`, stands on the image. A few rows can be had at a time.
    """

    def __init__(self, image: Float32, way: Affine, shape: tuple[int, int]) -> None:
        (self._above, self._down), (left, along) = (
            _between(origin, step, few, many)
            for origin, step, few, many in zip(
                way.origin, way.step, image.shape, shape, strict=True
            )
        )
        right = np.minimum(left + 1, image.shape[1] - 1)
        self._lines = image
        if image.shape[1] != shape[1] or along.any():
            # Indices of the second axis would take several times as long.
            self._lines = image.take(left, axis=1)
            self._lines += (image.take(right, axis=1) - self._lines) * along

    def rows(self, rows: slice = slice(None)) -> Float32:
        """Return the image on some rows of the canvas."""
        above, down = self._above[rows], self._down[rows, None]
        if not down.any():
            return self._lines[above]
        below = np.minimum(above + 1, len(self._lines) - 1)
        return np.asarray(self._lines[above] * (1 - down) + self._lines[below] * down)


def _between(
    origin: float, step: float, few: int, many: int
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the pixel before each place along a side, and how far it is after that."""
    # Rounded: where both have the same pixels, nothing lies between them.
    places = np.clip(np.round(origin + step * np.arange(many), 9), 0, few - 1)
    first = np.minimum(places.astype(np.intp), max(few - 2, 0))
    return first, (places - first).astype(np.float32)
