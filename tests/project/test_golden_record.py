"""``tools/golden_record.py`` records the same results twice, and detects a change."""

import json
import sys
from types import SimpleNamespace

import golden_record as tool
import pytest


@pytest.fixture
def small(monkeypatch):
    """The tool with one small command in place of its own; its other processes run in this one."""

    def run(command, **options):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", command[1:])
            return SimpleNamespace(returncode=tool.main())

    command = ("small", "ab", ".npz", ("--size", "6", "--frames", "2"))
    monkeypatch.setattr(tool.cases, "COMMANDS", (command,))
    monkeypatch.setattr(tool.cases, "calls", lambda backend, folder: iter([("a call", [1.0])]))
    monkeypatch.setattr(tool, "subprocess", SimpleNamespace(run=run, DEVNULL=None))


@pytest.mark.full
def test_make_and_compare(small, tmp_path, monkeypatch, capsys):
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
