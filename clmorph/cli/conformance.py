"""Compare a device with NumPy in every operation and in one whole morph."""

import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.build.kernel_files import KERNELS
from clmorph.backends.opencl.verification.findings import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.errors import InputError
from clmorph.measures.lift import lift
from clmorph.pipeline.morph import morph


def _picture(side: int, phase: float) -> NDArray[np.float64]:
    """Draw a smooth test picture."""
    y, x = np.mgrid[:side, :side] / side
    waves = [np.sin(5 * x + k * y + phase) * np.cos(3 * y - k * phase) for k in (1, 3, 6)]
    return 0.5 + 0.5 * np.stack(waves, axis=-1)


def check(operations: Operations, kernels: Sequence[str] = ()) -> Iterator[Finding]:
    """Compare a backend with NumPy, one operation after the other, and a morph.

    If names of kernels, or of kernel files with or without their ending, are given, only the
    operations that use one of them are compared. An error to which wrong results lead is a finding,
    too: the data of the comparisons are right, so those of clmorph come from wrong results as well.
    """
    # It imports pyopencl; where that is missing, the choice of the device has said so.
    from clmorph.backends.opencl.verification.table import device_checks

    wanted = wanted_kernels(kernels)
    first, second = lift(_picture(37, 0.2)), lift(_picture(31, 1.7))
    clouds = (first.points, first.weights), (second.points, second.weights)
    for used, run in device_checks(operations, clouds):
        if wanted & set(used):
            yield from _findings(", ".join(used), run())
    yield from _findings("morph", _check_morph(operations))


def _findings(about: str, found: Iterator[Finding]) -> Iterator[Finding]:
    try:
        yield from found
    except SIGNS_OF_WRONG_RESULTS as error:
        yield Finding(f"{about} ended in {words_of(error)}", np.inf, 0.0, "")


def wanted_kernels(names: Sequence[str]) -> set[str]:
    """Return the kernels that some names of kernels and files stand for; all if there are none."""
    found: set[str] = set()
    for name in names or KERNELS:
        own = [
            kernel
            for file, kernels in KERNELS.items()
            for kernel in kernels
            if name in (kernel, file, file.removesuffix(".cl"))
        ]
        if not own:
            listed = ", ".join(f"{file} ({', '.join(of)})" for file, of in KERNELS.items())
            raise InputError(f"--kernel {name!r}: expected a kernel or a file among {listed}")
        found.update(own)
    return found


def _check_morph(operations: Operations) -> Iterator[Finding]:
    images = _picture(20, 0.4), _picture(24, 2.9)
    ours, theirs = (
        morph(*images, n_frames=3, backend=backend) for backend in (operations, NumPyOperations())
    )
    error = max(float(np.abs(a - b).max()) for a, b in zip(ours.frames, theirs.frames, strict=True))
    yield Finding("morph", 255 * error, 1.0, "of 255")


def nearest(findings: Sequence[Finding]) -> Finding | None:
    """Return the finding whose error is the largest share of its tolerance; None if none is."""
    return max(findings, key=lambda finding: finding.share, default=None)


def report(
    device: Any, findings: list[Finding], pairs_per_second: float, seconds: dict[str, Any]
) -> dict[str, Any]:
    """Collect the data about a device for a report in JSON, without personal data."""
    from clmorph._shared.version import __version__

    close = nearest(findings)
    return {
        "clmorph": __version__,
        "system": f"{platform.system()} {platform.machine()}",
        "device": device.record(),
        "pairs_per_second": pairs_per_second,
        "seconds": seconds,
        "findings": [_record(finding) for finding in findings],
        "nearest": None if close is None else close.name,
    }


def _record(finding: Finding) -> dict[str, Any]:
    numbers = {"error": finding.error, "share": finding.share}
    # JSON has no infinity.
    finite = {name: value if np.isfinite(value) else None for name, value in numbers.items()}
    return asdict(finding) | finite | {"passed": finding.passed}
