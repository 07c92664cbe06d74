"""``tools/golden_record.py`` records the same results twice, and detects a change."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture
def tool(monkeypatch):
    """The tool with one small command in place of its own; its other processes run in this one."""
    if not TOOLS.exists():
        pytest.skip("the tools need a checkout")
    monkeypatch.syspath_prepend(str(TOOLS))
    tool = importlib.import_module("golden_record")

    def run(command, **options):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", command[1:])
            return SimpleNamespace(returncode=tool.main())

    small = ("small", "ab", ".npz", ("--size", "6", "--frames", "2"))
    monkeypatch.setattr(tool.cases, "COMMANDS", (small,))
    monkeypatch.setattr(tool.cases, "calls", lambda backend, folder: iter([("a call", [1.0])]))
    monkeypatch.setattr(tool, "subprocess", SimpleNamespace(run=run, DEVNULL=None))
    return tool


@pytest.mark.full
def test_make_and_compare(tool, tmp_path, monkeypatch, capsys):
    file = tmp_path / "golden.json"
    arguments = [str(file), "--device", "numpy"]
    for task, code, words in (
        ("make", 0, "golden.json: 2 records"),
        ("compare", 0, "the same: 2 records"),
    ):
        monkeypatch.setattr(sys, "argv", ["golden_record.py", task, *arguments])
        assert tool.main() == code
        assert words in capsys.readouterr().out
    record = json.loads(file.read_text())
    record["numpy"]["a call"] = [2.0]
    file.write_text(json.dumps(record))
    monkeypatch.setattr(sys, "argv", ["golden_record.py", "compare", *arguments])
    assert tool.main() == 1
    assert "numpy / a call [0]: 2.0 became 1.0" in capsys.readouterr().out
