"""Find landmarks: points that correspond in two pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph.errors import InputError
from clmorph.images.finding.cascade import cascade_faces
from clmorph.images.finding.matches import features, matches
from clmorph.images.finding.mesh import mesh_faces, mesh_missing, person
from clmorph.images.finding.reduced import small_copy

#: Longer sides of the copies in which meshes, and all else, are found.
MESHED, SEARCHED = 640, 256
#: Largest number of points of all faces.
MOST_POINTS = 256
#: Least shorter side of a picture in which anything is sought, in pixels.
LEAST = 48


class Found(NamedTuple):
    """Points that two pictures have in common."""

    #: (n, 2), in pixels of each picture; n is 0 if nothing was found.
    starts: Array
    ends: Array
    #: What was found, in a few words; "" if nothing was.
    text: str


NOTHING = Found(np.zeros((0, 2)), np.zeros((0, 2)), "")


class Finder:
    """Finds what images (H, W, 3 or 4) have in common; what is known of one is kept."""

    def __init__(self, images: Sequence[Array]) -> None:
        self._images, self._missing = images, mesh_missing()
        self._faces_of = cache(partial(_faces, images, not self._missing))
        self._features_of = cache(lambda of: features(small_copy(images[of], SEARCHED)))

    def common(self, one: int, other: int) -> Found:
        """Find points that correspond in two images: of faces, or else of things in both."""
        pair = one, other
        shapes = [self._images[number].shape[:2] for number in pair]
        if min(min(shape) for shape in shapes) < LEAST:
            return NOTHING
        if self._faces_of(one) and self._faces_of(other):
            faces = [self._faces_of(number) for number in pair]
            pairs = _paired(faces[0], faces[1], shapes)
            most = MOST_POINTS // len(pairs)
            starts, ends = (
                np.vstack([faces[side][chosen[side]][:most] for chosen in pairs]) for side in (0, 1)
            )
            number = "one face" if len(pairs) == 1 else f"{len(pairs)} faces"
            more = f", of place and size alone; {self._missing}" if self._missing else ""
            return Found(starts, ends, f"{number} in each picture: {len(starts)} points{more}")
        places = matches(*(self._features_of(number) for number in pair))
        if not len(places[0]):
            return NOTHING
        return Found(*places, f"the same thing in both pictures: {len(places[0])} points")


def _faces(images: Sequence[Array], meshed: bool, number: int) -> list[Array]:
    """Return points of the faces of an image, in its pixels; the largest face comes first."""
    copy = small_copy(images[number], MESHED if meshed else SEARCHED)
    return [copy.whole(face) for face in (mesh_faces if meshed else cascade_faces)(copy)]


def figures(images: Sequence[Array]) -> list[BoolArray] | None:
    """Return what stands before the ground in two images, (H, W): opaque parts, or a person."""
    found = []
    for image in images:
        if image.shape[2] == 4:
            found.append(image[..., 3] > 0)
            continue
        missing = mesh_missing()
        if missing:
            raise InputError(f"labels='auto' cannot look for people: {missing}")
        mask = person(small_copy(image, SEARCHED))
        if mask is None:
            return None
        rows, columns = (
            np.minimum((np.arange(side) + 0.5) * small / side, small - 1).astype(int)
            for side, small in zip(image.shape[:2], mask.shape, strict=True)
        )
        found.append(mask[rows][:, columns])
    return found


def _paired(
    one: Sequence[Array], other: Sequence[Array], shapes: Sequence[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Pair faces by size and place; of the larger number the smallest are left over."""
    from scipy.optimize import linear_sum_assignment

    count = min(len(one), len(other))
    marks = []
    for faces, shape in zip((one, other), shapes, strict=True):
        rows = []
        for face in faces[:count]:
            size = np.log(np.ptp(face[:, 0]) / max(shape))
            rows.append([*(face.mean(axis=0) / (shape[1], shape[0])), 0.25 * size])
        marks.append(np.array(rows))
    costs = np.linalg.norm(marks[0][:, None] - marks[1], axis=2)
    rows_of, columns = linear_sum_assignment(costs)
    return list(zip(rows_of.tolist(), columns.tolist(), strict=True))
