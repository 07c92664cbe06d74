"""Verify programs of a device: ``python -m clmorph.backends.opencl.probe INDEX [REQUEST]``."""

import contextlib
import json
import os
import sys
import threading
from dataclasses import asdict, replace

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import BuildConstants, choose_constants
from clmorph.backends.opencl.build.programs import program_key, read_request
from clmorph.backends.opencl.build.variants import Variant, further_variants, usual_variants
from clmorph.backends.opencl.devices.find import raw_devices
from clmorph.backends.opencl.devices.throughput import FEW_POINTS, seconds_of, throughput
from clmorph.backends.opencl.devices.trial import BEGUN, ENDED, FURTHER, LOADED, VERDICT
from clmorph.backends.opencl.devices.verdicts import Verdict, condemns
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, center_costs
from clmorph.backends.opencl.verification.findings import words_of
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.backends.records import NearPairs
from clmorph.errors import ClmorphError

#: The number of points of the timed log-sum-exp, small enough for any device.
TIMED_POINTS = 2048
#: By which factor pairs of float32 must be faster than float64 to replace it: not by noise.
FASTER = 1.2
#: Points of the timed sums over chosen columns, if all their pairs take fewer seconds than the
#: longest run, and sums of each kind, of which the fastest counts.
CHOSEN_POINTS, LONGEST_RUN, RUNS = 8192, 0.1, 5
#: Error codes of a driver whose resources are in use by this process or another one.
PASSING = (
    cl.status_code.DEVICE_NOT_AVAILABLE,
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE,
    cl.status_code.OUT_OF_HOST_MEMORY,
)
#: Bytes that a device must take to show that its resources are not in use.
FEW_BYTES = 1 << 24


def probe(index: str, request: str | None = None) -> Verdict:
    """Return the verdict on the device with this index: see `opencl.devices.trial.run_probe`."""
    found = dict(raw_devices())
    if index not in found:
        return Verdict("its probe did not find it", lasting=False)
    device, whole = found[index], request is None
    speed, eighths = Verdict.pairs_per_second, Verdict.many_eighths
    try:
        if whole or request == FURTHER:
            # A tuned build is no reason to refuse the device; it is verified when it is used.
            constants = _with_faster_exponents(device)
            variants = [
                variant for variant in (usual_variants() if whole else further_variants())
                if variant.suits(constants)
            ]  # fmt: skip
        else:
            constants, variants = read_request(str(request))
        operations = OpenCLOperations(device, constants, verify=False, profiled=True)
        failure: Verdict | None = None
        for variant in variants:
            verdict = _check(operations, variant)
            if verdict.reason:
                failure = failure or verdict
                # Each program of a request gets its own verdict.
                if whole:
                    break
        if failure:
            return failure
        if whole:
            speed = throughput(operations, TIMED_POINTS)
            if not operations.on_processor:
                eighths = many_eighths(operations, speed)
    except Exception as error:  # a driver's errors come in any class; the reason is shown
        return Verdict(_words(error), lasting=not _is_passing(error, device))
    slow = whole and constants.precise < choose_constants(device).precise
    verdict = Verdict(pairs_per_second=speed, slow_float64=slow, many_eighths=eighths)
    iterations = Variant("half_steps.cl")
    if whole and iterations.suits(constants):
        # A crash from here on is that of a program that the host does without.
        tell(verdict)
        last = _check(operations, iterations)
        if condemns(last.reason, optional=True):
            return last
    return verdict


def _with_faster_exponents(device: cl.Device) -> BuildConstants:
    """Return constants with float64 for precise exponents only where that is faster."""
    constants = choose_constants(device)
    if constants.precise == 2 and not device.type & cl.device_type.CPU:
        pairs = replace(constants, precise=1)
        if precise_rate(device, pairs) > FASTER * precise_rate(device, constants):
            return pairs
    return constants


def precise_rate(device: cl.Device, constants: BuildConstants) -> float:
    """Return point pairs per second in sums with precise exponents."""
    operations = OpenCLOperations(device, constants, verify=False, profiled=True)
    return throughput(operations, TIMED_POINTS, precise=True)


def many_eighths(operations: OpenCLOperations, rate: float) -> int:
    """Return from how many eighths of its columns on a whole tile is summed faster, by `rate`."""
    points = CHOSEN_POINTS if rate * LONGEST_RUN > CHOSEN_POINTS**2 else FEW_POINTS
    few, more, whole = (_chosen_seconds(operations, points, eighths) for eighths in (1, 5, 8))
    each = (more - few) / 4
    return int(np.clip(1 + (whole - few) / each, 1, 8)) if each > 0 else 8


def _chosen_seconds(operations: OpenCLOperations, points: int, eighths: int) -> float:
    """Return the seconds of sums over so many eighths of the columns of each tile."""
    tile, rng = operations.constants.tile, np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    n = len(cloud.centers)
    chosen = rng.random((n * n, tile // operations.constants.group_rows, tile)).argsort(axis=-1)
    bits = np.packbits(8 * chosen < eighths * tile, axis=-1, bitorder="little")
    bits = np.pad(bits, ((0, 0), (0, 0), (0, -bits.shape[-1] % 8)))
    masks = operations.work.buffer(bits.view(np.uint64), np.uint64)
    starts = n * np.arange(n + 1)
    pairs = TilePairs(
        starts, np.tile(np.arange(n, dtype=np.uint32), n),
        center_costs(cloud.centers[:, None], cloud.centers).ravel(), [(range(n), masks)],
        starts * tile**2,
    )  # fmt: skip
    near = NearPairs(pairs, np.zeros(points), np.zeros(points), points**2, points, 0.0)

    def run() -> None:
        operations.softmin(cloud, cloud, np.zeros(points), 0.01, False, near)

    run()
    return min(seconds_of(operations, run) for _ in range(RUNS))


def _check(operations: OpenCLOperations, variant: Variant) -> Verdict:
    """Return the verdict on a program."""
    key = program_key(operations.device, variant, operations.constants)
    print(f"\n{BEGUN} {key} {variant}", flush=True)
    try:
        verdict = Verdict(first_failure(operations, variant))
    except Exception as error:  # as in `probe`
        passing = _is_passing(error, operations.device)
        verdict = Verdict(f"{variant}: {_words(error)}", lasting=not passing)
    print(f"\n{ENDED} {json.dumps(verdict.reason if verdict.lasting else None)}", flush=True)
    return verdict


def _words(error: Exception) -> str:
    """Return an error in one line."""
    return str(error).split(";")[0] if isinstance(error, ClmorphError) else words_of(error)[:300]


def _is_passing(error: BaseException | None, device: cl.Device) -> bool:
    """Return whether an error, or its cause, is temporary and not a fault of the driver."""
    if error is None:
        return False
    if isinstance(error, MemoryError | OSError):
        return True
    code = error.code if isinstance(error, cl.Error) else cl.status_code.SUCCESS
    # NVIDIA returns it for an illegal access, too, after which another context works.
    if code == cl.status_code.OUT_OF_RESOURCES:
        return not _has_resources(device)
    return code in PASSING or _is_passing(error.__cause__, device)


def _has_resources(device: cl.Device) -> bool:
    """Return whether a new context can be used."""
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context, device)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, FEW_BYTES)
        cl.enqueue_copy(queue, buffer, bytes(FEW_BYTES), is_blocking=True)
    except (cl.Error, MemoryError):
        return False
    return True


def end_with_parent() -> None:
    """End this process when its parent ends and so closes the other end of standard input."""

    def wait() -> None:
        # The thread does not read `sys.stdin`, because it would hold its lock at exit.
        with contextlib.suppress(OSError):
            while os.read(0, 1):
                pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def main(index: str, request: str | None = None) -> None:
    """Print what `opencl.devices.trial` reads; see the words there."""
    # The driver may crash from here on, so this line is printed first.
    print(f"\n{LOADED}", flush=True)
    tell(probe(index, request))


def tell(verdict: Verdict) -> None:
    """Print the line of a verdict."""
    print(f"\n{VERDICT} {json.dumps(asdict(verdict))}", flush=True)


if __name__ == "__main__":
    end_with_parent()
    main(*sys.argv[1:])
