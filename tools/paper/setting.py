"""The inputs of one run of the reproduction, and the values that the paper has published."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import clmorph
from clmorph.backends.interface import Operations
from paper.pair import Pair

#: Section 4 of the paper; its axes are each stretched to [0, 1].
BLUR, REACH, COLOR_WEIGHT = 0.05, 0.3, 2.0
SIGMA_START, SIGMA_END, GAMMA = 1.2, 0.5, 0.5
#: Kernel width of its baseline.
FIXED_SIGMA = 0.5
#: How the paper's frames are made: Eq. 4 as printed up to both ends, and nothing drawn for mass
#: that does not travel. All pairs are kept that the relative rule keeps.
AS_PAPER: dict[str, Any] = {
    "preset": "paper", "size": None, "log_threshold": None,
    "blur": BLUR, "reach": REACH, "color_weight": COLOR_WEIGHT, "extent": "unit",
    "unmatched": "drop", "endpoints": "paper", "sigma_start": SIGMA_START,
    "sigma_end": SIGMA_END,
}  # fmt: skip
#: The same in words, for captions.
AS_PAPER_TEXT = (
    "blur 0.05, reach 0.3, λ 2, σ 1.2 to 0.5, γ 0.5, N_eff by kept pairs as in the authors' code, "
    "axes stretched to [0, 1]"
)
#: The authors' code takes this share of the number of kept pairs for N_eff, so that Eq. 3's floor
#: never acts; `clmorph` takes Kish's effective number.
COUNTED_SHARE = 0.8
#: Residual of converged solves here, in units of epsilon.
TOL = 1e-5

#: Side of the images of the published tables, in pixels.
PUBLISHED_SIZE = 48
#: Table 1: reach, largest and mean displacement in pixels.
PUBLISHED_DISPLACEMENTS: dict[float | None, tuple[float, float]] = {
    None: (28.85, 7.58),
    0.5: (29.32, 9.08),
    0.3: (27.73, 9.55),
    0.1: (17.88, 2.82),
    0.05: (9.86, 0.45),
    0.01: (0.00, 0.00),
}
#: Table 2: divergence to the target at t = 0, 1/4, 1/2, 3/4, 1.
PUBLISHED_DIVERGENCES = {
    "fixed": (0.0876, 0.0658, 0.0462, 0.0268, 0.0095),
    "adaptive": (0.0876, 0.0631, 0.0439, 0.0253, 0.0095),
}


@dataclass(frozen=True, eq=False)  # one run is like no other: results are kept for each
class Setting:
    """One run.

    Attributes
    ----------
    pair : Pair
    size : int
        Side of images, in pixels.
    quick : bool
        Fewer points and rows.
    operations : Operations
        The device.
    folder : Path
        Where files go.
    geomloss, published : bool
        Whether to run GeomLoss itself, and to print the published numbers.
    report : callable
        Called with the name of a section and the share of it done.
    """

    pair: Pair
    size: int
    quick: bool
    operations: Operations
    folder: Path
    geomloss: bool = False
    published: bool = False
    report: Callable[[str, float], None] = lambda stage, share: None

    def each(self, stage: str, items: Iterable[Any]) -> Iterator[Any]:
        """Go through items and show how many are done."""
        items = list(items)
        for number, item in enumerate(items):
            self.report(stage, number / len(items))
            yield item
        self.report(stage, 1.0)


def paper_morph(setting: Setting, images: Sequence[np.ndarray], **options: Any) -> clmorph.Morph:
    """Morph as the authors' code does, but with a solver that converges; `options` go on top."""
    one = clmorph.morph(
        *images, backend=setting.operations, **{**AS_PAPER, "n_frames": 2, **options}
    )
    counted = COUNTED_SHARE * len(one.plan)
    return replace(one, kernel_width=replace(one.kernel_width, n_start=counted, n_end=counted))


@dataclass(frozen=True)
class Section:
    """A table or figure, ready for the page.

    Attributes
    ----------
    name : str
        Of its files, ``name.png`` and ``name.csv``.
    title : str
    shows, parameters, says : str
        The caption: what is drawn, with which parameters, and what these numbers say.
    header, rows : sequences
        Of the CSV; numbers as they are.
    table : str, optional
        HTML of a table above the picture.
    """

    name: str
    title: str
    shows: str
    parameters: str
    says: str
    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    table: str = field(default="", repr=False)


def reach_name(reach: float | None) -> str:
    """Name a reach as the paper's tables do."""
    return "balanced" if reach is None else f"{reach:g}"


def reach_text(reach: float | None) -> str:
    """Name a reach in a sentence."""
    return "balanced" if reach is None else f"at reach {reach:g}"


def listed(parts: Sequence[str]) -> str:
    """Join parts with commas and an "and"."""
    return ", ".join(parts[:-1]) + (" and " if len(parts) > 1 else "") + parts[-1]


def signed(number: float, digits: int = 1) -> str:
    """Write a number with its sign."""
    return f"{number:+.{digits}f}".replace("-", "−")
