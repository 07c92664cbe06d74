"""Solutions are those of GeomLoss, whose schedule is taken step by step."""

from pathlib import Path

import numpy as np
import pytest
from plain import sinkhorn

from clmorph.transport.sinkhorn import geomloss_blurs

GEOMLOSS = np.load(Path(__file__).parents[1] / "data" / "geomloss.npz")


@pytest.mark.parametrize("scaling", [0.9, 0.5])
@pytest.mark.parametrize("reach", [None, 0.01, 0.05, 0.1, 0.3, 0.5])
def test_geomloss(any_backend, reach, scaling):
    """Its own results in float64, written by ``tools/geomloss_reference.py``."""
    pair = (GEOMLOSS["a"], GEOMLOSS["x"]), (GEOMLOSS["b"], GEOMLOSS["y"])
    got = sinkhorn(*pair, 0.05, reach, method="geomloss", scaling=scaling, backend=any_backend)
    for ours, name in ((got.f, "f"), (got.g, "g")):
        theirs = GEOMLOSS[f"{name} reach {reach} scaling {scaling}"]
        assert np.abs(ours - theirs).max() < 1e-3 * got.epsilon
    assert got.status in ("schedule", "converged")
    assert "GeomLoss" in got.message


def test_geomloss_schedule_of_points_at_one_place():
    assert geomloss_blurs(0.0, 0.05, 0.5) == [0.05, 0.05]
