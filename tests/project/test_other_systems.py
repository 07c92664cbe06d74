"""What can be seen here of a run on other systems."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.full
def test_all_tests_are_collected_without_what_windows_lacks():
    """An error in one module would end the run there before its first test."""
    path = os.pathsep.join([str(TESTS / "helpers"), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "pytest", "-p", "without_posix", "-n", "0", "--collect-only"]
    done = subprocess.run(
        [*command, "-q", "--full", TESTS], capture_output=True, text=True, check=False,
        cwd=TESTS.parent, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
