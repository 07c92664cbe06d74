"""A cluster on this machine, a worker for each device, and clients of running schedulers."""

import asyncio
import gc
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from clmorph._shared.printable import reason_of
from clmorph.batch.extra import need_dask
from clmorph.errors import InputError

#: The address of all ports of a local cluster: no other machine reaches them.
LOCAL = "127.0.0.1"
#: The variable of the level of Dask's log in the workers' processes.
LEVEL = "DASK_LOGGING__DISTRIBUTED"
#: Seconds in which a scheduler must answer.
TIMEOUT = 10.0
#: What is set of Dask. One worker may die during a job before the job is given up. The statistical
#: profiler is off: it keeps the call stacks of each second for an hour (0.3 MB a second).
SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.worker.profile.enabled": False,
}


def devices_of(device: str, workers: int | None) -> list[str]:
    """Return the device of each local worker, in turn; "auto" stands for all physical ones."""
    named = any(os.environ.get(name) for name in ("CLMORPH_DEVICE", "PYOPENCL_CTX"))
    if device not in ("auto", "opencl") or named:
        found = [device]
    else:
        from clmorph.backends.opencl.devices.find import physical_devices

        found = [each.index for each in physical_devices()] or [device]
    return [found[number % len(found)] for number in range(workers or len(found))]


@contextmanager
def quiet_dask() -> Iterator[None]:
    """Keep Dask's own messages off the terminal: what matters is told in lines of ours."""
    import dask
    import distributed  # noqa: F401 - sets levels of its own when it is imported

    # A client that could not connect is garbage, and closes when it is collected. A client that is
    # created meanwhile holds a lock that this needs, until its thread has started. If that thread
    # is the one that collects, both wait for good.
    gc.collect()

    kept = os.environ.get(LEVEL)
    os.environ[LEVEL] = "critical"  # of the workers' processes
    logs = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        with dask.config.set(SETTINGS):
            yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
        del os.environ[LEVEL]
        if kept is not None:
            os.environ[LEVEL] = kept


@contextmanager
def local_client(devices: list[str], memory: str | None = None) -> Iterator[Any]:
    """Yield the client of a new cluster on this machine, with a process for each device."""
    need_dask()
    from distributed import Client, Nanny, Scheduler, SpecCluster
    from distributed.security import Security
    from distributed.system import MEMORY_LIMIT

    # A certificate in memory alone: other users of the machine cannot send work.
    security = Security.temporary()
    limit: Any = memory or MEMORY_LIMIT // len(devices)
    workers = {
        number: {
            "cls": Nanny,
            "options": {
                "host": LOCAL, "protocol": "tls", "security": security, "nthreads": 1,
                "memory_limit": limit, "dashboard": False,
                "preload": ["clmorph.batch.preload"],
                "env": {} if device in ("auto", "opencl") else {"CLMORPH_DEVICE": device},
            },
        }
        for number, device in enumerate(devices)
    }  # fmt: skip
    options = {
        "host": LOCAL, "port": 0, "protocol": "tls", "security": security,
        "dashboard": True, "dashboard_address": f"{LOCAL}:0",
    }  # fmt: skip
    with quiet_dask():
        try:
            cluster = SpecCluster(
                scheduler={"cls": Scheduler, "options": options}, workers=workers,
                silence_logs=False, worker={"cls": Nanny}, security=security,
            )  # fmt: skip
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"no local workers could be started ({reason_of(error)})") from None
        try:
            with Client(cluster) as client:
                yield client
        finally:
            with suppress(Exception):  # a worker that has died cannot be closed
                cluster.close(timeout=TIMEOUT)


@contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """Yield the client of a running scheduler, or raise InputError if it does not answer."""
    need_dask()
    from distributed import Client

    with quiet_dask():
        try:
            asyncio.run(_greeted(address))
            client = Client(address, timeout=TIMEOUT)
        except Exception as error:  # of many classes, by the kind of the address
            silent = isinstance(error, TimeoutError) and not error.args
            reason = f"silent for {TIMEOUT:g} s" if silent else reason_of(error, 120)
            raise InputError(
                f"--scheduler {address}: no scheduler answers ({reason}); expected an address "
                "such as tcp://host:8786"
            ) from None
        try:
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=TIMEOUT)


async def _greeted(address: str) -> None:
    """Connect to a scheduler: Dask's client waits for good where a port accepts and is silent."""
    from distributed.comm import connect
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=TIMEOUT, **arguments), TIMEOUT)
    comm.abort()
