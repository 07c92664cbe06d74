"""Images with fewer pixels over the same extent."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_Real = TypeVar("_Real", np.float32, np.float64)


def reduced(image: NDArray[_Real], shape: tuple[int, ...]) -> NDArray[_Real]:
    """Return an image, (H, W, C), with fewer pixels, each the mean of the area that it covers."""
    if image.shape[:2] == shape:
        return image
    from skimage.transform import resize_local_mean

    small = resize_local_mean(image, shape, grid_mode=True, preserve_range=True, channel_axis=-1)
    return np.asarray(small, dtype=image.dtype)
