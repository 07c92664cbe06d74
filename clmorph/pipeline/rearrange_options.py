"""All options of `clmorph.rearrange`, which are also those of ``clmorph rearrange``."""

from dataclasses import dataclass
from typing import Any, ClassVar
from warnings import warn

from clmorph._shared.option_kinds import number
from clmorph._shared.options import option, with_default
from clmorph.images.color import ColorSpace
from clmorph.measures.options import Extent, LiftOptions
from clmorph.output.options import FPS, FrameStyle, PlaybackOptions
from clmorph.pipeline.options import BudgetOptions
from clmorph.transport.options import PlanOptions


@dataclass(frozen=True, init=False)
class RearrangeOptions(FrameStyle, PlaybackOptions):
    """All options of `clmorph.rearrange`, by keywords.

    Parameters
    ----------
    **given
        Options, see `clmorph.rearrange`.

    Raises
    ------
    InputError
        If an option is unknown, its value cannot be used, or options contradict one another.

    Examples
    --------
    >>> from clmorph.pipeline.rearrange_options import RearrangeOptions
    >>> RearrangeOptions(gap=0.001).gap
    0.001
    """

    size: int | None = with_default(BudgetOptions, "size", BudgetOptions.size)
    #: Higher than for a morph: the pixels' colors are the only ones with which B can be drawn.
    color_weight: float = with_default(LiftOptions, "color_weight", 2.0)
    color_space: ColorSpace = with_default(LiftOptions, "color_space", LiftOptions.color_space)
    extent: Extent = with_default(LiftOptions, "extent", LiftOptions.extent)
    gap: float = option(
        0.005, number(0.0, 1e3),
        "Largest share by which the cost may exceed its lower bound; the search for a cheaper "
        "arrangement ends there.",
        "Transport", word="",
    )  # fmt: skip
    seed: int = with_default(PlanOptions, "seed", PlanOptions.seed)

    alternatives: ClassVar = {("fps", "duration"): "both decide the pace"}
    replacing = (("fps", "duration"),)

    def settle(self, values: dict[str, Any]) -> dict[str, Any]:
        """Without a pace, it is the usual one; see `Options.settle`."""
        if values["fps"] is None and values["duration"] is None:
            values["fps"] = FPS
        return values

    def of_lift(self) -> dict[str, Any]:
        """Return the options of `clmorph.lift`, by their names. Deprecated: use `of`."""
        warn(
            "of_lift() will be removed in clmorph 1.0: use of(LiftOptions)",
            DeprecationWarning, stacklevel=2,
        )  # fmt: skip
        return self.of(LiftOptions)
