"""Batches from Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from clmorph._shared.validation import shown
from clmorph.batch.extra import check_client, check_device
from clmorph.batch.jobs import Defaults, from_pairs
from clmorph.batch.run import run_jobs
from clmorph.errors import InputError
from clmorph.images.pixels import MAX_PIXELS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS

Pairs = Iterable[tuple[Any, Any, Any]]


def morph(
    pairs: Pairs, *, client: Any, backend: str = "auto", preset: str | None = None, **options: Any
) -> Iterator[dict[str, Any]]:
    """Write the morphs of many pairs of files on Dask's workers; yield each as it ends.

    Parameters
    ----------
    pairs : iterable of (source, target, output)
        Paths on a disk that the workers share, or paths that fsspec opens (``s3://…``). The
        ending of an output chooses its format, as for `clmorph.save`.
    client : distributed.Client
        The client of a running scheduler.
    backend : str
        The device of each worker, as `clmorph.get_backend` takes it. "auto" is each worker's
        own choice, or what its environment's ``CLMORPH_DEVICE`` says.
    preset : str, optional
        As in `clmorph.morph`; "auto" if not given.
    **options
        Options of `clmorph.MorphOptions`, for all pairs.

    Yields
    ------
    dict
        ``output``, ``source``, ``target``, ``status`` ("done" or "failed"), ``line`` (the error of
        a failed pair in one line, or notes), ``seconds``, and for a pair that is done ``solver``,
        ``residual`` (in units of epsilon), ``iterations``, ``particles``, ``frames``, ``bytes``
        and ``device``.

    Raises
    ------
    InputError
        If an argument cannot be used, two outputs are the same, or Dask is not installed.
    DeviceError
        If the scheduler ends.

    Examples
    --------
    >>> import clmorph.batch
    >>> try:
    ...     clmorph.batch.morph([("a.png", "b.png", "out.gif")], client=None)
    ... except clmorph.InputError:
    ...     print("a client is needed")
    a client is needed
    """
    check_device(backend)
    if preset is not None and (not isinstance(preset, str) or preset not in (AUTO, *PRESETS)):
        names = ", ".join(map(repr, (AUTO, *PRESETS)))
        raise InputError(f"preset={shown(preset)}: expected one of {names}")
    MorphOptions(**options)  # raises an error about the options themselves
    jobs = from_pairs(pairs, Defaults("", options, preset, MAX_PIXELS))
    check_client(client)
    return run_jobs(client, [(job, "") for job in jobs], backend)
