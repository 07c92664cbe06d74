"""All options of a morph: the classes of the stages joined, and the rules between their fields.

``MorphOptions()`` is the default of `clmorph.morph` and of ``clmorph morph``.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from clmorph._shared.option_kinds import integer, number
from clmorph._shared.options import Options, is_off, option, specifications, text_of, with_default
from clmorph._shared.validation import as_float, check_choice, check_flag, shown
from clmorph.errors import InputError
from clmorph.frames.options import BULGING, GAMMA, LAYERS, RenderOptions
from clmorph.measures.landmark_options import GuideOptions
from clmorph.measures.options import LiftOptions
from clmorph.output.options import FrameStyle, PlaybackOptions
from clmorph.pipeline.presets import AUTO, FINE_BLOCKS, PRESETS, drafted
from clmorph.transport.options import PlanOptions, Reach, SolverOptions
from clmorph.transport.regularization import regularization

#: Pairs of options that exclude each other, and why; one that is set later replaces the other.
ALTERNATIVES = {
    ("blur", "epsilon"): "epsilon is the square of blur",
    ("reach", "rho"): "rho is the square of reach",
    ("fps", "duration"): "both decide the pace",
    ("sample", "barycentric"): "random draws and mean destinations exclude one another",
    ("log_threshold", "sample"): "random draws are of the whole plan",
    ("log_threshold", "barycentric"): "mean destinations are of the whole plan",
}
#: Options of the kernel with which particles draw detail, and their values where they ask nothing.
OF_PARTICLES = {
    "gamma": None,
    "sigma": None,
    "splatting": "local",
    "sigma_start": "auto",
    "sigma_end": "auto",
    "endpoints": "exact",
}
#: Error message for options without a divergence, by which optimal widths could be found.
NO_DIVERGENCE = (
    "sigma='optimal' needs a divergence: one reach for both images, and one color metric for all "
    "pixels"
)


def _check_memory(name: str, value: Any) -> float:
    number = as_float(value)
    if number is None or not 1.0 <= number <= 1e18:
        raise InputError(
            f"{name}={shown(value)}: expected bytes in Python, or gigabytes in the command "
            "line, above 0"
        )
    return number


@dataclass(frozen=True, init=False)
class BudgetOptions(Options):
    """Options that limit the cost of a morph: sizes, particles, memory."""

    size: int | None = option(
        256, integer(2, 1 << 16),
        "Reduce pictures to this longer side before anything else, sprites to whole blocks; "
        "none: keep them whole.",
        "Transport", unit="pixels",
    )  # fmt: skip
    solve_size: int | None = option(
        64, integer(2, 1 << 16),
        "Solve the transport between square blocks of pixels, at most this number along the "
        "longer side, and draw with pixels. The side of a block is 1, 2, 4, ... pixels, so there "
        "may be fewer blocks. none: solve between pixels. The default is 128 for particles, cells, "
        "sprites and drawings.",
        "Transport", unit="blocks",
    )  # fmt: skip
    max_particles: int | None = option(
        1_500_000, integer(1, 1 << 31),
        "If the plan has more pairs, draw about this number of particles from it, but at least "
        "one for each pixel; none: keep all pairs.",
        "Transport",
    )  # fmt: skip
    max_memory: float | None = option(
        None, replace(number(1.0, 1e18), check=_check_memory),
        "Memory that the morph may take; if the plan needs more, fewer particles are drawn; "
        "none: half of the device's memory.",
        "Transport", unit="GB", scale=1e9,
    )  # fmt: skip


@dataclass(frozen=True, init=False)
class MorphOptions(
    FrameStyle,
    PlaybackOptions,
    RenderOptions,
    PlanOptions,
    BudgetOptions,
    SolverOptions,
    GuideOptions,
    LiftOptions,
):
    """All options of `clmorph.morph`, by keywords; the preset sets options that are not given.

    Parameters
    ----------
    preset : str, optional
        A name of `clmorph.pipeline.presets.PRESETS`; "photo" if none is given. The preset "auto" is
        for `clmorph.morph`, which knows the pictures.
    draft : bool
        Whether size, particles, frames and accuracy are reduced to those of a first look, unless
        they are given (`clmorph.pipeline.presets.DRAFT`).
    **given
        Options, see `clmorph.morph`.

    Raises
    ------
    InputError
        If an option is unknown, its value cannot be used, or options contradict one another.

    Examples
    --------
    >>> from clmorph import MorphOptions
    >>> options = MorphOptions(blur=0.02, preset="balanced")
    >>> options.blur, options.reach
    (0.02, None)
    >>> options.replace(rho=0.04).as_dict()["rho"]
    0.04
    """

    #: A morph lets mass fade by default, unlike `clmorph.sinkhorn`.
    reach: Reach = with_default(SolverOptions, "reach", 0.3)

    alternatives = ALTERNATIVES
    replacing = tuple(ALTERNATIVES)[:3]

    def __init__(self, *, preset: str | None = None, draft: bool = False, **given: Any) -> None:
        chosen = preset_options(preset)
        if check_flag("draft", draft):
            chosen |= drafted(chosen)
        super().__init__(**self.layered((chosen, given)))

    @classmethod
    def joined(
        cls,
        given: Mapping[str, Any],
        preset: str | None,
        file: Mapping[str, Any],
        *,
        preset_wins: bool,
        draft: bool = False,
    ) -> Self:
        """Join a preset, a file of settings, and what is given beside them, which wins."""
        chosen = preset_options(preset)
        below = cls.layered((file, chosen) if preset_wins else (chosen, file))
        if draft:
            below |= drafted(below)
        return cls(**cls.layered((below, given)))

    @classmethod
    def layered(cls, layers: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
        """Merge layers as `Options.layered` does, and settle who draws the detail."""
        settings: dict[str, Any] = {}
        for layer in layers:
            below = settings.get("detail", "layers")
            settings = super().layered((settings, layer))
            _settle_gamma(settings, layer)
            _settle_detail(settings, layer, below)
        return settings

    def settle(self, values: dict[str, Any]) -> dict[str, Any]:
        """Fill in and compare values; see `Options.settle`."""
        for name, other in (("blur", "epsilon"), ("fps", "duration")):
            if values[name] is None and values[other] is None:
                values[name] = getattr(type(self), name)
        if values["splatting"] in BULGING and values["gamma"] is None:
            values["gamma"] = GAMMA
        found = regularization(*(values[name] for name in ("blur", "reach", "epsilon", "rho")))
        if values["rho"] is None:
            values["reach"] = found.reach
        # Store plain floats, with the value that was given and not with a recomputed one.
        for name in ("epsilon", "rho"):
            values[name] = _plain(values[name])
        given = [
            f"{name}={text_of(values[name])}"
            for name, neutral in OF_PARTICLES.items()
            if values[name] != neutral
        ]
        detail, splatting = values["detail"], values["splatting"]
        if detail != "particles" and given:
            raise InputError(
                f"detail={detail!r} and {', '.join(given)} contradict: these options are for "
                "detail='particles'; leave one side out"
            )
        if values["sigma"] is None:
            return values
        if splatting not in (*BULGING, "local"):
            raise InputError(
                f"sigma='optimal' and splatting={splatting!r} contradict: expected splatting "
                "'adaptive' or 'local' with it; widths in pixels are sigma_start and sigma_end"
            )
        if isinstance(found.reach, tuple):
            raise InputError(NO_DIVERGENCE)
        return values

    def replace(self, **given: Any) -> Self:
        """Return a copy with some options replaced, but no preset and no draft: they set many."""
        for name in ("preset", "draft"):
            if name in given:
                raise InputError(
                    f"replace() does not accept {name}; construct MorphOptions({name}=...)"
                )
        return super().replace(**given)


def preset_options(name: str | None) -> dict[str, Any]:
    """Return all options that any preset sets, with their values in one ("photo" if None)."""
    if isinstance(name, str) and name == AUTO:
        raise InputError(
            "preset='auto' is chosen by the pictures: give it to clmorph.morph(a, b), or choose "
            f"one of {', '.join(map(repr, PRESETS))}"
        )
    chosen = PRESETS[check_choice("preset", "photo" if name is None else name, tuple(PRESETS))]
    decided = {option for preset in PRESETS.values() for option in preset.options}
    usual = {name: getattr(MorphOptions, name) for name in specifications(MorphOptions)}
    # Landmarks belong to pictures: only presets that must not have any decide them.
    decided.discard("landmarks")
    return {name: value for name, value in usual.items() if name in decided} | dict(chosen.options)


def _plain(value: Any) -> Any:
    """Return a checked number, or a pair of them, as floats."""
    if isinstance(value, list | tuple) or np.ndim(value):
        return tuple(as_float(part) for part in value)
    return as_float(value)


def _bulges(splatting: Any) -> bool:
    """Return whether an unchecked value of `splatting` is a rule of widths with gamma."""
    return isinstance(splatting, str) and splatting in BULGING


def _settle_gamma(settings: dict[str, Any], layer: Mapping[str, Any]) -> None:
    """Let gamma imply adaptive splatting, because no other splatting has gamma."""
    if layer.get("gamma") is not None:
        splatting = layer.get("splatting", "adaptive")
        if not _bulges(splatting):
            raise InputError(
                f"gamma={text_of(layer['gamma'])} belongs to adaptive splatting, not to "
                f"{shown(splatting)}: leave one of them out"
            )
        settings["splatting"] = splatting
    elif not _bulges(layer.get("splatting", "adaptive")):
        settings["gamma"] = None


def _settle_detail(settings: dict[str, Any], layer: Mapping[str, Any], below: Any) -> None:
    """Settle who draws the detail: later layers win, and a kernel's option asks for particles."""

    def asked(values: Mapping[str, Any]) -> set[str]:
        return {
            name for name, neutral in OF_PARTICLES.items()
            if name in values and not is_off(values[name], (neutral,))
        }  # fmt: skip

    gave_way = False
    if "detail" not in layer:
        if asked(layer) or "splatting" in layer:
            settings["detail"] = "particles"
    elif not is_off(layer["detail"], ("particles",)) and not asked(layer):
        if "splatting" not in layer:
            settings |= {name: OF_PARTICLES[name] for name in asked(settings)}
        elif asked(settings):
            # A preset decides the detail unless an option that no preset sets asks for particles.
            settings["detail"], gave_way = "particles", True
    # Layers of photographs are drawn along means of the plan, but each particle is seen. The blocks
    # of a preset that gives way are for its layers.
    seen = not is_off(settings.get("detail", "layers"), LAYERS) and is_off(below, LAYERS)
    usual = is_off(settings.get("solve_size"), (MorphOptions.solve_size,))
    if usual and (gave_way or (seen and "solve_size" not in layer)):
        settings["solve_size"] = FINE_BLOCKS


#: The paper's own options, for the reference and for the paper's baseline.
PAPER = MorphOptions(preset="paper", size=None)
