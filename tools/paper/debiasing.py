"""Section 3.2: potentials of the debiased divergence do not define the plan."""

from dataclasses import dataclass

import numpy as np

import clmorph
from paper import drawing
from paper.report import html_table
from paper.setting import (
    BLUR,
    COLOR_WEIGHT,
    REACH,
    TOL,
    Section,
    Setting,
    listed,
    reach_name,
    reach_text,
)
from paper.table1 import REACHES, lifted

#: What the paper says of the relative error.
CLAIMED = 0.5
COLUMNS = ("source", "target")


@dataclass(frozen=True)
class Leak:
    """Marginals of the plan that debiased potentials give, against the plan's own.

    Attributes
    ----------
    mass, debiased_mass : float
        Of both plans.
    errors : (of the source, of the target)
        ‖r' − r‖₁ / ‖r‖₁ of each marginal r.
    """

    mass: float
    debiased_mass: float
    errors: tuple[float, float]


def debiasing(setting: Setting) -> list[Section]:
    """Measure what becomes of the mass if the plan is made of debiased potentials."""
    found = {reach: _leak(setting, reach) for reach in setting.each("Debiasing", REACHES)}
    n, m = (len(measure) for measure in lifted(setting))
    _draw(setting, found)
    header = ["reach", "mass", "mass (debiased)", "error (source)", "error (target)"]
    rows = [
        [reach_name(reach), leak.mass, leak.debiased_mass, *leak.errors]
        for reach, leak in found.items()
    ]
    own = found[REACH]
    beyond = [reach for reach in REACHES if max(found[reach].errors) > CLAIMED]
    verdict = (
        "at every reach" if len(beyond) == len(REACHES)
        else f"at {len(beyond)} of {len(REACHES)} reaches"
    )  # fmt: skip
    return [
        Section(
            "debiasing",
            "Section 3.2: debiased potentials and the plan",
            "A debiased solver returns f_ab − f_aa and g_ab − g_bb, the gradients of the "
            "divergence. Put into Eq. 2 in place of f_ab and g_ab they give another plan. Shown "
            "are its mass and the relative error ‖r′ − r‖₁ / ‖r‖₁ of its marginals r′ against the "
            "plan's own, r.",
            f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, {setting.size} × {setting.size} pixels as for "
            f"Table 1; all three problems converged to {TOL:g} ε.",
            f"At reach {REACH:g} the debiased potentials give a plan of mass "
            f"{own.debiased_mass:.3g} in place of {own.mass:.3g}, whose marginals are wrong by "
            f"{100 * own.errors[0]:.3g} % (source) and {100 * own.errors[1]:.3g} % (target). The "
            f"paper's error of more than {100 * CLAIMED:.0f} % is measured {verdict}: "
            + listed(
                [f"{100 * max(leak.errors):.3g} % {reach_text(r)}" for r, leak in found.items()]
            )
            + f". Without log α + log β a plan would have {n * m:.2g} times its mass, as α and β "
            f"are 1 / {n} and 1 / {m} here.",
            header,
            rows,
            html_table(
                ["reach", "mass", "mass, debiased", "error, source", "error, target"],
                [[row[0], *(f"{value:.3g}" for value in row[1:])] for row in rows],
            ),
        )
    ]


def _leak(setting: Setting, reach: float | None) -> Leak:
    source, target = lifted(setting)
    near = clmorph.sinkhorn_divergence(source, target, BLUR, reach, TOL, backend=setting.operations)
    cross = near.cross
    f, g = cross.f - near.source_self.f, cross.g - near.target_self.f
    operations, epsilon = setting.operations, cross.epsilon
    clouds = [operations.upload(measure.points, measure.weights) for measure in (source, target)]
    masses, errors = [], []
    for sides, own, other, weights, truth in (
        (clouds, f, g, source.weights, cross.row_mass),
        (clouds[::-1], g, f, target.weights, cross.column_mass),
    ):
        softmin = operations.softmin(*sides, other, epsilon, True)
        marginal = weights * np.exp((own - softmin) / epsilon)
        masses.append(float(marginal.sum()))
        errors.append(float(np.abs(marginal - truth).sum() / truth.sum()))
    return Leak(cross.transported_mass, masses[0], (errors[0], errors[1]))


def _draw(setting: Setting, found: dict[float | None, Leak]) -> None:
    figure, panels = drawing.panels(1, 2, height=2.9)
    reaches = REACHES[::-1]
    left, right = panels[0]
    left.plot([found[r].mass for r in reaches], "o-", color=drawing.BLUE, label="potentials of OT")
    left.plot([found[r].debiased_mass for r in reaches], "s--", color=drawing.RED, label="debiased")
    left.set_yscale("log")
    left.set(title="mass of the plan", ylabel="share of the images' mass")
    for side, style, color in (("source", "o-", drawing.BLUE), ("target", "s--", drawing.GREEN)):
        values = [100 * found[r].errors[COLUMNS.index(side)] for r in reaches]
        right.plot(values, style, color=color, label=f"marginal on the {side}")
    right.axhline(100 * CLAIMED, color=drawing.GRAY, linestyle=":", label="the paper's 50 %")
    right.set(title="error of the debiased plan", ylabel="%")
    right.set_ylim(bottom=0)
    for axes in panels[0]:
        axes.set_xticks(range(len(reaches)), [reach_name(reach) for reach in reaches])
        axes.set_xlabel("reach, in image sides")
        axes.legend()
    drawing.save(figure, setting.folder / "debiasing.png")
