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
from clmorph.measures.points import as_many, as_measure
from clmorph.transport.divergence import sinkhorn_divergence
from clmorph.transport.divergence_batch import sinkhorn_divergence_batch
from clmorph.transport.gradient import Gradient
from clmorph.transport.hessian import hessian_product

#: Residual at which losses stop, in units of epsilon: derivatives are then exact to 1e-4.
LOSS_TOL = 1e-6
NAMES = ("a", "x", "b", "y")


def divergence_and_gradient(
    arrays: tuple[Any, Any, Any, Any], differentiate: bool, options: dict[str, Any]
) -> tuple[Array, tuple[Array, ...]]:
    """Return divergences, () or (B,), and their derivatives by `arrays` (a, x, b, y), if asked for.

    `options` are keywords of `clmorph.sinkhorn_divergence`.
    """
    a, x, b, y = (as_floats(*pair) for pair in zip(NAMES, arrays, strict=True))
    batched = check_shapes(a.shape, x.shape, b.shape, y.shape)
    if batched:
        found = sinkhorn_divergence_batch((a, x), (b, y), gradient=differentiate, **options)
    else:
        found = [sinkhorn_divergence((a, x), (b, y), gradient=differentiate, **options)]
    values = np.array([each.value for each in found])
    parts = []
    if differentiate:
        for name in ("source_weights", "source_points", "target_weights", "target_points"):
            stacked = [getattr(each.gradient, name) for each in found]
            parts.append(np.stack(stacked) if batched else stacked[0])
    return values if batched else values[0], tuple(parts)


def changed_gradient(
    arrays: tuple[Any, ...], direction: tuple[Any, ...], options: dict[str, Any]
) -> tuple[Array, ...]:
    """Return the Hessian of the divergence times a direction, in the order (a, x, b, y)."""
    a, x, b, y = (as_floats(*pair) for pair in zip(NAMES, arrays, strict=True))
    da, dx, db, dy = (np.asarray(each, float) for each in direction)
    if check_shapes(a.shape, x.shape, b.shape, y.shape):
        found = [
            changed_gradient(each[:4], each[4:], options)
            for each in zip(a, x, b, y, da, dx, db, dy, strict=True)
        ]
        return tuple(np.stack(parts) for parts in zip(*found, strict=True))
    solved = sinkhorn_divergence((a, x), (b, y), **options)
    if np.isinf(solved.cross.rho):
        # Derivatives by weights have the mean 0 there.
        da, db = da - da.mean(), db - db.mean()
    product = hessian_product((a, x), (b, y), solved, Gradient(dx, da, dy, db))
    return (
        product.source_weights, product.source_points,
        product.target_weights, product.target_points,
    )  # fmt: skip


def check_values(*arrays: Any) -> None:
    """Check values of a, x, b and y, whose shapes are right, as a solve does."""
    a, x, b, y = (as_floats(*pair) for pair in zip(NAMES, arrays, strict=True))
    for name, measure in (("(a, x)", (a, x)), ("(b, y)", (b, y))):
        (as_many if a.ndim == 2 else as_measure)(name, measure)


def check_shapes(*shapes: tuple[int, ...]) -> bool:
    """Return whether arrays of these shapes, of a, x, b and y, are a batch, or raise InputError."""
    a, x, b, y = shapes
    if not (
        len(a) == len(b) in (1, 2)
        and len(x) == len(y) == len(a) + 1
        and (x[:-1], y[:-1]) == (a, b)
        and (len(a) == 1 or (len(a) == 2 and a[0] == b[0] > 0))
    ):
        listed = ", ".join(f"{name} {shape}" for name, shape in zip(NAMES, shapes, strict=True))
        raise InputError(
            f"shapes {listed}: expected a (N,), x (N, D), b (M,), y (M, D), or all with one more "
            "axis for a batch in front"
        )
    return len(a) == 2
