"""The Sinkhorn divergence as a loss of PyTorch. Install ``clmorph[torch]``."""

from __future__ import annotations

from functools import cache
from typing import Any

from clmorph.adapters._losses import LOSS_TOL, changed_gradient, divergence_and_gradient
from clmorph.backends.select import Backend
from clmorph.errors import InputError
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
    """Return the Sinkhorn divergence of two weighted point clouds as a tensor to differentiate.

    Values and derivatives are those of `clmorph.sinkhorn_divergence`, in closed form: nothing of
    the solver's iteration is recorded. Tensors are copied to the host once, and results back to
    their device. Second derivatives (``create_graph=True``) are those of `clmorph.hessian_product`,
    with its limits; third ones are refused.

    Parameters
    ----------
    a, b : (N,) and (M,) tensors, or (B, N) and (B, M)
        Weights. If the problem is balanced (`reach` is None), their derivatives have the mean 0.
    x, y : (N, D) and (M, D) tensors, or (B, N, D) and (B, M, D)
        Points.
    blur, reach, max_iter, backend, epsilon, rho
        As in `clmorph.sinkhorn_divergence`.
    tol : float
        As there; smaller by default, so that derivatives are within 1e-4 of the largest.

    Returns
    -------
    tensor
        (), or (B,) for a batch, of the points' dtype and on their device.

    Raises
    ------
    InputError
        If an argument cannot be used, or PyTorch is not installed.

    Examples
    --------
    >>> import clmorph.torch
    >>> try:
    ...     import torch
    ... except ImportError:
    ...     value = 0.5
    ... else:
    ...     x, y = torch.zeros(1, 1, requires_grad=True), torch.ones(1, 1)
    ...     ones = torch.ones(1)
    ...     value = clmorph.torch.sinkhorn_divergence(ones, x, ones, y, 0.1, backend="numpy")
    ...     value.backward()
    >>> round(float(value), 6)  # half the squared distance
    0.5
    """
    try:
        import torch
    except ImportError:
        raise InputError("clmorph.torch needs PyTorch: pip install 'clmorph[torch]'") from None
    tensors = a, x, b, y
    for name, tensor in zip(("a", "x", "b", "y"), tensors, strict=True):
        if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point():
            raise InputError(f"{name} is a {type(tensor).__name__}: expected a tensor of floats")
    options = {"blur": blur, "reach": reach, "tol": tol, "max_iter": max_iter,
               "backend": backend, "epsilon": epsilon, "rho": rho}  # fmt: skip
    return _function().apply(options, *tensors)


@cache
def _function() -> Any:
    """Return the function of autograd; it is made here, so that this module needs no PyTorch."""
    import torch

    def as_given(parts: tuple[Any, ...], tensors: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(
            torch.as_tensor(part).to(each) for part, each in zip(parts, tensors, strict=False)
        )

    def on_host(tensors: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(each.detach().cpu().double().numpy() for each in tensors)

    class DivergenceGradient(torch.autograd.Function):  # type: ignore[misc,unused-ignore]
        """The gradient, which is known, with its derivatives."""

        @staticmethod
        def forward(context: Any, options: dict[str, Any], parts: Any, *tensors: Any) -> Any:
            context.options = options
            context.save_for_backward(*tensors)
            return tuple(part.clone() for part in parts)

        @staticmethod
        @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
        def backward(context: Any, *outer: Any) -> Any:
            # The Hessian is symmetric, so that its product with a row is that with a column.
            tensors = context.saved_tensors
            changed = changed_gradient(on_host(tensors), on_host(outer), context.options)
            return None, None, *as_given(changed, tensors)

    class SinkhornDivergence(torch.autograd.Function):  # type: ignore[misc,unused-ignore]
        """The divergence with its closed gradient."""

        @staticmethod
        def forward(context: Any, options: dict[str, Any], *tensors: Any) -> Any:
            a, x, b, y = on_host(tensors)
            needed = any(context.needs_input_grad)
            value, parts = divergence_and_gradient((a, x, b, y), needed, options)
            context.options = options
            context.save_for_backward(*tensors, *as_given(parts, tensors))
            return torch.as_tensor(value).to(tensors[1])

        @staticmethod
        def backward(context: Any, outer: Any) -> Any:
            tensors, parts = context.saved_tensors[:4], context.saved_tensors[4:]
            if torch.is_grad_enabled():
                parts = DivergenceGradient.apply(context.options, parts, *tensors)
            return None, *(
                part * outer.to(part).reshape(outer.shape + (1,) * (part.ndim - outer.ndim))
                for part in parts
            )

    return SinkhornDivergence
