"""The Sinkhorn divergence as a loss of JAX. Install ``clmorph[jax]``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from clmorph.adapters._losses import (
    LOSS_TOL,
    changed_gradient,
    check_shapes,
    check_values,
    divergence_and_gradient,
)
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.transport.divergence import one_regularization
from clmorph.transport.options import SolverOptions

__all__ = ["sinkhorn_divergence"]


def sinkhorn_divergence(
    a: Any,
    x: Any,
    b: Any,
    y: Any,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = LOSS_TOL,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | None = None,
) -> Any:
    """Return the Sinkhorn divergence of two weighted point clouds, to differentiate and to compile.

    Values and derivatives are those of `clmorph.sinkhorn_divergence`, in closed form. The solver
    runs on the host as a callback, so this works under `jax.jit`, `jax.grad` and `jax.vmap`
    (one problem after another), in forward mode (`jax.jvp`) and in reverse mode. Second
    derivatives, `jax.hessian` too, are Hessian-vector products of `clmorph.hessian_product`, for
    positive weights; there are no third ones.

    Parameters
    ----------
    a, b : (N,) and (M,) arrays, or (B, N) and (B, M)
        Weights. If the problem is balanced (`reach` is None), their derivatives have the mean 0.
    x, y : (N, D) and (M, D) arrays, or (B, N, D) and (B, M, D)
        Points.
    blur, reach, max_iter, backend, epsilon, rho
        As in `clmorph.sinkhorn_divergence`; constants under `jax.jit`.
    tol : float
        As there; smaller by default, so that derivatives are within 1e-4 of the largest.

    Returns
    -------
    array
        (), or (B,) for a batch, of the points' dtype.

    Raises
    ------
    InputError
        If JAX is not installed, or an argument cannot be used. What depends on the values of the
        arrays (NaN, negative weights, different masses) JAX reports as an error of its own.

    Examples
    --------
    >>> import clmorph.jax
    >>> try:
    ...     import jax.numpy as jnp
    ... except ImportError:
    ...     value = 0.5
    ... else:
    ...     ones, x, y = jnp.ones(1), jnp.zeros((1, 1)), jnp.ones((1, 1))
    ...     value = clmorph.jax.sinkhorn_divergence(ones, x, ones, y, 0.1, backend="numpy")
    >>> round(float(value), 6)  # half the squared distance
    0.5
    """
    try:
        import jax
        import jax.numpy as jnp
        from jax.flatten_util import ravel_pytree
    except ImportError:
        raise InputError("clmorph.jax needs JAX: pip install 'clmorph[jax]'") from None
    try:
        arrays = tuple(
            jnp.asarray(each, dtype=jnp.result_type(each, float)) for each in (a, x, b, y)
        )
    except (TypeError, ValueError, OverflowError):
        raise InputError("a, x, b, y: expected arrays of floats") from None
    check_shapes(*(each.shape for each in arrays))
    # What JAX would report as its own error is found here where it can be.
    if not any(isinstance(each, jax.core.Tracer) for each in arrays):
        check_values(*(np.asarray(each, float) for each in arrays))
    one_regularization(blur, reach, epsilon, rho, tol, max_iter)
    get_backend(backend)
    options = {"blur": blur, "reach": reach, "tol": tol, "max_iter": max_iter,
               "backend": backend, "epsilon": epsilon, "rho": rho}  # fmt: skip
    shape = arrays[0].shape[:-1]
    types = [jax.ShapeDtypeStruct(shape, arrays[1].dtype)]
    types += [jax.ShapeDtypeStruct(each.shape, each.dtype) for each in arrays]

    def on_host(call: Any, types: Any, *given: Any) -> Any:
        def called(*arrays: Any) -> Any:
            found = call(*(np.asarray(each, float) for each in arrays))
            return [np.asarray(v, t.dtype) for v, t in zip(found, types, strict=True)]

        return tuple(jax.pure_callback(called, types, *given, vmap_method="sequential"))

    def solved(*given: Any, differentiate: bool = True) -> Any:
        value, parts = divergence_and_gradient(given, differentiate, options)
        return value, *parts

    def of_hessian(*given: Any) -> Any:
        return changed_gradient(given[:4], given[4:], options)

    @jax.custom_jvp  # type: ignore[untyped-decorator,unused-ignore]
    def divergence(*given: Any) -> Any:
        return on_host(partial(solved, differentiate=False), types[:1], *given)[0]

    @jax.custom_jvp  # type: ignore[untyped-decorator,unused-ignore]
    def differentiated(*given: Any) -> Any:
        return on_host(solved, types, *given)

    def along(parts: Any, changes: Any) -> Any:
        pairs = zip(parts, changes, strict=True)
        summed = [(part * change).reshape(*shape, -1).sum(axis=-1) for part, change in pairs]
        return sum(summed).astype(types[0].dtype)

    def of_value(given: Any, changes: Any) -> Any:
        value, *parts = differentiated(*given)
        return value, along(parts, changes)

    def of_gradient(given: Any, changes: Any) -> Any:
        found = differentiated(*given)
        flat, as_parts = ravel_pytree(changes)

        def product(_same: Any, direction: Any) -> Any:
            parts = on_host(of_hessian, types[1:], *given, *as_parts(direction))
            return ravel_pytree(parts)[0]

        def same(direction: Any) -> Any:
            kind = [jax.ShapeDtypeStruct(direction.shape, direction.dtype)]
            return on_host(lambda *all_given: all_given[-1:], kind, *given, direction)[0]

        # JAX can transpose, and map, what solves a symmetric system. Its matrix is the identity, in
        # a form that depends on `given` and has no derivatives, as the product has none.
        products = jax.lax.custom_linear_solve(same, flat, product, symmetric=True)
        return found, (along(found[1:], changes), *as_parts(products))

    divergence.defjvp(of_value)
    differentiated.defjvp(of_gradient)
    return divergence(*arrays)
