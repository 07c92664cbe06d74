"""Many barycenters on the workers of Dask."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

from clmorph._shared.typing import ArrayLike
from clmorph._shared.validation import errors_about
from clmorph.backends.select import get_backend
from clmorph.batch.extra import TURN, check_client, check_device, on_workers
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.measures.points import as_many
from clmorph.transport.barycenters.barycenter import barycenter, checked_call, prepared
from clmorph.transport.barycenters.result import Barycenter
from clmorph.transport.options import SolverOptions
from clmorph.transport.sinkhorn_batch import MeasuresLike


def barycenters(
    groups: Iterable[MeasuresLike],
    weights: ArrayLike | None = None,
    support: Any = None,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int | None = None,
    backend: str = "auto",
    *,
    client: Any,
    fixed: bool = False,
    debias: bool = True,
    epsilon: float | None = None,
    rho: float | None = None,
    seed: int = 0,
) -> list[Barycenter]:
    """Return the barycenter of each of many groups of measures, from Dask's workers.

    Parameters
    ----------
    groups : iterable
        Each item is what `clmorph.barycenter` takes as `measures`.
    weights, support, blur, reach, tol, max_iter, fixed, debias, epsilon, rho, seed
        As in `clmorph.barycenter`, for all groups.
    backend : str
        The device of each worker, as `clmorph.get_backend` takes it.
    client : distributed.Client
        The client of a running scheduler.

    Returns
    -------
    list of Barycenter

    Raises
    ------
    InputError
        If an argument cannot be used. The message says which group cannot be used.
    DeviceError
        If a worker's device fails, or the scheduler ends.

    Warns
    -----
    ConvergenceWarning
        If a residual does not reach `tol`.

    Examples
    --------
    >>> import clmorph.batch
    >>> try:
    ...     clmorph.batch.barycenters([[([1.0], [0.0])]], blur=0.1, client=None)
    ... except clmorph.InputError:
    ...     print("a client is needed")
    a client is needed
    """
    check_device(backend)
    call = checked_call(blur, reach, epsilon, rho, tol, max_iter, fixed, debias, seed)
    known = as_many("groups", groups)
    for number, group in enumerate(known):
        with errors_about(f"group {number}"):
            prepared(group, weights, support, call)
    check_client(client)
    options = {
        "weights": weights, "support": support, "blur": blur, "reach": reach, "tol": tol,
        "max_iter": max_iter, "fixed": fixed, "debias": debias, "epsilon": epsilon, "rho": rho,
        "seed": seed,
    }  # fmt: skip
    tasks: list[Any] = []
    with on_workers(client, tasks, "with fewer points if they lack memory"):
        tasks += [
            client.submit(_find, number, group, backend, options, pure=False)
            for number, group in enumerate(known)
        ]
        found: list[Barycenter] = client.gather(tasks)
    missed = sum(not each.converged for each in found)
    if missed:
        warnings.warn(
            ConvergenceWarning(f"{missed} of {len(found)} barycenters did not reach tol={tol:g}"),
            stacklevel=2,
        )
    return found


def _find(number: int, group: Any, backend: str, options: dict[str, Any]) -> Barycenter:
    """Return one barycenter, on a worker."""
    with TURN:
        try:
            return barycenter(group, backend=get_backend(backend), **options)
        except InputError as error:
            raise InputError(f"group {number}: {error}") from None
