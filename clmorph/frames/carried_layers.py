"""Layers of moving pictures: fields that are known at some pairs of frames, and carried between.

Both pictures of a film move along fields (`layers`). Where the pictures are frames of clips, the
fields of a pair belong to its moment. Between two such moments they are mixed by time, point by
point, and so are the places where both pictures agree and the times at which places change hands.
All of these are continuous in time, so nothing jumps where a pair is solved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import End
from clmorph.frames.fields import Field
from clmorph.frames.layers import Layers, follow
from clmorph.frames.moved_layer import layer_of
from clmorph.frames.pictures import Pictures
from clmorph.frames.resampling import reduced
from clmorph.frames.switching import switched

Array = NDArray[np.float64]


class Moment(NamedTuple):
    """What is known of two moving pictures at one moment; see `Layers`."""

    fields: tuple[Field, ...]
    agreement: Array
    times: Array

    @classmethod
    def of(cls, layers: Layers) -> Moment:
        """Return what the layers of a pair of frames say."""
        return cls(tuple(layers.fields), layers.agreement, layers.times)

    def towards(self, other: Moment, share: float) -> Moment:
        """Return the moment at a share, from 0 to 1, of the time to another one."""

        def mixed(first: Array, second: Array) -> Array:
            return first + share * (second - first)

        fields = tuple(
            one._replace(move=mixed(one.move, two.move), change=mixed(one.change, two.change))
            for one, two in zip(self.fields, other.fields, strict=True)
        )
        return Moment(
            fields, mixed(self.agreement, other.agreement), mixed(self.times, other.times)
        )

    def frame(
        self, t: float, pictures: tuple[Array, Array], canvas: Canvas, extent: str, space: str,
        operations: Operations,
    ) -> NDArray[np.floating]:  # fmt: skip
        """Draw two opaque pictures, (H, W, 3) each, on a canvas at the time t of their film."""
        ends = [End(picture, None, extent) for picture in pictures]
        drawn = Pictures(ends, (canvas, canvas), None, space, operations)
        layers = [
            layer_of(
                field._replace(guide=reduced(own, field.canvas.shape)),
                follow(field, drawn.stage, operations), operations,
            )
            for field, own in zip(self.fields, drawn.own, strict=True)
        ]  # fmt: skip
        second = switched(self.times, self.agreement, t)
        thin = np.zeros(drawn.stage.shape)  # figures alone are lines
        return drawn.frame(
            layers, (t, 1 - t), (1 - t, t), (1 - second, second), self.agreement, thin, canvas
        )
