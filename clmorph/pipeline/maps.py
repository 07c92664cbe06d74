"""Arrays that belong to images beside their pixels: masses, metrics, labels, features.

Features are further coordinates of the cost, such as depth or what a network sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.printable import reason_of
from clmorph._shared.typing import AnyArray, Array, IntArray
from clmorph._shared.validation import is_path
from clmorph.backends.arrays import as_floats
from clmorph.backends.interface import MAX_LIFTED
from clmorph.errors import FileError, InputError
from clmorph.images.label_maps import (
    as_labels,
    read_labels,
    read_npy,
    reduced_labels,
    reduced_values,
)
from clmorph.images.pixels import MAX_PIXELS, read_image
from clmorph.measures.measure import Measure, with_more

Shape = tuple[int, int]

#: Coordinates that position and color take.
OWN = 5
#: Largest feature times its weight.
MAX_FEATURE = 1e6
_EXPECTED = "numbers (H, W) or (H, W, K), one or K for each pixel"


@dataclass(frozen=True, eq=False)
class Maps:
    """Arrays beside two images, as `clmorph.morph` takes them; None where there are none."""

    weights: Any = None
    color_metric: Any = None
    labels: Any = None
    features: Any = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays that are given."""
        return tuple(each.name for each in fields(self) if getattr(self, each.name) is not None)

    def _checked(
        self, name: str, check: Callable[..., AnyArray], expected: str, shapes: Sequence[Shape]
    ) -> tuple[AnyArray, AnyArray] | None:
        """Return the checked labels, or features, of pictures of these shapes; None without."""
        value = getattr(self, name)
        if value is None:
            return None
        usable = isinstance(value, tuple | list) and len(value) == 2
        if not usable or is_path(value) or any(each is None for each in value):
            raise InputError(f"{name}: expected a pair of {expected}, one for each image")
        first, second = (
            check(f"{name} of image_{letter}", each, shape)
            for letter, each, shape in zip("ab", value, shapes, strict=True)
        )
        return first, second

    def labels_of(
        self, measures: tuple[Measure, Measure], shapes: Sequence[Shape]
    ) -> tuple[IntArray, IntArray] | None:
        """Return the labels of the pixels of two measures; None if there are none."""
        whole = self._checked("labels", as_labels, "label images (H, W) of integers", shapes)
        if whole is None:
            return None
        first, second = (
            reduced_labels(each, measure.shape)
            for each, measure in zip(whole, measures, strict=True)
        )
        return first, second

    def added(
        self, measures: tuple[Measure, Measure], shapes: Sequence[Shape], weight: Any
    ) -> tuple[Measure, Measure]:
        """Return measures with the features, if there are any."""
        whole = self._checked("features", as_features, "arrays (H, W) or (H, W, K)", shapes)
        return measures if whole is None else with_features(measures, whole, weight)


#: What stands in place of the files of labels where these are to be found in the pictures.
AUTO_LABELS = (Path("auto"), Path("auto"))
#: No arrays.
NO_MAPS = Maps()


def read_maps(labels: Sequence[Path], features: Sequence[Path], max_pixels: int) -> Maps:
    """Read label images and features of two pictures, if given; labels can be `AUTO_LABELS`."""
    found = tuple(labels) == AUTO_LABELS
    return Maps(
        labels=AUTO_LABELS[0].name
        if found
        else tuple(read_labels(path, max_pixels=max_pixels) for path in labels) or None,
        features=tuple(read_features(path, max_pixels=max_pixels) for path in features) or None,
    )


def as_features(name: str, value: Any, shape: tuple[int, int]) -> Array:
    """Return features of an image of this shape, (H, W) or (H, W, K), as (H, W, K) float64."""
    if is_path(value):
        raise InputError(f"{name} is a path: expected an array {_EXPECTED}; read the file first")
    array = as_floats(name, value, _EXPECTED)
    given = array.shape
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[:2] != shape or not array.shape[2]:
        raise InputError(
            f"{name} have shape {given}: expected {shape}, the shape of their picture as it is "
            "given, or K such maps along a third axis"
        )
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name}: it holds NaN or infinity; expected finite numbers")
    return array


def with_features(
    measures: tuple[Measure, Measure],
    features: Sequence[Array],
    weight: float | Sequence[float] = 1.0,
) -> tuple[Measure, Measure]:
    """Return measures of lifted images whose cost compares features, too.

    The cost of a pair grows by |w (F_i - G_j)|^2 / 2. Features F and G are (H, W, K) arrays of the
    size of their images, or larger ones, reduced by their mean in each pixel; w, one or K weights,
    is the image sides that a feature of 1 is worth.
    """
    if any(measure.has_metric_map for measure in measures):
        raise InputError(
            "features cannot be combined with a color_metric for each pixel: give one metric for "
            "all pixels, or no features"
        )
    counts = [each.shape[2] for each in features]
    if counts[0] != counts[1]:
        raise InputError(
            f"features of image_a have {counts[0]} coordinates, those of image_b {counts[1]}: "
            "expected the same"
        )
    weights = np.asarray(weight, float)
    if weights.ndim and len(weights) != counts[0]:
        raise InputError(
            f"feature_weight has {len(weights)} numbers, but there are {counts[0]} features: "
            "expected one for all, or one for each"
        )
    room = MAX_LIFTED - OWN
    if counts[0] > room:
        raise InputError(
            f"features have {counts[0]} coordinates: expected at most {room}, as the cost has "
            f"{MAX_LIFTED} in all and position and color take {OWN}; reduce them, by principal "
            "components for example"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # too large ones are refused below
        small = [
            reduced_values(each, measure.shape).reshape(len(measure), -1)
            for measure, each in zip(measures, features, strict=True)
        ]
        # Distances do not depend on the origin, but rounding does.
        middle = 0.5 * (small[0].mean(axis=0) + small[1].mean(axis=0))
        scaled = [weights * (each - middle) for each in small]
    largest = max(float(np.abs(each).max()) for each in scaled)
    if not largest <= MAX_FEATURE:
        raise InputError(
            f"features are up to {largest:.3g} with their weight: expected at most "
            f"{MAX_FEATURE:g}; scale them, or lower feature_weight"
        )
    return with_more(measures[0], scaled[0]), with_more(measures[1], scaled[1])


def read_features(path: Path, *, max_pixels: int = MAX_PIXELS) -> Array:
    """Read features, (H, W, K), from a ``.npy``, or from a picture, such as one of depth.

    A ``.npy`` holds (H, W) or (H, W, K) numbers. A gray picture is one feature from 0 (black) to 1,
    and one in color is three; a picture that is partly transparent is refused.
    """
    if path.suffix.lower() != ".npy":
        pixels = read_image(path, max_pixels=max_pixels)
        if pixels.shape[2] == 4:
            raise FileError(
                f"{path} is transparent in parts, which have no features: save it without opacity"
            )
        gray = np.array_equal(pixels[..., :1] + np.zeros(3), pixels)
        return pixels[..., :1] if gray else pixels
    try:
        found = read_npy(path, max_pixels)
    except InputError:
        raise
    except Exception as error:  # damaged files raise exceptions of any class
        raise FileError(f"{path}: features cannot be read ({reason_of(error)})") from None
    try:
        return as_features(str(path), found, found.shape[:2])
    except InputError as error:
        raise FileError(str(error)) from None
