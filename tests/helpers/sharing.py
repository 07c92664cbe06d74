"""A system that neither moves nor removes what somebody has open, as Windows does not."""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

#: Functions by their number of paths.
FUNCTIONS = {"replace": 2, "rename": 2, "unlink": 1, "remove": 1, "rmdir": 1}


def opened() -> set[str]:
    """Return the paths of files that this process has open, or has mapped into its memory."""
    found = set()
    for handle in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # that of the listing itself is gone
            found.add(str(handle.readlink()))
    lines = Path("/proc/self/maps").read_text("utf-8", "replace").splitlines()
    return found | {line.split(maxsplit=5)[5] for line in lines if line.count("/")}


def refuse_what_is_open(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let functions of `os` fail as they do on Windows; return the list of what was refused."""
    if not Path("/proc/self/fd").exists():
        pytest.skip("the system does not tell which files are open")
    refused: list[str] = []

    def guarded(function: Any, count: int) -> Any:
        def run(*paths: Any, **options: Any) -> Any:
            # Paths relative to an open folder come from `shutil.rmtree`, which does without below.
            own = [os.path.realpath(path) for path in paths[:count]]
            held = opened()
            for path in own:
                if path in held or any(name.startswith(f"{path}{os.sep}") for name in held):
                    refused.append(path)
                    raise PermissionError(13, "The process cannot access the file", path)
            return function(*paths, **options)

        return run

    for name, count in FUNCTIONS.items():
        monkeypatch.setattr(os, name, guarded(getattr(os, name), count))
    monkeypatch.setattr(shutil, "_use_fd_functions", False)
    return refused
