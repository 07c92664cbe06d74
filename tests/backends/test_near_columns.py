"""Near pairs: which columns are chosen, and that the bound of all others holds."""

import numpy as np
import pytest
from clouds import column_masks

import clmorph
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl import probe
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.devices import verdicts
from clmorph.backends.opencl.devices.verdicts import Verdict

#: The share of a row's sum that may be left out.
BUDGET = 1e-6


def clouds(operations, side, blur, rng):
    """Upload two noisy pictures; return them, random potentials g, T(g) in float64, and epsilon."""
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    pictures = [
        np.clip(np.stack((x, y, shift * x * y), axis=2) + 0.05 * rng.random((side, side, 3)), 0, 1)
        for shift in (0.2, 0.9)
    ]
    pair = [clmorph.lift(picture) for picture in pictures]
    epsilon = blur**2
    g = 0.2 * epsilon * rng.normal(size=side**2)
    exact = NumPyOperations()
    want = exact.softmin(*(exact.upload(m.points, m.weights) for m in pair), g, epsilon)
    return [operations.upload(m.points, m.weights) for m in pair], g, want, epsilon


def missing(got, want, near, epsilon):
    """Return by how many nats soft minima are outside of what near pairs leave out."""
    off = (got - want) / epsilon
    return float(np.max([-off.min(), (off - np.log1p(near.skipped)).max()]))


@pytest.mark.parametrize("blur", [0.2, 0.05, 0.01])
def test_sums_over_near_columns(device, rng, blur):
    """Plain, precise and bounded sums miss no more than the bound says."""
    own, g, want, epsilon = clouds(device, 40, blur, rng)
    near = device.near_pairs(*own, g, want, epsilon, BUDGET)
    assert near.skipped.max() <= 1.5 * BUDGET
    # Float32 rounds exponents of the size C / epsilon; of precise ones only powers are rounded.
    for precise, tolerance in ((False, 2e-7 / epsilon + 1e-5), (True, 2e-6)):
        got = device.softmin(*own, g, epsilon, precise, near)
        assert missing(got, want, near, epsilon) <= tolerance
    for enough in (0.0, 1e-4):
        got, error = device.bounded_softmin(*own, g, epsilon, near, enough)
        assert missing(got, want, near, epsilon) <= min(error, enough + 1e-5) + 1e-9
    if blur < 0.2:
        assert near.n_pairs < 0.6 * len(g) ** 2


@pytest.mark.parametrize("off", [-30.0, -3.0, 3.0, 30.0])
def test_a_bad_guess_costs_pairs_but_not_the_bound(device, rng, off):
    """The bound holds for any estimate of the sums, and a second choice has a better estimate."""
    own, g, want, epsilon = clouds(device, 40, 0.03, rng)
    near = device.near_pairs(*own, g, want + off * epsilon, epsilon, BUDGET)
    assert np.isfinite(near.softmin).all()
    tolerance = 2e-7 / epsilon + 1e-5
    assert missing(near.softmin, want, near, epsilon) <= tolerance
    again = device.near_pairs(*own, g, near.softmin, epsilon, BUDGET)
    assert missing(again.softmin, want, again, epsilon) <= tolerance
    third = device.near_pairs(*own, g, again.softmin, epsilon, BUDGET)
    assert third.skipped.max() <= 2 * BUDGET


def test_tiny_budgets_hold_for_far_moves(device, rng):
    """Shares far below the range of float32 are left out, and a bound of them is known."""
    own, g, want, epsilon = clouds(device, 40, 0.01, rng)
    budget = 1e-60
    near = device.near_pairs(*own, g, want, epsilon, budget)
    assert near.n_pairs < 0.8 * len(g) ** 2
    assert 0 < near.skipped.max() <= 1.5 * budget
    moved = g + 100 * epsilon * rng.uniform(-1, 1, len(g))
    got = device.softmin(*own, moved, epsilon, True, near)
    exact = device.softmin(*own, moved, epsilon, True)
    grown = ((moved - g).max() + (exact - want).max()) / epsilon
    left_out = np.log1p(near.skipped.max() * np.exp(grown))
    assert left_out < 0.1  # so that a wrong pair would be seen
    assert ((got - exact) / epsilon).max() <= left_out + 4e-6


@pytest.mark.full
def test_all_kinds_of_masks_are_met(device, rng):
    """Masks are full (then bits are not looked at), partly filled, or empty; sums are right."""
    own, g, want, epsilon = clouds(device, 96, 0.02, rng)
    near = device.near_pairs(*own, g, want, epsilon, BUDGET)
    tile, masks = device.constants.tile, column_masks(device, near)
    whole = np.uint64((1 << min(tile, 64)) - 1)
    full, empty = (masks == whole).all(axis=2), (masks == 0).all(axis=2)
    assert full.any()
    assert empty.any()
    assert (~full & ~empty).any()
    # No pair of tiles is listed for nothing, and every group of rows has a column.
    assert not empty.all(axis=1).any()
    filled = np.add.reduceat(~empty, near.pairs.starts[:-1], axis=0, dtype=int)
    assert filled.min() >= 1
    got = device.softmin(*own, g, epsilon, False, near)
    assert missing(got, want, near, epsilon) <= 2e-7 / epsilon + 1e-5


def test_maxima_over_near_columns_are_those_of_all(device, rng):
    own, g, want, epsilon = clouds(device, 40, 0.03, rng)
    near = device.near_pairs(*own, g, want, epsilon, BUDGET)
    few = device.row_maxima(*own, g, epsilon, near)
    everything = device.row_maxima(*own, g, epsilon)
    assert np.abs(few - everything).max() <= 2e-7 / epsilon + 1e-5


BOUNDS = {
    "columns": ["!may_be_above(&boxes[block], staged, 64 * w + c)"],
    "boxes": ["!(possible[block] & BOXES_OF(64 * w + c))"],
}
BOUNDS["both"] = BOUNDS["columns"] + BOUNDS["boxes"]


@pytest.mark.full
@pytest.mark.parametrize("bounds", BOUNDS.values(), ids=BOUNDS)
def test_bounds_over_rows_change_no_mask(device, monkeypatch, bounds):
    """Columns that a bound excludes are not notable: without the bound the masks are the same.

    Without both bounds no column is excluded, so that none is which both exclude wrongly.
    """

    def masks(operations):
        own, g, want, epsilon = clouds(operations, 64, 0.02, np.random.default_rng(3))
        return column_masks(operations, operations.near_pairs(*own, g, want, epsilon, BUDGET))

    real, staged = program.source, "if (of_any)"
    assert all(bound in real("near_field.cl") for bound in bounds)
    assert staged in real("near_field.cl")
    monkeypatch.setenv("PYOPENCL_NO_CACHE", "1")
    expected, found = masks(device), []

    def source(name, instead):
        text = real(name).replace(staged, "")  # all tiles are staged
        for bound in bounds:
            text = text.replace(bound, instead)
        return text

    for instead in ("false", "true"):
        with monkeypatch.context() as patch:
            patch.setattr(program, "source", lambda name, to=instead: source(name, to))
            found.append(masks(OpenCLOperations(device.device, device.constants, verify=False)))
    assert np.array_equal(found[0], expected)
    # Where no bound is formed, the text is not compiled.
    assert np.array_equal(found[1], expected) != device.constants.bounds_first


@pytest.mark.parametrize(
    ("seconds", "eighths"),
    [((1, 5, 4), 4), ((1, 5, 9), 8), ((1, 5, 1), 1), ((2, 2, 1), 8), ((1, 3, 4), 7)],
)
def test_tiles_are_whole_where_that_is_faster(monkeypatch, seconds, eighths):
    """From the seconds of an eighth of the columns, of five and of all."""
    taken = dict(zip((1, 5, 8), seconds, strict=True))
    monkeypatch.setattr(probe, "_chosen_seconds", lambda _, points, chosen: taken[chosen])
    assert probe.many_eighths(None, 1e9) == eighths


def test_rates_of_chosen_columns_are_measured(device, monkeypatch):
    """Sums over chosen columns are timed; by the record tiles with few near ones are whole."""
    with monkeypatch.context() as patch:
        sums, right = [], device.softmin
        patch.setattr(device, "softmin", lambda *a: sums.append(right(*a)))
        assert all(probe._chosen_seconds(device, 512, eighths) > 0 for eighths in (1, 8))
    assert np.all(sums[0] > sums[-1])  # the more columns, the less the soft minimum

    def pairs(eighths):
        monkeypatch.setattr(verdicts, "load", lambda _: Verdict(many_eighths=eighths))
        backend = OpenCLOperations(device.device, device.constants, verify=False)
        own, g, want, epsilon = clouds(backend, 24, 0.05, np.random.default_rng(0))
        near = backend.near_pairs(*own, g, want, epsilon, BUDGET)
        assert missing(near.softmin, want, near, epsilon) <= 2e-5
        return near.n_pairs

    chosen = pairs(8)
    assert pairs(1) > 1.1 * chosen


@pytest.mark.parametrize("on_processor", [False, True])
def test_a_cards_first_use_measures_chosen_columns(device, monkeypatch, on_processor):
    def operations(*arguments, **options):
        made = OpenCLOperations(*arguments, **options)
        made.on_processor = on_processor
        return made

    monkeypatch.setattr(probe, "OpenCLOperations", operations)
    monkeypatch.setattr(probe, "raw_devices", lambda: [("0:0", device.device)])
    monkeypatch.setattr(probe, "first_failure", lambda *_: "")
    monkeypatch.setattr(probe, "throughput", lambda *_: 2e9)
    monkeypatch.setattr(probe, "many_eighths", lambda _, rate: 3 if rate == 2e9 else 0)
    assert probe.probe("0:0").many_eighths == (Verdict.many_eighths if on_processor else 3)
