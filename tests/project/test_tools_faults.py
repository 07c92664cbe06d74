"""Run a small part of ``tools/faults.py``."""

import sys
from pathlib import Path

import pytest
from conftest import TESTED

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch):
    if not TOOLS.exists() or sys.platform == "win32":
        pytest.skip("the tools need a checkout, and signals as POSIX has them")
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.full
@pytest.mark.needs_device
def test_runs_that_are_interrupted(capsys):
    """Ctrl-C while frames are drawn and written, over an old file and without one; a full disk."""
    import faults

    runs = faults.Runs(TESTED[0].index, faults.Findings([]))
    runs.measure("gif")
    seconds = runs.references["gif"].seconds
    for share, old in ((0.6, True), (0.9, False)):
        runs.kill("gif", "SIGINT", share * seconds, old)
    runs.fill("gif", 0)
    assert runs.findings.end() == 0, capsys.readouterr().out
