"""Run a small part of ``tools/fuzz.py``, and check that it detects the faults it looks for."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
SEED = "20261122"


def fuzz(*arguments, tools=TOOLS):
    return subprocess.run(
        [sys.executable, tools / "fuzz.py", *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("target", "count"), [("images", "300"), ("configs", "40"), ("api", "200")]
)
@pytest.mark.full
def test_nothing_gives_way(target, count):
    done = fuzz(target, "--count", count, "--seed", SEED, "--jobs", "1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{target}: {count} cases, 0 findings" in done.stdout


HOSTILE = """
import os, time
class Target:
    def __init__(self, folder):
        self.number = 0
    def case(self, rng):
        # Numbers are told apart by what their generator draws first.
        draw = [__import__("numpy").random.default_rng([0, n]).integers(1 << 60) for n in range(6)]
        number = draw.index(rng.integers(1 << 60))
        return f"case {number}", bytes([number]), lambda: self.run(number)
    def run(self, number):
        if number == 1:
            return ["a finding"]
        if number == 2:
            os._exit(7)
        if number == 3:
            time.sleep(1000)
        if number == 4:
            raise RuntimeError("of the target")
        return []
"""


def test_what_gives_way_is_told(tmp_path):
    """A finding, a crash, a hang and a fault each end in a line; the cases behind them run."""
    shutil.copytree(TOOLS / "fuzzing", tmp_path / "fuzzing")
    shutil.copy(TOOLS / "fuzz.py", tmp_path)
    (tmp_path / "fuzzing" / "images.py").write_text(HOSTILE)
    kept = tmp_path / "kept"
    done = fuzz(
        "images", "--count", "6", "--jobs", "1", "--patience", "2", "--keep", kept, tools=tmp_path
    )
    assert done.returncode == 1, done.stderr
    for line in (
        "images 1: a finding", "images 2: the process ended with code 7",
        "images 3: no end after 2 s", "images 4: the process ended with code 1",
        "images: 6 cases, 4 findings", "python tools/fuzz.py images --seed 0 --only 3",
    ):  # fmt: skip
        assert line in done.stdout
    assert (kept / "images-0-1").read_bytes() == b"\1"
    again = fuzz("images", "--only", "1", tools=tmp_path)
    assert (again.returncode, again.stdout.splitlines()[-1]) == (1, "a finding")
