"""What the extra ``dask`` brings, and the error where it is missing."""

from importlib.util import find_spec
from typing import Any

from clmorph._shared.validation import shown
from clmorph.errors import InputError


def need_dask() -> None:
    """Raise an error that says what to install if the extra ``dask`` is missing.

    Raises
    ------
    InputError
        If `distributed` or `fsspec` is not installed.
    """
    if any(find_spec(name) is None for name in ("distributed", "fsspec")):
        raise InputError('batches need the extra "dask": pip install "clmorph[dask]"')


def check_client(client: Any) -> Any:
    """Return a client of Dask's scheduler, checked.

    Raises
    ------
    InputError
        If the extra ``dask`` is missing, or the value is no client.
    """
    need_dask()
    from distributed import Client

    if not isinstance(client, Client):
        raise InputError(f"client={shown(client)}: expected a distributed.Client")
    if client.status != "running":
        raise InputError(f"client={shown(client)}: it is closed; expected one that is connected")
    return client
