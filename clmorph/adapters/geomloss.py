"""GeomLoss's `SamplesLoss` with clmorph as its solver. Install ``clmorph[torch]``."""

from __future__ import annotations

from typing import Any

from clmorph.adapters import torch as losses
from clmorph.backends.select import Backend
from clmorph.errors import InputError

__all__ = ["SamplesLoss"]

#: GeomLoss's arguments that have one value here, with that value.
ONLY = {"loss": "sinkhorn", "p": 2, "cost": None, "kernel": None, "debias": True,
        "potentials": False}  # fmt: skip


class SamplesLoss:
    """The debiased Sinkhorn divergence with GeomLoss's arguments and conventions.

    Both libraries have the cost |x - y|^2 / 2, epsilon = blur^2 and rho = reach^2, so the numbers
    are the same. GeomLoss stops at the end of a schedule, clmorph when it has converged.

    Parameters
    ----------
    loss, p, cost, kernel, debias, potentials
        Only "sinkhorn", 2, None, None, True and False.
    blur, reach : float
        As in GeomLoss and in `clmorph.sinkhorn_divergence`.
    diameter, scaling, truncate, cluster_scale, verbose, backend
        Ways of GeomLoss's solver, which are accepted and have no effect.
    device : str, object of pyopencl, or Operations
        clmorph's backend, see `clmorph.get_backend`.

    Raises
    ------
    InputError
        If an argument has another value than the only one.

    Examples
    --------
    >>> import clmorph.geomloss
    >>> loss = clmorph.geomloss.SamplesLoss("sinkhorn", p=2, blur=0.05, reach=0.3)
    >>> loss.blur, loss.reach  # loss(a, x, b, y) or loss(x, y) is a tensor
    (0.05, 0.3)
    """

    def __init__(
        self,
        loss: str = "sinkhorn",
        p: int = 2,
        blur: float = 0.05,
        reach: float | None = None,
        diameter: float | None = None,
        scaling: float = 0.5,
        truncate: float | None = 5,
        cost: Any = None,
        kernel: Any = None,
        cluster_scale: float | None = None,
        debias: bool = True,
        potentials: bool = False,
        verbose: bool = False,
        backend: str = "auto",
        device: Backend = "auto",
    ) -> None:
        given = {"loss": loss, "p": p, "cost": cost, "kernel": kernel, "debias": debias,
                 "potentials": potentials}  # fmt: skip
        for name, only in ONLY.items():
            value = given[name]
            if value is not only and not (isinstance(value, int | str) and value == only):
                raise InputError(
                    f"{name} is not {only!r}: clmorph knows that value alone; use GeomLoss for "
                    "others"
                )
        self.blur, self.reach, self.device = blur, reach, device

    def __call__(self, *tensors: Any) -> Any:
        """Return the divergence as a tensor, (B,) for a batch.

        Parameters
        ----------
        *tensors
            Weights and points (a, x, b, y) as in `clmorph.torch.sinkhorn_divergence`, or points
            (x, y), which then have uniform weights 1/N and 1/M.
        """
        if len(tensors) == 2:
            x, y = tensors
            if not all(hasattr(each, "new_full") and each.ndim in (2, 3) for each in tensors):
                raise InputError("expected tensors x (N, D) and y (M, D), or (B, N, D), (B, M, D)")
            a, b = (each.new_full(each.shape[:-1], 1.0 / each.shape[-2]) for each in (x, y))
        elif len(tensors) == 4:
            a, x, b, y = tensors
        else:
            raise InputError(f"{len(tensors)} tensors: expected (x, y) or (a, x, b, y)")
        return losses.sinkhorn_divergence(a, x, b, y, self.blur, self.reach, backend=self.device)
