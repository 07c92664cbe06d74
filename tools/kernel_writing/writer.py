"""Write what symbols have recorded as loops of OpenCL C."""

from typing import Any

from clmorph.backends.opencl.build.half_step_slots import COLUMN_SLOTS, ROW_SLOTS, SCRATCH
from kernel_writing.symbols import Symbol

#: The number of entries of each side's vectors.
SIZES = {"row": "n", "column": "m"}

#: What stands for NumPy's functions in OpenCL C. Operands are `vdouble`, or `double`.
OPERATORS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "greater": ">"}
FUNCTIONS = {
    "exp": "exp", "expm1": "expm1", "log": "log", "sqrt": "sqrt", "absolute": "fabs",
    "minimum": "fmin", "maximum": "fmax",
}  # fmt: skip
#: Functions whose results are kept for later loops, and not computed again.
COSTLY = {"exp", "expm1", "log", "combined", "softmin"}


class Writer:
    """Writes the body of a kernel for results that are symbols.

    Parameters
    ----------
    results : dict of dict
        Vectors of each side by their slot.
    numbers : dict
        Numbers by their place.
    """

    #: The vectors of each side that have places of their own.
    known = {"row": ROW_SLOTS, "column": COLUMN_SLOTS}  # noqa: RUF012

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
        self._write_results()
        return self.lines

    def _write_results(self) -> None:
        """Write the numbers for the host: each item has the same ones, and one stores them."""
        self.lines.append("    if (get_local_id(0) == 0) {")
        for name, symbol in self.numbers.items():
            self.lines.append(f"        numbers[{name}] = {self._name(symbol)};")
        self.lines.append("    }")

    def _name(self, part: Any) -> str:
        if isinstance(part, float):
            return literal(part) if part >= 0 else f"({literal(part)})"
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
        reduced = self._reduced(stage, side)
        for x in reduced:
            if x.operation == "inner_each":
                self.lines += [f"    vdouble all{self._name(x)}[MEMORY];",
                               "    for (uint j = 0; j < MEMORY; ++j)",
                               f"        all{self._name(x)}[j] = (vdouble)(0.0);"]  # fmt: skip
            else:
                begin = "0.0" if x.operation == "sum" else "-INFINITY"
                self.lines.append(f"    vdouble all{self._name(x)} = (vdouble)({begin});")
        self.lines.append(self._loop_head(SIZES[side]))
        self.here: dict[Symbol, str] = {}
        for x in sorted(wanted, key=lambda each: each.number):
            value = self._entry(x, stage)
            if x in self.slots and x.stage == stage:
                for place in self.slots[x]:
                    self._store(value, *place)
        for x in reduced:
            name = self._name(x)
            value = self._entry(x.parts[-1], stage)
            if x.operation == "sum":
                self.lines.append(f"        all{name} += {value};")
            elif x.operation == "largest":
                self.lines.append(f"        all{name} = fmax(all{name}, {value});")
            else:
                self._add_each(f"all{name}[j] += ", str(x.parts[0]), f" * {value};")
        self.lines.append("    }")
        for x in reduced:
            self._reduce(x)

    def _reduced(self, stage: int, side: str) -> list[Symbol]:
        """Return the reductions over vectors of a side in the loop of a stage."""
        return [
            x for x in sorted(self.scalars, key=lambda each: each.number)
            if x.stage == stage + 1
            and (x.operation in ("sum", "largest", "inner_each"))
            and x.parts[-1].side == side
        ]  # fmt: skip

    def _loop_head(self, size: str) -> str:
        """Return the line that begins the loop over this many entries."""
        return f"    for (uint i = FIRST; i < {size}; i += STEP) {{"

    def _store(self, value: str, side: str, slot: str) -> None:
        """Store entries of a vector."""
        self.lines.append(f"        DSTORE({value}, i, {self._place(side, slot)});")

    def _add_each(self, begin: str, many: str, end: str) -> None:
        """Add something of each of many vectors."""
        self.lines += ["        for (uint j = 0; j < MEMORY; ++j)",
                       f"            {begin}DLOAD(i, {many}(j)){end}"]  # fmt: skip

    def _reduce(self, x: Symbol) -> None:
        """Reduce what each lane of each item has found."""
        name = self._name(x)
        if x.operation == "inner_each":
            self.lines += [f"    double {name}[MEMORY];",
                           "    for (uint j = 0; j < MEMORY; ++j)",
                           f"        {name}[j] = "
                           f"group_sum(sum_of_lanes(all{name}[j]), shared);"]  # fmt: skip
        else:
            self.lines.append(f"    const double {name} = {self._over_group(x)};")

    def _over_group(self, x: Symbol) -> str:
        """Return the sum or the largest entry over the work-group."""
        name = self._name(x)
        if x.operation == "sum":
            return f"group_sum(sum_of_lanes(all{name}), shared)"
        return f"group_largest(largest_lane(all{name}), shared)"

    def _place(self, side: str, slot: str) -> str:
        """Return a vector's place; those that change places have one in a variable."""
        of = f"{side.upper()}_{slot}" if slot in self.known[side] else f"{slot.lower()}_at"
        return f"{side.upper()}({of})"

    def _softmin(self, side: str) -> str:
        """Return the softmin of some points."""
        own = side.upper()
        return (f"softmin_of(maxima, sums, row_level, {own}({own}_OWN_COSTS), "
                f"shares, {SIZES[side]}, k, i)")  # fmt: skip

    def _entry(self, part: Any, stage: int) -> str:
        """Return the name of entries of a vector in the loop, which is written before."""
        if not isinstance(part, Symbol):
            return f"(vdouble)({literal(part)})"
        if not part.side:
            if part.operation in ("greater", "and", "flag", "solve"):
                return self._name(part)
            return f"(vdouble)({self._name(part)})"
        if part in self.here:
            return self.here[part]
        name, kind = f"v{part.number}", "vdouble"
        if part.operation == "vector":
            text = f"DLOAD(i, {self._place(part.side, str(part.parts[0]))})"
        elif part in self.slots and part.stage < stage:
            text = f"DLOAD(i, {self._place(*self.slots[part][0])})"
        elif part.operation == "softmin":
            text = self._softmin(part.side)
        elif part.operation == "combined":
            self.lines.append(f"        vdouble {name} = (vdouble)(0.0);")
            factors = f"factors{self._name(part.parts[0])}[j]"
            self._add_each(f"{name} += {factors} * ", str(part.parts[1]), ";")
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


def literal(value: float) -> str:
    """Return a number as OpenCL C has it."""
    return repr(value).replace("inf", "INFINITY")
