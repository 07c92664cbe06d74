"""The commands ``clmorph devices``, ``clmorph check`` and ``clmorph tune``."""

import json
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import atomic_path, check_file_place, is_standard_output
from clmorph._shared.printable import printable, reason_of
from clmorph._shared.version import __version__
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.build.kernel_files import KERNELS
from clmorph.backends.opencl.devices.cache import cache_folder
from clmorph.backends.opencl.devices.find import (
    Device,
    choose_device,
    find_devices,
    forget_verdicts,
    mark_unusable,
)
from clmorph.backends.opencl.devices.verdicts import WRONG
from clmorph.backends.opencl.verification.findings import SIGNS_OF_WRONG_RESULTS, Finding, words_of
from clmorph.cli.terminal import NOTES, note, print_table
from clmorph.errors import ClmorphError, DeviceError, InputError, OutputError

_share = attrgetter("share")
_TRYING = "trying OpenCL devices (remembered from the second time on)"


def _find() -> tuple[Device, ...]:
    with NOTES.status(_TRYING):
        return find_devices()


def list_devices(as_json: bool, again: bool) -> int:
    """Print every OpenCL device; return 1 if none is usable, else 0."""
    if again:
        forget_verdicts()
    devices = _find()
    if cache_folder() is None:
        note(
            "what is learned of devices cannot be kept; set XDG_CACHE_HOME to a folder that "
            "can be written to"
        )
    auto = ""
    with suppress(DeviceError):  # no device works
        auto = choose_device("auto").index
    if as_json:
        records = [device.record() | {"auto": device.index == auto} for device in devices]
        click.echo(json.dumps(records, indent=1))
        return 0 if auto else 1
    from clmorph.backends.opencl.devices.install_hints import advice, missing_files

    if devices:
        # Where pyopencl cannot be imported there are none.
        from clmorph.backends.opencl.devices.quirks import has_float64

        titles = (
            "", "index", "device", "platform, driver", "type", "units", "memory", "float64",
            "10⁹ pairs/s", "usable",
        )  # fmt: skip
        rows = [
            (
                "auto" if device.index == auto else "",
                device.index,
                device.name,
                f"{device.platform}, {device.version.split('  ')[0]}, {device.driver}",
                device.kind,
                str(device.compute_units),
                f"{device.memory / 2**30:.0f} GiB",
                "yes" if has_float64(device.handle) else "no",
                f"{device.pairs_per_second / 1e9:.1f}" if device.pairs_per_second else "",
                "yes" if device.usable else f"no: {device.reason}",
            )
            for device in devices
        ]
        print_table(titles, rows, right=["10⁹ pairs/s"])
    if auto:
        for line in missing_files() if sys.platform == "linux" else ():
            note(line)
        return 0
    click.echo("No OpenCL device is usable. What helps:")
    for line in advice():
        click.echo(f"  {line}")
    return 1


def _choose(spec: str | None, every: bool, even_wrong: bool = False) -> list[Device]:
    """Return the device that the user chose, or every usable device."""
    if every and (devices := [device for device in _find() if device.usable]):
        return devices
    with NOTES.status(_TRYING):
        return [choose_device(spec or "auto", even_wrong)]


def _choose_any(spec: str | None, every: bool) -> list[Device]:
    """Return the chosen device, or all: unusable ones too, as their tuning may be the reason."""
    if every:
        return list(_find()) or _choose(spec, every)
    try:
        return _choose(spec, every)
    except DeviceError:
        meant = [d for d in _find() if spec in (None, "auto", "opencl") or d.matches(str(spec))]
        if not meant:
            raise
        return meant


def tune_devices(spec: str | None, every: bool, reset: bool) -> None:
    """Tune devices, or delete their stored tuning."""
    devices = _choose_any(spec, every) if reset else _choose(spec, every)
    # These import pyopencl; where it is missing, the choice has said so.
    from clmorph.backends.opencl.build.tuned_record import forget_tuning
    from clmorph.backends.opencl.tuner import tune

    for device in devices:
        click.echo(f"[{device.index}] {device.name} ({device.platform}, driver {device.driver})")
        if reset:
            forget_tuning(device.handle)
            click.echo("  tuning forgotten")
            if not device.usable:
                forget_verdicts(device.handle)
                note(f"it was unusable: {device.reason}; it is tried again when it is needed")
            continue
        constants, before, after = tune(device.handle, lambda line: click.echo(f"  {line}"))
        click.echo(f"  kept: {constants}")
        click.echo(f"  {before / 1e9:.2f} to {after / 1e9:.2f}·10⁹ pairs/s")


def check_devices(
    spec: str | None, every: bool, report: Path | None, kernels: Sequence[str] = ()
) -> int:
    """Compare devices with NumPy, print the results; return 1 if one is out of tolerance.

    A device that is named is compared even if it is unusable because of a wrong result. What is
    found is remembered: a failure makes the device unusable, and a device that passes everything is
    no longer unusable because of a wrong result. If there are `kernels`, only operations that use
    one of these, or of these files, are compared.
    """
    wanted_kernels(kernels)  # or an error
    devices = _choose(spec, every, even_wrong=spec is not None)
    if report is not None:
        if is_standard_output(report):
            raise OutputError(
                "--report needs the name of a file, because the table is printed to standard output"
            )
        check_file_place(report)  # before the comparison begins
    bundles = [_check_one(device, kernels) for device in devices]
    if report is not None:
        text = json.dumps(bundles[0] if len(bundles) == 1 else bundles, indent=1) + "\n"
        with atomic_path(report) as new:
            new.write_text(text, "utf-8")
        click.echo(f"wrote {printable(report)}")
    return 0 if all(f["passed"] for bundle in bundles for f in bundle["findings"]) else 1


def _check_one(device: Device, kernels: Sequence[str]) -> dict[str, Any]:
    from clmorph.backends.opencl.backend import OpenCLOperations
    from clmorph.backends.opencl.devices.throughput import LEAST_SHARE, throughput

    click.echo(f"[{device.index}] {device.name} ({device.platform}, driver {device.driver})")
    if not device.usable:
        note(f"it is unusable: {device.reason}; it is compared because it was named")
    # A wrong program is to be a row of the table, so programs are not verified before their use.
    operations = OpenCLOperations(device.handle, verify=False, profiled=True)
    began, work = time.perf_counter(), operations.work
    findings: list[Finding] = []
    try:
        for finding in check(operations, kernels):
            findings.append(finding)
        in_kernels, elapsed = work.device_seconds, time.perf_counter() - began
        longest, name = work.longest_launch
        speed = throughput(operations)
    except Exception as error:  # drivers raise exceptions of any class
        if findings:
            _print_findings(findings)
            _remember(device, findings, whole=False)
        if isinstance(error, ClmorphError):
            raise
        raise DeviceError(
            f"{device.name} failed after {len(findings)} checks: {reason_of(error)}; "
            "update its driver, or choose another device"
        ) from error
    _print_findings(findings)
    click.echo(f"log-sum-exp: {speed / 1e9:.2f}·10⁹ pairs/s")
    seconds = {"device": in_kernels, "all": elapsed, "longest_launch": longest, "of": name}
    click.echo(
        f"kernels took {in_kernels:.2f} s of {elapsed:.2f} s with NumPy's; the longest launch: "
        f"{name}, {1e3 * longest:.1f} ms"
        if in_kernels > LEAST_SHARE * elapsed
        else f"all took {elapsed:.2f} s with NumPy's; the device's own clock does not run"
    )
    _remember(device, findings, whole=not kernels)
    # A report has no personal data.
    return {
        "clmorph": __version__,
        "system": f"{platform.system()} {platform.machine()}",
        "device": device.record(),
        "pairs_per_second": speed,
        "seconds": seconds,
        "findings": [_record(finding) for finding in findings],
        "nearest": max(findings, key=_share).name if findings else None,
    }


def _print_findings(findings: list[Finding]) -> None:
    titles = "operation", "largest error", "tolerance", "", "share", "verdict"
    rows = [
        (
            f.name, f"{f.error:.1e}", f"{f.tolerance:.1e}", f.unit, _percent(f),
            "pass" if f.passed else "FAIL",
        )
        for f in findings
    ]  # fmt: skip
    print_table(titles, rows, right=["share"])
    if findings:
        close = max(findings, key=_share)
        click.echo(f"nearest its tolerance: {close.name} ({_percent(close)} of it)")


def _percent(finding: Finding) -> str:
    return f"{finding.share:.0%}" if finding.share < 100 else f"{finding.share:.2g} times"


def _remember(device: Device, findings: list[Finding], whole: bool) -> None:
    """Remember that a device computes wrongly, or forget it if it has passed everything."""
    failed = [finding for finding in findings if not finding.passed]
    if failed:
        worst = max(failed, key=_share)
        mark_unusable(device.handle, f"{WRONG}clmorph check: {worst}")
        note("the device is unusable from now on; clmorph devices --again forgets that")
    elif whole and not device.usable:
        forget_verdicts(device.handle)
        note("what was remembered of the device is forgotten: it is tried again when it is needed")


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
    from clmorph.measures.lift import lift

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
    from clmorph.backends.numpy import NumPyOperations
    from clmorph.pipeline.morph import morph

    images = _picture(20, 0.4), _picture(24, 2.9)
    ours, theirs = (
        morph(*images, n_frames=3, backend=backend) for backend in (operations, NumPyOperations())
    )
    error = max(float(np.abs(a - b).max()) for a, b in zip(ours.frames, theirs.frames, strict=True))
    yield Finding("morph", 255 * error, 1.0, "of 255")


def _record(finding: Finding) -> dict[str, Any]:
    numbers = {"error": finding.error, "share": finding.share}
    # JSON has no infinity.
    finite = {name: value if np.isfinite(value) else None for name, value in numbers.items()}
    return asdict(finding) | finite | {"passed": finding.passed}
