"""Table 2, and Figures 7 and 8."""

from typing import Any

import numpy as np

from clmorph.analysis.metrics import REFERENCES
from clmorph.pipeline.optimal_width import WIDTHS
from paper import drawing
from paper.report import html_table
from paper.setting import (
    FIXED_SIGMA,
    GAMMA,
    PUBLISHED_DIVERGENCES,
    PUBLISHED_SIZE,
    SIGMA_END,
    SIGMA_START,
    Section,
    Setting,
    listed,
    signed,
)
from paper.table1 import recognized
from paper.widths import (
    NAMES,
    POINTS,
    QUICK_POINTS,
    STYLES,
    TIMES,
    Curves,
    curves,
    floor_at,
    sigmas,
)

#: Half a unit of the last published digit, and the rounding of float32.
LAST_DIGIT = 0.00005 + 0.00001


def table_2_and_figures_7_and_8(setting: Setting) -> list[Section]:
    """Make the table and both figures."""
    found = curves(setting)
    _draw_differences(setting, found)
    _draw_divergences(setting, found)
    _draw_widths(setting, found)
    rows = [
        [reference, rule, float(t), each.value, *each.interval]
        for (reference, rule), divergences in found.divergences.items()
        for t, each in zip(found.times, divergences, strict=True)
    ]
    header = ["to", "rule", "t", "divergence", "certainly at least", "certainly at most"]
    parameters = (
        f"{setting.size} × {setting.size} pixels as for Table 1, blur 0.05, reach 0.3, λ 2, "
        "unmatched mass left out. Frames are measures of equal pixels beside the target (the "
        "paper's way), and of their kernel mass beside the particles, merged to at most "
        f"{QUICK_POINTS if setting.quick else POINTS} points. Table 2's columns agree "
        f"at both ends, so its adaptive rule is taken as σ {FIXED_SIGMA:g} to {SIGMA_END:g}, γ "
        f"{GAMMA:g}, with kept pairs counted as N_eff as in the authors' code; Section 4's is "
        f"σ {SIGMA_START:g} to {SIGMA_END:g}, γ {GAMMA:g}, with Eq. 3's floor."
    )
    return [
        Section(
            "table-2",
            "Table 2: divergence by kernel width",
            "Sinkhorn divergence S of the frame at t to the target image, as in the paper, and "
            "to the particles μ(t) of which it is a picture; and by how much each rule is "
            "nearer than the fixed width (below 0) or farther (above). Intervals are certain.",
            parameters,
            _says(setting, found),
            header,
            rows,
            _table(setting, found),
        ),
        Section(
            "figure-7",
            "Figure 7: divergence along the path",
            "S over t for every rule; bands are the certain intervals (mostly narrower than the "
            "line).",
            parameters,
            _says_bands(found),
            header,
            rows,
        ),
        Section(
            "figure-8",
            "Figure 8: kernel width σ(t)",
            "The width of every rule, in pixels of the canvas; dotted, Eq. 3's floor: half the "
            "particles' mean distance, by their effective number. For the local rule, the width "
            "where particles are neither torn apart nor crowded.",
            f"{parameters} The optimal width has the least divergence to μ(t) and is sought from "
            f"{WIDTHS[0]:g} px on.",
            _says_widths(found),
            ["rule", "t", "sigma px", "floor px"],
            _width_rows(found),
        ),
    ]


def _columns(found: Curves) -> list[int]:
    return [found.times.index(t) for t in TIMES]


def _table(setting: Setting, found: Curves) -> str:
    parts = []
    for reference in REFERENCES:
        rows = [
            [STYLES[rule][0], *(f"{divergences[k].value:.4f}" for k in _columns(found))]
            for (to, rule), divergences in found.divergences.items()
            if to == reference
        ]
        if setting.published and reference == "target":
            rows += [
                [f"{name}: {recognized(setting).published}", *(f"{v:.4f}" for v in values)]
                for name, values in PUBLISHED_DIVERGENCES.items()
            ]
        title = f"S {NAMES[reference]}"
        parts.append(html_table([title, *(f"t\u00a0=\u00a0{t:g}" for t in TIMES)], rows))
    return "".join(f'<div style="margin: .8rem 0">{part}</div>' for part in parts)


def _says(setting: Setting, found: Curves) -> str:
    texts = []
    for reference in REFERENCES:
        fixed = found.divergences[reference, "fixed"]
        counts = []
        for rule in found.morphs:
            if rule == "fixed":
                continue
            verdicts = [
                found.divergences[reference, rule][k].closer_than(fixed[k]) for k in _columns(found)
            ]
            nearer, farther = verdicts.count(True), verdicts.count(False)
            counts.append(f"{STYLES[rule][0]} at {nearer} (farther at {farther})")
        texts.append(f"{NAMES[reference]}: {listed(counts)}")
    return (
        f"{_published_verdict(setting, found)} On this setup, between the ends, frames of the "
        f"adaptive width are {_against(found, 'fixed')} than those of the fixed one "
        f"({_changes(found, 'fixed')} in S; the paper: nearer throughout), and "
        f"{_against(found, 'none')} than those without splatting ({_changes(found, 'none')}; the "
        f"paper: nearly the same, or slightly less). Of {len(TIMES)} times, proven nearer than "
        f"fixed σ {FIXED_SIGMA:g} {'; '.join(texts)}."
    )


def recovered(found: Curves) -> bool:
    """Return whether the published Table 2 comes out, to its last digit."""
    return all(
        abs(found.divergences["target", rule][k].value - published) <= LAST_DIGIT
        for rule, row in PUBLISHED_DIVERGENCES.items()
        for k, published in zip(_columns(found), row, strict=True)
    )


def _published_verdict(setting: Setting, found: Curves) -> str:
    if setting.size != PUBLISHED_SIZE:
        return f"The published Table 2 is of {PUBLISHED_SIZE} × {PUBLISHED_SIZE} pixels."
    if recovered(found):
        return "The published Table 2 comes out to its last digit."
    return "The published Table 2 was not recovered."


def _against(found: Curves, other: str) -> str:
    """Tell where the adaptive width is proven nearer to the target, and where farther."""
    own, others = found.divergences["target", "adaptive"], found.divergences["target", other]
    places: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    for k, t in list(zip(_columns(found), TIMES, strict=True))[1:-1]:
        places[own[k].closer_than(others[k])].append(f"{t:g}")
    names = {True: "nearer to the target", False: "farther from it", None: "not decidedly nearer"}
    return " and ".join(f"{names[key]} at t = {listed(ts)}" for key, ts in places.items() if ts)


def _changes(found: Curves, other: str) -> str:
    """Tell by how many percent the adaptive width changes S to the target, between the ends."""
    texts = []
    for k in _columns(found)[1:-1]:
        own, others = (found.divergences["target", rule][k].value for rule in ("adaptive", other))
        texts.append(f"{signed(100 * (own / others - 1))} %")
    return listed(texts)


def _says_bands(found: Curves) -> str:
    widest = max(
        each.interval[1] - each.interval[0]
        for divergences in found.divergences.values()
        for each in divergences
    )
    texts = []
    for reference in REFERENCES:
        means = {
            rule: float(np.mean([each.value for each in found.divergences[reference, rule]]))
            for rule in found.morphs
        }
        best = min(means, key=lambda rule: means[rule])
        ratio = 100 * (means[best] / means["fixed"] - 1)
        texts.append(
            f"{NAMES[reference]} {means[best]:.4f} by {STYLES[best][0]} "
            f"({signed(ratio)} % against fixed)"
        )
    return f"Lowest means over t: {'; '.join(texts)}. The widest interval is {widest:.1e}."


def _says_widths(found: Curves) -> str:
    optimal = sigmas(found, "optimal")
    text = sigmas(found, "adaptive-text")
    floor = [floor_at(found, t) for t in found.times]
    acts = np.mean(np.isclose(text, floor))
    least = " (the least that is sought)" if max(optimal) <= WIDTHS[0] else ""
    return (
        f"The optimal width is {_span(optimal)} px{least}, Section 4's {_span(text)} px, which "
        f"Eq. 3's floor decides at {100 * acts:.0f} % of the times."
    )


def _span(values: list[float]) -> str:
    low, high = f"{min(values):.2f}", f"{max(values):.2f}"
    return low if low == high else f"{low} to {high}"


def _width_rows(found: Curves) -> list[list[Any]]:
    return [
        [rule, float(t), float(sigma), floor_at(found, t)]
        for rule in found.morphs
        for t, sigma in zip(found.times, sigmas(found, rule), strict=True)
    ]


def _draw_differences(setting: Setting, found: Curves) -> None:
    figure, panels = drawing.panels(1, 2, height=2.9)
    others = [rule for rule in found.morphs if rule != "fixed"]
    step = 0.8 / len(others)
    for axes, reference in zip(panels[0], REFERENCES, strict=True):
        fixed = found.divergences[reference, "fixed"]
        for place, rule in enumerate(others):
            own = found.divergences[reference, rule]
            middle = [1e3 * (own[k].value - fixed[k].value) for k in _columns(found)]
            low = [1e3 * (own[k].interval[0] - fixed[k].interval[1]) for k in _columns(found)]
            high = [1e3 * (own[k].interval[1] - fixed[k].interval[0]) for k in _columns(found)]
            errors = np.maximum(np.array([np.subtract(middle, low), np.subtract(high, middle)]), 0)
            at = np.arange(len(TIMES)) + step * (place - (len(others) - 1) / 2)
            name, color, _ = STYLES[rule]
            axes.bar(at, middle, 0.95 * step, yerr=errors, color=color, label=name,
                     error_kw={"linewidth": 0.8})  # fmt: skip
        axes.axhline(0, color="#444444", linewidth=0.8)
        axes.grid(axis="x", visible=False)
        axes.set_xticks(range(len(TIMES)), [f"{t:g}" for t in TIMES])
        axes.set(xlabel="t", title=NAMES[reference])
    panels[0][0].set_ylabel("S − S of fixed width, 10⁻³")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    drawing.save(figure, setting.folder / "table-2.png")


def _draw_divergences(setting: Setting, found: Curves) -> None:
    figure, panels = drawing.panels(1, 2, height=3.3)
    for (reference, rule), divergences in found.divergences.items():
        axes = panels[0][REFERENCES.index(reference)]
        name, color, style = STYLES[rule]
        low, high = zip(*(each.interval for each in divergences), strict=True)
        axes.fill_between(found.times, low, high, color=color, alpha=0.25, linewidth=0)
        values = [each.value for each in divergences]
        axes.plot(found.times, values, style, color=color, label=name, zorder=_order(rule))
    for axes, reference in zip(panels[0], REFERENCES, strict=True):
        _time_axis(axes)
        axes.set_title(NAMES[reference])
    panels[0][0].set_ylabel("divergence S, image sides²")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    drawing.save(figure, setting.folder / "figure-7.png")


def _draw_widths(setting: Setting, found: Curves) -> None:
    figure, ((axes,),) = drawing.panels(1, 1, height=3.0)
    for rule in found.morphs:
        name, color, style = STYLES[rule]
        axes.plot(found.times, sigmas(found, rule), style, color=color, label=name,
                  zorder=_order(rule))  # fmt: skip
    floor = [floor_at(found, t) for t in found.times]
    axes.plot(found.times, floor, ":", color=drawing.GRAY, label="floor of Eq. 3")
    _time_axis(axes)
    axes.set_ylabel("σ, pixels")
    figure.legend(loc="outside lower center", ncols=3)
    drawing.save(figure, setting.folder / "figure-8.png")


def _order(rule: str) -> int:
    """Draw the dashed line last, so that it shows on those that it coincides with."""
    return 4 if rule == "fixed" else 3


def _time_axis(axes: Any) -> None:
    """Name the axis of t, and begin the other at 0."""
    axes.set(xlabel="t", xlim=(-0.03, 1.03), xticks=TIMES)
    axes.set_xticklabels([f"{t:g}" for t in TIMES])
    axes.set_ylim(bottom=0)
