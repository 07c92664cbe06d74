"""The pictures that frames show at both ends, which can have more pixels than what is lifted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clmorph._shared.typing import AnyArray, Array
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.measures.measure import Measure


@dataclass(frozen=True, eq=False)
class End:
    """A picture that frames show at one end."""

    #: sRGB in [0, 1]: (H, W, 3) array; of large pictures in float32.
    colors: AnyArray
    #: Opacity, (H, W); None if all pixels are opaque.
    alpha: Array | None
    #: How pixels map to positions, see `clmorph.lift`.
    extent: str

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.colors.shape[0], self.colors.shape[1]

    @property
    def canvas(self) -> Canvas:
        """Its pixels as the canvas of a frame."""
        return canvas_at(0.0, self.shape, self.shape, self.extent)

    @classmethod
    def of(cls, measure: Measure) -> End:
        """Return the picture whose pixels a measure has."""
        alpha = None if measure.alpha is None else measure.alpha.reshape(measure.shape)
        return cls(measure.colors.reshape(*measure.shape, 3), alpha, measure.extent)


def ends_of(
    measures: tuple[Measure, Measure], pictures: Sequence[AnyArray] | None = None
) -> tuple[End, End]:
    """Return both ends; opaque pictures, (H, W, 3), can replace the pixels of the measures."""
    if pictures is None:
        return End.of(measures[0]), End.of(measures[1])
    first, second = (
        End(picture, None, measure.extent)
        for picture, measure in zip(pictures, measures, strict=True)
    )
    return first, second
