"""Every usable OpenCL device of this machine is a test parameter; none is a failure."""

import os
from pathlib import Path

import numpy as np
import pytest
from programs import PROGRAMS

import clmorph
from clmorph.opencl.device import Device, find_devices
from clmorph.opencl.knobs import apply_quirks, cpu_knobs, gpu_knobs
from clmorph.opencl.operations import OpenCLOperations

DEVICES = find_devices()
USABLE = [device for device in DEVICES if device.usable]
#: Comma-separated parts of names that CI requires among the usable devices; names of programs
#: are for the tests that need them.
REQUIRED = set(os.environ.get("CLMORPH_TEST_REQUIRE", "").split(",")) - {"", *PROGRAMS}


def pytest_report_header() -> list[str]:
    lines = [f"OpenCL device {device}" for device in DEVICES]
    return lines or ["OpenCL devices: none"]


def pytest_sessionstart(session: pytest.Session) -> None:
    if not USABLE:
        raise pytest.UsageError(
            "no usable OpenCL device: install one, for example with pip install '.[cpu,test]'"
        )
    for name in REQUIRED:
        if not any(device.matches(name) for device in USABLE):
            raise pytest.UsageError(f"no usable OpenCL device matches the required {name!r}")


def _label(device: Device) -> str:
    return f"{device.platform} {device.driver}".replace(" ", "-")


#: Each device with its own build-time constants, and with the other kind's: a CPU runs what
#: a GPU without float64 would (scalars, work-groups, barriers, shares of the columns, pairs of
#: float32), and the reverse.
VARIANTS = [pytest.param((device, False), id=_label(device)) for device in USABLE]
VARIANTS += [pytest.param((device, True), id=_label(device) + "-swapped") for device in USABLE]


@pytest.fixture(scope="session", params=VARIANTS)
def variant(request: pytest.FixtureRequest) -> OpenCLOperations:
    """Operations on each usable device, built in both ways."""
    device, swapped = request.param
    if not swapped:
        return OpenCLOperations(device.handle)
    knobs = gpu_knobs(256) if device.kind == "CPU" else cpu_knobs(4)
    return OpenCLOperations(device.handle, apply_quirks(knobs, frozenset({"no_float64"})))


@pytest.fixture(scope="session", params=USABLE, ids=_label)
def device(request: pytest.FixtureRequest) -> OpenCLOperations:
    """Operations on each usable device in turn."""
    operations = clmorph.get_backend(request.param.index)
    assert isinstance(operations, OpenCLOperations)
    return operations


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Indexes of the devices probed, in an empty cache; every probe is content."""
    probed: list[str] = []

    def probe(index: str) -> dict[str, object]:
        probed.append(index)
        return {"usable": True, "reason": "", "pairs_per_second": 1.0}

    monkeypatch.setattr("clmorph.opencl.storage.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("clmorph.opencl.device.run_probe", probe)
    return probed
