"""Write `cl_kernels/half_steps.cl` and `stored_steps.cl`: the arithmetic between two softmins.

The formulas are those of `clmorph.transport._solver`, which this tool calls with symbols in place
of arrays. Symbols record what is done to them; the record is cut where a number needs a whole
vector (a sum, a maximum), and each part becomes one loop over the entries. In the first file all
loops of a half-step are one kernel of one work-group; in the second one each loop is a launch of
many work-groups. ``--check`` only says whether the files are what the formulas say.

    python tools/make_half_steps.py
"""

import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from kernel_writing import stored_texts
from kernel_writing.staged import StagedWriter
from kernel_writing.symbols import Symbol, Traced, number, vector
from kernel_writing.texts import ARGUMENTS, HEAD, KERNELS
from kernel_writing.writer import Writer

from clmorph.backends.opencl.build.stored_step_slots import LARGEST_CHANGE, STAGES
from clmorph.transport._solver import half_steps
from clmorph.transport._solver.anderson import limited_step, mixed
from clmorph.transport._solver.coarse_grid import StoredProblem
from clmorph.transport._solver.problem import Problem

FOLDER = Path(__file__).parents[1] / "cl_kernels"


def traced_problem(kind: type[Problem], balanced: tuple[bool, bool]) -> Any:
    """Return a problem of symbols."""
    problem: Any = kind.__new__(kind)
    problem.a, problem.log_a = vector("row", "WEIGHTS"), vector("row", "LOG_WEIGHTS")
    problem.b, problem.log_b = vector("column", "WEIGHTS"), vector("column", "LOG_WEIGHTS")
    problem.of_rows, problem.of_columns = problem.reductions = Traced("row"), Traced("column")
    names = "inverse_rho_source", "inverse_rho_target"
    problem.inverse_rho = tuple(
        0.0 if side else number(name) for name, side in zip(names, balanced, strict=True)
    )
    problem.masses = 1.0, 1.0  # no closed form needs them
    # All pairs are summed, and rounding is not bounded.
    problem.to_rows = problem.to_columns = SimpleNamespace(left_out=0.0, roundoff=0.0)
    problem.oscillations = 0.0, 0.0
    if kind is StoredProblem:
        problem.center = vector("row", "CENTER")
        problem.masses = number("source_mass"), number("target_mass")
    return problem


def trace_row_step(problem: Problem) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the results for the rows, for the columns, and the numbers for the host."""
    softmin = Symbol("softmin", side="row")
    step = half_steps.row_step(problem, vector("column", "G"), softmin, number("epsilon"))
    finite = problem.of_rows.sum(softmin * Symbol("number", "nothing"))
    return (
        {"F": step.f, "SOFTMIN": step.t_rows},
        {"SHIFTED": step.g},
        {"MASS": step.mass, "ROW_DUAL": step.dual, "ROW_FINITE": finite},
    )


def trace_column_step(problem: Problem) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the results for the rows, for the columns, and the numbers for the host."""
    softmin = Symbol("softmin", side="column")
    g = vector("column", "G")
    before = half_steps.RowStep(
        vector("row", "F"), vector("column", "SHIFTED"), vector("row", "SOFTMIN"), None, None
    )
    step = half_steps.column_step(problem, before, softmin, number("epsilon"))
    vectors, numbers = accelerated(problem, g, step)
    numbers["COLUMN_FINITE"] = problem.of_columns.sum(softmin * Symbol("number", "nothing"))
    return {"SHIFTED": step.f}, vectors, numbers


def accelerated(problem: Problem, g: Symbol, step: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return vectors of the columns and the numbers of a half-step of g with Anderson's guess."""
    of, begun = problem.of_columns, Symbol("flag", "begun")
    residual = step.image - g
    # As `Anderson.extrapolate` does, with these vectors in place of its attributes.
    mass = np.where(begun, vector("column", "MASS"), step.mass)
    of_image = half_steps.new_difference(begun, step.image, vector("column", "OLD_IMAGE"))
    of_residual = half_steps.new_difference(begun, residual, vector("column", "OLD_RESIDUAL"))
    ahead = mixed(of_image, of_residual)
    row = of.inner_each("DIFFERENCES", of_residual * mass, of_residual)
    right = of.inner_each("DIFFERENCES", mass * residual, of_residual)
    found = Symbol("solve", row, right, stage=max(row.stage, right.stage))
    correction = of.combined(found, "AHEAD")
    moved, factor, cut = limited_step(of, residual, correction, mass, number("radius"))
    guess = half_steps.without_drift(problem, step.image + factor * moved, step.image, step.mass)
    return (
        {
            "IMAGE": step.image, "SOFTMIN": step.t_columns, "RESIDUAL": residual, "MASS": mass,
            "NEW_AHEAD": ahead, "NEW_DIFFERENCE": of_residual, "GUESS": guess,
        },
        {
            "RESIDUAL_SIZE": step.residual, "COLUMN_DUAL": step.dual,
            "FOUND": found, "CUT": found & cut,
        },
    )  # fmt: skip


#: A rounding that the dual may have, so that its closed forms are recorded:
#: `StoredProblem.start_iteration` decides whether they have enough digits.
CLOSED_FORM = 1.0


def trace_stored_row_step(problem: Any) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return what `trace_row_step` returns, over stored pairs and with closed forms."""
    softmin = Symbol("softmin", side="row")
    step = half_steps.row_step(
        problem, vector("column", "G"), softmin, number("epsilon"), CLOSED_FORM
    )
    finite = problem.of_rows.sum(softmin * Symbol("number", "nothing"))
    changes, following = centered_changes(problem.of_rows, problem.a, step.f)
    return (
        {"F": step.f, "SOFTMIN": step.t_rows, "CHANGES": changes},
        {"SHIFTED": step.g},
        {
            "MASS": step.mass, "LOG_MASS": step.log_mass, "ROW_DUAL": step.dual,
            "ROW_FINITE": finite, "MOVED": problem.farthest(step.f),
            "ROW_MIDDLE": number("next_middle"), "ROW_NEXT": following,
        },
    )  # fmt: skip


def trace_stored_column_step(
    problem: Any,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return what `trace_column_step` returns, over stored pairs and with closed forms."""
    softmin = Symbol("softmin", side="column")
    before = half_steps.RowStep(
        vector("row", "F"), vector("column", "SHIFTED"), vector("row", "SOFTMIN"), None, None,
        number("log_mass"),
    )  # fmt: skip
    step = half_steps.column_step(problem, before, softmin, number("epsilon"), CLOSED_FORM)
    vectors, numbers = accelerated(problem, vector("column", "G"), step)
    potential = np.where(numbers["FOUND"], vectors["GUESS"], vectors["IMAGE"])
    changes, following = centered_changes(problem.of_columns, problem.b, potential)
    finite = problem.of_columns.sum(softmin * Symbol("number", "nothing"))
    return (
        {"SHIFTED": step.f},
        vectors | {"CHANGES": changes},
        numbers | {
            "COLUMN_FINITE": finite,
            "COLUMN_MIDDLE": number("next_middle"), "COLUMN_NEXT": following,
        },
    )  # fmt: skip


def centered_changes(of: Traced, masses: Any, potential: Any) -> tuple[Any, Any]:
    """Return what sums over stored pairs take of a potential, and the midrange of its changes."""
    changes = (potential - vector(of.side, "ORIGIN")) * number("k")
    changes = np.minimum(np.maximum(changes, -LARGEST_CHANGE), LARGEST_CHANGE)
    changes = np.where(masses > 0, changes, 0.0)
    return changes - number("next_middle"), 0.5 * (of.largest(changes) - of.largest(-changes))


#: How each kernel's formulas are recorded.
TRACES = {"row_step": trace_row_step, "column_step": trace_column_step}
STORED_TRACES = {"row": trace_stored_row_step, "column": trace_stored_column_step}


def recorded(kind: type[Problem], trace: Any, writer: type[Writer], balanced: Any) -> Any:
    """Return a writer of the formulas that a trace records."""
    Symbol.known.clear()
    rows, columns, numbers = trace(traced_problem(kind, balanced))
    places = {f"NUMBER_{each}": value for each, value in numbers.items()}
    return writer({"row": rows, "column": columns}, places)


def half_steps_text() -> str:
    """Return the text of `half_steps.cl`."""
    text = HEAD
    for name, trace in TRACES.items():
        size, other, comment, begin, end = KERNELS[name]
        text += f"\n{comment}__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))\n"
        text += f"void {name}(\n{ARGUMENTS.format(size=size, other=other)}{{\n"
        text += "    __local double shared[GROUP];\n"
        if name == "column_step":
            text += "    __local double system[MEMORY * SYSTEM_ROW];\n"
        text += begin
        for balanced in product((False, True), repeat=2):
            writer = recorded(Problem, trace, Writer, balanced)
            code = balanced[0] + 2 * balanced[1]
            text += f"#{'if' if not code else 'elif'} BALANCED == {code}\n"
            text += "\n".join(writer.write()) + "\n"
            if name == "column_step":
                found = writer._name(writer.numbers["NUMBER_FOUND"])
                text += f"    const bool numbers_found = {found};\n"
        text += f"#endif\n{end}}}\n"
    return text


def stored_steps_text() -> str:
    """Return the text of `stored_steps.cl`."""
    text = stored_texts.HEAD
    for place, (name, trace) in enumerate(STORED_TRACES.items()):
        written = {}
        for balanced in product((False, True), repeat=2):
            code = balanced[0] + 2 * balanced[1]
            writer = recorded(StoredProblem, trace, StagedWriter, balanced)
            written[code] = writer, writer.stages()
            assert len(written[code][1]) == STAGES[code][place], (code, name)
        for part, kind in enumerate(("loops", "joins")):
            text += stored_texts.begin(name, kind)
            for code in sorted(written):
                text += f"#{'elif' if code else 'if'} BALANCED == {code}\n"
                writer, stages = written[code]
                text += stored_texts.joins(writer) * (kind == "joins")
                for stage, bodies in enumerate(stages):
                    text += stored_texts.stage_text(name, stage, bodies[part])
            text += "#endif\n" + stored_texts.end(kind)
    return text


def made() -> dict[Path, str]:
    """Return the text of each file."""
    return {
        FOLDER / "half_steps.cl": half_steps_text(),
        FOLDER / "stored_steps.cl": stored_steps_text(),
    }


def main() -> None:
    """Write the files, or compare them."""
    for file, text in made().items():
        if sys.argv[1:] != ["--check"]:
            file.write_text(text, encoding="utf-8")
        elif file.read_text(encoding="utf-8") != text:
            sys.exit(f"cl_kernels/{file.name} is old: run python tools/make_half_steps.py")


if __name__ == "__main__":
    main()
