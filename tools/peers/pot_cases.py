"""POT against clmorph in its place, beyond what POT's tests compare: logs, costs, references.

POT's tests mostly compare its solvers with each other, which one solver in place of all passes
too easily. Here each is run to a small threshold, and compared with the adapter.
"""

from typing import Any

import numpy as np
import ot
import pytest
import torch

from peers import adapter_pot

REG, REG_M = 0.3, (0.7, 1.2)
RNG = np.random.default_rng(0)
M, A, B, C = RNG.random((5, 4)), RNG.random(5), RNG.random(4), RNG.uniform(0.5, 2, (5, 4))
KINDS = [np.asarray, torch.tensor]


def close(theirs: Any, ours: Any, tolerance: float = 1e-5) -> None:
    """Compare two of POT's numbers or arrays."""
    np.testing.assert_allclose(np.asarray(ours), np.asarray(theirs), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "method", ["sinkhorn", "sinkhorn_stabilized", "sinkhorn_translation_invariant"]
)
@pytest.mark.parametrize("options", [{}, {"c": C}, {"reg_type": "entropy"}, {"numItermax": 3000}])
def test_unbalanced(kind: Any, method: str, options: dict[str, Any]) -> None:
    """Plan, potentials and both costs, for every reference measure."""
    given = {"stopThr": 1e-13, "numItermax": 20000} | options
    # With two strengths POT 0.9.7's translation-invariant solver is 1.6 percent off its others.
    reg_m = (0.9, 0.9) if method == "sinkhorn_translation_invariant" else REG_M
    plan, log = ot.unbalanced.sinkhorn_unbalanced(
        A, B, M, REG, reg_m, method=method, log=True, **given
    )
    given = {key: kind(value) if key == "c" else value for key, value in given.items()}
    ours, told = adapter_pot.sinkhorn_unbalanced(
        kind(A), kind(B), kind(M), REG, reg_m, log=True, **given
    )
    close(plan, ours)
    for name in ("logu", "logv", "cost", "total_cost"):
        close(log[name], told[name])


@pytest.mark.parametrize("c", [None, C])
def test_other_unbalanced_solvers(c: Any) -> None:
    """Majorization-minimization, and the quasi-Newton solver, with its entropy too."""
    mm = {"reg": REG, "reg_m": REG_M, "c": c, "log": True, "numItermax": 100000}
    lbfgs = {"reg": REG, "reg_m": REG_M, "c": c, "log": True}
    unbalanced = ot.unbalanced
    for theirs, ours in (
        (unbalanced.mm_unbalanced(A, B, M, **mm), adapter_pot.mm_unbalanced(A, B, M, **mm)),
        *(
            (
                unbalanced.lbfgsb_unbalanced(A, B, M, reg_div=entropy, **lbfgs),
                adapter_pot.lbfgsb_unbalanced(A, B, M, reg_div=entropy, **lbfgs),
            )
            for entropy in ("kl", "entropy")
        ),
    ):
        close(theirs[0], ours[0])
        close(theirs[1]["cost"], ours[1]["cost"])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", ["sinkhorn", "sinkhorn_log", "sinkhorn_stabilized"])
def test_balanced(kind: Any, method: str) -> None:
    """The plan, and scalings up to the factor that balanced transport leaves open."""
    a, b = A / A.sum(), B / B.sum()
    given = {"log": True, "stopThr": 1e-13, "numItermax": 5000}
    plan, log = ot.sinkhorn(a, b, M, REG, method=method, **given)
    ours, told = adapter_pot.sinkhorn(kind(a), kind(b), kind(M), REG, **given)
    close(plan, ours)
    for name in set(log) & {"u", "v"}:
        ratio = np.asarray(told[name]) / log[name]
        close(ratio, np.full(len(ratio), ratio[0]))
    many = np.column_stack([b, np.roll(b, 1)])
    close(ot.sinkhorn(a, many, M, REG, method=method), adapter_pot.sinkhorn(a, many, M, REG))
