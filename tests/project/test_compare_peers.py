"""Plans and potentials are POT's, by ``tools/compare_peers.py``."""

import sys

import compare_peers
from findings import Findings


def test_plans_and_potentials_are_pots(any_backend, capsys, monkeypatch):
    """One method of POT for each kind of entropy; what lines tell to repeat."""
    kept = {name: compare_peers.PEERS[name] for name in ("POT sinkhorn", "POT sinkhorn, entropy")}
    monkeypatch.setattr(compare_peers, "PEERS", kept)
    monkeypatch.setattr(sys, "argv", ["compare_peers.py"])
    findings = Findings([])
    compare_peers.compare(0, [0, 1, 2], any_backend, findings)
    assert findings.tried == {"POT sinkhorn": 3, "POT sinkhorn, entropy": 2}
    assert findings.end() == 0, capsys.readouterr().out
