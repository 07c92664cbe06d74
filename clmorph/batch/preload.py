"""What each local worker does first, as Dask's ``preload``."""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the command: it ends workers."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
