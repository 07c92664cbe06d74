"""Trials of devices and programs in a process of their own: a driver may abort or hang it."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO, Any, NamedTuple

from clmorph._shared.validation import check_number
from clmorph.backends.opencl.devices.verdicts import CRASHED, OPTIONAL, Verdict, save

#: Time limit in seconds to build and check a program, and the variable that changes it.
PROBE_SECONDS = 60.0
PROBE_SECONDS_VARIABLE = "CLMORPH_PROBE_SECONDS"
#: The line that the probe prints before it opens the device.
LOADED = "clmorph.backends.opencl.probe: loaded"
#: The words with which the probe begins the lines before and after the check of a program, and the
#: line of its verdict. Reasons and the verdict are JSON in ASCII. Each line begins anew, because
#: drivers print text, too, and not always whole lines.
BEGUN, ENDED = "clmorph.program.begun", "clmorph.program.ended"
VERDICT = "clmorph.verdict"
#: The request to verify the programs that most morphs use beside those of a trial.
FURTHER = "further"
#: Signals that end a process for a reason outside the driver: a user, or a lack of memory.
_FROM_OUTSIDE = ("SIGHUP", "SIGINT", "SIGKILL", "SIGQUIT", "SIGTERM")
#: Status of a process that Ctrl-C ended on Windows.
_CONTROL_C = 0xC000013A
#: Seconds after which the end of a silent process is looked for, and for which a killed one may
#: take to end.
_STEP, _PATIENCE = 0.5, 5.0
#: Variables that limit the threads of NumPy's matrix products. Idle ones spin, which makes a trial
#: on a busy machine several times as long. Drivers read OMP_NUM_THREADS, so that it stays as it is.
_ONE_THREAD = ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
#: Variables that would change how the probe's interpreter ends, warns or prints.
_UNWANTED = ("PYTHONINSPECT", "PYTHONIOENCODING", "PYTHONWARNINGS")


def probe_seconds() -> float:
    """Return the time limit of the check of a program, in seconds."""
    text = os.environ.get(PROBE_SECONDS_VARIABLE, "").strip()
    if not text:
        return PROBE_SECONDS
    try:
        value: Any = float(text)
    except ValueError:
        value = text
    return check_number(PROBE_SECONDS_VARIABLE, value, 1, 3600)


def run_probe(index: str, request: str | None = None) -> Verdict:
    """Build and verify kernels on a device of `raw_devices`, in a separate process.

    `request` names the programs to verify (`programs.make_request`, or `FURTHER`); by default they
    are those that most morphs use, and the speed is measured. Each may take `probe_seconds`. The
    verdicts on the programs that were checked are saved, even if the process then fails.
    """
    seconds, python = probe_seconds(), interpreter()
    if python is None:
        return Verdict(
            f"cannot be tried, because {sys.executable or 'an empty sys.executable'!r} is no "
            "Python interpreter: name one with multiprocessing.set_executable", lasting=False,
        )  # fmt: skip
    # The probe ends when this pipe is closed, which happens however this process ends.
    reading, writing = os.pipe()
    try:
        ended = _run(_command(python, index, request), seconds, reading)
    except OSError as error:
        return Verdict(f"cannot be tried ({python}: {error.strerror})", lasting=False)
    finally:
        os.close(reading)
        os.close(writing)
    return _judge(ended, seconds)


def _command(python: str, index: str, request: str | None) -> list[str]:
    # -P: the current folder may hold another clmorph, such as a source tree.
    command = [python, "-P", "-W", "ignore", "-m", "clmorph.backends.opencl.probe", index]
    return command if request is None else [*command, request]


class Ended(NamedTuple):
    """How a probe ended: its status, None if it ran out of time, and what it printed."""

    status: int | None
    lines: list[str]
    errors: list[str] = []  # noqa: RUF012 (nothing is added)


def _run(command: list[str], seconds: float, reading: int) -> Ended:
    """Run a process until it ends, not its output; each of its lines may take `seconds`."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as noise:
        process = subprocess.Popen(
            command, env=_environment(), stdin=reading, stdout=subprocess.PIPE, stderr=noise,
            text=True, errors="replace",
        )  # fmt: skip
        assert process.stdout is not None
        reader = threading.Thread(target=_read, args=(process.stdout, lines), daemon=True)
        reader.start()
        status, known, deadline = None, 0, time.monotonic() + seconds
        try:
            while status is None and time.monotonic() < deadline:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    status = process.wait(timeout=_STEP)
                if len(lines) > known:
                    known, deadline = len(lines), time.monotonic() + seconds
        finally:
            process.kill()
            # A process that waits in a kernel's driver cannot be killed, and is not waited for.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=_PATIENCE)
        reader.join(_STEP)  # the last lines may come a moment after the end
        noise.seek(0)
        errors = noise.read().decode(errors="replace").splitlines()
    return Ended(status, list(lines), errors)


def _read(pipe: IO[str], lines: list[str]) -> None:
    """Collect the lines of a pipe, which this thread owns and closes."""
    with pipe:
        for line in pipe:
            lines.append(line.rstrip("\r\n"))


def _judge(ended: Ended, seconds: float) -> Verdict:
    """Return the verdict of a probe that has ended."""
    status, lines = ended.status, ended.lines
    key, name = _keep_program_verdicts(lines)
    found: Verdict | None = None
    for line in lines:
        word, _, rest = line.partition(" ")
        with contextlib.suppress(ValueError, TypeError):
            found = Verdict(**json.loads(rest)) if word == VERDICT else found
    if found and status == 0:
        return found
    noise = next((line.strip() for line in ended.errors[::-1] if line.strip()), "no output")
    crashed = f"{CRASHED} ({{}} {abs(status or 0)}) on {name or 'a kernel'}"
    lasting, outside = True, [getattr(signal, each, None) for each in _FROM_OUTSIDE]
    if status is None:
        lasting, reason = False, (
            f"did not build and verify {name or 'the kernels'} within {seconds:g} s; it is tried "
            f"again by the next process, and {PROBE_SECONDS_VARIABLE} sets how many seconds it may "
            "take"
        )  # fmt: skip
    elif status == _CONTROL_C:
        lasting, reason = False, f"its probe was killed (status {status:#x})"
    elif status < 0 and -status in outside:
        lasting, reason = False, f"its probe was killed (signal {-status})"
    elif status < 0:
        reason = crashed.format("signal")
    elif LOADED in lines:
        reason = f"{crashed.format('status')}: {noise}"
    else:
        # The probe had not opened the device yet, so the driver is not the cause of the failure.
        lasting, reason = False, f"its probe ended with status {status}: {noise}"
    if key and (lasting or (status is None and name in OPTIONAL)):
        save(key, Verdict(reason, lasting))
    if found and name in OPTIONAL:
        return found
    return Verdict(reason, lasting, timed_out=status is None)


def _keep_program_verdicts(lines: list[str]) -> tuple[str, str]:
    """Save the verdicts that a probe has printed; return key and name of the one not finished."""
    key = name = ""
    for line in lines:
        word, _, rest = line.partition(" ")
        if word == BEGUN:
            key, _, name = rest.partition(" ")
        elif word == ENDED and key:
            # Failures that another check need not repeat have null in place of a reason.
            with contextlib.suppress(ValueError):
                if isinstance(reason := json.loads(rest), str):
                    save(key, Verdict(reason))
            key = name = ""
    return key, name


def interpreter() -> str | None:
    """Return the Python interpreter; None where an application that embeds Python stands there."""
    from multiprocessing.spawn import get_executable

    python = os.fsdecode(get_executable() or "")
    named = re.match(r"(python|pypy|graalpy)", Path(python).name, re.IGNORECASE)
    return python if named else None


def _environment() -> dict[str, str]:
    """Return the variables with which the probe finds the same modules as this process."""
    known = {name: value for name, value in os.environ.items() if name not in _UNWANTED}
    if sys.flags.ignore_environment:
        known = {name: value for name, value in known.items() if not name.startswith("PYTHON")}
    known |= dict.fromkeys(_ONE_THREAD, "1")
    # Relative entries refer to the current folder, whose modules may shadow others.
    places = [place for place in sys.path if Path(place).is_absolute()]
    root = str(Path(__file__).parents[4])
    known["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([*places, root]))
    return known
