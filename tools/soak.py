"""Morph for a long time in threads and processes: ``python tools/soak.py``.

Draws sets of options (presets, splattings, formats, ...), works each out once in a row, and then
draws among them: half of the morphs in threads of this process, half in processes. Every file
must be the same as the first of its kind, on the same device; memory, open files, threads,
temporary files and OpenCL objects must not grow. Prints a line for every finding, with the
command that repeats it, and a summary; ends with 1 if there was a finding.
"""

import argparse
import ctypes
import gc
import multiprocessing
import os
import random
import sys
import tempfile
import threading
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from findings import Findings, digest

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.frames.options import ENDPOINTS, SPLATTING, UNMATCHED
from clmorph.images.color import COLOR_SPACES
from clmorph.output.options import EASES
from clmorph.output.save import FORMATS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import PRESETS

#: Values that options are drawn from, beside those of a preset.
CHOICES: dict[str, list[Any]] = {
    "splatting": list(SPLATTING),
    "color_space": list(COLOR_SPACES),
    "path_space": list(COLOR_SPACES),
    "endpoints": list(ENDPOINTS),
    "unmatched": list(UNMATCHED),
    "mass": ["uniform", "luminance"],
    "reach": [0.1, 0.3, None],
    "blur": [0.03, 0.08],
    "ease": list(EASES),
    "sample": [None, 3],
}
#: Bytes by which this process may grow after every set was worked out once.
GROWTH = 64 << 20
#: A set of options: of the morph, its pictures and its file.
Options = dict[str, Any]


def draw(seed: int, count: int) -> list[Options]:
    """Draw sets of options; every format and every preset is among the first."""
    rng = random.Random(seed)
    sets = []
    for number in range(count):
        name = list(PRESETS)[number % len(PRESETS)]
        drawn = {key: rng.choice(CHOICES[key]) for key in rng.sample(sorted(CHOICES), 3)}
        # Drawn options take the place of the preset's, and of their alternatives there.
        chosen = MorphOptions.layered((PRESETS[name].options, drawn))
        sets.append({
            "morph": chosen,
            "format": list(FORMATS)[number % len(FORMATS)],
            "sides": (rng.randint(6, 14), rng.randint(6, 14)),
            "seed": rng.randint(0, 2),
            "alpha": rng.random() < 0.25,
        })  # fmt: skip
    return sets


def work(options: Options, device: str) -> str:
    """Morph with a set of options, save, and return the digest of the file, or the error."""
    height, width = options["sides"]
    rng = np.random.default_rng(options["seed"])
    shape = (height, width, 4 if options["alpha"] else 3)
    first, second = rng.random(shape), rng.random(shape)
    try:
        result = clmorph.morph(first, second, n_frames=3, backend=device, **options["morph"])
        with tempfile.TemporaryDirectory(prefix="soak-") as folder:
            format = FORMATS[options["format"]]
            place = Path(folder) / ("out" + (format.endings or ("",))[0])
            clmorph.save(result, place, format=options["format"], fps=20)
            return digest(place)
    except clmorph.ClmorphError as error:  # some options contradict: always in the same words
        return f"error: {error}"


def quiet() -> None:
    """Let warnings be: of options drawn at random some do not converge."""
    warnings.simplefilter("ignore")


def work_many(jobs: list[tuple[int, Options]], device: str, threads: int) -> list[tuple[int, str]]:
    """Work out numbered sets in the threads of one process."""
    with ThreadPoolExecutor(threads) as pool:
        answers = list(pool.map(partial(work, device=device), [options for _, options in jobs]))
    return [(number, answer) for (number, _), answer in zip(jobs, answers, strict=True)]


def resources(device: str) -> dict[str, float]:
    """Return what this process holds."""
    gc.collect()
    with suppress(AttributeError, OSError):  # glibc alone has it
        ctypes.CDLL(None).malloc_trim(0)  # freed memory that the allocator keeps is no leak
    counts: dict[str, float] = {"threads": threading.active_count()}
    if Path("/proc/self").exists():
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        counts["memory"] = pages * os.sysconf("SC_PAGE_SIZE")
        counts["open files"] = len(list(Path("/proc/self/fd").iterdir()))
    counts["temporary files"] = len(list(Path(tempfile.gettempdir()).iterdir()))
    operations = clmorph.get_backend(device)
    if isinstance(operations, OpenCLOperations):
        pool = operations.work._pool
        counts["device memory in use"] = pool.active_bytes
        # Buffers, programs, kernels and queues; without what is kept for the next buffers.
        counts["objects"] = operations.context.reference_count - pool.held_blocks
        counts["backends"] = sum(isinstance(it, OpenCLOperations) for it in gc.get_objects())
    return counts


def compare(
    findings: Findings, kind: str, answers: list[tuple[int, str]], first: dict[int, str]
) -> None:
    """Add a finding for every answer that is not the first one."""
    for number, answer in answers:
        findings.trial(kind)
        if answer != first[number]:
            what = f"set {number} differs: {answer[:60]} is not {first[number][:60]}"
            findings.add(kind, what, ["--only", str(number)])


def soak(arguments: argparse.Namespace, findings: Findings, device: str) -> None:
    """Work out sets one after the other, then in threads, then in processes."""
    sets = list(enumerate(draw(arguments.seed, arguments.sets)))
    sets = [one for one in sets if arguments.only in (None, one[0])]
    first = dict(work_many(sets, device, threads=1))
    compare(findings, "again", work_many(sets, device, threads=1), first)
    # Threads keep memory of their own: let them all have had some before it is counted.
    rng = random.Random(arguments.seed)
    jobs = [rng.choice(sets) for _ in range(max(0, arguments.morphs - 2 * len(sets)))]
    share, half = len(jobs) // 4, len(jobs) // 2
    warm, counted, apart = jobs[:share], jobs[share:half], jobs[half:]
    compare(findings, "threads", work_many(warm, device, arguments.threads), first)
    before = resources(device)
    compare(findings, "threads", work_many(counted, device, arguments.threads), first)
    after = resources(device)
    for name, value in after.items():
        findings.trial("resources")
        if value > before[name] + (GROWTH if name == "memory" else 0):
            repeat = ["--morphs", str(arguments.morphs), "--sets", str(arguments.sets)]
            findings.add("resources", f"{name} grew from {before[name]} to {value}", repeat)
    if arguments.processes and apart:
        # Not forked: drivers do not survive that.
        context = multiprocessing.get_context("spawn")
        threads = max(1, arguments.threads // arguments.processes)
        parts = [apart[number :: arguments.processes] for number in range(arguments.processes)]
        with ProcessPoolExecutor(
            arguments.processes, mp_context=context, initializer=quiet
        ) as pool:
            task = partial(work_many, device=device, threads=threads)
            for answers in pool.map(task, [part for part in parts if part]):
                compare(findings, "processes", answers, first)


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--morphs", type=int, default=500, help="over all")
    parser.add_argument("--sets", type=int, default=44, help="of options, each worked out twice")
    parser.add_argument("--threads", type=int, default=8)
    parser.add_argument("--processes", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--only", type=int, metavar="SET", help="this set of options alone")
    arguments = parser.parse_args(given)
    findings = Findings(["--seed", str(arguments.seed), "--device", arguments.device])
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder, warnings.catch_warnings():
        quiet()
        # What is left in the temporary folder shall be ours.
        before, tempfile.tempdir = tempfile.tempdir, folder
        try:
            soak(arguments, findings, arguments.device)
            left = sorted(path.name for path in Path(folder).iterdir())
        finally:
            tempfile.tempdir = before
    if left:
        findings.add("resources", f"left in the temporary folder: {left[:5]}", [])
    print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    return findings.end()


if __name__ == "__main__":
    if sys.platform == "linux" and "MALLOC_ARENA_MAX" not in os.environ:
        # By default glibc keeps freed memory for each of the threads that have been, which grows
        # by hundreds of megabytes without any leak. It reads the variable when a process starts.
        os.execve(sys.executable, sys.orig_argv, os.environ | {"MALLOC_ARENA_MAX": "1"})
    raise SystemExit(main())
