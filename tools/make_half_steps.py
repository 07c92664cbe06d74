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

from clmorph.backends.opencl.build.half_step_slots import COLUMN_SLOTS, NUMBERS, ROW_SLOTS, SCRATCH
from clmorph.transport._solver import half_steps
from clmorph.transport._solver.anderson import MEMORY, limited_step, mixed
from clmorph.transport._solver.problem import Problem

FILE = Path(__file__).parents[1] / "cl_kernels" / "half_steps.cl"

#: What stands for NumPy's functions in OpenCL C. Operands are `vdouble`, or `double`.
OPERATORS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "greater": ">"}
FUNCTIONS = {
    "exp": "exp", "expm1": "expm1", "log": "log", "sqrt": "sqrt", "absolute": "fabs",
    "minimum": "fmin", "maximum": "fmax",
}  # fmt: skip
#: Functions whose results are kept for later loops, and not computed again.
COSTLY = {"exp", "expm1", "log", "combined", "softmin"}


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """A number or a vector of a kernel.

    Attributes
    ----------
    operation : str
        A function of NumPy, or one of the kinds of inputs and reductions below.
    parts : tuple
        Its operands: symbols and Python's numbers, or the name of an input.
    side : {"", "row", "column"}
        Whose entries a vector has; "" for a number.
    stage : int
        The number of loops that must end before it can be computed.
    """

    __array_priority__ = 100.0
    known: dict[Any, "Symbol"] = {}

    def __new__(cls, operation: str, *parts: Any, side: str = "", stage: int = 0) -> "Symbol":
        key = operation, tuple(id(x) if isinstance(x, Symbol) else x for x in parts), side
        if key not in cls.known:
            made = cls.known[key] = super().__new__(cls)
            made.operation, made.parts, made.side, made.stage = operation, parts, side, stage
            made.number = len(cls.known)
        return cls.known[key]

    def __bool__(self) -> bool:
        return True  # only rates that are not 0 are symbols

    __hash__ = object.__hash__

    def __array_ufunc__(self, function: Any, method: str, *operands: Any, **_: Any) -> Any:
        assert method == "__call__", (function, method)
        return applied(function.__name__, *operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, _: Any) -> Any:
        assert function is np.where, function
        condition, one, other = operands
        return applied("where", condition, one, other)

    def __and__(self, other: Any) -> "Symbol":
        return applied("and", self, other)


def applied(name: str, *operands: Any) -> Any:
    """Return a function of symbols and numbers."""
    operands = tuple(x if isinstance(x, Symbol) else float(x) for x in operands)
    if not any(isinstance(x, Symbol) for x in operands):
        return float(getattr(np, name)(*operands))
    one, other = operands[0], operands[-1]
    if name == "equal":
        return False  # compared with 0, see `Symbol.__bool__`
    if name == "negative":
        return applied("multiply", -1.0, one)
    if name == "multiply" and 0.0 in (one, other):
        return 0.0
    if name in ("add", "subtract") and isinstance(other, float) and other == 0.0:
        return one
    if name == "add" and isinstance(one, float) and one == 0.0:
        return other
    if name == "multiply" and isinstance(one, float) and one == 1.0:
        return other
    if name == "multiply" and isinstance(other, float) and other == 1.0:
        return one
    symbols = [x for x in operands if isinstance(x, Symbol)]
    sides = {x.side for x in symbols} - {""}
    assert len(sides) <= 1, (name, sides)
    stage = max(x.stage for x in symbols)
    return Symbol(name, *operands, side=sides.pop() if sides else "", stage=stage)


class Traced:
    """The reductions of `clmorph.transport._solver.reductions` over symbols."""

    shape = (1,)  # so that numbers are compared by NumPy's functions

    def __init__(self, side: str) -> None:
        self.side = side

    def sum(self, x: Symbol) -> Symbol:
        return Symbol("sum", x, stage=x.stage + 1)

    def inner(self, x: Any, y: Any) -> Symbol:
        return self.sum(x * y)

    def largest(self, x: Symbol) -> Symbol:
        return Symbol("largest", x, stage=x.stage + 1)

    def spread(self, value: Any) -> Any:
        return value

    def scaled(self, factor: Any, x: Any) -> Any:
        return factor * x

    def inner_each(self, many: str, x: Symbol, stored: Symbol) -> Symbol:
        """`stored` is what the newest of the vectors is."""
        return Symbol("inner_each", many, x, stage=max(x.stage, stored.stage) + 1)

    def combined(self, factors: Symbol, many: str) -> Symbol:
        return Symbol("combined", factors, many, side=self.side, stage=factors.stage)


def vector(side: str, slot: str) -> Symbol:
    return Symbol("vector", slot, side=side)


def number(name: str) -> Symbol:
    return Symbol("number", name)


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


class Writer:
    """Writes the body of a kernel for results that are symbols.

    Parameters
    ----------
    results : dict of dict
        Vectors of each side by their slot.
    numbers : dict
        Numbers by their place.
    """

    def __init__(self, results: dict[str, dict[str, Any]], numbers: dict[str, Any]) -> None:
        self.results, self.numbers = results, numbers
        #: Where a vector is stored; without damping a potential is its softmin, and has two places.
        self.slots: dict[Symbol, list[tuple[str, str]]] = {}
        for side, of in results.items():
            for slot, value in of.items():
                self.slots.setdefault(value, []).append((side, slot))
        self.scratch = {"row": 0, "column": 0}
        self.wanted: dict[int, set[Symbol]] = {}  # vectors that a stage's loops store or reduce
        self.scalars: list[Symbol] = []
        self.lines: list[str] = []
        for side in results:
            for value in results[side].values():
                self._want(value, value.stage)
        for value in numbers.values():
            self._number(value)
        self.n_stages = 1 + max(x.stage for x in (*self.scalars, *self.slots))

    def _number(self, symbol: Any) -> None:
        if not isinstance(symbol, Symbol) or symbol in self.scalars:
            return
        if symbol.operation in ("sum", "largest"):
            self._want(symbol.parts[0], symbol.stage - 1)
        elif symbol.operation == "inner_each":
            self._want(symbol.parts[1], symbol.stage - 1)
        elif symbol.operation not in ("number", "flag"):
            for part in symbol.parts:
                self._number(part)
        self.scalars.append(symbol)

    def _want(self, symbol: Symbol, stage: int) -> None:
        """Compute a vector in the loop of a stage."""
        if symbol in self.wanted.setdefault(stage, set()):
            return
        self.wanted[stage].add(symbol)
        self._need(symbol, stage)

    def _need(self, symbol: Any, stage: int) -> None:
        if not isinstance(symbol, Symbol):
            return
        if not symbol.side:
            self._number(symbol)
        elif stage > symbol.stage and (symbol.operation in COSTLY or symbol in self.slots):
            if symbol not in self.slots:
                self.slots[symbol] = [(symbol.side, f"SCRATCH_{self.scratch[symbol.side]}")]
                self.scratch[symbol.side] += 1
                assert self.scratch[symbol.side] <= SCRATCH
            self._want(symbol, symbol.stage)
        else:
            for part in symbol.parts:
                self._need(part, stage)

    def write(self) -> list[str]:
        """Return the lines of the body."""
        for stage in range(self.n_stages):
            for symbol in sorted(self.scalars, key=lambda each: each.number):
                if symbol.stage == stage and symbol.operation not in ("sum", "largest"):
                    self._write_number(symbol)
            for side in ("row", "column"):
                self._write_loop(stage, side)
        # Each item has the same numbers; one writes them.
        self.lines.append("    if (get_local_id(0) == 0) {")
        for name, symbol in self.numbers.items():
            self.lines.append(f"        numbers[{name}] = {self._name(symbol)};")
        self.lines.append("    }")
        return self.lines

    def _name(self, part: Any) -> str:
        if isinstance(part, float):
            return repr(part) if part >= 0 else f"({part!r})"
        if part.operation in ("number", "flag"):
            return str(part.parts[0])
        return f"x{part.number}"

    def _expression(self, symbol: Symbol, named: Any) -> str:
        names = [named(part) for part in symbol.parts]
        if symbol.operation == "where":
            return f"{names[0]} ? {names[1]} : {names[2]}"
        if symbol.operation == "and":
            return f"{names[0]} && {names[1]}"
        if symbol.operation in OPERATORS:
            return f" {OPERATORS[symbol.operation]} ".join(names)
        return f"{FUNCTIONS[symbol.operation]}({', '.join(names)})"

    def _write_number(self, symbol: Symbol) -> None:
        name = self._name(symbol)
        if symbol.operation in ("number", "flag", "inner_each"):
            return
        if symbol.operation == "solve":
            row, right = (self._name(part) for part in symbol.parts)
            self.lines += [
                f"    double factors{name}[MEMORY];",
                f"    const bool {name} = solve_normal(",
                f"        products, {row}, {right}, place, count, system, factors{name});",
            ]
            return
        kind = "bool" if symbol.operation in ("greater", "and") else "double"
        self.lines.append(f"    const {kind} {name} = {self._expression(symbol, self._name)};")

    def _write_loop(self, stage: int, side: str) -> None:
        wanted = [x for x in self.wanted.get(stage, ()) if x.side == side]
        if not wanted:
            return
        size = {"row": "n", "column": "m"}[side]
        reduced = [
            x for x in sorted(self.scalars, key=lambda each: each.number)
            if x.stage == stage + 1
            and (x.operation in ("sum", "largest", "inner_each"))
            and x.parts[-1].side == side
        ]  # fmt: skip
        for x in reduced:
            if x.operation == "inner_each":
                self.lines += [f"    vdouble all{self._name(x)}[MEMORY];",
                               "    for (uint j = 0; j < MEMORY; ++j)",
                               f"        all{self._name(x)}[j] = (vdouble)(0.0);"]  # fmt: skip
            else:
                begin = "0.0" if x.operation == "sum" else "-INFINITY"
                self.lines.append(f"    vdouble all{self._name(x)} = (vdouble)({begin});")
        self.lines.append(f"    for (uint i = FIRST; i < {size}; i += STEP) {{")
        self.here: dict[Symbol, str] = {}
        for x in sorted(wanted, key=lambda each: each.number):
            value = self._entry(x, stage)
            if x in self.slots and x.stage == stage:
                for place in self.slots[x]:
                    self.lines.append(f"        DSTORE({value}, i, {place_of(*place)});")
        for x in reduced:
            name = self._name(x)
            value = self._entry(x.parts[-1], stage)
            if x.operation == "sum":
                self.lines.append(f"        all{name} += {value};")
            elif x.operation == "largest":
                self.lines.append(f"        all{name} = fmax(all{name}, {value});")
            else:
                self.lines += ["        for (uint j = 0; j < MEMORY; ++j)",
                               f"            all{name}[j] += DLOAD(i, {x.parts[0]}(j)) * {value};"]  # fmt: skip
        self.lines.append("    }")
        for x in reduced:
            name = self._name(x)
            if x.operation == "inner_each":
                self.lines += [f"    double {name}[MEMORY];",
                               "    for (uint j = 0; j < MEMORY; ++j)",
                               f"        {name}[j] = group_sum(sum_of_lanes(all{name}[j]), shared);"]  # fmt: skip
            elif x.operation == "sum":
                self.lines.append(
                    f"    const double {name} = group_sum(sum_of_lanes(all{name}), shared);"
                )
            else:
                self.lines.append(
                    f"    const double {name} = group_largest(largest_lane(all{name}), shared);"
                )

    def _entry(self, part: Any, stage: int) -> str:
        """Return the name of entries of a vector in the loop, which is written before."""
        if not isinstance(part, Symbol):
            return f"(vdouble)({part!r})"
        if not part.side:
            if part.operation in ("greater", "and", "flag"):
                return self._name(part)
            return f"(vdouble)({self._name(part)})"
        if part in self.here:
            return self.here[part]
        name, side = f"v{part.number}", part.side.upper()
        kind = "vdouble"
        if part.operation == "vector":
            text = f"DLOAD(i, {place_of(part.side, str(part.parts[0]))})"
        elif part in self.slots and part.stage < stage:
            text = f"DLOAD(i, {place_of(*self.slots[part][0])})"
        elif part.operation == "softmin":
            size = {"row": "n", "column": "m"}[part.side]
            text = (f"softmin_of(maxima, sums, row_level, {side}({side}_OWN_COSTS), "
                    f"shares, {size}, k, i)")  # fmt: skip
        elif part.operation == "combined":
            self.lines += [
                f"        vdouble {name} = (vdouble)(0.0);",
                "        for (uint j = 0; j < MEMORY; ++j)",
                f"            {name} += factors{self._name(part.parts[0])}[j] * "
                f"DLOAD(i, {part.parts[1]}(j));",
            ]
            self.here[part] = name
            return name
        elif part.operation == "greater":
            # Masks have a type of their own, which only a choice takes.
            return f"({self._expression(part, lambda each: self._entry(each, stage))})"
        else:
            text = self._expression(part, lambda each: self._entry(each, stage))
        self.lines.append(f"        const {kind} {name} = {text};")
        self.here[part] = name
        return name


def place_of(side: str, slot: str) -> str:
    """Return a vector's place in its buffer; those that change places have one in a variable."""
    known = {"row": ROW_SLOTS, "column": COLUMN_SLOTS}[side]
    of = f"{side.upper()}_{slot}" if slot in known else f"{slot.lower()}_at"
    return f"{side.upper()}({of})"


HEAD = """\
// The arithmetic of an iteration between two softmins, float64, in one launch of one work-group each:
// damping, translation, marginals, residual, dual, and Anderson's combination of iterates (paper, 2.1
// and 3.1; the formulas are those of clmorph/transport/_solver/half_steps.py, problem.py and anderson.py).
// Before it a kernel joins the softmin that log_sum_exp.cl has computed; after it, it prepares the next.
//
// Written by tools/make_half_steps.py from those formulas: change them.
//
// Shapes: n points of the rows and m of the columns, both padded to whole tiles by points without mass.
// Launch: get_global_size(0) == GROUP, see vector_steps.cl.
//
// -D BALANCED  1: inverse_rho_source is 0; 2: inverse_rho_target; 3: both; 0: none
// -D ROW_*, COLUMN_*, NUMBER_*  places of vectors and numbers, see half_step_slots.py

#ifndef BALANCED
#error "BALANCED (which sides are balanced) must be given"
#endif

#include "vector_steps.cl"

#define ROW(slot) (rows + (size_t)(slot) * n)
#define COLUMN(slot) (columns + (size_t)(slot) * m)
#define AHEAD(j) COLUMN(COLUMN_AHEAD + (j))
#define DIFFERENCES(j) COLUMN(COLUMN_DIFFERENCES + (j))

// `control` has g's place, the parity of the iterate, whether an iterate is stored, the place of its
// difference, and the number of differences.
#define G_AT (control & 63u)
#define PARITY (control >> 6 & 1u)
#define BEGUN (control >> 7 & 1u)
#define PLACE (control >> 8 & 15u)
#define COUNT (control >> 12)

// Prepare the softmin of the rows, T(g), for a new g: that of the host, or one of the columns' vectors.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_rows(
    const uint n, const uint m, const uint planes, const uint control, const double k,
    const __global double* restrict start,       // (m,): the host's g
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // (n / TILE, m / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict row_level,         // (n / TILE,)
    __global float* restrict logits,             // (2, m)
    __global float* restrict levels)             // (n / TILE, planes, m / TILE)
{
    if (G_AT == COLUMN_START)
        for (uint i = FIRST; i < m; i += STEP)
            DSTORE(DLOAD(i, start), i, COLUMN(COLUMN_START));
    prepare_softmin(COLUMN(G_AT), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS), tile_costs, m,
                    n / TILE, planes, k, tile_max, row_level, logits, levels);
}
"""
ARGUMENTS = """\
    const uint n, const uint m, const uint shares, const uint planes, const uint control,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double radius,
    const __global float* restrict maxima,       // (shares, {size})
    const __global float* restrict sums,         // (shares, {size})
    const __global double* restrict row_level,   // ({size} / TILE,): of this softmin
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // ({other} / TILE, {size} / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict next_level,        // ({other} / TILE,): of the next softmin
    __global float* restrict logits,             // (2, {size}): of the next softmin
    __global float* restrict levels,             // ({other} / TILE, planes, {size} / TILE)
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see half_step_slots.py
"""
KERNELS = {
    "row_step": (
        trace_row_step, "n", "m",
        """\
// After T(g): f, the shift of g, and the dual. Then the softmin of the columns, T(f), is prepared.
""",
        """\
    const double nothing = 0.0;
    const uint g_at = G_AT;
""",
        """\
    prepare_softmin(ROW(ROW_F), ROW(ROW_OFFSETS), ROW(ROW_LOG2_WEIGHTS), tile_costs, n, m / TILE,
                    planes, k, tile_max, next_level, logits, levels);
""",
    ),
    "column_step": (
        trace_column_step, "m", "n",
        """\
// After T(f): the residual, the image of g, the shift of f, the dual, and the extrapolated g. Then the
// softmin of the rows, T(g), is prepared.
""",
        """\
    const double nothing = 0.0;
    const bool begun = BEGUN;
    const uint place = PLACE, count = COUNT, g_at = G_AT;
    const uint image_at = COLUMN_IMAGE_0 + PARITY, old_image_at = COLUMN_IMAGE_1 - PARITY;
    const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
    const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
    const uint guess_at = COLUMN_GUESS_0 + PARITY;
    const uint new_ahead_at = COLUMN_AHEAD + place;
    const uint new_difference_at = COLUMN_DIFFERENCES + place;
""",
        """\
    // Without an extrapolation the image itself is next.
    const uint next_at = numbers_found ? guess_at : image_at;
    prepare_softmin(COLUMN(next_at), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS), tile_costs, m,
                    n / TILE, planes, k, tile_max, next_level, logits, levels);
""",
    ),
}  # fmt: skip


def made() -> str:
    """Return the file's text."""
    text = HEAD
    for name, (trace, size, other, comment, begin, end) in KERNELS.items():
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
