"""Prepare a call: check its images, choose its options, and bring the images to their size."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph._shared.typing import AnyArray
from clmorph._shared.validation import check_flag, shown
from clmorph.backends.arrays import as_array
from clmorph.errors import InputError
from clmorph.images.kind import FEWEST_BLOCKS, kind_of
from clmorph.images.pixels import as_samples, block_size, fit, reduced_shape
from clmorph.images.resizing import as_unit
from clmorph.pipeline.maps import NO_MAPS, Maps
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PresetName, preset_for

Picture = NDArray[np.float64]

#: Of pictures with a longer side above this number of pixels, layers take their fields from the
#: particles of smaller copies: a field has at most 256 points along a side.
MOST_CARRIED = 512


def as_images(images: Sequence[ArrayLike]) -> list[AnyArray]:
    """Return images as `clmorph.images.pixels.as_samples` does, named in its error messages."""
    names = [f"image_{letter}" for letter in "ab"] if len(images) == 2 else [""] * len(images)
    return [as_samples(image, name) for image, name in zip(images, names, strict=True)]


def recognized(images: Iterable[AnyArray]) -> PresetName:
    """Return the preset for what images show, at the size at which they were given."""
    return preset_for(kind_of(image) for image in images)


def as_options(
    options: MorphOptions | None,
    preset: str | None,
    given: Any,
    images: Iterable[AnyArray],
    *,
    draft: bool = False,
) -> MorphOptions:
    """Return a call's options: those of an object or a preset, replaced by those by name."""
    if options is None:
        if preset is None or (isinstance(preset, str) and preset == AUTO):
            preset = recognized(images)
        return MorphOptions(preset=preset, draft=draft, **given)
    chosen = MorphOptions.of_call(options, given, "n_frames=30")
    if preset is not None:
        raise InputError(
            f"options and preset={shown(preset)} contradict: give one of them, or "
            "MorphOptions(preset=...)"
        )
    if check_flag("draft", draft):
        raise InputError(
            "options and draft=True contradict: give one of them, or MorphOptions(draft=True)"
        )
    return chosen


def fitted(
    images: Sequence[AnyArray], options: MorphOptions, beside: Maps = NO_MAPS
) -> list[Picture]:
    """Return images at the size at which they are drawn; InputError if one with a map shrinks."""
    weights = beside.weights if isinstance(beside.weights, tuple | list) else ()
    maps = [("weights", k) for k, each in enumerate(weights[:2]) if each is not None]
    if beside.color_metric is not None:
        expected = "an array (3, 3), (H, W, 3, 3) or (H, W)"
        if as_array("color_metric", beside.color_metric, expected).shape != (3, 3):
            maps.append(("color_metric", 0))
    small = [_reduced(image, options, bool(maps)) for image in images]
    for name, k in maps:
        if images[k].shape != small[k].shape:
            raise InputError(
                f"{name} is a map of the pixels of image_{'ab'[k]}, but size={options.size} "
                "reduces that image: give size=None, or an image of that size"
            )
    return small


def small_copies(
    images: Sequence[Picture], options: MorphOptions, beside: Maps = NO_MAPS
) -> list[Picture] | None:
    """Return smaller copies, whose pixels become particles for large pictures; None otherwise."""
    if not takes_copies([image.shape for image in images], options, beside):
        return None
    return [fit(image, MOST_CARRIED) for image in images]


def takes_copies(shapes: Sequence[tuple[int, ...]], options: MorphOptions, beside: Maps) -> bool:
    """Return whether `small_copies` of images with these shapes (H, W, C) are lifted."""
    drawn = options.detail == "layers" and options.endpoints == "exact" and options.sigma is None
    drawn = drawn and options.solve_size is not None and options.solve_size <= MOST_CARRIED
    if not drawn or beside.names:
        return False
    large = max(max(shape[:2]) for shape in shapes) > MOST_CARRIED
    return large and all(shape[2] == 3 for shape in shapes)


def lifted_shapes(
    shapes: Sequence[tuple[int, int, int]], options: MorphOptions, beside: Maps = NO_MAPS
) -> list[tuple[int, int, int]]:
    """Return about the shapes of what is lifted of fitted images: of smaller copies, or theirs."""
    if not takes_copies(shapes, options, beside):
        return list(shapes)
    return [(*reduced_shape(shape[:2], MOST_CARRIED), shape[2]) for shape in shapes]


def _reduced(image: AnyArray, options: MorphOptions, mapped: bool) -> Picture:
    """Return an image as it is drawn; blocks of a sprite become pixels unless they are `mapped`."""
    if options.size is None:
        return as_unit(image)
    if options.detail == "pixels" and not mapped:
        block = block_size(image)
        if max(image.shape[:2]) >= FEWEST_BLOCKS * block:
            image = image[::block, ::block]
    return fit(image, options.size)
