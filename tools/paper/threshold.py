"""Section 4.2: whether mass moves only where the cost is below 2 rho."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import clmorph
from paper import drawing
from paper.setting import BLUR, COLOR_WEIGHT, REACH, TOL, Section, Setting, listed
from paper.table1 import REACHES, lifted

Array = NDArray[np.float64]

#: Reaches that are finite and leave some mass below the threshold and some above it.
FINITE = tuple(reach for reach in REACHES if reach is not None and reach >= BLUR)
#: Edges of the bins of C / (2 rho).
EDGES = np.linspace(0.0, 4.0, 41)
#: The bins next to the threshold.
BELOW, ABOVE = 9, 10
#: A fall from one to the other to less than this share would be called a threshold.
SHARP = 0.5
#: Pairs of a block of rows.
BLOCK = 1 << 22
#: Moved mass below which a bin is not drawn.
LEAST = 1e-4
COLORS = (drawing.PURPLE, drawing.BLUE, drawing.GREEN, drawing.ORANGE)


@dataclass(frozen=True)
class Profile:
    """Moved mass by its cost.

    Attributes
    ----------
    moved : (bins,) array
        Share of the moved mass in each bin of `EDGES`.
    beyond : float
        Share of it at costs of 2 rho and more.
    share : (bins,) array
        Geometric mean of the shares of their mass that move at both ends of a pair, on average
        over the moved mass of a bin.
    formula : (bins,) array
        The same for two Diracs with the masses of these pixels.
    """

    moved: Array
    beyond: float
    share: Array
    formula: Array


def threshold(setting: Setting) -> list[Section]:
    """Measure the transported share against the cost, in units of 2 rho."""
    found = {reach: _profile(setting, reach) for reach in setting.each("2 ρ", FINITE)}
    _draw(setting, found)
    header = [
        "reach", "C/(2 rho) from", "C/(2 rho) to", "share of the moved mass", "transported share",
        "transported share (two Diracs)",
    ]  # fmt: skip
    rows = [
        [reach, float(low), float(high), *map(float, (moved, share, formula))]
        for reach, profile in found.items()
        for low, high, moved, share, formula in zip(
            EDGES[:-1], EDGES[1:], profile.moved, profile.share, profile.formula, strict=True
        )
    ]
    own = found[REACH]
    sharp = own.share[ABOVE] < SHARP * own.share[BELOW]
    return [
        Section(
            "threshold",
            "Section 4.2: transported share and the threshold 2ρ",
            "The paper says that mass moves only where its cost C is below 2ρ. Left: dots show "
            "which share of the mass at both ends of a pair of pixels is transported (geometric "
            "mean of both ends, averaged over the mass that moves at this cost); lines show the "
            "same for two Diracs with the masses a and b of two pixels, whose plan is "
            "log m = ((ρ + ε)(log a + log b) − C) / (2ρ + ε); gray is a sharp threshold. Right: "
            "how much of the moved mass has a cost of more than C.",
            f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, {setting.size} × {setting.size} pixels as for "
            f"Table 1, converged to {TOL:g} ε; C has the factor ½; bins of {EDGES[1]:g} × 2ρ; "
            "bins with less than 0.01 % of the moved mass are not drawn.",
            f"At 2ρ there is {'a' if sharp else 'no'} sharp threshold: at reach {REACH:g} the "
            f"transported share is {100 * own.share[BELOW]:.0f} % just below it and "
            f"{100 * own.share[ABOVE]:.0f} % just above it (two Diracs: "
            f"{100 * own.formula[BELOW]:.0f} % and {100 * own.formula[ABOVE]:.0f} %). Mass that "
            "moves at a cost of 2ρ or more: "
            + listed(
                [f"{100 * profile.beyond:.2g} % at reach {r:g}" for r, profile in found.items()]
            )
            + ". Two Diracs with KL as the marginal penalty have no threshold either: the share "
            "decays as e^(−C/(2ρ + ε)). One at 2ρ belongs to total variation as the penalty.",
            header,
            rows,
        )
    ]


def _profile(setting: Setting, reach: float) -> Profile:
    source, target = lifted(setting)
    potentials = clmorph.sinkhorn(source, target, BLUR, reach, TOL, backend=setting.operations)
    epsilon, rho = potentials.epsilon, reach**2
    f, g = potentials.f, potentials.g
    log_a, log_b = np.log(source.weights), np.log(target.weights)
    # log of the transported shares of source and target pixels.
    own, other = np.log(potentials.row_mass) - log_a, np.log(potentials.column_mass) - log_b
    squares = 0.5 * np.sum(target.points**2, axis=1)
    sums = np.zeros((3, len(EDGES) - 1))
    whole = beyond = 0.0
    step = max(1, BLOCK // len(target))
    for start in range(0, len(source), step):
        rows = slice(start, start + step)
        points = source.points[rows]
        cost = 0.5 * np.sum(points**2, axis=1)[:, None] + squares - points @ target.points.T
        cost = np.maximum(cost, 0.0)
        masses = log_a[rows, None] + log_b
        mass = np.exp((f[rows, None] + g - cost) / epsilon + masses)
        share = np.exp(0.5 * (own[rows, None] + other))
        # log m - (log a + log b) / 2 of two Diracs.
        formula = np.exp((0.5 * epsilon * masses - cost) / (2 * rho + epsilon))
        level = cost / (2 * rho)
        whole += float(mass.sum())
        beyond += float(mass[level >= 1].sum())
        for total, values in zip(sums, (mass, mass * share, mass * formula), strict=True):
            # Equal bins are summed one by one, others by differences of a running sum.
            bins = len(EDGES) - 1, (0.0, float(EDGES[-1]))
            total += np.histogram(level, *bins, weights=values)[0]
    with np.errstate(invalid="ignore"):
        return Profile(sums[0] / whole, beyond / whole, sums[1] / sums[0], sums[2] / sums[0])


def _draw(setting: Setting, found: dict[float, Profile]) -> None:
    figure, panels = drawing.panels(1, 2, height=3.3)
    left, right = panels[0]
    middles = 0.5 * (EDGES[1:] + EDGES[:-1])
    left.plot([0, 1, 1], [1, 1, 1e-3], color=drawing.GRAY, linewidth=1.2, label="sharp threshold")
    for (reach, profile), color in zip(found.items(), COLORS, strict=True):
        drawn = profile.moved > LEAST
        left.plot(middles[drawn], profile.share[drawn], "o", color=color, markersize=3,
                  label=f"reach {reach:g}")  # fmt: skip
        left.plot(middles[drawn], profile.formula[drawn], "-", color=color, linewidth=1)
        rest = 1 - np.concatenate(([0.0], np.cumsum(profile.moved)))
        right.plot(EDGES, 100 * rest, "-", color=color)
    left.set_yscale("log")
    left.set_ylim(1e-3, 1.5)
    left.set(title="transported share (lines: two Diracs)", ylabel="share of the mass")
    right.axvline(1, color=drawing.GRAY, linewidth=1.2)
    right.set(title="moved mass that costs more", ylabel="% of the moved mass")
    right.set_ylim(0, 103)
    for axes in panels[0]:
        axes.set(xlabel="C / (2ρ)", xlim=(0, EDGES[-1]))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    drawing.save(figure, setting.folder / "threshold.png")
