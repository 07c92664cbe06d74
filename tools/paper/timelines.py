"""Figures 1, 4 and 5: rows of frames."""

from dataclasses import replace
from typing import Any

import numpy as np

import clmorph
from clmorph.analysis.channel_baseline import channel_morph
from clmorph.analysis.metrics import hole_fraction, sharpness
from clmorph.frames.kernel_width import KernelWidth
from paper import drawing
from paper.setting import (
    AS_PAPER,
    AS_PAPER_TEXT,
    COLOR_WEIGHT,
    FIXED_SIGMA,
    GAMMA,
    SIGMA_END,
    SIGMA_START,
    Section,
    Setting,
    listed,
    paper_morph,
    reach_name,
)

#: The columns of every timeline.
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Figure 4's color weights; 0 is each channel by itself.
COLOR_WEIGHTS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
#: Figure 1's first rows.
TORN_WEIGHTS = (3.0, 10.0)
#: Figure 5's reaches, in its order.
TIMELINE_REACHES = (None, 0.01, 0.05, 0.1, 0.3, 0.5)

HEADER = ["row", "t", "width", "height", "sigma px", "holes %", "sharpness"]
Row = tuple[str, list[np.ndarray]]


def figure_1(setting: Setting) -> list[Section]:
    """Compare ways to draw particles."""
    images = setting.pair.fitted(setting.size)
    morphs = {
        weight: paper_morph(setting, images, color_weight=weight)
        for weight in setting.each("Figure 1", (COLOR_WEIGHT, *TORN_WEIGHTS))
    }
    own = morphs[COLOR_WEIGHT]
    counts = own.kernel_width.n_start, own.kernel_width.n_end
    fixed = KernelWidth(FIXED_SIGMA, FIXED_SIGMA, 0.0, *counts, "fixed")
    local = KernelWidth(FIXED_SIGMA, SIGMA_END, 0.0, *counts, "local")
    cases = [
        *((f"none\nλ {weight:g}", _drawn(morphs[weight], "none")) for weight in TORN_WEIGHTS),
        ("adaptive\nλ 2", own),
        ("fixed σ 0.5\nλ 2", replace(own, kernel_width=fixed)),
        ("none\nλ 2", _drawn(own, "none")),
        ("local (ours)\nλ 2", replace(own, kernel_width=local)),
    ]
    rows, numbers = _frames(cases)
    drawing.timeline(setting.folder / "figure-1.png", rows, TIMES)
    return [
        Section(
            "figure-1",
            "Figure 1: splatting against tearing",
            "The same particles drawn in different ways: each into its nearest pixel (none), "
            "with the width of Eq. 4 for all (adaptive), with one width throughout (fixed), or "
            "with a width for each particle by the density around it (local, not in the paper). "
            "Black pixels are empty; holes "
            "are those far less covered than what surrounds them.",
            f"{sizes(images)}, {AS_PAPER_TEXT} but for what the labels say.",
            "Holes at t = 0.5, before any are filled: "
            + listed(
                [
                    f"{label.replace(chr(10), ' at ')} {holes:.1f} %"
                    for label, t, *_, holes, _ in numbers
                    if t == 0.5
                ]
            )
            + ".",
            HEADER,
            [[" ".join(row[0].split()), *row[1:]] for row in numbers],
        )
    ]


def figure_4(setting: Setting) -> list[Section]:
    """Show what the color weight does, and the baseline without joint colors."""
    images = setting.pair.fitted(setting.size)
    weights = COLOR_WEIGHTS if not setting.quick else (0.0, 0.5, 2.0, 3.0)
    cases: list[tuple[str, Any]] = []
    for weight in setting.each("Figure 4", weights):
        if weight == 0:
            one: Any = channel_morph(
                *images, n_frames=len(TIMES), blur=AS_PAPER["blur"], reach=AS_PAPER["reach"],
                sigma_start=SIGMA_START, sigma_end=SIGMA_END, gamma=GAMMA,
                backend=setting.operations, extent="unit",
            )  # fmt: skip
            cases.append(("λ 0\n(per channel)", one))
        else:
            one = paper_morph(setting, images, color_weight=weight)
            cases.append((f"λ {weight:g}", one))
    rows, numbers = _frames(cases)
    drawing.timeline(setting.folder / "figure-4.png", rows, TIMES)
    foreign = [_foreign_color(frames[2], images) for _, frames in rows]
    names = [f"λ {weight:g}" for weight in weights]
    return [
        Section(
            "figure-4",
            "Figure 4: timelines by color weight λ",
            "λ 0 is the baseline of three independent transports, one for each channel, in the "
            "plane; the others transport position and color jointly.",
            f"{sizes(images)}, {AS_PAPER_TEXT} but for λ; the baseline draws unmatched light, so "
            "that its channels keep theirs.",
            "Mean distance of a color at t = 0.5 from the nearest color of either image (RGB in "
            "[0, 1]): "
            + listed([f"{d:.3f} for {name}" for d, name in zip(foreign, names, strict=True)])
            + ".",
            HEADER,
            [[" ".join(row[0].split()), *row[1:]] for row in numbers],
        )
    ]


def figure_5(setting: Setting) -> list[Section]:
    """Show what the reach does."""
    images = setting.pair.fitted(setting.size)
    cases = []
    for reach in setting.each("Figure 5", TIMELINE_REACHES):
        # What does not travel is drawn here: at small reaches it is nearly all that there is.
        one = paper_morph(setting, images, reach=reach, unmatched="fade")
        cases.append((reach_name(reach) if reach is None else f"reach {reach:g}", one))
    rows, numbers = _frames(cases)
    drawing.timeline(setting.folder / "figure-5.png", rows, TIMES)
    return [
        Section(
            "figure-5",
            "Figure 5: timelines by reach",
            "Small reaches let mass die and be born rather than travel: a cross-fade. Large ones "
            "and balanced transport move it.",
            f"{sizes(images)}, {AS_PAPER_TEXT} but for the reach, and with unmatched mass drawn "
            "as it fades.",
            "Mass that travels: "
            + listed(
                [
                    f"{100 * one.potentials.transported_mass:.3g} % "
                    + (label if label == "balanced" else f"at {label}")
                    for label, one in cases
                ]
            )
            + ".",
            HEADER,
            [[" ".join(row[0].split()), *row[1:]] for row in numbers],
        )
    ]


def _drawn(one: clmorph.Morph, splatting: str) -> clmorph.Morph:
    return replace(one, kernel_width=replace(one.kernel_width, splatting=splatting))


def _frames(cases: list[tuple[str, Any]]) -> tuple[list[Row], list[list[Any]]]:
    """Render every case; return rows of frames, and their numbers as `HEADER` says."""
    rows, numbers = [], []
    for label, one in cases:
        frames = [one.frame(t) for t in TIMES]
        rows.append((label, frames))
        for t, frame in zip(TIMES, frames, strict=True):
            sigma, holes = float("nan"), float("nan")
            if isinstance(one, clmorph.Morph):
                sigma = float(one.kernel_width.at(t, one.canvas(t)))
                holes = 100 * hole_fraction(one.coverage(t))
            height, width = frame.shape[:2]
            numbers.append([label, t, width, height, sigma, holes, sharpness(frame)])
    return rows, numbers


def _foreign_color(frame: np.ndarray, images: list[np.ndarray]) -> float:
    """Return the mean distance of a frame's colors from the nearest one of both images."""
    from scipy.spatial import KDTree

    palette = np.concatenate([image.reshape(-1, 3) for image in images])
    return float(KDTree(palette).query(frame.reshape(-1, 3))[0].mean())


def sizes(images: list[np.ndarray]) -> str:
    (h, w), (height, width) = (image.shape[:2] for image in images)
    return f"{w} × {h} to {width} × {height} pixels"
