"""The divergence as a function of arrays, with its derivatives, for libraries that differentiate.

Source and target are one problem, with weights (N,) and points (N, D), or a batch of B problems
with weights (B, N) and points (B, N, D).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError
from clmorph.transport.divergence import sinkhorn_divergence

#: Residual at which losses stop, in units of epsilon: derivatives are then exact to 1e-4.
LOSS_TOL = 1e-6
NAMES = ("a", "x", "b", "y")


def divergence_and_gradient(
    arrays: tuple[Any, Any, Any, Any], differentiate: bool, options: dict[str, Any]
) -> tuple[Array, tuple[Array, ...]]:
    """Return divergences and their derivatives.

    Parameters
    ----------
    arrays : (a, x, b, y)
    differentiate : bool
        Whether derivatives are needed.
    options : dict
        Keywords of `clmorph.sinkhorn_divergence`.

    Returns
    -------
    values : () or (B,) array
    gradient : four arrays with the shapes of `arrays`, or none

    Raises
    ------
    InputError
        If shapes do not belong together, or a problem cannot be solved.
    """
    a, x, b, y = (as_floats(*pair) for pair in zip(NAMES, arrays, strict=True))
    shapes = ", ".join(f"{n} {v.shape}" for n, v in zip(NAMES, (a, x, b, y), strict=True))
    batched = a.ndim == 2
    if not (
        a.ndim == b.ndim in (1, 2)
        and x.ndim == y.ndim == a.ndim + 1
        and x.shape[:-1] == a.shape
        and y.shape[:-1] == b.shape
        and (not batched or len(a) == len(b))
    ):
        raise InputError(
            f"shapes {shapes}: expected a (N,), x (N, D), b (M,), y (M, D), or all with one more "
            "axis for a batch in front"
        )
    found = [
        sinkhorn_divergence(
            (each[0], each[1]), (each[2], each[3]), gradient=differentiate, **options
        )
        for each in (zip(a, x, b, y, strict=True) if batched else [(a, x, b, y)])
    ]
    values = np.array([each.value for each in found])
    parts = []
    if differentiate:
        for name in ("source_weights", "source_points", "target_weights", "target_points"):
            stacked = [getattr(each.gradient, name) for each in found]
            parts.append(np.stack(stacked) if batched else stacked[0])
    return values if batched else values[0], tuple(parts)
