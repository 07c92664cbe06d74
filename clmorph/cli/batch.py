"""The command ``clmorph batch``: many pairs on Dask's workers."""

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import click
from rich import progress

from clmorph._shared.printable import printable
from clmorph._shared.signals import note_partial
from clmorph._shared.staging import clear_leftovers
from clmorph._shared.validation import check_max_pixels
from clmorph.backends.select import get_backend
from clmorph.batch.extra import need_dask
from clmorph.batch.index import write_index
from clmorph.batch.jobs import Defaults, Job, from_folder, read_jobs
from clmorph.batch.journal import Journal
from clmorph.batch.places import exists, is_remote, name_of, resolved
from clmorph.batch.run import run_jobs
from clmorph.batch.workers import devices_of, local_client, remote_client
from clmorph.cli.config import NOTHING, read_settings
from clmorph.cli.terminal import NOTES, device_name, note, print_table, say
from clmorph.errors import InputError
from clmorph.images.pixels import MAX_PIXELS
from clmorph.output.formats.registry import by_ending, usual_endings

#: Failed pairs that the summary lists; the page lists all.
LISTED = 20
#: Bytes below which a worker cannot even start.
LEAST_MEMORY = 300e6


def _defaults(given: Mapping[str, Any]) -> Defaults:
    """Return what holds for all jobs, from the checked arguments of the command line."""
    out, ending, memory, config = (given[name] for name in ("out", "ending", "memory", "config"))
    if not out or "\0" in out:
        raise InputError("--out is empty: expected the name of a folder")
    if not ending.startswith(".") or by_ending(Path(f"a{ending}")) is None:
        raise InputError(f"--ending {ending}: expected one of {', '.join(usual_endings())}")
    need_dask()
    if memory is not None:
        from dask.utils import parse_bytes

        try:
            enough = parse_bytes(memory) >= LEAST_MEMORY
        except ValueError:
            enough = False
        if not enough:
            raise InputError(f"--memory {memory}: expected a size such as 4GB, 300MB or more")
    found, most = NOTHING if config is None else read_settings(config), given["max_pixels"]
    for name in found.beside:
        raise InputError(
            f"--config {config}: its {name} belong to one pair of pictures: name them in the "
            f"table, in the columns source_{name} and target_{name}"
        )
    ignored = [name for name in ("output", "format", "recipe") if name in found.own]
    if ignored:
        note(f"{config}: batches do not use {', '.join(ignored)}")
    # A recipe holds all options, so that no preset is chosen under it.
    preset = given["preset"] or found.preset or (None if found.named.own else "photo")
    most = found.own.get("max_pixels", MAX_PIXELS) if most is None else most
    return Defaults(resolved(out), found.options, preset, check_max_pixels(most))


def _with_earlier(journal: Journal, records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the records of a run, and before them those of earlier ones that are still there."""
    new = {record["output"] for record in records}
    earlier = [
        record for record in journal.records.values()
        if record["output"] not in new and record["status"] == "done" and exists(record["output"])
    ]  # fmt: skip
    return [*earlier, *records]


def run_batch(given: Mapping[str, Any]) -> int:
    """Do all jobs that are not done yet; return 1 if any pair has failed, else 0."""
    began = time.perf_counter()
    device, defaults = device_name(given["device"], given["backend"]), _defaults(given)
    jobs, folder = _jobs(given, defaults), defaults.folder
    with Journal(folder) as journal:
        left = journal.missing(jobs, device, given["redo"])
        if len(left) < len(jobs):
            say(f"{len(jobs) - len(left)} of {len(jobs)} pairs are done already")
        try:
            if left:
                with _client(given, device, len(left)) as client:
                    _work(client, left, journal, device)
        finally:
            # What workers left that were ended in the middle; those that still write hold a lock.
            for place in {Path(job.output).parent for job, _ in left if not is_remote(job.output)}:
                clear_leftovers(place)
            records = [journal.records[job.output] for job in jobs if job.output in journal.records]
            page = write_index(folder, _with_earlier(journal, records)) if records else ""
            n_done = sum(record["status"] == "done" for record in records)
            note_partial(f"{n_done} of {len(jobs)} pairs are done: the same command does the rest")
    failed = [record for record in records if record["status"] == "failed"]
    seconds = time.perf_counter() - began
    if given["as_json"]:
        summary = {
            "pairs": len(jobs), "done": len(jobs) - len(failed), "failed": len(failed),
            "new": len(left), "seconds": round(seconds, 3), "index": page,
            "results": [
                {key: value for key, value in record.items() if key not in ("thumbnail", "key")}
                for record in records
            ],
        }  # fmt: skip
        click.echo(json.dumps(summary))
    else:
        if failed:
            rows = [
                (name_of(each["output"]), Path(each["where"]).name, each["line"])
                for each in failed[:LISTED]
            ]
            print_table(("failed", "job", "why"), rows)
        if len(failed) > LISTED:
            click.echo(f"and {len(failed) - LISTED} more, see the page")
        click.echo(
            f"{printable(page)}: {len(jobs) - len(failed)} of {len(jobs)} pairs done, "
            f"{len(failed)} failed, in {seconds:.1f} s"
        )
    return 1 if failed else 0


def _jobs(given: Mapping[str, Any], defaults: Defaults) -> list[Job]:
    sources = [given[name] for name in ("jobs", "all_pairs", "chain")]
    if sum(source is not None for source in sources) != 1:
        raise InputError("expected a table of jobs, or --all-pairs FOLDER, or --chain FOLDER")
    if given["scheduler"] is not None and (given["workers"] or given["memory"]):
        raise InputError("--scheduler has workers of its own: leave out --workers and --memory")
    table, pairs, chain = sources
    if table is not None:
        return read_jobs(resolved(table), defaults)
    return from_folder(pairs or chain, given["ending"], chain is not None, defaults)


def _client(given: Mapping[str, Any], device: str, count: int) -> AbstractContextManager[Any]:
    if given["scheduler"] is not None:
        return remote_client(given["scheduler"])
    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        if device not in ("auto", "opencl"):
            get_backend(device)  # a mistake is one error, and not one for each pair
        devices = devices_of(device, given["workers"])
    return local_client(devices[:count], given["memory"])


def _work(client: Any, left: Sequence[tuple[Job, str]], journal: Journal, device: str) -> None:
    """Do the jobs, and show how many are done and the time that is left."""
    info = client.scheduler_info(n_workers=-1)
    say(f"workers: {len(info['workers'])}; dashboard: {client.dashboard_link}")
    if not info["workers"]:
        note("the scheduler has no worker yet; the jobs wait for one")
    bar = progress.Progress(
        progress.TextColumn("pairs"), progress.BarColumn(), progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(), progress.TextColumn("left"), progress.TimeRemainingColumn(),
        progress.TextColumn("{task.fields[failed]}"),
        console=NOTES, disable=not NOTES.is_terminal, transient=True,
    )  # fmt: skip
    failed = 0
    with bar:
        task = bar.add_task("", total=len(left), failed="")
        for record in run_jobs(client, left, device):
            journal.add(record)
            if record["status"] == "failed":
                failed += 1
                note(f"{record['where']}: {record['line']}")
            bar.update(task, advance=1, failed=f"{failed} failed" if failed else "")
