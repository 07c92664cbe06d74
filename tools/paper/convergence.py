"""Section 5's open question: the convergence of frames to the geodesic with growing resolution."""

from typing import Any

import numpy as np

import clmorph
from clmorph.frames.as_measure import frame_measure, particle_measure
from paper import drawing
from paper.pair import SMOOTHNESS
from paper.setting import (
    AS_PAPER,
    AS_PAPER_TEXT,
    FIXED_SIGMA,
    TOL,
    Section,
    Setting,
    listed,
    paper_morph,
)

#: Sides of the images; the last is what the others are compared with.
SIDES, QUICK_SIDES = (12, 16, 24, 32, 48, 64), (8, 12, 16, 24, 32)
#: The middle of the path, where frames are farthest from both images.
MIDDLE = 0.5
#: Widths: the paper's two rules.
RULES: dict[str, dict[str, Any]] = {
    "adaptive": {},
    "fixed": {"splatting": "fixed", "sigma_start": FIXED_SIGMA},
}
REFERENCES = {"frame": "to the finest frame", "particles": "to the finest particles"}


def convergence(setting: Setting) -> list[Section]:
    """Measure frames of growing images against the finest."""
    sides = QUICK_SIDES if setting.quick else SIDES
    frames: dict[tuple[str, int], Any] = {}
    for side in setting.each("Section 5", sides):
        images = setting.pair.sampled(side)
        for rule, options in RULES.items():
            one = paper_morph(setting, images, tol=TOL, **options)
            frames[rule, side] = frame_measure(one, MIDDLE)
    particles, spread = particle_measure(one, MIDDLE)
    rows: list[list[Any]] = []
    rates = {}
    for rule, reference in setting.each(
        "Rates", [(rule, reference) for reference in REFERENCES for rule in RULES]
    ):
        finest = frames[rule, sides[-1]] if reference == "frame" else particles
        compared = sides[:-1] if reference == "frame" else sides
        values = []
        for side in compared:
            found = clmorph.sinkhorn_divergence(
                frames[rule, side], finest, AS_PAPER["blur"], AS_PAPER["reach"], 1e-4,
                backend=setting.operations,
            )  # fmt: skip
            values.append(found.value)
            rows.append([reference, rule, side * side, found.value, *found.interval])
        counts = np.array(compared, float) ** 2
        values = np.maximum(values, 1e-12)
        rates[reference, rule] = counts, values, _fit(counts, values, 0.0), _limit(counts, values)
    _draw(setting, rates)
    told = [
        f"N^{rates[reference, rule][2][0]:.2f} {name} for {rule} widths"
        for reference, name in REFERENCES.items()
        for rule in RULES
    ]
    falls = all(np.all(np.diff(values) < 0) for _, values, *_ in rates.values())
    limits = [f"{rates['particles', rule][3]:.2g} for {rule} widths" for rule in RULES]
    finest = sides[-1]
    return [
        Section(
            "convergence",
            "Section 5: convergence as N grows",
            f"Divergence of the frame at t = {MIDDLE:g} from images of N pixels to that from the "
            f"finest ones, N = {finest}², and to the finest particles themselves, which stand for "
            "the geodesic. Frames are measures weighted by their kernel mass. Dotted: fitted "
            "powers of N; dashed: with a limit, as averages of colors may stay away "
            "from the geodesic. Nearness to a finest frame of the same rule flatters the largest "
            f"N; particles are merged before (by {spread:.2g} image sides, root mean square).",
            f"N = {', '.join(f'{side}²' for side in sides)}: cell means of the pictures, smoothed "
            f"by {SMOOTHNESS:g} sides beforehand so that all N show the same ones; "
            f"{AS_PAPER_TEXT}; fixed: σ {FIXED_SIGMA:g}.",
            f"Fitted, S falls as {listed(told)}; "
            + ("every curve falls all the way. " if falls else "not every curve all the way. ")
            + f"With a limit allowed, S to the particles tends to {listed(limits)}.",
            ["to", "rule", "N", "divergence", "certainly at least", "certainly at most"],
            rows,
        )
    ]


def _draw(setting: Setting, rates: dict[tuple[str, str], Any]) -> None:
    figure, panels = drawing.panels(1, 2, height=3.0, sharey=True)
    for (reference, rule), (counts, values, (slope, level), limit) in rates.items():
        axes = panels[0][list(REFERENCES).index(reference)]
        color, style = (drawing.BLUE, "o") if rule == "adaptive" else (drawing.RED, "s")
        axes.loglog(counts, values, style, color=color, label=f"{rule}: $N^{{{slope:.2f}}}$")
        axes.loglog(counts, np.exp(level) * counts**slope, ":", color=color)
        if reference == "particles":
            power, height = _fit(counts, values, limit)
            fine = np.geomspace(counts[0], counts[-1])
            axes.loglog(fine, limit + np.exp(height) * fine**power, "--", color=color, linewidth=1)
        axes.set(xlabel="N, pixels of each image", title=REFERENCES[reference])
        axes.set_xticks(counts, [f"{round(n**0.5)}²" for n in counts])
        axes.minorticks_off()
        axes.legend()
    panels[0][0].set_ylabel("Sinkhorn divergence S")
    drawing.save(figure, setting.folder / "convergence.png")


def _fit(counts: np.ndarray, values: np.ndarray, limit: float) -> tuple[float, float]:
    """Return p and log c of values = limit + c N^p, by least squares of logarithms."""
    slope, level = np.polyfit(np.log(counts), np.log(values - limit), 1)
    return float(slope), float(level)


def _limit(counts: np.ndarray, values: np.ndarray) -> float:
    """Return the limit with which such a law fits best, of those from 0 to the least value."""

    def error(limit: float) -> float:
        slope, level = _fit(counts, values, limit)
        fitted = limit + np.exp(level) * counts**slope
        return float(np.sum(np.log(fitted / values) ** 2))

    return min(np.linspace(0.0, 0.98, 99) * values.min(), key=error)
