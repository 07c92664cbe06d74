"""Compare the errors that `clmorph.sinkhorn` reports with those of an independent judge.

    python tools/cross_check.py --count 500
    python tools/cross_check.py --count 500 --device 0:0 --device numpy
    python tools/cross_check.py --seed 0 --only 17 --device 0:0     the one problem again
    python tools/cross_check.py --grids --count 200                 problems between grids

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
import signal
import threading
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from crosscheck.claims import CHECKS, Outcome, Told, check, widening_of_the_value
from crosscheck.exact import Dense, evaluate
from crosscheck.judge import Optimum, solve
from crosscheck.numbers import NUMBER
from crosscheck.problems import SMALL, Problem, make
from findings import Findings

import clmorph
from clmorph.backends.opencl.devices.find import find_devices

#: More pairs than this are left out in NumPy, which would take minutes for each.
MOST_IN_NUMPY = 1 << 20
#: Seconds of work in which a solve must end, and more of them for each pair of points: 300 s for
#: 2^27 pairs; and seconds of the clock for each, as other programs may be running.
PATIENCE, PATIENCE_PER_PAIR, CLOCK = 60.0, 300.0 / (1 << 27), 20.0
#: Problems with more pairs than this are judged by sums alone.
MOST_SOLVED = SMALL * SMALL


class OutOfTimeError(BaseException):
    """A call took too long. The class is one that no library code catches as its own error."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise `OutOfTimeError` after so much work of all threads; not on Windows."""
    if not hasattr(signal, "setitimer") or threading.current_thread() != threading.main_thread():
        yield
        return

    def end(number: int, frame: Any) -> None:
        raise OutOfTimeError(f"no answer after {seconds:g} s of work")

    timers = {signal.SIGPROF: signal.ITIMER_PROF, signal.SIGALRM: signal.ITIMER_REAL}
    before = {number: signal.signal(number, end) for number in timers}
    try:
        signal.setitimer(signal.ITIMER_PROF, seconds)
        signal.setitimer(signal.ITIMER_REAL, CLOCK * seconds)
        yield
    finally:
        for number, timer in timers.items():
            signal.setitimer(timer, 0.0)
            signal.signal(number, before[number])


class Judge:
    """Problems with their optima, worked out once for all backends."""

    def __init__(self, seed: int, patience: float = PATIENCE, grids: bool = False) -> None:
        self._seed, self._patience, self._grids = seed, patience, grids
        self._problem: Problem | None = None
        self._solved: tuple[int, Dense, Optimum | None] | None = None

    def problem(self, number: int) -> Problem:
        """Return the problem of a number."""
        if self._problem is None or self._problem.number != number:
            self._problem = make(self._seed, number, self._grids)
        return self._problem

    def optimum(self, number: int) -> tuple[Dense, Optimum | None]:
        """Return what is judged, and its optimum; None if it is too large to solve."""
        if self._solved is None or self._solved[0] != number:
            dense = self.problem(number).dense()
            found = solve(dense) if dense.pairs <= MOST_SOLVED else None
            self._solved = number, dense, found
        return self._solved[1:]

    def _answer(self, problem: Problem, backend: Any) -> Any:
        seconds = self._patience + PATIENCE_PER_PAIR * problem.pairs
        with limited(seconds), warnings.catch_warnings():
            # NumPy's warnings of overflow and the like are findings.
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
            return clmorph.sinkhorn(
                problem.source, problem.target, problem.blur, problem.reach,
                backend=backend, **problem.options,
            )  # fmt: skip

    def compare(self, number: int, backend: Any) -> tuple[list[Outcome], Told | None]:
        """Solve a problem; return the claims held against the truth, and the result if any."""
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
    backends: Sequence[str], seed: int, numbers: Sequence[int], findings: Findings,
    largest: int | None = None, patience: float = PATIENCE, grids: bool = False,
) -> list[str]:  # fmt: skip
    """Hold problems against the truth on some backends, and return lines that sum it up.

    Problems with more than `largest` pairs of points are left out; `patience` is in seconds of
    work for a solve, but for what large problems take; `grids` are problems between grids.
    """
    judge = Judge(seed, patience, grids)
    counts: dict[str, Counter[str]] = {name: Counter() for name in backends}
    worst: dict[str, dict[str, tuple[float, int]]] = {name: {} for name in backends}
    widened: dict[str, float] = defaultdict(float)
    for number in numbers:
        problem = judge.problem(number)
        for name, count in counts.items():
            most = MOST_IN_NUMPY if name == "numpy" and largest is None else largest
            if most is not None and problem.pairs > most:
                count["too large and left out"] += 1
                continue
            outcomes, told = judge.compare(number, name)
            count["problems"] += 1
            if told is not None and told.optimum is None:
                count["judged by sums alone"] += 1
            elif told is not None and not told.optimum.settled:
                count["not settled by the judge"] += 1
            if told is not None:
                widened[name] = max(widened[name], widening_of_the_value(told) or 0.0)
            findings.trial(name)
            for outcome in outcomes:
                count[outcome.check] += 1
                worst[name][outcome.check] = max(
                    worst[name].get(outcome.check, (-np.inf, 0)), (outcome.worst, number)
                )
                if outcome.broken:
                    what = f"{number}, {outcome.check}: {outcome.words} ({problem.words})"
                    findings.add(
                        name, what, [*grids * ["--grids"], "--only", str(number), "--device", name]
                    )
    lines = []
    for name, count in counts.items():
        told_of = ", ".join(f"{count[key]} {key}" for key in count if key not in CHECKS)
        lines.append(f"{name}: {told_of}; intervals are wider by up to {widened[name]:.2g}")
        for claim in CHECKS:
            if claim in worst[name]:
                size, number = worst[name][claim]
                lines.append(f"  {claim}: {count[claim]} cases, worst {size:.2g} ({number})")
    return lines


def _devices(given: list[str] | None) -> list[str]:
    """Return names of backends."""
    usable = [device for device in find_devices() if device.usable]
    if given is None:
        return [*(device.index for device in usable), "numpy"]
    found = []
    for name in given:
        matching = [device.index for device in usable if device.matches(name)]
        if name != "numpy" and not matching:
            raise ValueError(f"no usable OpenCL device matches {name!r}")
        found.append(name if name == "numpy" else matching[0])
    return found


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=500, help="problems [default: 500]")
    parser.add_argument("--seed", type=int, default=0, help="of all problems [default: 0]")
    parser.add_argument("--device", action="append", metavar="NAME",
                        help="index or part of the name of a device, or 'numpy'; may be given "
                             "several times [default: all, and numpy]")  # fmt: skip
    parser.add_argument("--only", type=int, metavar="NUMBER", help="this one problem")
    parser.add_argument("--grids", action="store_true", help="problems between grids")
    arguments = parser.parse_args(given)
    if arguments.count < 1 or arguments.seed < 0 or (arguments.only or 0) < 0:
        parser.error("--count: expected at least 1; --seed and --only: at least 0")
    try:
        names = _devices(arguments.device)
    except ValueError as error:
        parser.error(str(error))
    print(f"the judge computes with {np.finfo(NUMBER).nmant + 1} bits")
    numbers, largest = range(arguments.count), None
    if arguments.only is not None:
        problem = make(arguments.seed, arguments.only, arguments.grids)
        numbers, largest = [arguments.only], problem.pairs
        print(f"{arguments.only}: {problem.words}; to be refused: {problem.refused or 'no'}")
    findings = Findings(["--seed", str(arguments.seed)])
    print("\n".join(run(names, arguments.seed, numbers, findings, largest, grids=arguments.grids)))
    return findings.end()


if __name__ == "__main__":
    raise SystemExit(main())
