"""A few of the random problems of ``tools/random_problems.py``, whose errors have limits."""

import sys
from pathlib import Path

import numpy as np
import pytest

import clmorph

TOOLS = Path(__file__).parents[2] / "tools"
if not TOOLS.exists():
    pytest.skip("the tools need a checkout", allow_module_level=True)
sys.path.insert(0, str(TOOLS))

import random_problems  # noqa: E402


@pytest.mark.parametrize(
    ("kind", "count"), [("assignments", 6), ("grids", 4), ("barycenters", 2), ("second", 3)]
)
def test_problems_are_within_their_limits(kind, count, device):
    found = random_problems.worst(kind, count, device, seed=1000)
    assert found
    assert all(share <= 1 for share, _ in found.values()), found


def test_wrong_prices_are_found(monkeypatch):
    right = clmorph.assignment

    def wrong(*arguments, **options):
        found = right(*arguments, **options)
        size = 1e-6 * np.ptp(found.prices[0]) + 1e-6 * abs(found.cost) + 1e-12
        return type(found)(
            found.rows, found.columns, found.cost, found.bound + size,
            (found.prices[0] + size, found.prices[1]),
        )  # fmt: skip

    monkeypatch.setattr(clmorph, "assignment", wrong)
    found = random_problems.worst("assignments", 2, "numpy", seed=1000)
    assert found["prices above a pair's cost"][0] > 1
    assert found["bound above the cheapest"][0] > 1
