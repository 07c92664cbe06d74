"""Compare the errors that `clmorph.sinkhorn` reports with those of an independent judge.

    python tools/cross_check.py --count 500
    python tools/cross_check.py --count 500 --device 0:0 --device numpy --markdown
    python tools/cross_check.py --seed 0 --only 17 --device 0:0     the one problem again

Each problem is made from the seed and its number alone, and solved on every usable OpenCL device
and in NumPy. The judge knows nothing of the library's solver: it sums over all pairs in long
double, with a bound of its own error (`crosscheck.exact`), and for up to 60 points a side it
solves the problem itself, to a gap of 1e-15 of the value (`crosscheck.judge`). Larger problems,
up to 2^27 pairs, are judged by the sums alone, in float64 with a bound. What is checked is listed
by `crosscheck.claims.CHECKS`. The problem is the one of the arrays that are given, with
epsilon = blur^2 and rho = reach^2 as float64 has them. Exit codes: 0 nothing was found; 1 something
was; 2 a mistake in the command line.
"""

import argparse
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from crosscheck.claims import CHECKS, Outcome, Told, check, widening_of_the_value
from crosscheck.exact import EXTENDED, NUMBER, Dense, evaluate
from crosscheck.judge import Optimum, solve
from crosscheck.patience import OutOfTimeError, limited
from crosscheck.problems import SMALL, Problem, make, parts
from findings import Findings

import clmorph
from clmorph.backends.opencl.devices.find import find_devices

#: More pairs than this are left out in NumPy, which would take minutes for each.
MOST_IN_NUMPY = 1 << 20
#: Seconds of work in which a solve must end, and more of them for each pair of points: 300 s for
#: 2^27 pairs.
PATIENCE, PATIENCE_PER_PAIR = 60.0, 300.0 / (1 << 27)
#: Problems with more pairs than this are judged by sums alone.
MOST_SOLVED = SMALL * SMALL


@dataclass
class Tally:
    """What one backend told, over all problems."""

    cases: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    broken: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    worst: dict[str, float] = field(default_factory=lambda: defaultdict(lambda: -np.inf))
    where: dict[str, int] = field(default_factory=dict)
    problems: int = 0
    violated: int = 0
    unsettled: int = 0
    unsolved: int = 0
    left_out: int = 0
    widening_of_value: float = -np.inf
    seconds: float = 0.0

    def add(self, number: int, outcome: Outcome) -> None:
        """Count an outcome."""
        self.cases[outcome.check] += 1
        self.broken[outcome.check] += outcome.broken
        if outcome.worst > self.worst[outcome.check]:
            self.worst[outcome.check] = outcome.worst
            self.where[outcome.check] = number


class Judge:
    """Problems with their optima, worked out once for all backends."""

    def __init__(self, seed: int, patience: float = PATIENCE) -> None:
        self._seed, self._patience = seed, patience
        self._problem: Problem | None = None
        self._solved: tuple[int, Dense, Optimum | None] | None = None

    def problem(self, number: int) -> Problem:
        """Return the problem of a number."""
        if self._problem is None or self._problem.number != number:
            self._problem = make(self._seed, number)
        return self._problem

    def optimum(self, number: int) -> tuple[Dense, Optimum | None]:
        """Return what is judged, and its optimum; None if it is too large to solve."""
        if self._solved is None or self._solved[0] != number:
            problem = self.problem(number)
            dense, found = problem.dense(), None
            if not problem.refused and dense.pairs <= MOST_SOLVED:
                found = solve(dense)
            self._solved = number, dense, found
        return self._solved[1:]

    def _answer(self, problem: Problem, backend: Any) -> Any:
        """Call the solver."""
        with (
            limited(self._patience + PATIENCE_PER_PAIR * problem.pairs),
            warnings.catch_warnings(),
        ):
            # NumPy's warnings of overflow and the like are findings.
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
            return clmorph.sinkhorn(
                problem.source, problem.target, problem.blur, problem.reach,
                backend=backend, **problem.options,
            )  # fmt: skip

    def compare(self, number: int, backend: Any) -> tuple[list[Outcome], Told | None]:
        """Solve a problem on a backend, and compare the reported errors with the true ones.

        Returns
        -------
        list of Outcome
        Told or None
            The result with the truth, if there is a result.
        """
        problem = self.problem(number)
        try:
            try:
                result = self._answer(problem, backend)
            except OutOfTimeError:  # kernels may have been compiled: once more
                result = self._answer(problem, backend)
        except OutOfTimeError as error:
            return [Outcome("answers", 1.0, True, str(error))], None
        except Exception as error:
            meant = bool(problem.refused) and isinstance(error, clmorph.InputError)
            words = f"{type(error).__name__}: {error}"
            return [Outcome("answers", float(not meant), not meant, words)], None
        if problem.refused:
            return [Outcome("answers", 1.0, True, f"not refused: {problem.refused}")], None
        dense, optimum = self.optimum(number)
        f, g = np.asarray(result.f)[dense.source.places], np.asarray(result.g)[dense.target.places]
        answered = Outcome("answers", 0.0, False)
        if not (np.all(np.isfinite(f)) and np.all(np.isfinite(g))):
            return [answered, Outcome("finite", 1.0, True, "f, g")], None
        with np.errstate(over="ignore"):
            truth = evaluate(dense, f, g)
        told = Told(result, dense, truth, optimum, problem.options["tol"])
        return [answered, *check(told)], told


def run(
    backends: Sequence[str],
    seed: int,
    numbers: Sequence[int],
    findings: Findings,
    largest: int | None = None,
    patience: float = PATIENCE,
) -> dict[str, Tally]:
    """Hold problems against the truth on some backends.

    Parameters
    ----------
    backends : sequence of str
        As `clmorph.get_backend` takes them.
    seed : int
    numbers : sequence of int
        Of the problems.
    findings : Findings
    largest : int, optional
        Leave out problems with more pairs of points.
    patience : float
        Seconds of work for a solve, but for what large problems take.

    Returns
    -------
    dict of str to Tally
        By backend.
    """
    judge, tallies = Judge(seed, patience), {name: Tally() for name in backends}
    for number in numbers:
        problem = judge.problem(number)
        for name, tally in tallies.items():
            most = MOST_IN_NUMPY if name == "numpy" and largest is None else largest
            if most is not None and problem.pairs > most:
                tally.left_out += 1
                continue
            began = time.perf_counter()
            outcomes, told = judge.compare(number, name)
            tally.seconds += time.perf_counter() - began
            tally.problems += 1
            if told is not None:
                tally.unsolved += told.optimum is None
                tally.unsettled += told.optimum is not None and not told.optimum.settled
                share = widening_of_the_value(told)
                if share is not None:
                    tally.widening_of_value = max(tally.widening_of_value, share)
            findings.trial(name)
            tally.violated += any(outcome.broken for outcome in outcomes)
            for outcome in outcomes:
                tally.add(number, outcome)
                if outcome.broken:
                    what = f"{number}, {outcome.check}: {outcome.words} ({problem.words})"
                    findings.add(name, what, ["--only", str(number), "--device", name])
    return tallies


def table(tallies: dict[str, Tally], names: dict[str, str], markdown: bool) -> list[str]:
    """Return the lines that sum up what was found."""
    header = ["backend", "claim", "cases", "broken", "worst", "problem"]
    rows = []
    for backend, tally in tallies.items():
        for name in CHECKS:
            if tally.cases[name]:
                rows.append([
                    backend, name, str(tally.cases[name]), str(tally.broken[name]),
                    f"{tally.worst[name]:.2g}", str(tally.where.get(name, "")),
                ])  # fmt: skip
    widths = [max(len(row[k]) for row in [header, *rows]) for k in range(len(header))]
    if markdown:
        lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
        lines += ["| " + " | ".join(row).replace("<=", "≤") + " |" for row in rows]
        lines.append("")
    else:
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in [header, *rows]
        ]
    for backend, tally in tallies.items():
        lines.append(
            f"{'- ' if markdown else ''}{backend} ({names[backend]}): {tally.problems} problems, "
            f"{tally.violated} with a claim broken, {tally.unsettled} not settled by the judge, "
            f"{tally.unsolved} judged by sums alone, {tally.left_out} too large and left out, "
            f"{tally.seconds:.0f} s; the interval is wider than it need be by up to "
            f"{tally.widening_of_value:.2g} of the value itself"
        )
    return lines


def _devices(given: list[str] | None) -> dict[str, str]:
    """Return names of backends, with what they are."""
    usable = [device for device in find_devices() if device.usable]
    if given is None:
        return {device.index: str(device) for device in usable} | {"numpy": "NumPy, float64"}
    found = {}
    for name in given:
        if name == "numpy":
            found[name] = "NumPy, float64"
            continue
        matching = [device for device in usable if device.matches(name)]
        if not matching:
            raise ValueError(f"no usable OpenCL device matches {name!r}")
        found[matching[0].index] = str(matching[0])
    return found


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=500, help="problems [default: 500]")
    parser.add_argument("--seed", type=int, default=0, help="of all problems [default: 0]")
    parser.add_argument("--device", action="append", metavar="NAME",
                        help="index or part of the name of a device, or 'numpy'; may be given "
                             "several times [default: all, and numpy]")  # fmt: skip
    parser.add_argument("--only", type=int, metavar="NUMBER", help="this one problem")
    parser.add_argument("--largest", type=int, metavar="PAIRS",
                        help="leave out problems with more pairs of points [default: none, in "
                             f"NumPy more than {MOST_IN_NUMPY}]")  # fmt: skip
    parser.add_argument("--patience", type=float, default=PATIENCE, metavar="SECONDS",
                        help=f"of work for a small problem [default: {PATIENCE:g}]")  # fmt: skip
    parser.add_argument("--markdown", action="store_true", help="print the table for the docs")
    arguments = parser.parse_args(given)
    if arguments.count < 1 or arguments.seed < 0 or (arguments.only or 0) < 0:
        parser.error("--count: expected at least 1; --seed and --only: at least 0")
    try:
        names = _devices(arguments.device)
    except ValueError as error:
        parser.error(str(error))
    bits = np.finfo(NUMBER).nmant + 1
    print(f"the judge computes with {bits} bits", file=sys.stderr)
    if not EXTENDED:
        print("long double is float64 here: the judge settles less, and allows more for itself",
              file=sys.stderr)  # fmt: skip
    numbers = range(arguments.count) if arguments.only is None else [arguments.only]
    if arguments.only is not None:
        problem = make(arguments.seed, arguments.only)
        n, m = len(parts(problem.source)[0]), len(parts(problem.target)[0])
        print(
            f"{arguments.only}: {problem.words}"
            + (f"; to be refused: {problem.refused}" if problem.refused else "")
        )
        arguments.largest = arguments.largest or n * m
    findings = Findings(["--seed", str(arguments.seed)])
    tallies = run(
        list(names), arguments.seed, numbers, findings, arguments.largest, arguments.patience
    )
    print("\n".join(table(tallies, names, arguments.markdown)))
    return findings.end()


if __name__ == "__main__":
    raise SystemExit(main())
