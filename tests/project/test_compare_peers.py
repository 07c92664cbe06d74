"""Plans and potentials are POT's, by ``tools/compare_peers.py``."""

import sys
from pathlib import Path

import pytest

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
