"""A plugin of pytest that takes away what Windows does not have, so that tests are collected so."""

import contextlib
import importlib
import os
import signal
import sys

# What other packages have imported before stays theirs.
for name in (
    "distributed",
    "matplotlib.pyplot",
    "platformdirs",
    "playwright.sync_api",
    "psutil",
    "uvicorn",
):
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
for name in ("SIGALRM", "SIGHUP", "SIGKILL", "SIGQUIT", "SIGUSR1", "SIGXFSZ"):
    vars(signal).pop(name, None)
for name in ("fork", "geteuid", "killpg", "mkfifo", "setsid"):
    vars(os).pop(name, None)
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None  # type: ignore[assignment]
