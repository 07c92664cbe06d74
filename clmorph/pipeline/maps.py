"""Arrays that belong to images beside their pixels: masses, metrics, labels, features."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from clmorph._shared.typing import AnyArray, IntArray
from clmorph._shared.validation import is_path
from clmorph.errors import InputError
from clmorph.images.label_maps import as_labels, read_labels, reduced_labels
from clmorph.measures.features import as_features, read_features, with_features
from clmorph.measures.measure import Measure

Shape = tuple[int, int]


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
