"""Find the programs of the system that some tests need and that CI requires."""

import os
import shutil
import subprocess
import sysconfig
from typing import Any

import pytest

#: The command line as pip installs it, which is not always beside the interpreter.
COMMAND = shutil.which("clmorph", path=sysconfig.get_path("scripts")) or "clmorph"

#: What CLMORPH_TEST_REQUIRE can name beside devices, and the programs that it stands for.
PROGRAMS = {
    "clang": ("clang-19", "clang"),
    "clang-19": ("clang-19",),
    "chromium": ("chromium", "chromium-browser", "google-chrome"),
    "ffmpeg": ("ffmpeg",),
    "ffprobe": ("ffprobe",),
}


def program(name: str) -> str:
    """Return the path of a program; skip the test if there is none, fail if it is required."""
    path = next(filter(None, map(shutil.which, PROGRAMS[name])), None)
    if path is None:
        why = f"none of {', '.join(PROGRAMS[name])} is installed"
        if name in os.environ.get("CLMORPH_TEST_REQUIRE", "").split(","):
            pytest.fail(why)
        pytest.skip(why)
    return path


def ffmpeg(*arguments: object, **options: Any) -> bytes:
    """Run FFmpeg, which replaces files and must succeed; return what it writes to its output."""
    command = [program("ffmpeg"), "-v", "error", "-y", *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, **options).stdout
