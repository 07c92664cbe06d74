"""Which devices and how much is tested; fixtures that many tests share.

``pytest`` tests the operations on the first usable device, in the build that is chosen for it, with
a share of each grid of parameters, and a third of it on the others; and a part of what is written
over them, on one device or another.
``pytest --full`` runs whole grids, and tests operations also in the build of the other kind of
device: each place of a grid is on one device or another in one of both builds, and the share of the
default on each. A device that repeats another one has that share of operations alone.
``--device NAME`` tests one device. Beside other devices a slow one runs some of the tests of
operations, and the tests marked as small, also with ``--full``. Without any usable device the tests
of NumPy run, "auto" means NumPy, and the tests that need a device are skipped.
"""

import os
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from programs import PROGRAMS

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import apply_quirks, cpu_constants, gpu_constants
from clmorph.backends.opencl.devices import verdicts
from clmorph.backends.opencl.devices.find import Device, find_devices, tried
from clmorph.backends.opencl.devices.quirks import NO_VECTORS

#: Helpers that have fixtures.
pytest_plugins = ("browsers", "pictures", "refusals", "studio_pages")
DEVICES = find_devices()
USABLE = [device for device in DEVICES if device.usable]
#: The devices to test: all usable ones but pip's old PoCL, or those that `--device` names.
TESTED = [
    device for device in USABLE if not any(old in device.version.lower() for old in NO_VECTORS)
]
#: Comma-separated parts of names that CI requires among the tested devices; names of programs
#: are for the tests that need them.
REQUIRED = set(os.environ.get("CLMORPH_TEST_REQUIRE", "").split(",")) - {"", *PROGRAMS}
#: Why a test is skipped where OpenCL has no usable device.
NO_DEVICE = "needs a usable OpenCL device, and there is none (clmorph devices says what to install)"
#: Parameters that name a device; grids are thinned for each device by itself.
OF_DEVICES = ("variant", "device", "each_device", "any_backend")
#: What is written over operations, or marked so, is tested on one device after the other.
IN_TURNS = {"device", "any_backend"}
#: One of so many tests of a grid's share is run by devices but the first one, and in turns.
STEP = 3
#: Modules that take longest with --full, the longest first. Processes that share the tests take a
#: module at a time and in this order, so that none starts on a long one when the others are done.
LONGEST = (
    "backends/test_verification.py",
    "backends/test_operations.py",
    "backends/test_small.py",
    "backends/test_many_dimensions.py",
    "analysis/test_inspection.py",
    "project/test_pages.py",
    "output/test_export.py",
    "project/test_cross_check.py",
    "transport/test_certificate.py",
    "batch/test_dask_batches.py",
    "transport/test_gradient.py",
    "transport/test_batch_fuzz.py",
    "cli/test_check.py",
    "backends/test_device.py",
    "frames/test_figures.py",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("clmorph")
    group.addoption(
        "--full",
        action="store_true",
        help="run tests marked as full, whole grids of parameters, and operations on each device "
        "also in the build of the other kind of device",
    )
    group.addoption(
        "--device",
        metavar="NAME",
        help="test one device only: its index, or a part of its or its platform's name",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "full: a long test, run with --full only")
    config.addinivalue_line("markers", "small: for slow devices too")
    config.addinivalue_line("markers", "in_turns: each place of the grid on one device or another")
    config.addinivalue_line("markers", "one_device: on the first tested device, in its own build")
    config.addinivalue_line("markers", "needs_device: skipped without a usable OpenCL device")
    if config.getoption("numprocesses", None):
        # Processes of tests share the cores, and inherit this. With threads of linear algebra a
        # frame of the dense reference takes 1.2 to 2.5 times as long.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Programs that tests start keep the package compiled for the next ones: a third of their time.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    name = config.getoption("--device")
    if name is None:
        if not TESTED:
            os.environ["CLMORPH_DEVICE"] = "numpy"
        return
    TESTED[:] = [device for device in USABLE if device.matches(name)][:1]
    if not TESTED:
        listed = "; ".join(map(str, DEVICES)) or "none"
        raise pytest.UsageError(f"no usable OpenCL device matches --device {name}: {listed}")
    # What "auto" means in the tests and in the programs that they start.
    os.environ["CLMORPH_DEVICE"] = TESTED[0].index


def pytest_xdist_auto_num_workers() -> int:
    """Share tests among some processes: each takes up to 2 GB, and devices have threads."""
    return min(4, os.cpu_count() or 1)


def pytest_report_header(config: pytest.Config) -> list[str]:
    lines = [
        f"OpenCL device {device}{'' if device in TESTED or not device.usable else ', not tested'}"
        f"{', slow: few tests' if _is_slow(device) else ''}"
        for device in DEVICES
    ]
    if not TESTED:
        lines.append("no usable OpenCL device: tests run on NumPy, or are skipped if they need one")
    lines.append(f"tests: {'all' if config.getoption('--full') else 'a share; --full runs all'}")
    return lines


def pytest_sessionstart(session: pytest.Session) -> None:
    for name in REQUIRED:
        if not any(device.matches(name) for device in TESTED):
            raise pytest.UsageError(f"no usable OpenCL device matches the required {name!r}")


def _label(device: Device) -> str:
    return f"{device.platform} {device.driver}".replace(" ", "-")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Let each device be a parameter; without one, tests that need it are skipped.

    With --full `variant` is each device with its own build constants and with those of the other
    kind: a CPU runs what a GPU without float64 would (scalars, work-groups, barriers, shares of
    the columns, pairs of float32), and the reverse.
    """
    labels = [_label(device) for device in TESTED]
    for name in OF_DEVICES[:3]:
        if name not in metafunc.fixturenames:
            continue
        values: list[Any] = list(TESTED)
        ids = labels
        if name == "variant":
            values = [(device, False) for device in TESTED]
            if metafunc.config.getoption("--full"):
                firsts = [it for it in TESTED if not _is_repeated(it) and not _is_slow(it)]
                values += [(device, True) for device in firsts]
                ids = labels + [f"{_label(device)}-swapped" for device in firsts]
        if not TESTED:
            none = (None, False) if name == "variant" else None
            values = [pytest.param(none, marks=pytest.mark.skip(reason=NO_DEVICE))]
            ids = ["no-device"]
        metafunc.parametrize(name, values, ids=ids, indirect=True, scope="session")
    if "any_backend" in metafunc.fixturenames:
        names = ["numpy", *(device.index for device in TESTED)]
        metafunc.parametrize("any_backend", names, ids=["numpy", *labels], scope="session")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without --full, leave out long tests and most of each grid of parameters.

    Of a grid so many combinations are left as its longest axis has values, and each value of every
    axis is among them; of tests in turns, and on devices but the first one, every third of these.
    With --full all combinations are left, and each combination of a test in turns, or of one of
    operations, is for one device in one build beside the default's share. A device that repeats
    another one then tests operations, with a share of each grid.
    """
    if not TESTED:
        for item in items:
            if item.get_closest_marker("needs_device") is not None:
                item.add_marker(pytest.mark.skip(reason=NO_DEVICE))
    full = config.getoption("--full")
    suitable = [item for item in items if _suits(item, _device_of(item))]
    chosen: set[pytest.Item] = set()
    for own in _by_function([it for it in suitable if it.get_closest_marker("full") is None]):
        if not (full and _is_in_turns(own[0])):
            chosen.update(_share(own))
    if full:
        whole = [
            item
            for item in suitable
            if not _is_repeated(_device_of(item))
            and (not _is_slow(_device_of(item)) or item.get_closest_marker("small") is not None)
        ]
        for own in _by_function(whole):
            turns = _is_in_turns(own[0]) or "variant" in _params(own[0])
            chosen.update(_one_device_each(own) if turns else own)
    config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
    items[:] = [item for item in items if item in chosen]
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=_turn)


def _turn(item: pytest.Item) -> int:
    """Return which module's turn it is; modules that are not among the longest come last."""
    path = item.path.relative_to(Path(__file__).parent).as_posix()
    return LONGEST.index(path) if path in LONGEST else len(LONGEST)


def _is_repeated(device: Device | None) -> bool:
    """Whether a device before this one is of the same kind and platform.

    So it is with two versions of PoCL, or with two graphics cards.
    """
    if device not in TESTED:
        return False
    before = TESTED[: TESTED.index(device)]
    return any((it.platform, it.kind) == (device.platform, device.kind) for it in before)


def _is_slow(device: Device | None) -> bool:
    """Whether a device is a CPU without vectors, such as llvmpipe, and another one is tested.

    The measured speed does not decide, because other work on the machine changes it.
    """
    slow = [it for it in TESTED if it.kind == "CPU" and it.handle.native_vector_width_float <= 1]
    return device in slow and len(slow) < len(TESTED)


def _suits(item: pytest.Item, device: Device | None) -> bool:
    """Whether a test is for its device: of slow ones, operations and what is marked as small."""
    params = _params(item)
    if item.get_closest_marker("one_device") is not None and device is not None:
        return device == TESTED[0] and not params.get("variant", (device, False))[1]
    if not _is_slow(device) or item.get_closest_marker("small") is not None:
        return True
    # Only some of a slow device's turns would be run, so it takes none.
    return "variant" in params and not _is_in_turns(item)


def _device_of(item: pytest.Item) -> Device | None:
    """Return the device that an item is for; None if for none, or for NumPy."""
    params = _params(item)
    if "variant" in params:
        return params["variant"][0]
    if "any_backend" in params:
        return next((it for it in TESTED if it.index == params["any_backend"]), None)
    return params.get("device", params.get("each_device"))


def _params(item: pytest.Item) -> dict[str, Any]:
    return getattr(getattr(item, "callspec", None), "params", {})


def _by_function(items: list[pytest.Item]) -> Iterable[list[pytest.Item]]:
    """Return the items of each test function."""
    functions: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        functions[item.nodeid.partition("[")[0]].append(item)
    return functions.values()


def _is_in_turns(item: pytest.Item) -> bool:
    """Whether one device is enough for each combination of a test's other parameters."""
    marked = item.get_closest_marker("in_turns") is not None
    return marked or not IN_TURNS.isdisjoint(_params(item))


def _one_device_each(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return one item of a test function for each combination of parameters, and those of NumPy.

    Devices and builds take turns, and tests marked as small are for all of them.
    """
    combinations: dict[tuple[int, ...], list[pytest.Item]] = defaultdict(list)
    for item in items:
        others = [id(value) for name, value in _params(item).items() if name not in OF_DEVICES]
        combinations[tuple(others)].append(item)
    chosen = []
    for place, own in enumerate(combinations.values()):
        of_devices = [item for item in own if _device_of(item) is not None]
        small = [item for item in of_devices if item.get_closest_marker("small") is not None]
        one = small
        if of_devices and not small:
            # Each round begins elsewhere: else turns of two would go along with axes of two values.
            number = len(of_devices)
            begin = crc32(f"{items[0].originalname} {place // number}".encode())
            one = [of_devices[(begin + place) % number]]
        chosen += [item for item in own if item in one or item not in of_devices]
    return chosen


def _share(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return those items of one test function that stand for its grid of parameters.

    What tests single operations does so on the first device, and a part of it on the others; of
    whole solves and morphs, which are written over these, a part goes to one device or another.
    """
    callspecs = [getattr(item, "callspec", None) for item in items]
    devices, *axes = _axes(callspecs)
    longest = max(axes, key=max, default=[0] * len(items))
    shorter = [axis for axis in axes if axis is not longest]
    in_turns = _is_in_turns(items[0])
    everywhere = not in_turns and (
        items[0].get_closest_marker("small") is not None or "variant" in _params(items[0])
    )
    n_devices, turn = max(devices) + 1, crc32(items[0].nodeid.partition("[")[0].encode())
    chosen = []
    for number, item in enumerate(items):
        place, device = longest[number], devices[number]
        if in_turns:
            if place % STEP != turn % min(STEP, max(longest) + 1):
                continue
            place //= STEP
        if not everywhere and device != (place + turn) % n_devices:
            continue
        small = item.get_closest_marker("small") is not None
        if everywhere and device > 0 and not small and (place + device + turn) % STEP:
            continue
        shift = device if everywhere else 0
        if all(axis[number] == (place + shift) % (max(axis) + 1) for axis in shorter):
            chosen.append(item)
    return chosen


def _axes(callspecs: list[Any]) -> list[list[int]]:
    """Number the devices, and the values along each axis of a grid: an index for each item.

    Parameters of which not all combinations occur, as those that one decorator sets, are one axis.
    """
    devices = [0] * len(callspecs)
    axes: list[list[int]] = []
    for name in callspecs[0].params if callspecs[0] else ():
        # The values are the objects of the decorator's list.
        axis = _numbered([id(callspec.params[name]) for callspec in callspecs])
        if name in OF_DEVICES:
            devices = axis
            continue
        for other in list(axes):
            if len(set(zip(axis, other, strict=True))) < (max(axis) + 1) * (max(other) + 1):
                axes.remove(other)
                axis = _numbered(list(zip(axis, other, strict=True)))
        axes.append(axis)
    return [devices, *axes]


def _numbered(keys: list[Any]) -> list[int]:
    """Return the place of each key among the different ones."""
    places = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    return [places[key] for key in keys]


@pytest.fixture(scope="session")
def variant(request: pytest.FixtureRequest) -> OpenCLOperations:
    """Operations on a device, built with its own constants or with those of the other kind."""
    device, swapped = request.param
    if not swapped:
        return OpenCLOperations(device.handle, verify=False)
    constants = gpu_constants(256) if device.kind == "CPU" else cpu_constants(4)
    # The tests themselves compare with NumPy.
    quirks = frozenset({"no_float64"})
    return OpenCLOperations(device.handle, apply_quirks(constants, quirks), verify=False)


def _operations(request: pytest.FixtureRequest) -> OpenCLOperations:
    operations = clmorph.get_backend(request.param.index)
    assert isinstance(operations, OpenCLOperations)
    return operations


#: Operations on each tested device in turn; and on each one, where other tests take turns.
device = pytest.fixture(scope="session", name="device")(_operations)
each_device = pytest.fixture(scope="session", name="each_device")(_operations)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


def forget_devices() -> None:
    """Know as much of devices as a new process."""
    verdicts._known.clear()
    tried.cache_clear()
    find_devices.cache_clear()


def found_anew() -> tuple[Device, ...]:
    forget_devices()
    return find_devices()


@pytest.fixture
def fresh_search() -> Iterator[None]:
    """Let what a test finds, and verdicts that it fakes, be forgotten before and after it."""
    kept = verdicts._known.copy()
    forget_devices()
    yield
    forget_devices()
    verdicts._known.update(kept)


@pytest.fixture
def empty_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The test's own folder in place of the user's cache."""
    monkeypatch.setattr("clmorph.backends.opencl.devices.cache.cache_folder", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, empty_cache: Path, fresh_search: None) -> list[str]:
    """Indexes of the devices probed, in an empty cache; every probe is content."""
    probed: list[str] = []

    def probe(index: str, request: str | None = None) -> verdicts.Verdict:
        if request is None:
            probed.append(index)
        return verdicts.Verdict(pairs_per_second=1.0)

    monkeypatch.setattr("clmorph.backends.opencl.devices.find.run_probe", probe)
    return probed
