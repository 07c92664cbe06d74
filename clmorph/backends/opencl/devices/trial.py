"""Trials of devices and programs: `opencl.probe` runs in a separate process, within a time limit.

A driver may abort or hang its process, so no program is run in this process before it was verified.
"""

import contextlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO, Any

from clmorph._shared.validation import check_number
from clmorph.backends.opencl.devices.verdicts import CRASHED, OPTIONAL, save_program_verdict

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
#: What the request of a trial without some optional files begins with.
WITHOUT = "without "
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


def run_probe(
    index: str, seconds: float | None = None, request: str | None = None
) -> dict[str, Any]:
    """Return the verdict of `_probe_once`; a trial that ends in an optional program is repeated.

    It is repeated without the program.
    """
    skipped: list[str] = []
    while True:
        without = WITHOUT + " ".join(skipped) if skipped else request
        verdict = _probe_once(index, seconds, without)
        under_check = verdict.pop("under_check", "")
        if request is not None or under_check not in OPTIONAL or under_check in skipped:
            return verdict
        skipped.append(under_check)


def _probe_once(index: str, seconds: float | None, request: str | None) -> dict[str, Any]:
    """Build and verify kernels on a device of `raw_devices`, in a separate process.

    `request` names the programs to verify (`programs.make_request`, or `FURTHER`); by default they
    are those that most morphs use, and the speed is measured. Each may take `seconds`, by default
    `probe_seconds`. The verdicts on the programs that were checked are saved, even if the process
    then fails.

    The result has the entries usable (bool), reason (str), pairs_per_second (float), lasting
    (bool), which states whether another probe would return the same verdict, and if it ran out of
    time, timed_out (True).
    """
    seconds = probe_seconds() if seconds is None else seconds
    python = _interpreter()
    if python is None:
        return _untried(
            f"cannot be tried, because {sys.executable or 'an empty sys.executable'!r} is no "
            "Python interpreter: name one with multiprocessing.set_executable"
        )
    command = _command(python, index, request)
    # The probe ends when this pipe is closed, which happens however this process ends.
    reading, writing = os.pipe()
    try:
        done = _run(command, seconds, reading)
    except subprocess.TimeoutExpired as error:
        key, under_check = _keep_program_verdicts(str(error.output or "").splitlines())
        verdict = _untried(
            f"did not build and verify {under_check or 'the kernels'} within {seconds:g} s; it is "
            f"tried again by the next process, and {PROBE_SECONDS_VARIABLE} sets how many seconds "
            "it may take"
        ) | {"timed_out": True, "under_check": under_check}
        if under_check in OPTIONAL:
            save_program_verdict(key, verdict["reason"], lasting=False)
        return verdict
    except OSError as error:
        return _untried(f"cannot be tried ({python}: {error.strerror})")
    finally:
        os.close(reading)
        os.close(writing)
    return _judge(done)


def _command(python: str, index: str, request: str | None) -> list[str]:
    # -P: the current folder may hold another clmorph, such as a source tree.
    command = [python, "-P", "-W", "ignore", "-m", "clmorph.backends.opencl.probe", index]
    return command if request is None else [*command, request]


def _run(command: list[str], seconds: float, reading: int) -> "subprocess.CompletedProcess[str]":
    """Run a process, which may take `seconds` for each of the lines that it prints.

    The end of the process counts, and not that of its standard output, which a further process
    that a driver has started may keep open.
    """
    found: queue.Queue[str | None] = queue.Queue()
    lines: list[str] = []
    with tempfile.TemporaryFile() as noise:
        process = subprocess.Popen(
            command, env=_environment(), stdin=reading, stdout=subprocess.PIPE, stderr=noise,
            text=True, errors="replace",
        )  # fmt: skip
        assert process.stdout is not None
        threading.Thread(target=_pass_on, args=(process.stdout, found), daemon=True).start()
        try:
            deadline, ended = time.monotonic() + seconds, False
            while True:
                try:
                    line = found.get(timeout=_STEP)
                except queue.Empty:
                    # The last lines may come a moment after the end.
                    if ended:
                        break
                    ended = process.poll() is not None
                    if not ended and time.monotonic() > deadline:
                        raise subprocess.TimeoutExpired(command, seconds, "".join(lines)) from None
                    continue
                if line is None:
                    break
                lines.append(line)
                deadline = time.monotonic() + seconds
            try:
                code = process.wait(timeout=seconds)
            except subprocess.TimeoutExpired:
                raise subprocess.TimeoutExpired(command, seconds, "".join(lines)) from None
        finally:
            process.kill()
            # A process that waits in a kernel's driver cannot be killed, and is not waited for.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=_PATIENCE)
        noise.seek(0)
        complaints = noise.read().decode(errors="replace")
    return subprocess.CompletedProcess(command, code, "".join(lines), complaints)


def _pass_on(pipe: IO[str], found: "queue.Queue[str | None]") -> None:
    """Put the lines of a pipe, which this thread owns and closes, into a queue; None at the end."""
    with pipe:
        for line in pipe:
            found.put(line)
    found.put(None)


def _untried(reason: str) -> dict[str, Any]:
    return {"usable": False, "reason": reason, "pairs_per_second": 0.0, "lasting": False}


def _judge(done: "subprocess.CompletedProcess[str]") -> dict[str, Any]:
    """Return the verdict of a probe that has ended."""
    lines = done.stdout.strip().splitlines()
    key, under_check = _keep_program_verdicts(lines)
    words = [line.partition(" ") for line in lines]
    if done.returncode == 0 and (found := [rest for word, _, rest in words if word == VERDICT]):
        with contextlib.suppress(ValueError, TypeError):
            return dict(json.loads(found[-1]))
    noise = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    reason = noise[-1] if noise else "no output"
    name, under_check = under_check, under_check or "a kernel"
    # If the probe has not opened the device yet, the driver is not the cause of the failure.
    lasting = LOADED in lines
    if lasting:
        reason = f"{CRASHED} (status {done.returncode}) on {under_check}: {reason}"
    else:
        reason = f"its probe ended with status {done.returncode}: {reason}"
    if done.returncode == _CONTROL_C:
        lasting, reason = False, f"its probe was killed (status {done.returncode:#x})"
    if done.returncode < 0:
        lasting = True
        reason = f"{CRASHED} (signal {-done.returncode}) on {under_check}"
        outside = [getattr(signal, name, None) for name in _FROM_OUTSIDE]
        if -done.returncode in outside:
            lasting, reason = False, f"its probe was killed (signal {-done.returncode})"
    if lasting and key:
        save_program_verdict(key, reason)
    return _untried(reason) | {"lasting": lasting, "under_check": name}


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
                    save_program_verdict(key, reason)
            key = name = ""
    return key, name


def can_start_process() -> bool:
    """Return whether the path of the Python interpreter is known, so that a probe can be run."""
    return _interpreter() is not None


def _interpreter() -> str | None:
    """Return the path of the Python interpreter; None if an embedding program does not set it.

    The path may then be that of the application itself, which must not be started as the probe.
    """
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
