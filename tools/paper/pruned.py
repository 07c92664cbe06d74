"""Section 3.1: what the threshold tau = -13 keeps of the plan, by the size of the images."""

import clmorph
from clmorph.pipeline.options import PAPER
from clmorph.transport.options import PruningOptions
from paper import drawing
from paper.report import html_table
from paper.setting import BLUR, COLOR_WEIGHT, REACH, Section, Setting, listed, signed

#: The paper's threshold, and the relative one.
LOG_THRESHOLD, PLAN_RELATIVE = PAPER.log_threshold, PruningOptions().relative
#: Sides of the images.
SIDES, QUICK_SIDES = (16, 24, 32, 48, 64, 96), (12, 16, 20)


def pruned(setting: Setting) -> list[Section]:
    """Count pairs and dropped mass of the paper's threshold and of the relative one."""
    rows = []
    for side in setting.each("Pruning", QUICK_SIDES if setting.quick else SIDES):
        source, target = (
            clmorph.lift(image, COLOR_WEIGHT, extent="unit")
            for image in setting.pair.as_published(side)
        )
        options = {"backend": setting.operations}
        potentials = clmorph.sinkhorn(source, target, BLUR, REACH, **options)
        relative = clmorph.transport_plan(source, target, potentials, **options)
        absolute = clmorph.transport_plan(
            source, target, potentials, log_threshold=LOG_THRESHOLD, **options
        )
        common = (absolute.to_scipy() != 0).multiply(relative.to_scipy() != 0).nnz
        rows.append([
            side, len(absolute), len(relative), int(common),
            100 * absolute.dropped_mass, 100 * relative.dropped_mass,
        ])  # fmt: skip
    header = [
        "side px", "pairs (tau)", "pairs (relative)", "pairs (both)", "dropped % (tau)",
        "dropped % (relative)",
    ]  # fmt: skip
    _draw(setting, rows)
    return [
        Section(
            "pruning",
            "Section 3.1: the threshold τ on the plan",
            f"Pairs of pixels with log π > τ = {signed(LOG_THRESHOLD, 0)}, which the paper keeps, "
            f"beside those above {PLAN_RELATIVE:g} of the largest pair of their row or column, "
            "and the share of the plan's mass that is dropped. log π falls as log(1/N²), so τ "
            "keeps the less of a plan the larger the images are.",
            f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, reach {REACH:g}, images resized as for Table 1.",
            "Mass that τ drops: "
            + listed([f"{row[4]:.2g} % at {row[0]} × {row[0]} pixels" for row in rows])
            + ". Of the pairs that one rule or the other keeps, both keep "
            + listed(
                [f"{100 * row[3] / (row[1] + row[2] - row[3]):.0f} % at {row[0]}" for row in rows]
            )
            + ".",
            header,
            rows,
            html_table(
                header, [[*map(str, row[:4]), *(f"{value:.2g}" for value in row[4:])]
                         for row in rows],
            ),
        )
    ]  # fmt: skip


def _draw(setting: Setting, rows: list[list[float]]) -> None:
    figure, panels = drawing.panels(1, 2, height=2.9)
    sides = [row[0] for row in rows]
    for axes, columns, title in (
        (panels[0][0], (1, 2), "kept pairs"), (panels[0][1], (4, 5), "dropped mass, %"),
    ):  # fmt: skip
        for column, style, color, label in zip(
            columns, ("s--", "o-"), (drawing.RED, drawing.BLUE),
            (f"log π > {signed(LOG_THRESHOLD, 0)}", "relative to row or column"), strict=True,
        ):  # fmt: skip
            axes.plot(sides, [row[column] for row in rows], style, color=color, label=label)
        axes.set(xlabel="side of the images, pixels", title=title, yscale="log")
        axes.set_xscale("log")
        axes.set_xticks(sides, [str(side) for side in sides])
        axes.set_xticks([], minor=True)
    panels[0][0].legend()
    drawing.save(figure, setting.folder / "pruning.png")
