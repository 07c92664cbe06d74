"""Lift two images to two measures that can be compared."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from clmorph._shared.typing import ArrayLike
from clmorph.backends.arrays import as_array
from clmorph.errors import InputError
from clmorph.images.color import ColorSpace
from clmorph.measures.lift import NoMassError, lift
from clmorph.measures.measure import Measure
from clmorph.measures.options import Extent, LiftOptions, Mass


def lift_pair(
    images: tuple[ArrayLike, ArrayLike],
    color_weight: float = LiftOptions.color_weight,
    *,
    weights: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    mass: Mass = LiftOptions.mass,
    extent: Extent = LiftOptions.extent,
    color_space: ColorSpace = LiftOptions.color_space,
    color_metric: ArrayLike | None = None,
) -> tuple[Measure, Measure]:
    """Lift two images with the same options, as `clmorph.morph` does.

    The maps (H, W) of mass in `weights` are not normalized. If one of them is None, `mass` gives
    its distribution, with the total of the other map. A map as `color_metric` belongs to the source
    alone. See `clmorph.lift` for the rest.
    """
    maps = _pair_of_weights(weights)
    found = []
    for letter, image, given, metric in zip(
        "ab", images, maps, _metrics(color_metric), strict=True
    ):
        try:
            found.append(
                lift(
                    image, color_weight, weights=given, mass=mass, extent=extent,
                    color_space=color_space, color_metric=metric,
                )
            )  # fmt: skip
        except NoMassError as error:
            raise InputError(str(error).replace("the image", f"image_{letter}")) from None
    return _of_equal_mass(found[0], found[1], maps)


def _pair_of_weights(weights: Any) -> tuple[Any, Any]:
    """Return the maps of mass of both images."""
    if weights is None:
        return None, None
    if not isinstance(weights, tuple | list) or len(weights) != 2:
        raise InputError(
            "weights: expected a pair of maps (H, W), one for each image; None in it stands for "
            "the rule that `mass` names"
        )
    return weights[0], weights[1]


def _of_equal_mass(
    source: Measure, target: Measure, maps: tuple[Any, Any]
) -> tuple[Measure, Measure]:
    """Scale the masses of an image without a map to the total of the other image's map."""
    if maps[0] is None and maps[1] is not None:
        source = replace(source, weights=source.weights * (target.mass / source.mass))
    if maps[1] is None and maps[0] is not None:
        target = replace(target, weights=target.weights * (source.mass / target.mass))
    return source, target


def _metrics(metric: ArrayLike | None) -> tuple[Any, Any]:
    """Return the color metrics of source and target: a map belongs to the source alone."""
    if metric is None:
        return None, None
    array = as_array("color_metric", metric, "an array (3, 3), (H, W, 3, 3) or (H, W)")
    return array, array if array.shape == (3, 3) else None
