"""Run a small part of ``tools/fuzz.py``."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
SEED = "20261122"


@pytest.mark.parametrize(
    ("target", "count"), [("images", "300"), ("configs", "40"), ("api", "200")]
)
@pytest.mark.full
def test_nothing_gives_way(target, count):
    given = [target, "--count", count, "--seed", SEED, "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, TOOLS / "fuzz.py", *given], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{target}: {count} cases, 0 findings" in done.stdout
