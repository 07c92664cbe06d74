"""A few of the random problems of ``tools/random_problems.py``, whose errors have limits."""

import pytest
import random_problems


@pytest.mark.parametrize(
    ("kind", "count"),
    [("assignments", 40), ("grids", 4), ("barycenters", 8), ("reaches", 4), ("second", 16)],
)
def test_problems_are_within_their_limits(kind, count, device):
    found = random_problems.worst(kind, count, device, seed=1000)
    assert found
    assert all(share <= 1 for share, _ in found.values()), found
