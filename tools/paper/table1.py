"""Table 1: the distance of moved mass by reach, for the published schedule and at convergence."""

from dataclasses import dataclass
from functools import cache

import clmorph
from clmorph.transport.displacement import Displacement
from paper import drawing, geomloss
from paper.recognition import Recognition, recognize
from paper.report import html_table
from paper.setting import (
    BLUR,
    COLOR_WEIGHT,
    PUBLISHED_DISPLACEMENTS,
    TOL,
    Section,
    Setting,
    reach_name,
    signed,
)

#: Rows of at most this mass count as resting, as in the paper's code.
MASK = 1e-6
#: Share of a row's largest pair that is kept: the whole plan, as far as numbers go.
WHOLE = 1e-30
METHODS = ("geomloss", "certified")
REACHES = tuple(PUBLISHED_DISPLACEMENTS)
#: Differences of columns from GeomLoss that are called agreement, in pixels.
AGREEMENT = 0.005


@dataclass(frozen=True)
class Entry:
    """One cell of the table.

    Attributes
    ----------
    masked : Displacement
        By the paper's definition.
    mass_weighted_mean, mass, residual : float
        Without the mask: pixels; share of the images' mass that moves; of the potentials.
    """

    masked: Displacement
    mass_weighted_mean: float
    mass: float
    residual: float


def lifted(setting: Setting) -> list[clmorph.Measure]:
    """Return both images as the published numbers had them."""
    images = setting.pair.as_published(setting.size)
    return [clmorph.lift(image, COLOR_WEIGHT, extent="unit") for image in images]


def masked_displacement(
    setting: Setting,
    source: clmorph.Measure,
    target: clmorph.Measure,
    blur: float,
    reach: float | None,
) -> Displacement:
    """Return displacements by the paper's definition, for potentials of GeomLoss's schedule."""
    potentials = _solve(setting, source, target, blur, reach, "geomloss")
    plan = _whole_plan(setting, source, target, potentials)
    return clmorph.displacement_statistics(source, target, plan, mask=MASK)


def _solve(
    setting: Setting,
    source: clmorph.Measure,
    target: clmorph.Measure,
    blur: float,
    reach: float | None,
    method: str,
) -> clmorph.Potentials:
    return clmorph.sinkhorn(
        source, target, blur, reach, TOL, method=method, scaling=0.9, backend=setting.operations
    )


def _whole_plan(
    setting: Setting,
    source: clmorph.Measure,
    target: clmorph.Measure,
    potentials: clmorph.Potentials,
) -> clmorph.Plan:
    return clmorph.transport_plan(
        source, target, potentials, relative=WHOLE, backend=setting.operations
    )


@cache
def entries(setting: Setting) -> dict[tuple[str, float | None], Entry]:
    """Solve for every method and reach."""
    source, target = lifted(setting)
    keys = [(method, reach) for method in METHODS for reach in REACHES]
    found = {}
    for method, reach in setting.each("Table 1", keys):
        potentials = _solve(setting, source, target, BLUR, reach, method)
        plan = _whole_plan(setting, source, target, potentials)
        masked, whole = (
            clmorph.displacement_statistics(source, target, plan, mask=mask) for mask in (MASK, 0.0)
        )
        found[method, reach] = Entry(
            masked, whole.mass_weighted_mean, potentials.transported_mass, potentials.residual
        )
    return found


def recognized(setting: Setting) -> Recognition:
    """Say whether the pair is the authors', by the column of GeomLoss's schedule."""
    found = entries(setting)
    own = {
        reach: (found["geomloss", reach].masked.max, found["geomloss", reach].masked.mean)
        for reach in REACHES
    }
    return recognize(own, setting.size)


def peer(setting: Setting) -> tuple[dict[float | None, dict[str, float]], str]:
    """Return GeomLoss's own numbers by reach, and where they are from; or nothing."""
    if setting.geomloss:
        measures = lifted(setting)
        return {
            reach: geomloss.displacements(*measures, BLUR, reach, MASK)
            for reach in setting.each("GeomLoss", REACHES)
        }, "run beside"
    if setting.pair.bundled:
        return geomloss.stored(setting.size), "stored"
    return {}, ""


def table_1(setting: Setting) -> list[Section]:
    """Make the table and its picture."""
    found, (theirs, origin) = entries(setting), peer(setting)
    header, groups = ["reach"], [("", 1)]
    for method, title in zip(METHODS, ("GeomLoss schedule", "converged"), strict=True):
        columns = ("max px", "mean px", "weighted mean px", "mass moved", "residual")
        header += [f"{column} ({method})" for column in columns]
        groups.append((title, len(columns)))
    if theirs:
        header += ["max px (GeomLoss)", "mean px (GeomLoss)"]
        groups.append(("GeomLoss, float64", 2))
    if setting.published:
        header += ["max px (published)", "mean px (published)"]
        groups.append((recognized(setting).published, 2))
    rows = []
    for reach in REACHES:
        row = [reach_name(reach)]
        for method in METHODS:
            entry = found[method, reach]
            row += [
                entry.masked.max, entry.masked.mean, entry.mass_weighted_mean, entry.mass,
                entry.residual,
            ]  # fmt: skip
        row += [theirs[reach]["max"], theirs[reach]["mean"]] if theirs else []
        row += PUBLISHED_DISPLACEMENTS[reach] if setting.published else []
        rows.append(row)
    _draw(setting, found)
    short = [name.split(" (")[0] for name in header]
    return [
        Section(
            "table-1",
            "Table 1: displacement by reach",
            "How far the source's pixels travel. max and mean are the paper's: over all pixels, "
            f"those of at most {MASK:g} of the mass counted as resting. The weighted mean "
            "counts what really moves, without that mask; the residual says how far the "
            "potentials are from a solution, in units of ε.",
            f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, {setting.size} × {setting.size} pixels, resized "
            "without anti-aliasing and with opacity dropped, as the published numbers were; "
            f"GeomLoss's schedule with scaling 0.9, and the solver converged to {TOL:g} ε.",
            f"{recognized(setting).text} {_says(found, theirs, origin)}",
            header,
            rows,
            html_table(short, [[_cell(c, v) for c, v in zip(short, r, strict=True)] for r in rows],
                       groups),
        )
    ]  # fmt: skip


def _cell(column: str, value: object) -> str:
    """Write a number as its column's kind is best read."""
    if not isinstance(value, float):
        return str(value)
    if column in ("mass moved", "residual"):
        return f"{value:.1e}" if value < 1e-3 else f"{value:.3f}"
    return f"{value:.2f}"


def largest_difference(
    found: dict[tuple[str, float | None], Entry], theirs: dict[float | None, dict[str, float]]
) -> float:
    """Return the largest difference of our GeomLoss column from GeomLoss itself, in pixels."""
    return max(
        abs(ours - theirs[reach][name])
        for reach in REACHES
        for name, ours in (
            ("max", found["geomloss", reach].masked.max),
            ("mean", found["geomloss", reach].masked.mean),
            ("mass_weighted_mean", found["geomloss", reach].mass_weighted_mean),
        )
    )


def _says(
    found: dict[tuple[str, float | None], Entry],
    theirs: dict[float | None, dict[str, float]],
    origin: str,
) -> str:
    changes = {
        reach: found["certified", reach].mass_weighted_mean
        / found["geomloss", reach].mass_weighted_mean
        - 1
        for reach in REACHES
    }
    worst = max(changes, key=lambda reach: abs(changes[reach]))
    smallest = found["certified", REACHES[-1]]
    rests = float((smallest.masked.source_mass <= MASK).mean())
    text = (
        f"Converging changes the mass-weighted mean most at reach {reach_name(worst)}, by "
        f"{signed(100 * changes[worst])} %. At reach {REACHES[-1]:g} the mask makes "
        f"{100 * rests:.4g} % of the pixels rest, though what moves ({smallest.mass:.1e} of the "
        f"mass) goes {smallest.mass_weighted_mean:.2f} px on average."
    )
    if theirs:
        difference = largest_difference(found, theirs)
        verdict = "within" if difference <= AGREEMENT else "beyond"
        text += (
            f" Largest difference of our GeomLoss schedule from GeomLoss itself in float64 "
            f"({origin}): {difference:.1e} px, {verdict} {AGREEMENT:g} px."
        )
    return text


def _draw(setting: Setting, found: dict[tuple[str, float | None], Entry]) -> None:
    figure, panels = drawing.panels(1, 2, height=2.5)
    for axes, name, title in zip(panels[0], ("max", "mean"), ("largest", "mean"), strict=True):
        for method, style in zip(METHODS, ("s--", "o-"), strict=True):
            label = "GeomLoss schedule" if method == "geomloss" else "converged"
            color = drawing.RED if method == "geomloss" else drawing.BLUE
            values = [getattr(found[method, reach].masked, name) for reach in REACHES]
            axes.plot(values[::-1], style, color=color, label=label)
        if setting.published:
            index = 0 if name == "max" else 1
            values = [PUBLISHED_DISPLACEMENTS[reach][index] for reach in REACHES]
            axes.plot(values[::-1], "x:", color=drawing.GRAY, label=recognized(setting).published)
        axes.set_xticks(range(len(REACHES)), [reach_name(reach) for reach in REACHES[::-1]])
        axes.set(xlabel="reach, in image sides", title=f"{title} displacement")
        axes.set_ylim(bottom=0)
    panels[0][0].set_ylabel("pixels")
    panels[0][0].legend()
    drawing.save(figure, setting.folder / "table-1.png")
