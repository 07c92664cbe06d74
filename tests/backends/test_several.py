"""Several devices as one backend: each operation, and how they are named.

The operations' own tests run here too, on two parts of a device: the fixture `variant` of
this module takes the place of the one in ``conftest.py``.
"""

import gc
import inspect
import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
from clouds import PAIRS
from several import KINDS, two_parts
from test_operations import (  # noqa: F401 (collected from here)
    test_a_hopeless_guess_is_told,
    test_barycentric_projection,
    test_bounded_softmin_in_any_dimension_and_over_near_pairs,
    test_bounded_softmin_is_as_near_as_it_says,
    test_deposit,
    test_draws_are_unbiased,
    test_launches_are_cut_without_changing_a_bit,
    test_moments_and_draws_over_near_pairs,
    test_near_pairs,
    test_near_pairs_leave_out_most_of_far_clusters,
    test_offsets_add_to_the_cost,
    test_plan_moments,
    test_plan_rows,
    test_plan_rows_by_lists_are_the_same,
    test_plan_rows_keeps_everything_or_nothing,
    test_sample_plan_rows,
    test_softmin_and_row_maxima,
    test_softmin_in_other_dimensions,
    test_softmin_of_one_pair_is_its_cost,
    test_softmin_survives_huge_potentials,
    test_stored_sums_are_those_of_changed_potentials,
    test_sums_over_stored_pairs,
)

import clmorph
from clmorph import DeviceError, InputError
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices import cache, speed
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.opencl.kernels.tiles import tile_order
from clmorph.backends.several import SeveralDevices, frame_turns, members_of, sharing_note
from clmorph.backends.several.clouds import UNIT, divide_rows
from clmorph.backends.several.shares import recorded_shares
from clmorph.backends.verification.clouds import log_sum_exp_tolerance
from clmorph.cli.conformance import check

# How rows are divided does not depend on the device.
pytestmark = pytest.mark.one_device


@pytest.fixture(scope="session")
def variant(request):
    """Two parts of a device."""
    return SeveralDevices(two_parts(request.param[0].handle))


def test_several_devices_have_the_protocols_signatures():
    several = SeveralDevices([NumPyOperations(), NumPyOperations()])
    names = [name for name in vars(Operations) if not name.startswith("_")]
    operations = [name for name in names if callable(getattr(Operations, name, None))]
    assert len(operations) > 15
    for name in operations:
        wanted = list(inspect.signature(getattr(Operations, name)).parameters)[1:]
        assert list(inspect.signature(getattr(several, name)).parameters) == wanted, name


@pytest.mark.parametrize(
    "kind",
    ["halves", *(pytest.param(name, marks=pytest.mark.full) for name in KINDS if name != "halves")],
)
def test_all_operations_pass_the_check(device, kind):
    findings = list(check(KINDS[kind](device)))
    assert len(findings) > 30
    assert [str(finding) for finding in findings if not finding.passed] == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", PAIRS)
def test_several_devices_give_what_one_gives(device, rng, kind, name):
    """Over all pairs to rounding; of a plan, but for pairs on the threshold."""
    pair, epsilon = PAIRS[name](rng), 0.01
    g = 0.1 * rng.random(len(pair[1][0]))
    tolerance = 2 * log_sum_exp_tolerance(device, *pair, epsilon)
    results = []
    for operations in (device, KINDS[kind](device)):
        rows, columns = (operations.upload(*cloud) for cloud in pair)
        softmin = operations.softmin(rows, columns, g, epsilon)
        bounded, error = operations.bounded_softmin(rows, columns, g, epsilon)
        maxima = operations.row_maxima(rows, columns, g, epsilon)
        thresholds = np.full(len(softmin), -12.0), np.full(len(g), np.inf)
        counts = operations.count_plan_rows(rows, columns, softmin, g, epsilon, *thresholds)
        kept = operations.plan_rows(rows, columns, softmin, g, epsilon, *thresholds)
        assert np.array_equal(np.diff(kept.indptr), counts)
        assert all(np.all(np.diff(row) > 0) for row in np.split(kept.indices, kept.indptr[1:-1]))
        results.append((softmin, bounded, error, maxima, kept))
    one, several = results
    assert np.abs(one[0] - several[0]).max() / epsilon <= tolerance
    assert np.abs(one[1] - several[1]).max() / epsilon <= one[2] + several[2]
    assert np.abs(one[3] - several[3]).max() <= tolerance
    plans = [
        {
            (i, j): mass
            for i in range(len(softmin))
            for j, mass in zip(
                kept.indices[kept.indptr[i] : kept.indptr[i + 1]],
                kept.mass[kept.indptr[i] : kept.indptr[i + 1]],
                strict=True,
            )
        }
        for softmin, *_, kept in results
    ]
    for own, other in (plans, plans[::-1]):
        for place, mass in own.items():
            assert abs(np.log(other.get(place, np.exp(-12.0)) / mass)) <= 2 * tolerance


@pytest.mark.parametrize("kind", KINDS)
def test_results_repeat_to_the_bit(device, rng, kind):
    points, weights = rng.random((700, 5)), np.full(700, 1 / 700)
    g = 0.01 * rng.random(700)
    found = []
    for _ in range(2):
        operations = KINDS[kind](device)
        cloud = operations.upload(points, weights)
        softmin = operations.softmin(cloud, cloud, g, 0.01)
        near = operations.near_pairs(cloud, cloud, g, softmin, 0.01, 1e-4)
        thresholds = np.full(700, -15.0), np.full(700, -15.0)
        stored = operations.store_pairs(
            cloud, cloud, softmin, g, 0.01, *thresholds, 10**6, (near, near)
        )
        found.append(
            [
                softmin, near.softmin, near.skipped,
                operations.sum_stored(stored, g, False), operations.sum_stored(stored, g, True),
                operations.sum_stored(stored, g[stored.orders[1]], False, ordered=True),
                *operations.barycentric_projection(cloud, cloud, g, 0.01, True, near),
                *operations.plan_moments(cloud, cloud, g, softmin, 0.01, True, near),
            ]
        )  # fmt: skip
    assert all(one.tobytes() == other.tobytes() for one, other in zip(*found, strict=True))
    assert np.array_equal(found[0][5], found[0][3][stored.orders[0]])


def _tile_volume(points):
    """Return the mean volume of the boxes around tiles, each relative to its number of points."""
    tiles = np.array_split(points[tile_order(points, UNIT)], -(-len(points) // UNIT))
    return np.mean([np.ptp(tile, axis=0).prod() / len(tile) for tile in tiles])


@pytest.mark.parametrize("shares", [[0.5, 0.5], [0.99, 0.01], [0.2, 0.3, 0.5], [1 / 3] * 3])
@pytest.mark.parametrize("count", [1, 63, 64, 65, 200, 6400, 10_000])
def test_each_row_is_on_one_device(rng, shares, count):
    points = rng.random((count, 3))
    divided = divide_rows(points, shares)
    assert np.array_equal(np.sort(np.concatenate([rows for _, rows in divided])), np.arange(count))
    numbers = [member for member, _ in divided]
    assert numbers == sorted(set(numbers))
    for member, rows in divided:
        assert abs(len(rows) - count * shares[member]) <= UNIT
        if count == 10_000 and min(shares) > 0.1:
            # Tiles of random points would be 5.6 times as large as those of all points.
            assert _tile_volume(points[rows]) < 3 * _tile_volume(points)


def test_a_part_may_have_no_mass(device, rng):
    """The devices' rows are compact, so all masses of one may be 0."""
    points = np.concatenate((rng.random((128, 2)), 50.0 + rng.random((128, 2))))
    weights = np.repeat([1 / 128, 0.0], 128)
    for kind in ("halves", "with NumPy"):
        operations = SeveralDevices(KINDS[kind](device).members)
        cloud = operations.upload(points, weights)
        assert {weights[part.rows].sum() for part in cloud.parts} == {0.0, 1.0}
        exact = NumPyOperations()
        whole = exact.upload(points, weights)
        f = exact.softmin(whole, whole, np.zeros(256), 1.0)
        got = operations.softmin(cloud, cloud, np.zeros(256), 1.0)
        assert got == pytest.approx(f, abs=1e-3)
        near = operations.near_pairs(cloud, cloud, np.zeros(256), f, 1.0, 1e-3)
        assert near.softmin == pytest.approx(f, abs=5e-3)
        thresholds = np.where(weights > 0, -20.0, np.inf), np.where(weights > 0, -20.0, np.inf)
        arguments = f, np.zeros(256), 1.0, *thresholds
        stored = operations.store_pairs(cloud, cloud, *arguments, 10**6)
        want = exact.store_pairs(whole, whole, *arguments, 10**6)
        assert stored.n_pairs == want.n_pairs
        for by_column in (False, True):
            sums = operations.sum_stored(stored, np.zeros(256), by_column)
            wanted = exact.sum_stored(want, np.zeros(256), by_column)
            assert np.array_equal(np.isneginf(sums), weights == 0)
            assert sums[:128] == pytest.approx(wanted[:128], abs=1e-4)


def test_limits_are_the_narrowest():
    class Small(NumPyOperations):
        sum_roundoff, has_float64, memory_bytes = 2.0**-24, False, 1000
        shares_host_memory = on_processor = False
        pairs_per_second = 5.0

    class Host(Small):
        memory_bytes, shares_host_memory = 1500, True

    several = SeveralDevices([NumPyOperations(), Small()])
    assert (several.sum_roundoff, several.has_float64) == (2.0**-24, False)
    assert (several.memory_bytes, several.shares_host_memory) == (1000, True)
    assert not several.on_processor
    # Both are in the host's memory.
    assert SeveralDevices([NumPyOperations(), Host(), Small()]).memory_bytes == 750
    assert SeveralDevices([NumPyOperations(), NumPyOperations()]).memory_bytes is None
    names = [name for name in Operations.__annotations__ if not name.startswith("_")]
    assert len(names) > 8
    for operations in (several, NumPyOperations()):
        assert [name for name in names if not hasattr(operations, name)] == []


def test_bounds_are_the_largest(rng):
    class Bounded(NumPyOperations):
        def __init__(self, number):
            self.number = number

        def bounded_softmin(self, *arguments):
            return super().bounded_softmin(*arguments)[0], float(self.number)

        def near_pairs(self, *arguments):
            near = super().near_pairs(*arguments)
            return near._replace(n_pairs=self.number, n_columns=self.number, largest=self.number)

    points, weights, g = rng.random((400, 2)), np.full(400, 1 / 400), np.zeros(400)
    for numbers in ((3, 5), (5, 3)):
        several = SeveralDevices([Bounded(number) for number in numbers])
        cloud = several.upload(points, weights)
        softmin, error = several.bounded_softmin(cloud, cloud, g, 0.1)
        assert error == 5.0
        near = several.near_pairs(cloud, cloud, g, softmin, 0.1, 1e-3)
        assert (near.n_pairs, near.n_columns, near.largest) == (8, 5, 5)


def test_nothing_is_stored_if_all_devices_together_keep_too_many(rng):
    """Each of them alone would be within the limit, and fill its memory for nothing."""
    stored = []

    class Storing(NumPyOperations):
        def store_pairs(self, *arguments):
            stored.append(super().store_pairs(*arguments))
            return stored[-1]

    several = SeveralDevices([Storing(), Storing()])
    cloud = several.upload(rng.random((128, 2)), np.full(128, 1 / 128))
    zeros, everything = np.zeros(128), np.full(128, -np.inf)
    for limit, want in ((128**2 - 1, 0), (128**2, 2)):
        found = several.store_pairs(cloud, cloud, zeros, zeros, 0.1, everything, everything, limit)
        assert (found is not None, len(stored)) == (want > 0, want)


@pytest.mark.parametrize(
    "shares", [[1.0], [1.0, 0.0], [1.0, -1.0], [1.0, np.inf], [np.nan, 1.0], ["a", 1.0]]
)
def test_wrong_shares(shares):
    with pytest.raises(InputError, match="expected a number above 0 for each of 2 devices"):
        SeveralDevices([NumPyOperations(), NumPyOperations()], shares)
    with pytest.raises(InputError, match="of 0 devices"):
        SeveralDevices([])


# --- names of devices -----------------------------------------------------------------------


def index_of(device):
    return next(found.index for found in find_devices() if found.handle == device.device)


def test_a_list_of_devices(device, monkeypatch):
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    index = index_of(device)
    several = clmorph.get_backend([index, "numpy"])
    assert [member for member, _ in members_of(several)] == [device, clmorph.get_backend("numpy")]
    assert sum(several.shares) == pytest.approx(1.0)
    assert several.shares[0] > 0.5  # NumPy is slower
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
    index, name = index_of(device), device.device.name.strip()
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
    assert sharing_note(device) is None
    note = sharing_note(SeveralDevices([NumPyOperations(), device]))
    if device.on_processor:
        assert "cannot be faster" in note
    else:
        assert note is None


# --- shares by records ----------------------------------------------------------------------


class Timed(NumPyOperations):
    """A backend whose speed was never recorded; `clock` counts how often it is measured."""

    def __init__(self, key, known=0.0):
        self.record_key, self.pairs_per_second = key, known


@pytest.fixture
def measured(monkeypatch, tmp_path):
    """Backends whose speed is measured, in an empty cache; they get faster each time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = []

    def throughput(operations):
        found.append(operations.record_key)
        return 100.0 * len(found)

    monkeypatch.setattr("clmorph.backends.several.shares.throughput", throughput)
    return found


def test_speeds_are_measured_once(measured):
    members = [Timed("a"), Timed("b"), Timed("c", known=300.0)]
    first = recorded_shares(members)
    assert measured == ["a", "b"]
    assert first == [1 / 6, 2 / 6, 3 / 6]
    assert recorded_shares(members) == first
    assert recorded_shares([Timed("b"), Timed("a")]) == [2 / 3, 1 / 3]
    # What a later probe finds does not change a record.
    assert recorded_shares([*members[:2], Timed("c", known=900.0)]) == first
    assert measured == ["a", "b"]


@pytest.mark.parametrize("value", ['"fast"', "NaN", "-1.0", "0.0", "true", "}", "null"])
def test_a_damaged_record_is_made_again(measured, value):
    recorded_shares([Timed("a"), Timed("b")])
    record = cache.cache_folder() / speed.FOLDER / "a.json"
    record.write_text(f'{{"pairs_per_second": {value}}}')
    assert recorded_shares([Timed("a"), Timed("b")]) == [3 / 5, 2 / 5]
    assert measured == ["a", "b", "a"]


def test_without_a_cache_shares_are_equal(measured, monkeypatch):
    monkeypatch.setattr("clmorph.backends.several.shares.cache_folder", lambda: None)
    monkeypatch.setattr(cache, "cache_folder", lambda: None)
    assert recorded_shares([Timed("a"), Timed("b")]) == [0.5, 0.5]
    assert measured == []


def test_a_cache_that_keeps_nothing_means_equal_shares(measured, monkeypatch):
    monkeypatch.setattr("clmorph.backends.several.shares.save_record", lambda name, record: None)
    assert recorded_shares([Timed("a"), Timed("b"), Timed("c", 7.0)]) == [1 / 3] * 3


def test_parts_of_a_device_have_records_of_their_own(device):
    parts = two_parts(device.device)
    if parts[0].device.max_compute_units == device.device.max_compute_units:
        pytest.skip("this driver has no parts of devices, or the device has one unit")
    assert parts[0].record_key == parts[1].record_key != device.record_key
    assert parts[0].pairs_per_second == 0.0
    assert device.pairs_per_second > 0


def test_tuning_is_the_record(device, monkeypatch, tmp_path):
    from clmorph.backends.opencl.build.tuned_record import forget_tuning, save_tuning

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    save_tuning(device.device, device.constants, device.constants, 3e9)
    other = Timed("b", known=1e9)
    assert recorded_shares([device, other]) == [0.75, 0.25]
    forget_tuning(device.device)
    assert recorded_shares([device, other])[0] != 0.75


@pytest.mark.parametrize("shares", [[1.0], [0.5, 0.5], [0.99, 0.01], [0.2, 0.3, 0.5]])
def test_frames_follow_the_shares(shares):
    turns = frame_turns(shares, 1000)
    for end in range(1, 1001):
        counts = np.bincount(turns[:end], minlength=len(shares))
        assert np.abs(counts - end * np.array(shares)).max() <= len(shares) - 0.5


# --- the end of a process -------------------------------------------------------------------

PREAMBLE = """
import os, threading, time
import numpy as np
import clmorph
from clmorph.backends.several import SeveralDevices
from several import two_parts
from clmorph.backends.opencl.devices.find import raw_devices
handle = dict(raw_devices())[{index!r}]
o = SeveralDevices(two_parts(handle))
c = o.upload(np.random.default_rng(0).random((3000, 5)), np.ones(3000))
"""


def program(device, code):
    helpers = Path(__file__).parents[1] / "helpers"
    return subprocess.run(
        [sys.executable, "-c", PREAMBLE.format(index=index_of(device)) + code],
        env=os.environ | {"PYTHONPATH": f"{helpers}{os.pathsep}{Path.cwd()}"},
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def test_daemon_threads_do_not_abort_the_end_of_several(device):
    done = program(device, """
def work():
    while True: o.softmin(c, c, np.zeros(3000), 0.01)
threading.Thread(target=work, daemon=True).start()
time.sleep(0.3)
""")  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


def test_frames_that_nobody_takes_do_not_keep_a_process(device):
    done = program(device, """
frames = clmorph.morph(*np.random.default_rng(0).random((2, 8, 8, 3)), n_frames=9, backend=o)
frames = frames.iter_frames()
next(frames)
""")  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


def test_ctrl_c_stops_all_devices(device):
    """The second device's thread would work for minutes; it ends within a launch or two."""
    done = program(device, """
import signal
def interrupt():
    time.sleep(0.5)
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
c = o.upload(np.random.default_rng(0).random((400_000, 5)), np.ones(400_000))
threading.Thread(target=interrupt, daemon=True).start()
began = time.perf_counter()
try:
    o.softmin(c, c, np.zeros(400_000), 0.01)
    print("not interrupted")
except KeyboardInterrupt:
    # The locks are free: nothing works on the devices any more.
    print([member.lock.acquire(blocking=False) for member in o.members])
    print(time.perf_counter() - began < 5.0)
""")  # fmt: skip
    assert done.stdout.splitlines() == ["[True, True]", "True"], done.stderr


def test_two_threads_share_several_devices(device, rng):
    several = SeveralDevices(two_parts(device.device))
    clouds = [several.upload(rng.random((300 + 50 * k, 5)), np.ones(300 + 50 * k)) for k in (0, 1)]
    want = [several.softmin(c, c, np.zeros(c.size), 0.01) for c in clouds]
    wrong = []

    def work(number):
        for _ in range(20):
            got = several.softmin(clouds[number], clouds[number], np.zeros_like(want[number]), 0.01)
            wrong.extend([] if np.array_equal(got, want[number]) else [number])

    threads = [threading.Thread(target=work, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
