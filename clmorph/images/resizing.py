"""Images at another size: what `skimage.transform.resize` computes, in bands and without copies.

Smoothing and interpolation are linear and act on rows and columns alone, so both are one sparse
matrix for each. Where scikit-image smooths the whole image first, only the rows and columns that
are kept are computed.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from clmorph._shared.typing import AnyArray, Array

#: Radius of the smoothing, in standard deviations, as in SciPy.
TRUNCATE = 4.0
#: Number of rows that are computed at a time.
BAND = 8


def resized(
    image: AnyArray,
    shape: tuple[int, int],
    mode: Literal["mirror", "edge"] = "edge",
    *,
    weighted: bool = False,
) -> Array:
    """Return an image (H, W, C) as `as_unit` does, at another size: linear, smoothed if smaller."""
    (height, width), channels = image.shape[:2], image.shape[2]
    if (height, width) == shape:
        return as_unit(image, weighted=weighted)
    down, along = _weights(height, shape[0], mode), _weights(width, shape[1], mode)
    rows = np.empty((shape[0], width * channels))
    for start in range(0, shape[0], BAND):
        band = down[start : start + BAND]
        first, last = band.indices.min(), band.indices.max() + 1
        part = as_unit(image[first:last], weighted=weighted)
        rows[start : start + BAND] = band[:, first:last] @ part.reshape(last - first, -1)
    columns = np.moveaxis(rows.reshape(shape[0], width, channels), 1, 0).reshape(width, -1)
    made = (along @ columns).reshape(shape[1], shape[0], channels)
    return np.ascontiguousarray(np.moveaxis(made, 0, 1))


def as_unit(samples: AnyArray, *, weighted: bool = False) -> Array:
    """Return samples (H, W, C) as float64, integers in [0, 1]; `weighted` multiplies by opacity."""
    if samples.dtype.kind == "u":
        made = samples / float(np.iinfo(samples.dtype).max)
    else:
        made = samples.astype(np.float64, copy=weighted)
    if weighted:
        made[..., :3] *= made[..., 3:]
    return made


def _weights(before: int, after: int, mode: str) -> Any:
    """Return the sparse matrix (after, before) of weights along one axis."""
    from scipy.sparse import csr_array

    factor = before / after
    sigma = max(0.0, (factor - 1) / 2)
    radius = int(TRUNCATE * sigma + 0.5)
    smooth = np.ones(1)
    if radius:
        smooth = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
        smooth /= smooth.sum()
    place = (np.arange(after) + 0.5) * factor - 0.5
    lower = np.floor(place).astype(int)
    share = (place - lower)[:, None]
    weights = (1 - share) * np.append(smooth, 0.0) + share * np.append(0.0, smooth)
    columns = lower[:, None] + np.arange(-radius, radius + 2)
    if mode == "edge":
        columns = np.clip(columns, 0, before - 1)
    else:
        period = max(1, 2 * before - 2)
        columns = np.abs(columns) % period
        columns = np.minimum(columns, period - columns) if before > 1 else columns * 0
    rows = np.broadcast_to(np.arange(after)[:, None], columns.shape)
    return csr_array((weights.ravel(), (rows.ravel(), columns.ravel())), shape=(after, before))
