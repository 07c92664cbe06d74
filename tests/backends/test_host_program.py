"""Objects and arrays of a host program that uses pyopencl: its queues, its arrays, its events."""

import gc
import os
import re
import subprocess
import sys
import threading
import time
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import host_program as example
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from api_values import OnlyDLPack
from conftest import USABLE
from count_transfers import COPIES, TransferCount
from several import parts_of

import clmorph
from clmorph import InputError
from clmorph.backends.arrays import as_array, as_floats
from clmorph.backends.opencl import host_program
from clmorph.backends.opencl.devices.find import tried

OUT_OF_ORDER = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
PROFILING = cl.command_queue_properties.PROFILING_ENABLE
N = 90


@pytest.fixture
def context(device):
    return cl.Context([device.device])


@pytest.fixture
def queue(context):
    return cl.CommandQueue(context)


@pytest.fixture
def clouds(rng):
    """Two clouds (weights, points) on the host."""
    weights = rng.random(N) + 0.1
    return tuple((weights / weights.sum(), rng.random((N, 2))) for _ in range(2))


def n_maps(buffer):
    """Return how often a buffer is mapped; None where the driver does not count."""
    queue = cl.CommandQueue(buffer.context)
    other = cl.Buffer(buffer.context, cl.mem_flags.READ_WRITE, 64)
    mapped, _ = cl.enqueue_map_buffer(queue, other, cl.map_flags.READ, 0, (64,), np.uint8)
    counts = other.get_info(cl.mem_info.MAP_COUNT) == 1
    mapped.base.release(queue).wait()
    return buffer.get_info(cl.mem_info.MAP_COUNT) if counts else None


def unmapped(buffer):
    """Whether a buffer is mapped no longer; a driver may count that after its event has ended."""
    deadline = time.monotonic() + 60
    while n_maps(buffer) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not n_maps(buffer)


def solved(clouds, backend):
    return clmorph.sinkhorn(*clouds, blur=0.1, reach=0.5, backend=backend)


def on_device(queue, cloud):
    return tuple(cl_array.to_device(queue, each) for each in cloud)


@pytest.fixture
def expected(clouds, device):
    return solved(clouds, device)


def properties(device, wanted):
    """Return the queue properties, or skip where the device does not have them."""
    if wanted & ~device.device.queue_properties:
        pytest.skip("the device has no such queues")
    return wanted


# --- backend= ------------------------------------------------------------------------------------


def test_a_device_is_the_same_backend_as_its_name(device):
    again = cl.Device.from_int_ptr(device.device.int_ptr, retain=True)
    assert clmorph.get_backend(device.device) is clmorph.get_backend(again)
    assert clmorph.get_backend(device.device).device == device.device


def test_work_runs_in_the_given_context_and_queue(clouds, expected, context, queue):
    for given in (context, queue):
        operations = clmorph.get_backend(given)
        assert operations.context == context
        assert clmorph.get_backend(given) is operations
        found = solved(clouds, given)
        assert np.array_equal(found.f, expected.f)
        assert np.array_equal(found.g, expected.g)
    assert clmorph.get_backend(queue).queue == queue
    assert clmorph.get_backend(context) is not clmorph.get_backend(queue)
    buffer = clmorph.get_backend(queue).work.empty(64)
    assert buffer.get_info(cl.mem_info.CONTEXT) == context


@pytest.mark.parametrize("wanted", [OUT_OF_ORDER, PROFILING, OUT_OF_ORDER | PROFILING])
def test_other_kinds_of_queues(clouds, expected, context, device, wanted):
    queue = cl.CommandQueue(context, properties=properties(device, wanted))
    found = solved([on_device(queue, cloud) for cloud in clouds], queue)
    assert np.array_equal(found.f, expected.f)
    pictures = np.random.default_rng(0).random((2, 8, 8, 3))
    frame = clmorph.morph(*pictures, n_frames=3, backend=queue).frame(0.4)
    assert np.array_equal(frame, clmorph.morph(*pictures, n_frames=3, backend=device).frame(0.4))


@pytest.fixture
def parts(device):
    """Two sub-devices, or one."""
    return parts_of(device.device) or pytest.skip("the device has no sub-devices")


def test_sub_devices(clouds, expected, parts):
    part = parts[0]
    operations = clmorph.get_backend(part)
    assert operations.queue.device == operations.device == part
    assert part.max_compute_units == 1
    assert operations is clmorph.get_backend(part)
    assert np.allclose(solved(clouds, part).f, expected.f, rtol=0, atol=1e-6)


def test_the_operations_of_a_sub_device_end_with_it(device, context):
    (part, *_) = parts_of(device.device) or pytest.skip("the device has no sub-devices")
    made = weakref.ref(clmorph.get_backend(part))
    assert made() is clmorph.get_backend(part)
    del part
    gc.collect()
    clmorph.get_backend(cl.CommandQueue(context))  # abandoned operations go at the next call
    gc.collect()
    assert made() is None


def test_a_context_of_several_devices(clouds, expected, parts):
    if len(parts) < 2:
        pytest.skip("the device has one part only")
    context = cl.Context(parts)
    if len(context.devices) == 2:  # PoCL reports the device that both are parts of
        with pytest.raises(InputError, match=r"Context of 2 devices[^\n]*CommandQueue"):
            clmorph.get_backend(context)
    for part in parts:
        queue = cl.CommandQueue(context, part)
        operations = clmorph.get_backend(queue)
        assert operations.queue.device == operations.device == part
        assert np.allclose(solved(clouds, queue).f, expected.f, rtol=0, atol=1e-6)


def test_operations_end_with_the_object_that_they_were_made_for(clouds, device):
    context = cl.Context([device.device])
    queue = cl.CommandQueue(context)
    solved(clouds, queue)
    ends = [weakref.ref(clmorph.get_backend(given)) for given in (context, queue)]
    gc.collect()
    assert all(end() is not None for end in ends)
    del queue
    other = cl.CommandQueue(context)
    clmorph.get_backend(other)  # where queues cannot be weakly referenced they end here
    gc.collect()
    assert ends[1]() is None
    assert ends[0]() is not None
    del context
    gc.collect()
    assert ends[0]() is None


def test_a_morph_keeps_its_operations(context):
    queue = cl.CommandQueue(context)
    pictures = np.random.default_rng(0).random((2, 6, 6, 3))
    morph = clmorph.morph(*pictures, n_frames=3, backend=queue)
    twin = cl.CommandQueue.from_int_ptr(queue.int_ptr, retain=True)
    del queue
    gc.collect()
    assert clmorph.get_backend(twin) is morph.operations
    assert morph.frame(0.5).shape == (6, 6, 3)
    assert "device" in morph.parameters
    assert isinstance(morph.parameters["device"], str)


def test_threads_get_the_same_operations(queue):
    with ThreadPoolExecutor(8) as threads:
        assert len(set(map(id, threads.map(clmorph.get_backend, [queue] * 8)))) == 1


def test_other_objects_of_pyopencl_are_no_backends(queue, context):
    array = cl_array.zeros(queue, 3, np.float32)
    for wrong in (array, array.data, queue.device.platform, cl.Context, cl.CommandQueue):
        with pytest.raises(InputError, match=r"^backend=[^\n]*expected[^\n]*$"):
            clmorph.get_backend(wrong)


def test_an_unusable_device_is_refused_with_the_reason(queue, monkeypatch):
    def wrong(index):
        return replace(tried(index), usable=False, reason="wrong splat")

    monkeypatch.setattr(host_program, "tried", wrong)
    for given in (queue, queue.context, queue.device):
        with pytest.raises(clmorph.DeviceError, match="wrong splat"):
            clmorph.get_backend(given)


def test_pyopencl_is_imported_for_its_own_objects_alone():
    code = (
        "import sys, clmorph, numpy as np\n"
        "class Array:\n"
        "    __array_interface__ = np.ones(3).__array_interface__\n"
        "clmorph.sinkhorn((np.full(3, 1 / 3), Array()), (np.full(3, 1 / 3), [0, 1, 2]),\n"
        "    blur=.1, backend='numpy')\n"
        "assert 'pyopencl' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


# --- arrays of the device as input -------------------------------------------------------------


def test_device_arrays_stand_for_host_arrays(clouds, expected, queue, any_backend):
    given = [on_device(queue, cloud) for cloud in clouds]
    before = [[each.get() for each in cloud] for cloud in given]
    assert np.array_equal(solved(given, queue).f, expected.f)
    measures = [clmorph.WeightedPoints(points, weights) for weights, points in given]
    assert np.array_equal(solved(measures, queue).f, expected.f)
    assert "mass 1" in repr(measures[0])
    # On another device, or in NumPy, they are read just so.
    assert np.array_equal(solved(given, any_backend).f, solved(clouds, any_backend).f)
    value = clmorph.sinkhorn_divergence(*given, blur=0.1, backend=queue)
    same = clmorph.sinkhorn_divergence(*clouds, blur=0.1, backend=queue)
    assert value.value == same.value
    for cloud, copies in zip(given, before, strict=True):
        for array, copy in zip(cloud, copies, strict=True):
            assert np.array_equal(array.get(), copy)
            assert unmapped(array.base_data)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.bool_, np.float32, np.float64])
def test_images(queue, device, rng, dtype):
    pictures = rng.random((2, 7, 6, 3))
    if np.issubdtype(dtype, np.floating):
        pictures = pictures.astype(dtype)
    else:
        pictures = (pictures * (2 if dtype is np.bool_ else 255)).astype(dtype)
    given = [cl_array.to_device(queue, each) for each in pictures]
    found = clmorph.morph(*given, n_frames=3, backend=queue)
    expected = clmorph.morph(*pictures, n_frames=3, backend=device)
    assert np.array_equal(found.potentials.f, expected.potentials.f)
    assert np.array_equal(found.plan.mass, expected.plan.mass)
    assert np.array_equal(found.frame(0.5), expected.frame(0.5))
    weights = cl_array.to_device(queue, np.ones((7, 6), np.float32))
    assert np.array_equal(clmorph.lift(given[0], weights=weights).weights, np.ones(42))
    assert np.array_equal(clmorph.fit(given[0], 4), clmorph.fit(pictures[0], 4))


VIEWS = {
    "whole": lambda a: a,
    "rows": lambda a: a[2:7],
    "steps": lambda a: a[1::3, ::2],
    "backwards": lambda a: a[::-1, ::-2],
    "transposed": lambda a: a.T,
    "one": lambda a: a[3:4, 2:3],
    "column": lambda a: a[:, 1],
    "scalar": lambda a: a[3, 2],
    "nothing": lambda a: a[:0],
}


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "u1", "i8", "?"])
@pytest.mark.parametrize("view", VIEWS)
def test_layouts(queue, rng, dtype, view):
    values = (100 * rng.random((9, 5))).astype(dtype)
    for order in "CF":
        ordered = np.asarray(values, order=order)
        whole = cl_array.to_device(queue, ordered)
        given, expected = VIEWS[view](whole), VIEWS[view](ordered)
        found = as_array("points", given)
        assert found.dtype == expected.dtype
        assert np.array_equal(found, expected)
        assert not found.flags.writeable or not found.size
        assert np.array_equal(as_floats("points", given), expected.astype(float))


def test_a_part_of_a_buffer(queue, device, rng):
    values = rng.random(256).astype(np.float32)
    whole = cl_array.to_device(queue, values)
    align = device.device.mem_base_addr_align // 8
    part = whole.data.get_sub_region(align, values.nbytes - align)
    given = cl_array.Array(queue, (32,), np.float32, data=part, offset=16)
    first = align // 4 + 4
    assert np.array_equal(as_array("points", given), values[first : first + 32])


def test_a_list_of_device_arrays(queue, rng):
    values = rng.random((4, 3))
    given = [cl_array.to_device(queue, each) for each in values]
    assert np.array_equal(as_array("points", given), values)
    assert np.array_equal(as_array("points", tuple(given)), values)


def test_wrong_shapes_are_reported_as_those_of_numpy(queue):
    for values in (np.zeros(()), np.zeros((2, 2, 2)), np.full((3, 2), np.nan)):
        told = []
        for points in (values, cl_array.to_device(queue, values)):
            with pytest.raises(InputError) as error:
                solved([(np.ones(3), points)] * 2, "numpy")
            told.append(str(error.value))
        assert told[0] == told[1]
    complex_numbers = cl_array.to_device(queue, np.zeros(3, np.complex64))
    with pytest.raises(InputError, match="dtype complex64"):
        as_array("points", complex_numbers)


def test_memory_that_the_host_shares_is_read_in_place(context, queue, device):
    if not device.shares_host_memory:
        pytest.skip("the device has memory of its own")
    place = np.zeros(4096 + 64, np.uint8)
    place = place[-place.ctypes.data % 64 :][:4096].view(np.float32)
    place[:] = np.arange(1024)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
    buffer = cl.Buffer(context, flags, hostbuf=place)
    given = cl_array.Array(queue, place.shape, place.dtype, data=buffer)
    with TransferCount() as count:
        found = as_array("points", given)
        assert found.ctypes.data == place.ctypes.data
        assert np.array_equal(found, np.arange(1024))
        part = found[3:5]
        del found
        assert part.tolist() == [3, 4]
    assert count.of([given]) == {"map": 1}
    assert n_maps(buffer) in (1, None)
    del part
    assert unmapped(buffer)


# --- events -------------------------------------------------------------------------------------

FILL = """
kernel void fill(global const float *from, global float *to)
{
    to[get_global_id(0)] = from[get_global_id(0)];
}
"""


class Late:
    """An array that a kernel of the program fills when an event of the program lets it start."""

    def __init__(self, context, queue, values, writes_on=None, keeps_event=False):
        program = example.built(context, FILL)
        self.array = cl_array.zeros(queue, values.shape, np.float32)
        source = cl_array.to_device(queue, values.astype(np.float32))
        queue.finish()
        self.gate = cl.UserEvent(context)
        self.kernel = cl.Kernel(program, "fill")
        on = writes_on or queue
        done = self.kernel(
            on, (values.size,), None, source.data, self.array.data, wait_for=[self.gate]
        )
        if keeps_event:
            self.array.add_event(done)
        on.flush()
        self.source = source

    def open_soon(self):
        timer = threading.Timer(0.3, self.gate.set_status, [cl.command_execution_status.COMPLETE])
        timer.start()
        return timer


@pytest.mark.parametrize(
    "case", ["same queue", "another queue", "out of order", "event of another queue"]
)
def test_pending_kernels_are_waited_for(context, device, rng, case):
    wanted = properties(device, OUT_OF_ORDER) if case == "out of order" else 0
    queue, other = cl.CommandQueue(context, properties=wanted), cl.CommandQueue(context)
    values = rng.random((N, 2)).astype(np.float32)
    foreign = case == "event of another queue"
    late = Late(context, queue, values, other if foreign else None, keeps_event=foreign)
    timer = late.open_soon()
    weights = np.full(N, 1 / N)
    backend = other if case == "another queue" else queue
    found = solved([(weights, late.array), (weights, values)], backend)
    timer.join()
    assert np.array_equal(found.f, solved([(weights, values)] * 2, device).f)


def test_results_are_ordered_on_their_queue(queue, clouds, expected):
    program = example.built(queue.context, FILL)
    copy = cl_array.zeros(queue, N, np.float32)
    f = expected.to_device(queue, np.float32).f
    cl.Kernel(program, "fill")(queue, (N,), None, f.data, copy.data)
    assert np.array_equal(copy.get(), expected.f.astype(np.float32))
    assert len(f.events) == 1


def test_a_failed_event_is_reported(context, queue):
    late = Late(context, queue, np.zeros(4), keeps_event=True)
    late.gate.set_status(-5)
    with pytest.raises(clmorph.ClmorphError, match=r"^points cannot be mapped[^\n]*$"):
        as_array("points", late.array)


def test_arrays_that_cannot_be_read(context, queue, device):
    array = cl_array.zeros(queue, 3, np.float32)
    with pytest.raises(InputError, match=r"^points is of [^\n]*Buffer[^\n]*Array[^\n]*$"):
        as_array("points", array.data)
    with pytest.raises(InputError, match=r"^points has no queue[^\n]*with_queue[^\n]*$"):
        as_array("points", array.with_queue(None))
    elsewhere = cl.Context([device.device])
    foreign = cl_array.Array(queue, 3, np.float32, data=array.data)
    foreign.queue = cl.CommandQueue(elsewhere)
    with pytest.raises(InputError, match=r"^points cannot be mapped[^\n]*same context$"):
        as_array("points", foreign)
    gone = cl_array.zeros(queue, 3, np.float32)
    gone.base_data = None
    with pytest.raises(InputError, match=r"^points is not in a buffer[^\n]*$"):
        as_array("points", gone)


# --- other arrays ------------------------------------------------------------------------------


def only_interface(values):
    """An array of another library, which has nothing but NumPy's interface."""
    return SimpleNamespace(values=values, __array_interface__=values.__array_interface__)


@pytest.mark.parametrize("wrapped", [OnlyDLPack, only_interface])
@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "u1", "?"])
def test_protocols(rng, wrapped, dtype):
    values = (2 * rng.random((6, 4))).astype(dtype)
    for each in (values, values[::2, 1:], values.T):
        found = as_array("points", wrapped(each))
        assert found.dtype == each.dtype
        assert np.array_equal(found, each)
        assert np.shares_memory(found, values)


def test_protocols_are_taken_where_arrays_are(clouds, rng):
    expected = solved(clouds, "numpy")
    picture = rng.random((5, 4, 3))
    for wrapped in (OnlyDLPack, only_interface):
        given = [tuple(map(wrapped, cloud)) for cloud in clouds]
        assert np.array_equal(solved(given, "numpy").f, expected.f)
        assert np.array_equal(clmorph.fit(wrapped(picture), 3), clmorph.fit(picture, 3))


@pytest.mark.parametrize(("library", "made"), [("torch", "from_numpy"), ("jax.numpy", "asarray")])
def test_arrays_of_other_libraries(clouds, library, made):
    make = getattr(pytest.importorskip(library), made)
    rounded = [tuple(each.astype(np.float32) for each in cloud) for cloud in clouds]
    given = [tuple(map(make, cloud)) for cloud in rounded]
    assert np.array_equal(solved(given, "numpy").f, solved(rounded, "numpy").f)


def test_dlpack_that_cannot_be_read_is_refused():
    for kind in (2, 4, 8, 10):
        with pytest.raises(InputError, match=rf"^points is in [^\n]*type {kind} [^\n]*host[^\n]*$"):
            as_array("points", OnlyDLPack(np.zeros(3), kind))

    class Broken(OnlyDLPack):
        def __dlpack__(self, **options):
            raise BufferError("it is gone")

    class Odd(OnlyDLPack):
        def __dlpack_device__(self):
            return None

    with pytest.raises(InputError, match=r"points cannot be read through DLPack \(it is gone\)"):
        as_array("points", Broken(np.zeros(3)))
    with pytest.raises(InputError, match="points cannot be read through DLPack"):
        as_array("points", Odd(np.zeros(3)))
    with pytest.raises(InputError, match="dtype complex128"):
        as_array("points", OnlyDLPack(np.zeros(3, complex)))


# --- results on the device ------------------------------------------------------------------------


def test_potentials_and_plans(clouds, expected, queue, device):
    plan = clmorph.transport_plan(*clouds, expected, backend=device)
    for dtype in (None, np.float32, "float64"):
        if dtype == "float64" and not device.has_float64:
            with pytest.raises(InputError, match="no double precision"):
                expected.to_device(queue, dtype)
            continue
        real = np.dtype(dtype or (np.float64 if device.has_float64 else np.float32))
        potentials, pairs = expected.to_device(queue, dtype), plan.to_device(queue, dtype)
        for found, wanted in zip(
            (*potentials, *pairs),
            (expected.f, expected.g, plan.indptr, plan.indices, plan.mass),
            strict=True,
        ):
            assert found.queue == queue
            assert found.context == queue.context
            assert found.dtype == (real if wanted.dtype.kind == "f" else wanted.dtype)
            assert np.array_equal(found.get(), wanted.astype(found.dtype))
            assert unmapped(found.data)
    assert expected.to_device(clmorph.get_backend(queue)).f.queue == queue


def test_a_plan_without_pairs(queue):
    nothing = np.zeros(0)
    plan = clmorph.Plan(
        np.zeros(3, np.int64), nothing.astype(np.int32), nothing, (2, 2), np.ones(2), np.ones(2)
    )
    indptr, indices, mass = plan.to_device(queue)
    assert indptr.get().tolist() == [0, 0, 0]
    assert indices.shape == mass.shape == (0,)


@pytest.mark.parametrize("channels", [3, 4])
def test_frames(queue, rng, channels):
    pictures = rng.random((2, 6, 8, channels))
    morph = clmorph.morph(*pictures, n_frames=3, backend=queue)
    for t in (0.0, 0.3, 1.0):
        with TransferCount() as count:
            found = morph.device_frame(t)
        assert found.queue == queue
        assert found.shape == (6, 8, channels)
        assert found.dtype == np.float32
        assert not sum(count.of([found])[kind] for kind in COPIES)
        assert np.array_equal(found.get(), morph.frame(t))
    other = cl.CommandQueue(queue.context)
    assert morph.device_frame(0.5, other).queue == other
    numpy = clmorph.morph(*pictures, n_frames=3, backend="numpy")
    assert np.array_equal(numpy.device_frame(0.5, queue).get(), numpy.frame(0.5))


def test_wrong_queues_and_dtypes(queue, expected, clouds):
    for wrong in ("auto", queue.context, queue.device, None, clmorph.get_backend("numpy")):
        with pytest.raises(InputError, match=r"^queue=[^\n]*CommandQueue[^\n]*$"):
            expected.to_device(wrong)
    for wrong in ("float16", int, "numbers", 3):
        with pytest.raises(InputError, match=r"^dtype=[^\n]*float32[^\n]*$"):
            expected.to_device(queue, wrong)


# --- the example --------------------------------------------------------------------------------


def test_the_example_copies_none_of_its_arrays(device, capsys):
    index = next(each.index for each in USABLE if each.handle == device.device)
    assert example.main([index]) == 0
    told = capsys.readouterr().out
    assert "read 0, write 0, copy 0, fill 0, migrate 0; mapped 20 times" in told


@pytest.mark.full
def test_the_driver_sees_no_other_transfers(device, tmp_path):
    """PoCL's own log holds the commands that the example has counted, and no more."""
    if "Portable" not in device.device.platform.name:
        pytest.skip("only PoCL writes such a log")
    log = tmp_path / "log"
    index = next(each.index for each in USABLE if each.handle == device.device)
    logged = {"POCL_TRACING": "text", "POCL_TRACING_OPT": str(log)}
    # The first run verifies programs in processes that would write into the same log.
    for environment in ({}, logged):
        done = subprocess.run(
            [sys.executable, example.__file__, index], capture_output=True, text=True, check=True,
            env=os.environ | environment, timeout=300,
        )  # fmt: skip
    if not log.exists():
        pytest.skip("this PoCL is built without its log")
    seen = Counter(re.findall(r"\| (\w+) \| complete \|", log.read_text()))
    reads, writes = (
        int(re.search(rf"own state: .*{kind} (\d+)", done.stdout)[1]) for kind in ("read", "write")
    )
    assert reads > 10
    assert seen["read_buffer"] == reads
    # Of those that are counted, most are buffers that are made with their content.
    assert seen["write_buffer"] <= writes
    assert seen["map_buffer"] == 20
    copies = {"copy_buffer", "fill_buffer", "read_buffer_rect"}
    assert not copies & set(seen), seen


def test_the_example_computes_what_the_host_would(queue):
    program = example.HostProgram(queue)
    morph, plan = program.morph_pictures(3), program.transport_clouds()
    arrays = {name: array.get() for name, array in program.arrays.items()}
    frames = [morph.frame(float(t)) for t in morph.times]
    assert arrays["picture 0"].max() == np.float32(0.9)
    assert not np.array_equal(arrays["picture 0"], arrays["picture 1"])
    assert np.array_equal(arrays["exposure"], np.maximum.reduce([arrays["picture 0"], *frames]))
    forth, _ = plan.mean_destinations(arrays["points 0"], arrays["points 1"])
    assert np.allclose(arrays["moved"], forth, rtol=0, atol=1e-5)
    assert np.ptp(arrays["moved"], axis=0).min() > 0.1
