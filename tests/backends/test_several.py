"""Several devices as one backend: how they are named, and who does what."""

import gc
import weakref

import numpy as np
import pytest
from several import two_parts

import clmorph
from clmorph import ClmorphWarning, DeviceError, InputError
from clmorph.backends.interface import Operations
from clmorph.backends.multi_device import MultiDevice, members_of, sharing_notes, turns
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import index_of

pytestmark = pytest.mark.one_device


class Known(NumPyOperations):
    """NumPy with the speed of another device."""

    def __init__(self, speed):
        self.pairs_per_second = speed


def test_the_first_device_computes(rng):
    first, second = NumPyOperations(), NumPyOperations()
    several = MultiDevice([first, second])
    cloud = several.upload(rng.random((20, 2)), np.full(20, 0.05))
    assert several.softmin.__self__ is first
    assert np.array_equal(
        several.softmin(cloud, cloud, np.zeros(20), 0.1),
        first.softmin(cloud, cloud, np.zeros(20), 0.1),
    )
    assert members_of(several) == [first, second]
    assert members_of(first) == [first]


def test_a_single_solve_says_which_device_it_uses(device, rng):
    pair = [(np.full(30, 1 / 30), rng.random((30, 2))) for _ in range(2)]
    several = MultiDevice(two_parts(device.device))
    for solve in (clmorph.sinkhorn, clmorph.sinkhorn_divergence):
        with pytest.warns(ClmorphWarning, match="a single solve uses one device") as told:
            found = solve(*pair, blur=0.1, reach=0.3, backend=several)
        (warning,) = told
        assert several.primary.description in str(warning.message)
        assert "\n" not in str(warning.message)
        one = solve(*pair, blur=0.1, reach=0.3, backend=several.primary)
        for name in ("dual",) if solve is clmorph.sinkhorn else ("value",):
            assert getattr(found, name) == getattr(one, name)


@pytest.mark.parametrize("speeds", [[1.0], [3.0, 3.0], [99.0, 1.0], [2.0, 3.0, 5.0]])
def test_work_follows_the_speeds(speeds):
    several = MultiDevice([Known(speed) for speed in speeds])
    shares = np.array(speeds) / sum(speeds)
    chosen = turns(several, 1000)
    for end in range(1, 1001):
        counts = np.bincount(chosen[:end], minlength=len(speeds))
        assert np.abs(counts - end * shares).max() <= len(speeds) - 0.5


def test_an_unknown_speed_is_the_slowest_known_one():
    for speeds, like in (([4.0, 0.0, 2.0], [4.0, 2.0, 2.0]), ([0.0, 0.0], [1.0, 1.0])):
        found, want = (turns(MultiDevice(list(map(Known, own))), 40) for own in (speeds, like))
        assert found == want


def test_memory_is_the_least():
    class Small(NumPyOperations):
        sum_roundoff, has_float64, memory_bytes = 2.0**-24, False, 1000
        shares_host_memory = on_processor = False
        pairs_per_second = 5.0

    class Host(Small):
        memory_bytes, shares_host_memory = 1500, True

    several = MultiDevice([NumPyOperations(), Small()])
    assert (several.memory_bytes, several.shares_host_memory) == (1000, True)
    # Both are in the host's memory.
    assert MultiDevice([NumPyOperations(), Host(), Small()]).memory_bytes == 750
    assert MultiDevice([NumPyOperations(), NumPyOperations()]).memory_bytes is None
    names = [name for name in Operations.__annotations__ if not name.startswith("_")]
    assert len(names) > 8
    for operations in (several, NumPyOperations()):
        assert [name for name in names if not hasattr(operations, name)] == []


# --- names of devices -----------------------------------------------------------------------


def test_a_list_of_devices(device, monkeypatch):
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    index = index_of(device.device)
    several = clmorph.get_backend([index, "numpy"])
    assert members_of(several) == [device, clmorph.get_backend("numpy")]
    for same in ((index, "numpy"), [device, "numpy"], f"{index},numpy", f" {index} , numpy"):
        assert clmorph.get_backend(same) is several
    assert clmorph.get_backend(["numpy", index]) is not several
    monkeypatch.setenv("CLMORPH_DEVICE", f"{index}, numpy")
    assert clmorph.get_backend() is several
    assert clmorph.get_backend("auto") is several
    assert clmorph.get_backend(several) is several
    assert clmorph.get_backend([index]) is device
    # "auto" in the variable is the best device, not the variable again.
    monkeypatch.setenv("CLMORPH_DEVICE", "auto,numpy")
    assert isinstance(clmorph.get_backend().members[0], OpenCLOperations)


def test_a_backend_of_objects_is_not_kept(device):
    parts = two_parts(device.device)
    several = clmorph.get_backend(parts)
    assert clmorph.get_backend(list(parts)) is several
    gone = weakref.ref(several)
    del several
    gc.collect()
    assert gone() is None


def test_wrong_lists(device, monkeypatch):
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    index, name = index_of(device.device), device.device.name.strip()
    for wrong, words in (
        ([], r"backend=\[\]: expected at least one device"),
        ([index, name], "are the same device"),
        (["numpy", "numpy"], "'numpy' and 'numpy' are the same device"),
        ([index, OpenCLOperations(device.device)], "are the same device"),
        ([index, ["numpy"]], "one device for each entry"),
        ([index, "numpy,0:0"], "one device for each entry"),
        (f"{index},", "expected a name for each device"),
        (",", "expected a name for each device"),
        ([index, 3], "backend=3"),
        ([clmorph.get_backend(["numpy", index]), "numpy"], "stands for several devices"),
    ):
        with pytest.raises(InputError, match=words) as error:
            clmorph.get_backend(wrong)
        assert "\n" not in str(error.value)
    with pytest.raises(DeviceError, match="no OpenCL device matches 'no such device'"):
        clmorph.get_backend(["numpy", "no such device"])
    monkeypatch.setenv("CLMORPH_DEVICE", f"{index},numpy")
    with pytest.raises(InputError, match="'auto' stands for several devices"):
        clmorph.get_backend(["auto", "numpy"])


def test_two_drivers_of_one_processor_are_noted(device):
    assert sharing_notes(device) == []
    first, *more = sharing_notes(MultiDevice([NumPyOperations(), device]))
    assert "computes the transport" in first
    assert ("cannot be faster" in " ".join(more)) == device.on_processor
