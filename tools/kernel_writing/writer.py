"""Write what symbols have recorded as loops of OpenCL C."""

from typing import Any

from clmorph.backends.opencl.build.half_step_slots import COLUMN_SLOTS, ROW_SLOTS, SCRATCH
from kernel_writing.symbols import Symbol

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
                               f"            all{name}[j] += "
                               f"DLOAD(i, {x.parts[0]}(j)) * {value};"]  # fmt: skip
        self.lines.append("    }")
        for x in reduced:
            name = self._name(x)
            if x.operation == "inner_each":
                self.lines += [f"    double {name}[MEMORY];",
                               "    for (uint j = 0; j < MEMORY; ++j)",
                               f"        {name}[j] = "
                               f"group_sum(sum_of_lanes(all{name}[j]), shared);"]  # fmt: skip
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
