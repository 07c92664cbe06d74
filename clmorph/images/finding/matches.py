"""Points of one thing that is seen in two pictures: matches of local features that agree."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import AnyArray, Array, BoolArray
from clmorph.images.finding.reduced import Copy

#: Largest ratio of the distances to the best and to the second best match (Lowe, 2004).
RATIO = 0.8
#: Largest distance from one affine map, in longer sides, and number of trials.
TOLERANCE, TRIALS = 0.015, 500
#: Least number of matches that agree, and their least share of all matches.
FEWEST, SHARE = 10, 0.4
#: Largest factor between lengths in both pictures, and between two directions.
SCALE, SHEAR = 5.0, 2.5
#: Least standard deviation of the places along both axes, in longer sides.
SPREAD = 0.04
#: Number of matches that become landmarks, and their least distance in longer sides.
MOST, DISTANCE = 24, 0.03


class Features(NamedTuple):
    """Local features of a picture."""

    #: (n, 2), in pixels of the small copy.
    places: Array
    #: (n, 128).
    descriptors: AnyArray
    copy: Copy


def features(copy: Copy) -> Features:
    """Return the local features of a picture."""
    from skimage.feature import SIFT

    model = SIFT(upsampling=1)
    gray = copy.pixels @ np.array([0.2125, 0.7154, 0.0721]) / 255.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures without contrast
            model.detect_and_extract(gray)
    except RuntimeError:  # it found none
        return Features(np.zeros((0, 2)), np.zeros((0, 128)), copy)
    return Features(model.keypoints[:, ::-1].astype(float), model.descriptors, copy)


def matches(one: Features, other: Features) -> tuple[Array, Array]:
    """Return places (n, 2) of both pictures that show the same (Lowe, 2004); n can be 0."""
    from skimage.feature import match_descriptors

    none = np.zeros((0, 2)), np.zeros((0, 2))
    if min(len(one.places), len(other.places)) < FEWEST:
        return none
    pairs = match_descriptors(one.descriptors, other.descriptors, max_ratio=RATIO, cross_check=True)
    if len(pairs) < FEWEST:
        return none
    starts, ends = one.places[pairs[:, 0]], other.places[pairs[:, 1]]
    sides = [max(each.copy.pixels.shape[:2]) for each in (one, other)]
    agree = _agreeing(starts, ends, TOLERANCE * sides[1])
    if agree.sum() < max(FEWEST, SHARE * len(pairs)):
        return none
    starts, ends = starts[agree], ends[agree]
    for places, side in zip((starts, ends), sides, strict=True):
        if places.std(axis=0).min() < SPREAD * side:
            return none
    kept = _spread_out(starts, DISTANCE * sides[0])
    return one.copy.whole(starts[kept]), other.copy.whole(ends[kept])


def _agreeing(starts: Array, ends: Array, tolerance: float) -> BoolArray:
    """Return which pairs agree on one plausible affine map, found by random trials."""
    rng = np.random.default_rng(0)
    whole = np.column_stack((starts, np.ones(len(starts))))
    best = np.zeros(len(starts), bool)
    for _ in range(TRIALS):
        chosen = rng.choice(len(starts), 3, replace=False)
        if abs(np.linalg.det(whole[chosen])) < 1.0:  # on one line
            continue
        found = _inliers(whole, ends, np.linalg.solve(whole[chosen], ends[chosen]), tolerance)
        if found.sum() > best.sum():
            best = found
    if best.sum() < 3:
        return best
    return _inliers(whole, ends, np.linalg.lstsq(whole[best], ends[best], rcond=None)[0], tolerance)


def _inliers(whole: Array, ends: Array, matrix: AnyArray, tolerance: float) -> BoolArray:
    sizes = np.linalg.svd(matrix[:2], compute_uv=False)
    plausible = np.linalg.det(matrix[:2]) > 0 and sizes[1] > 1 / SCALE and sizes[0] < SCALE
    if not plausible or sizes[0] > SHEAR * sizes[1]:
        return np.zeros(len(ends), bool)
    return np.asarray(np.hypot(*(whole @ matrix - ends).T) < tolerance)


def _spread_out(places: Array, distance: float) -> list[int]:
    """Return numbers of places, each of which is the farthest from those before it."""
    kept = [int(np.argmin(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))]
    away = np.hypot(*(places - places[kept[0]]).T)
    while len(kept) < MOST and away.max() > distance:
        kept.append(int(np.argmax(away)))
        away = np.minimum(away, np.hypot(*(places - places[kept[-1]]).T))
    return kept
