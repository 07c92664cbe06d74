"""Frontal faces by scikit-image's cascade of local binary patterns: their places and sizes.

A single pass finds faces in gravel. A face is therefore believed only if it is found at the same
place in copies of several sizes and in their mirror images, and resembles the mean face.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from PIL import Image

from clmorph._shared.typing import Array
from clmorph.images.finding.reduced import Bytes, Copy

#: Longer sides of the copies that are searched, and the side of the smallest face in each.
SIDES, SMALLEST = (128, 160, 192, 224, 256), 24
#: Shapes (common area by joint area) above which two finds are one, and below which they are two.
SAME = 0.5
#: Least correlation with the mean face, of 16 x 16 pixels.
LIKENESS, ACROSS = 0.2, 16
#: The mean of scikit-image's faces: left, top and side of its box, in sides of these pictures.
MEAN_BOX = (0.11, 0.09, 0.76)
#: Points that a box stands for: corners of a square around eyes and mouth, and its middle.
POINTS = np.array([[0.28, 0.36], [0.72, 0.36], [0.5, 0.58], [0.32, 0.82], [0.68, 0.82]])


def cascade_faces(copy: Copy) -> list[Array]:
    """Return points of each face's box, the largest first: (5, 2) arrays in pixels of the copy."""
    passes = _passes(copy.pixels)
    kept = [[box] for box in next(passes)]
    while kept and (found := next(passes, None)) is not None:
        kept = [[*each, near] for each in kept if (near := _nearest(each[0], found)) is not None]
    boxes: list[Array] = []
    for box in sorted((np.median(each, axis=0) for each in kept), key=lambda box: -box[2]):
        patch = _patch(copy.pixels.mean(axis=2), box)
        spread = np.linalg.norm(patch)
        alike = spread > 0 and np.sum(patch * _mean_face()) / spread >= LIKENESS
        if alike and all(_shared(box, other) <= 0.1 for other in boxes):
            boxes.append(box)
    return [box[:2] - 0.5 + box[2] * POINTS for box in boxes]


def _passes(pixels: Bytes) -> Iterator[list[Array]]:
    """Search copies and their mirror images; boxes are (left, top, side) in pixels."""
    longer = max(pixels.shape[:2])
    for side in SIDES:
        size = [max(1, round(each * side / longer)) for each in pixels.shape[1::-1]]
        if min(size) < SMALLEST:
            yield []
            return
        small = np.asarray(
            Image.fromarray(pixels).resize((size[0], size[1]), Image.Resampling.BICUBIC)
        )
        for mirrored in (False, True):
            seen = np.ascontiguousarray(small[:, ::-1] if mirrored else small)
            found = _cascade().detect_multi_scale(
                seen, scale_factor=1.15, step_ratio=1, min_size=(SMALLEST, SMALLEST),
                max_size=seen.shape[:2], min_neighbor_number=1,
            )  # fmt: skip
            boxes = []
            for each in found:
                left = size[0] - each["c"] - each["width"] if mirrored else each["c"]
                boxes.append(np.array([left, each["r"], each["width"]], float) * longer / side)
            yield boxes


def _nearest(box: Array, boxes: list[Array]) -> Array | None:
    """Return the box that shares most with another one; None if none is the same."""
    shares = [_shared(box, other) for other in boxes]
    return boxes[int(np.argmax(shares))] if max(shares, default=0.0) > SAME else None


@cache
def _cascade() -> Any:
    from skimage.data import lbp_frontal_face_cascade_filename
    from skimage.feature import Cascade

    return Cascade(lbp_frontal_face_cascade_filename())


def _shared(one: Array, other: Array) -> float:
    """Return the common area of two boxes, in units of their joint area."""
    low, high = np.maximum(one[:2], other[:2]), np.minimum(one[:2] + one[2], other[:2] + other[2])
    common = float(np.prod(np.maximum(high - low, 0.0)))
    return common / (float(one[2] ** 2 + other[2] ** 2) - common)


@cache
def _mean_face() -> Array:
    from skimage.data import lfw_subset

    faces = lfw_subset()[:100]  # the others are none
    patch = _patch(faces.mean(axis=0), np.array(MEAN_BOX) * faces.shape[1])
    return patch / np.linalg.norm(patch)


def _patch(gray: Array, box: Array) -> Array:
    """Return a box, blurred and reduced, with the mean 0."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    step = box[2] / ACROSS
    along = (np.arange(ACROSS) + 0.5) * step - 0.5
    places = np.meshgrid(box[1] + along, box[0] + along, indexing="ij")
    found = map_coordinates(gaussian_filter(gray, step / 2), places, order=1, mode="nearest")
    return np.asarray(found - found.mean())
