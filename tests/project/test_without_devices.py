"""Without any OpenCL device the tests of NumPy pass, and the others report why they are skipped."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.full
def test_a_selection_without_devices():
    """No driver is registered there; a whole run without devices takes minutes."""
    dropped = ("CLMORPH_TEST_REQUIRE", "CLMORPH_DEVICE", "PYOPENCL_CTX")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", "-q",
         "tests/reference", "tests/measures/test_measures.py",
         "tests/transport/test_plan.py"],
        capture_output=True, text=True, check=False, cwd=ROOT,
        env=environment | {"OCL_ICD_VENDORS": "/nowhere"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    counts = {word: int(n) for n, word in re.findall(r"(\d+) (passed|skipped)", done.stdout)}
    assert counts["passed"] > 30
    assert counts["skipped"] > 10
    assert "needs a usable OpenCL device, and there is none" in done.stdout
