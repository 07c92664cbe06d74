"""Compare the dense reference with another library and with itself, without any device."""

import numpy as np
import ot
import pytest
from plain import reference

from clmorph import InputError


@pytest.mark.parametrize("reach", [0.2, 0.5])
def test_plan_is_that_of_pot(rng, reach):
    """POT's regularization is epsilon and its marginal penalty rho, at the same cost."""
    a, b = rng.random(20), 2 * rng.random(25)
    x, y = rng.random((20, 3)), rng.random((25, 3))
    cost = ((x[:, None] - y) ** 2).sum(-1) / 2
    assert reference.cost_matrix((a, x), (b, y)) == pytest.approx(cost, abs=1e-12)
    potentials = reference.sinkhorn((a, x), (b, y), 0.2, reach, 1e-9, 20_000)
    ours = reference.transport_plan((a, x), (b, y), potentials)
    theirs = ot.unbalanced.sinkhorn_unbalanced(
        a, b, cost, 0.2**2, reach**2, reg_type="kl", numItermax=20_000, stopThr=1e-13
    )
    assert ours == pytest.approx(theirs, abs=1e-8 * theirs.max())


def test_constant_images_stay_constant():
    gray = np.full((5, 4, 3), 0.25)
    result = reference.morph(gray, gray, n_frames=3, reach=None)
    assert len(result.frames) == 3
    for frame in result.frames:
        assert frame == pytest.approx(gray, abs=1e-9)


def test_errors_are_ours(rng):
    with pytest.raises(InputError, match="blur"):
        reference.sinkhorn((np.ones(2), rng.random((2, 2))), (np.ones(2), rng.random((2, 2))), -1)
