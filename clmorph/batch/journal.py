"""The journal in the folder of outputs: what is done, so that a second run does only the rest.

A local journal gets a line for each job as it ends, flushed to the disk. File systems without
appending (object stores) get the whole journal at most every few seconds, and at the end.
"""

import hashlib
import json
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from clmorph._shared.printable import reason_of
from clmorph._shared.version import __version__
from clmorph.batch.jobs import Job
from clmorph.batch.places import JOURNAL, exists, is_remote, read_bytes, resolved, stamp
from clmorph.errors import InputError, OutputError

#: The states of a record, and its entries that are texts.
STATUSES, TEXTS = ("done", "failed"), ("output", "source", "target", "where", "key")
#: Seconds between two writes of a journal that cannot be appended to.
INTERVAL = 10.0
#: A place behind the end of any journal.
FAR = 1 << 40


def identity(job: Job, device: str) -> str:
    """Return a digest of what decides an output: options, files read, device asked for, version."""
    beside = {kind: [[place, stamp(place)] for place in two] for kind, two in job.beside.items()}
    parts = [
        job.source, job.target, stamp(job.source), stamp(job.target), beside,
        job.settled(job.preset).outside(), job.preset, job.defaults.max_pixels, device, __version__,
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


def _lock(file: Any) -> None:
    """Take a file for this process; an OSError says why not."""
    if sys.platform == "win32":
        import msvcrt

        # Nobody reads or writes what is locked, so that it is a byte far behind the end.
        file.seek(FAR)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Journal:
    """The last record of each output of the jobs that have ended; one run holds it at a time."""

    def __init__(self, folder: str) -> None:
        self.place, self.records = resolved(JOURNAL, folder), dict[str, dict[str, Any]]()
        self._file: Any = None if is_remote(self.place) else self._opened(folder)
        self._written = time.monotonic()
        text = read_bytes(self.place, missing=b"")
        for line in text.split(b"\n"):
            # The last line of a run that was killed can be incomplete.
            with suppress(ValueError, TypeError, KeyError):
                record = json.loads(line)
                # The file can be edited by anybody.
                if record["status"] in STATUSES and all(
                    isinstance(record[name], str) for name in TEXTS
                ):
                    self.records[record["output"]] = record
        if self._file is None:
            self._rewrite()  # before the work, so that a place that cannot be written is known
        elif text and not text.endswith(b"\n"):
            self._file.write(b"\n")

    def _opened(self, folder: str) -> Any:
        """Return the open journal, which no other run holds."""
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            file = Path(self.place).open("ab")  # noqa: SIM115
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written to ({reason_of(error)})") from None
        try:
            _lock(file)
        except (BlockingIOError, PermissionError):
            file.close()
            raise OutputError(
                f"{folder}: another clmorph batch writes to it; wait for it, or choose another "
                "folder"
            ) from None
        except OSError:  # a file system without locks
            pass
        return file

    def missing(self, jobs: list[Job], device: str, redo: bool) -> list[tuple[Job, str]]:
        """Return jobs to be done and their identities; changed ones need `redo` (InputError)."""
        left, changed = [], []
        for job in jobs:
            key = identity(job, device)
            known = self.records.get(job.output)
            is_done = known is not None and known["status"] == "done" and exists(job.output)
            if is_done and known is not None and known["key"] == key:
                continue
            if is_done:
                changed.append(job)
            left.append((job, key))
        if changed and not redo:
            raise InputError(
                f"{len(changed)} outputs were made with other options, pictures, device or version "
                f"of clmorph, the first {Path(changed[0].output).name}: give --redo to make them "
                "again, or choose another folder"
            )
        return left

    def add(self, record: dict[str, Any]) -> None:
        """Record a job that has ended."""
        self.records[record["output"]] = record
        if self._file is None:
            if time.monotonic() - self._written > INTERVAL:
                self._rewrite()
            return
        try:
            self._file.write(json.dumps(record).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self.place}: cannot be written ({reason_of(error)})") from None

    def _rewrite(self) -> None:
        import fsspec

        lines = "".join(json.dumps(record) + "\n" for record in self.records.values())
        try:
            system, path = fsspec.core.url_to_fs(self.place)
            system.makedirs(path.rpartition("/")[0], exist_ok=True)
            system.pipe_file(path, lines.encode())
        except Exception as error:  # file systems raise exceptions of any class
            raise OutputError(f"{self.place}: cannot be written ({reason_of(error)})") from None
        self._written = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is None:
            self._rewrite()
        else:
            self._file.close()
