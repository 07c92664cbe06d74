"""Plans and potentials are POT's, and ``tools/compare_peers.py`` finds it where they are not."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

import clmorph

TOOLS = Path(__file__).parents[2] / "tools"
if not TOOLS.exists():
    pytest.skip("the tools need a checkout", allow_module_level=True)
sys.path.insert(0, str(TOOLS))

import compare_peers  # noqa: E402
from findings import Findings  # noqa: E402


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """One method of POT for each kind of entropy; what lines tell to repeat."""
    kept = {name: compare_peers.PEERS[name] for name in ("POT sinkhorn", "POT sinkhorn, entropy")}
    monkeypatch.setattr(compare_peers, "PEERS", kept)
    monkeypatch.setattr(sys, "argv", ["compare_peers.py"])


def test_plans_and_potentials_are_pots(any_backend, capsys):
    findings = Findings([])
    compare_peers.compare(0, [0, 1, 2], any_backend, findings)
    assert findings.tried == {"POT sinkhorn": 3, "POT sinkhorn, entropy": 2}
    assert findings.end() == 0, capsys.readouterr().out


def test_another_epsilon_is_found(monkeypatch, capsys):
    """By a thousandth."""
    backend, problem = clmorph.get_backend("numpy"), compare_peers.make(0, 1)
    right = compare_peers.ours(problem, backend, False)
    other = replace(problem, epsilon=1.001 * problem.epsilon)
    wrong = compare_peers.ours(other, backend, False)
    assert max(compare_peers.differences(right, right, False)) == 0
    assert max(compare_peers.differences(wrong, right, False)) > compare_peers.TOLERANCE
    monkeypatch.setattr(compare_peers, "ours", lambda *_: wrong)
    assert compare_peers.main(["--only", "1"]) == 1
    assert "FINDING POT sinkhorn: 1: plans " in capsys.readouterr().out


def test_without_libraries_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(compare_peers.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit) as ended:
        compare_peers.main([])
    assert ended.value.code == 2
    assert "pip install -e '.[bench]'" in capsys.readouterr().err
