"""Write `cl_kernels/half_steps.cl`: the arithmetic between two softmins as kernels of one group.

The formulas are those of `clmorph.transport._solver`, which this tool calls with symbols in place
of arrays. Symbols record what is done to them; the record is cut where a number needs a whole
vector (a sum, a maximum), and each part becomes one loop over the entries. ``--check`` only says
whether the file is what the formulas say.

    python tools/make_half_steps.py
"""

import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from kernel_writing.symbols import Symbol, Traced, number, vector
from kernel_writing.texts import ARGUMENTS, HEAD, KERNELS
from kernel_writing.writer import Writer

from clmorph.transport._solver import half_steps
from clmorph.transport._solver.anderson import limited_step, mixed
from clmorph.transport._solver.problem import Problem

FILE = Path(__file__).parents[1] / "cl_kernels" / "half_steps.cl"


def traced_problem(balanced: tuple[bool, bool]) -> Problem:
    """Return a problem of symbols."""
    problem = Problem.__new__(Problem)
    problem.a, problem.log_a = vector("row", "WEIGHTS"), vector("row", "LOG_WEIGHTS")
    problem.b, problem.log_b = vector("column", "WEIGHTS"), vector("column", "LOG_WEIGHTS")
    problem.of_rows, problem.of_columns = problem.reductions = Traced("row"), Traced("column")
    names = "inverse_rho_source", "inverse_rho_target"
    problem.inverse_rho = tuple(
        0.0 if side else number(name) for name, side in zip(names, balanced, strict=True)
    )
    problem.masses = 1.0, 1.0  # the kernels sum the plan's mass
    # All pairs are summed, and rounding is not bounded.
    problem.to_rows = problem.to_columns = SimpleNamespace(left_out=0.0, roundoff=0.0)
    problem.oscillations = 0.0, 0.0
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
    finite = of.sum(softmin * Symbol("number", "nothing"))
    return (
        {"SHIFTED": step.f},
        {
            "IMAGE": step.image, "SOFTMIN": step.t_columns, "RESIDUAL": residual, "MASS": mass,
            "NEW_AHEAD": ahead, "NEW_DIFFERENCE": of_residual, "GUESS": guess,
        },
        {
            "RESIDUAL_SIZE": step.residual, "COLUMN_DUAL": step.dual, "COLUMN_FINITE": finite,
            "FOUND": found, "CUT": found & cut,
        },
    )  # fmt: skip


#: How each kernel's formulas are recorded.
TRACES = {"row_step": trace_row_step, "column_step": trace_column_step}


def made() -> str:
    """Return the file's text."""
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
            Symbol.known.clear()
            rows, columns, numbers = trace(traced_problem(balanced))
            writer = Writer(
                {"row": rows, "column": columns},
                {f"NUMBER_{each}": value for each, value in numbers.items()},
            )
            code = balanced[0] + 2 * balanced[1]
            text += f"#{'if' if not code else 'elif'} BALANCED == {code}\n"
            text += "\n".join(writer.write()) + "\n"
            if "FOUND" in numbers:
                text += f"    const bool numbers_found = {writer._name(numbers['FOUND'])};\n"
        text += f"#endif\n{end}}}\n"
    return text


def main() -> None:
    """Write the file, or compare it."""
    text = made()
    if sys.argv[1:] == ["--check"]:
        if FILE.read_text(encoding="utf-8") != text:
            sys.exit("cl_kernels/half_steps.cl is old: run python tools/make_half_steps.py")
        return
    FILE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
