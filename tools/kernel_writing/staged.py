"""Write what symbols have recorded as parts of kernels that run in many work-groups."""

import re

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import stored_step_slots
from kernel_writing.symbols import Symbol
from kernel_writing.writer import SIZES, Writer


class StagedWriter(Writer):
    """Writes loops over vectors that many work-groups share, and what joins their sums.

    A loop and the numbers that its sums lead to are a stage. The groups leave their sums in
    ``partials``; a single group joins these and keeps the stage's numbers in ``scalars``. No stage
    has a barrier, because some compilers do not bear them in branches: what needs barriers stands
    before the stages, or after them.
    """

    known = {  # noqa: RUF012
        "row": stored_step_slots.ROW_SLOTS, "column": stored_step_slots.COLUMN_SLOTS,
    }  # fmt: skip

    def stages(self) -> list[tuple[list[str], list[str]]]:
        """Return for each stage the lines of its loops, and those that join their sums."""
        self._partials: dict[Symbol, int] = {}
        self._kept: dict[str, int] = {}  # places of numbers in `scalars`
        self._read: set[str] = set()  # those of them that a later stage reads
        self._texts: dict[str, Symbol] = {self._name(x): x for x in self.scalars}
        #: The number of partial sums of each stage, and bits of those that are largest entries.
        self.found: list[tuple[int, int]] = []
        #: The stage of the normal equations, and the places of their inner products.
        self.solved_at: tuple[int, int, int] | None = None
        bodies = []
        last = max(self.wanted)
        for stage in range(last + 1):
            self._partials = {}
            count = 0
            for side in SIZES:
                for x in self._reduced(stage, side):
                    self._partials[x] = count
                    count += MEMORY if x.operation == "inner_each" else 1
            assert count <= stored_step_slots.PARTIALS, count
            largest = sum(
                1 << place for x, place in self._partials.items() if x.operation == "largest"
            )
            self.found.append((count, largest))
            self.lines = []
            for side in SIZES:
                self._write_loop(stage, side)
            self.lines += [f"    n_found = {count};", f"    largest = {largest}ul;"]
            loops = self._with_numbers(self.lines)
            self.lines = []
            for x in self._partials:
                self._join(x)
            for x in sorted(self.scalars, key=lambda each: each.number):
                if x.stage == stage + 1 and x not in self._partials:
                    self._write_number(x)
                if x.stage == stage + 1 and x.operation == "solve":
                    row, right = (self._partials[part] for part in x.parts)
                    self.solved_at = stage, row, right
            made = [
                self._name(x) for x in self.scalars
                if x.stage == stage + 1 and x.operation != "inner_each"
            ]  # fmt: skip
            self.lines.append("    if (get_local_id(0) == 0) {")
            for name in made:
                self._keep(name)
            if stage == last:
                for place, symbol in self.numbers.items():
                    self.lines.append(f"        numbers[{place}] = {self._name(symbol)};")
            self.lines.append("    }")
            bodies.append((loops, self._with_numbers(self.lines)))
        return [(loops, self._without_unread(joins)) for loops, joins in bodies]

    def _without_unread(self, lines: list[str]) -> list[str]:
        """Leave out the lines that keep numbers which no later stage reads."""
        kept = re.compile(r" *scalars\[\d+\] = (x\d+);")
        found = [(line, kept.fullmatch(line)) for line in lines]
        return [line for line, match in found if not match or match[1] in self._read]

    def _keep(self, name: str) -> None:
        """Keep a number for the next stages."""
        symbol = self._texts[name]
        place = sum(self._size(each) for each in self._kept)
        self._kept[name] = place
        assert place + self._size(name) <= stored_step_slots.SCALARS
        self.lines.append(f"        scalars[{place}] = {name};")
        if symbol.operation == "solve":
            self.lines += ["        for (uint j = 0; j < MEMORY; ++j)",
                           f"            scalars[{place + 1} + j] = factors[j];"]  # fmt: skip

    def _size(self, name: str) -> int:
        solved = self._texts[name].operation == "solve"
        return 1 + MEMORY * solved

    def _with_numbers(self, lines: list[str]) -> list[str]:
        """Return lines after those that load or compute the numbers which they need."""
        made = set(re.findall(r"(?:double|bool) (x\d+)", "\n".join(lines)))
        before: list[str] = []

        def load(text: str) -> None:
            for factors, name in re.findall(r"\b(factors)?(x\d+)\b", text):
                key = factors + name
                if key in made or name in made:
                    continue
                made.add(key)
                symbol = self._texts[name]
                if name in self._kept:
                    self._read.add(name)
                if factors:
                    place = self._kept[name] + 1
                    before.append(f"    const __global double* {key} = scalars + {place};")
                elif symbol.stage == 0:
                    line = f"    const double {name} = {self._expression(symbol, self._name)};"
                    load(line.partition("=")[2])
                    before.append(line)
                elif symbol.operation in ("greater", "and", "solve"):
                    before.append(f"    const bool {name} = scalars[{self._kept[name]}] != 0.0;")
                else:
                    before.append(f"    const double {name} = scalars[{self._kept[name]}];")

        load("\n".join(lines))
        return before + lines

    def _loop_head(self, size: str) -> str:
        return f"    for (uint i = OWN_FIRST({size}); i < OWN_END({size}); i += STEP) {{"

    def _store(self, value: str, side: str, slot: str) -> None:
        if slot == "CHANGES":
            self.lines.append(f"        SSTORE(TO_VSINGLE({value}), i, changes);")
        else:
            super()._store(value, side, slot)

    def _place(self, side: str, slot: str) -> str:
        if slot in stored_step_slots.GIVEN:
            return f"{side.upper()}_GIVEN(GIVEN_{slot})"
        return super()._place(side, slot)

    def _add_each(self, begin: str, many: str, end: str) -> None:
        # Differences that are not stored yet are not read: their memory may hold anything.
        self.lines += ["#pragma unroll",
                       "        for (uint j = 0; j < MEMORY; ++j)",
                       "            if (j < count)",
                       f"                {begin}DLOAD(i, {many}(j)){end}"]  # fmt: skip

    def _reduce(self, x: Symbol) -> None:
        place, name = self._partials[x], self._name(x)
        if x.operation == "inner_each":
            self.lines += ["    for (uint j = 0; j < MEMORY; ++j)",
                           f"        found[{place} + j] = sum_of_lanes(all{name}[j]);"]  # fmt: skip
        else:
            lanes = {"sum": "sum_of_lanes", "largest": "largest_lane"}[x.operation]
            self.lines.append(f"    found[{place}] = {lanes}(all{name});")

    def _join(self, x: Symbol) -> None:
        """Take what the groups' sums have been joined to."""
        if x.operation != "inner_each":
            self.lines.append(f"    const double {self._name(x)} = found[{self._partials[x]}];")

    def _write_number(self, symbol: Symbol) -> None:
        if symbol.operation == "solve":
            self.lines.append(f"    const bool {self._name(symbol)} = determined;")
        else:
            super()._write_number(symbol)

    def _softmin(self, side: str) -> str:
        base, alone = (self._place(side, slot) for slot in ("BASE", "ALONE"))
        return f"stored_softmin(maxima, sums, {base}, {alone}, middle, k, i)"
