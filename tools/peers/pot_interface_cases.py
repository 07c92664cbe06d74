"""POT's own cases that it refuses and ``clmorph.pot.solve_sample`` solves: lazy and unbalanced.

The problem is that of POT's ``test_solve_sample_NotImplemented``; POT solves it with the whole
cost matrix.
"""

from typing import Any

import numpy as np
import ot
import pytest

import clmorph.pot
from peers.bridge import TALLY, backend


@pytest.mark.parametrize("unbalanced", [None, 1, (0.5, 2.0)])
@pytest.mark.parametrize("reg", [1, 0.3])
def test_lazy(unbalanced: Any, reg: float) -> None:
    """The plan, its slices, marginals and potentials."""
    rng = np.random.RandomState(0)
    x, y = rng.randn(20, 2), rng.randn(7, 2)
    weights = ot.utils.unif(20), ot.utils.unif(7)
    options = {"reg": reg, "unbalanced": unbalanced}
    TALLY.calls += 1
    ours = clmorph.pot.solve_sample(x, y, *weights, **options, lazy=True, backend=backend())
    plan = ot.solve_sample(x, y, *weights, **options, tol=1e-13, max_iter=50000).plan
    near = {"rtol": 1e-4, "atol": 1e-7}
    np.testing.assert_allclose(ours.lazy_plan[:], plan, **near)
    np.testing.assert_allclose(ours.lazy_plan[3:5, ::2], plan[3:5, ::2], **near)
    np.testing.assert_allclose(ours.marginals[0], plan.sum(1), **near)
    np.testing.assert_allclose(ours.marginals[1], plan.sum(0), **near)
    np.testing.assert_allclose(ours.sparse_plan.toarray(), plan, rtol=0, atol=1e-4)
    np.testing.assert_allclose(ours.value_linear, np.vdot(plan, ot.dist(x, y)), **near)
