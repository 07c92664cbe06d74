"""The landmarks of morphs: those that are given, or those that are found in the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from clmorph.backends.interface import MAX_LIFTED
from clmorph.errors import InputError
from clmorph.images.finding.common import Finder, figures
from clmorph.measures.landmark_options import AUTO, MAX_LANDMARKS, Landmarks, is_for_several
from clmorph.measures.warp import agreeing
from clmorph.pipeline.maps import NO_MAPS, OWN, Maps
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import Picture


class Guided(NamedTuple):
    """The landmarks of one or several morphs, and the options that name them."""

    options: MorphOptions
    each: list[Landmarks]
    #: What was found, in a line; "" if nothing was sought or found.
    found: str

    def of(self, number: int) -> MorphOptions:
        """Return the options of one of several morphs."""
        if not is_for_several(self.options.landmarks):
            return self.options
        return self.options.replace(landmarks=self.each[number] or None)


def guides(
    images: Sequence[Picture],
    pairs: Sequence[tuple[int, int]],
    options: MorphOptions,
    maps: Maps = NO_MAPS,
) -> Guided:
    """Return the landmarks of morphs between pairs of images, and find them if options say so."""
    given: Any = options.landmarks
    if given != AUTO:
        known: list[Landmarks] = list(given) if is_for_several(given) else [given or ()]
        if given and len(known) != len(pairs):
            raise InputError(
                f"landmarks of {_morphs(len(known))} given: expected those of "
                f"{_morphs(len(pairs))}, as pairs of points, or a list of such pairs for each morph"
            )
        return Guided(options, known if given else [() for _ in pairs], "")
    each: list[Landmarks] = []
    lines: list[str] = []
    room = _has_room(maps)
    sides = [max(image.shape[:2]) for image in images]
    finder = Finder(images)
    for one, other in pairs:
        landmarks, text = _found(finder, sides, (one, other)) if room else ((), "")
        each.append(landmarks)
        if text:
            which = f"pictures {one + 1} and {other + 1}: " if len(pairs) > 1 else ""
            lines.append(which + text)
    chosen: Any = None
    if any(each):
        chosen = tuple(each) if len(pairs) > 1 else each[0]
    return Guided(options.replace(landmarks=chosen), each, "; ".join(lines))


def labeled(images: Sequence[Picture], maps: Maps) -> tuple[Maps, str]:
    """Return maps whose labels are arrays, and what was found if they were "auto"."""
    if not (isinstance(maps.labels, str) and maps.labels == AUTO):
        return maps, ""
    found = figures(images)
    if found is None:
        return replace(maps, labels=None), "no figure before a background in both pictures"
    shares = " and ".join(f"{mask.mean():.0%}" for mask in found)
    text = f"one figure in each picture, on {shares} of the pixels"
    return replace(maps, labels=tuple(mask.astype(np.int8) for mask in found)), text


def _morphs(count: int) -> str:
    return "one morph" if count == 1 else f"{count} morphs"


def _has_room(maps: Maps) -> bool:
    """Return whether landmarks go with the arrays beside the images, which are checked later."""
    try:
        if maps.color_metric is not None and np.shape(maps.color_metric) != (3, 3):
            return False
        pair = maps.features if isinstance(maps.features, tuple | list) else ()
        shapes = [np.shape(each) for each in pair]
    except ValueError:  # lists that differ in length
        return False
    counts = [shape[2] if len(shape) == 3 else 1 for shape in shapes]
    return max(counts, default=0) < MAX_LIFTED - OWN


def _found(finder: Finder, sides: Sequence[int], pair: tuple[int, int]) -> tuple[Any, str]:
    """Return landmarks of two images, whose longer sides are given, and what they are."""
    found = finder.common(*pair)
    if not found.text:
        return (), ""
    one, other = pair
    kept = agreeing(found.starts / sides[one], found.ends / sides[other])
    starts, ends = (places[kept][:MAX_LANDMARKS] for places in (found.starts, found.ends))
    text = found.text.replace(f"{len(found.starts)} points", f"{len(starts)} points")
    marks = tuple(
        ((x, y), (u, v)) for (x, y), (u, v) in zip(starts.tolist(), ends.tolist(), strict=True)
    )
    return marks, text
