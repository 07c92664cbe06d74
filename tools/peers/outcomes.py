"""Turn lines that the plugin wrote into outcomes, counts and a table, without a peer library."""

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

#: What begins the reason of an adapter that declined; see `peers.bridge.Declined`.
DECLINED = "not applicable: "
OUTCOMES = ("passed", "failed", "not applicable", "not exercised")


class Outcome(NamedTuple):
    """Of one test: one of `OUTCOMES`, and why."""

    test: str
    outcome: str
    reason: str
    calls: int


def classify(told: dict[str, Any]) -> Outcome:
    """Return what a test says of clmorph.

    A test that passed says something only if clmorph was called; one that failed is a failure
    whether or not; one that was skipped needs a reason, the adapter's or the library's own.
    """
    test, calls, message = told["test"], int(told["calls"]), str(told["message"])
    if told["outcome"] == "failed":
        return Outcome(test, "failed", message, calls)
    if told["outcome"] == "skipped":
        if DECLINED in message:
            return Outcome(test, "not applicable", message.partition(DECLINED)[2], calls)
        if not message:
            return Outcome(test, "failed", "skipped without a reason", calls)
        return Outcome(test, "not applicable", f"skipped by the library: {message}", calls)
    if told["outcome"] == "passed" and calls:
        return Outcome(test, "passed", "", calls)
    if told["outcome"] == "passed":
        return Outcome(test, "not exercised", "no solver that is replaced was called", calls)
    return Outcome(test, "failed", f"unknown outcome {told['outcome']!r}", calls)


def read(report: Path) -> list[Outcome]:
    """Return the outcomes of a report."""
    lines = report.read_text(encoding="utf-8").splitlines() if report.exists() else []
    return [classify(json.loads(line)) for line in lines]


def verdict(outcomes: Iterable[Outcome]) -> int:
    """Return the exit code: 1 if a test failed, or none called clmorph."""
    counts = Counter(each.outcome for each in outcomes)
    return int(bool(counts["failed"]) or not counts["passed"])


def summary(suites: dict[str, list[Outcome]], markdown: bool) -> str:
    """Return a table of counts, and of the reasons of what is not applicable."""
    rows = [("suite", *OUTCOMES, "solves")]
    for name, outcomes in suites.items():
        counts = Counter(each.outcome for each in outcomes)
        solves = sum(each.calls for each in outcomes if each.outcome == "passed")
        rows.append((name, *(str(counts[each]) for each in OUTCOMES), str(solves)))
    lines = _table(rows, markdown)
    for name, outcomes in suites.items():
        reasons = Counter(each.reason for each in outcomes if each.outcome == "not applicable")
        if reasons:
            heading = f"not applicable in {name}"
            counted = [(reason[:90], str(count)) for reason, count in reasons.most_common()]
            lines += ["", *_table([(heading, "tests"), *counted], markdown)]
    return "\n".join(lines)


def _table(rows: list[tuple[str, ...]], markdown: bool) -> list[str]:
    if markdown:
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        return [lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
