"""Images with more pixels over the same extent."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_Real = TypeVar("_Real", np.float32, np.float64)


def enlarged(
    image: NDArray[_Real], shape: tuple[int, int], first: int = 0, stop: int | None = None
) -> NDArray[_Real]:
    """Return rows of an image (H, W, C) enlarged linearly to `shape`, constant at its borders."""
    height, width = shape
    low, weight = _between(
        image.shape[0], height, np.arange(first, height if stop is None else stop)
    )
    found = _mixed(image, low, weight.astype(image.dtype)[:, None, None], axis=0)
    low, weight = _between(image.shape[1], width, np.arange(width))
    return _mixed(found, low, weight.astype(image.dtype)[:, None], axis=1)


def _between(
    few: int, many: int, pixels: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the lower one of the two of few pixels around each place, and the other's weight."""
    places = (pixels - (many - 1) / 2) * (few / many) + (few - 1) / 2
    places = np.clip(places, 0, few - 1)
    low = np.minimum(np.floor(places).astype(np.int64), max(few - 2, 0))
    return low, places - low


def _mixed(
    image: NDArray[_Real], low: NDArray[np.int64], weight: NDArray[_Real], axis: int
) -> NDArray[_Real]:
    if not weight.any():
        return image.take(low, axis)
    high = np.minimum(low + 1, image.shape[axis] - 1)
    found = image.take(low, axis)
    found += weight * (image.take(high, axis) - found)
    return found
