"""Runs as on other systems: without any device, and without what Windows lacks."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.full


def run(environment, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", "-q", *arguments],
        capture_output=True, text=True, check=False, cwd=ROOT, env=environment,
    )  # fmt: skip


def test_a_selection_without_devices():
    """The tests of NumPy pass there, and the others report why they are skipped.

    No driver is registered; a whole run without devices takes minutes.
    """
    dropped = ("CLMORPH_TEST_REQUIRE", "CLMORPH_DEVICE", "PYOPENCL_CTX")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    some = "tests/reference", "tests/measures/test_measures.py", "tests/transport/test_plan.py"
    done = run(environment | {"OCL_ICD_VENDORS": "/nowhere"}, *some)
    assert done.returncode == 0, done.stdout + done.stderr
    counts = {word: int(n) for n, word in re.findall(r"(\d+) (passed|skipped)", done.stdout)}
    assert counts["passed"] > 30
    assert counts["skipped"] > 5
    assert "needs a usable OpenCL device, and there is none" in done.stdout


def test_all_tests_are_collected_without_what_windows_lacks():
    """An error in one module would end the run there before its first test."""
    path = os.pathsep.join([str(ROOT / "tests/helpers"), os.environ.get("PYTHONPATH", "")])
    options = "-p", "without_posix", "--collect-only", "--full"
    done = run(os.environ | {"PYTHONPATH": path}, *options, "tests")
    assert done.returncode == 0, done.stdout[-3000:]
