"""All options of `clmorph.rearrange`, which are also those of ``clmorph rearrange``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from clmorph._shared.option_kinds import number
from clmorph._shared.options import option, specifications, with_default
from clmorph.errors import InputError
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
        "Share of the lower bound by which the cost may exceed it; the search for a cheaper "
        "arrangement ends there.",
        "Transport", word="",
    )  # fmt: skip
    seed: int = with_default(PlanOptions, "seed", PlanOptions.seed)

    def settle(self, values: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
        """Let a duration replace the frame rate; see `Options.settle`."""
        if given.get("duration") is not None:
            if given.get("fps") is not None:
                raise InputError(
                    "fps and duration contradict (both decide the pace): give one of them"
                )
            values["fps"] = None
        elif values["fps"] is None:
            values["fps"] = FPS
        return values

    def as_dict(self) -> dict[str, Any]:
        """Return the effective options by their names, without replaced alternatives."""
        settings = super().as_dict()
        del settings["fps" if settings["duration"] is not None else "duration"]
        return settings

    def replace(self, **given: Any) -> Self:
        """Return a copy of these options with some replaced.

        Parameters
        ----------
        **given
            Options, see `clmorph.rearrange`.

        Raises
        ------
        InputError
            The errors of `RearrangeOptions`.
        """
        settings = self.as_dict()
        for name, other in (("fps", "duration"), ("duration", "fps")):
            if given.get(name) is not None:
                settings.pop(other, None)
        return type(self)(**settings | given)

    def of_lift(self) -> dict[str, Any]:
        """Return the options of `clmorph.lift`, by their names."""
        known = specifications(type(self))
        return {name: getattr(self, name) for name in specifications(LiftOptions) if name in known}
