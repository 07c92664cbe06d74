"""What the extra ``dask`` brings, the error where it is missing, and those of its workers."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import Any

from clmorph._shared.validation import shown
from clmorph.errors import ClmorphError, DeviceError, InputError

#: Held by the task that computes, where a worker has several threads: a device is one.
TURN = threading.Lock()


def need_dask() -> None:
    """Raise an error that says what to install if the extra ``dask`` is missing."""
    if any(find_spec(name) is None for name in ("distributed", "fsspec")):
        raise InputError('batches need the extra "dask": pip install "clmorph[dask]"')


def check_device(backend: Any) -> None:
    """Raise InputError if a device of workers is not given by its name."""
    if not isinstance(backend, str) or not backend:
        raise InputError(f"backend={shown(backend)}: expected a name, such as 'auto'")


def check_client(client: Any) -> None:
    """Raise InputError if this is no client of Dask's scheduler that is connected."""
    need_dask()
    from distributed import Client

    if not isinstance(client, Client):
        raise InputError(f"client={shown(client)}: expected a distributed.Client")
    if client.status != "running":
        raise InputError(f"client={shown(client)}: it is closed; expected one that is connected")


@contextmanager
def on_workers(client: Any, tasks: list[Any], remedy: str) -> Iterator[None]:
    """Report what ends workers as DeviceError with a remedy, and cancel `tasks` in the end."""
    try:
        yield
    except ClmorphError:
        raise
    except Exception as error:  # of many classes: a worker or the scheduler has ended
        raise DeviceError(
            f"the workers did not finish ({type(error).__name__}); start again, {remedy}"
        ) from None
    finally:
        with suppress(Exception):  # the scheduler has gone
            client.cancel(tasks)
