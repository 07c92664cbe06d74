"""clmorph's functions with settings of their own: tests here do not depend on the defaults.

The settings are the paper's where it has some, with exact ends, and nothing is reduced or drawn at
random, so that images of a few pixels show what is tested.
"""

from typing import Any

from plain_options import COLOR_WEIGHT, PLAIN

import clmorph
from clmorph import reference as dense
from clmorph.pipeline.options import MorphOptions

OPTIONS = MorphOptions(**PLAIN)
STRENGTHS = {name: PLAIN[name] for name in ("blur", "reach")}

#: Arguments of `morph` and `inspect` that are arrays.
MAPS = ("weights", "color_metric", "labels", "features")


def morph(image_a, image_b, *numbers, backend="auto", **given) -> Any:
    given |= dict(zip(("n_frames", "blur", "reach"), numbers, strict=False))
    own = {name: given.pop(name) for name in (*MAPS, "progress") if name in given}
    return clmorph.morph(image_a, image_b, OPTIONS.replace(**given), backend=backend, **own)


def inspect(image_a, image_b, **given) -> Any:
    own = {
        name: given.pop(name)
        for name in (*MAPS, "progress", "backend", "divergence", "max_bytes")
        if name in given
    }
    return clmorph.inspect(image_a, image_b, OPTIONS.replace(**given), **own)


def lift(image, color_weight=COLOR_WEIGHT, **options) -> Any:
    return clmorph.lift(image, color_weight, **options)


def _with_strengths(function: Any) -> Any:
    def called(source, target, *more, **options) -> Any:
        names = ("blur", "reach")[len(more) :]
        for name, other in (("blur", "epsilon"), ("reach", "rho")):
            if name in names and options.get(other) is None:
                options.setdefault(name, STRENGTHS[name])
        return function(source, target, *more, **options)

    return called


sinkhorn = _with_strengths(clmorph.sinkhorn)
sinkhorn_divergence = _with_strengths(clmorph.sinkhorn_divergence)


class reference:  # noqa: N801 (stands for the module)
    """`clmorph.reference`, likewise."""

    sinkhorn = staticmethod(_with_strengths(dense.sinkhorn))

    @staticmethod
    def morph(image_a, image_b, n_frames=30, **given) -> Any:
        usual = {"extent": "true", "unmatched": "fade", "log_threshold": None}
        return dense.morph(image_a, image_b, n_frames=n_frames, **{**usual, **given})


for _name, _value in vars(dense).items():
    if not _name.startswith("_") and not hasattr(reference, _name):
        setattr(reference, _name, staticmethod(_value) if callable(_value) else _value)
