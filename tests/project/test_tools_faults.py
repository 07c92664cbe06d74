"""Run a small part of ``tools/faults.py``."""

import sys

import pytest
from conftest import TESTED


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
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
