"""Near pairs: which columns are chosen, and that the bound of all others holds."""

import numpy as np
import pytest

import clmorph
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl import probe
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices import verdicts
from clmorph.backends.opencl.devices.verdicts import Verdict


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
        near = backend.near_pairs(*own, g, want, epsilon, 1e-6)
        off = (near.softmin - want) / epsilon
        assert off.min() >= -2e-5
        assert np.all(off <= np.log1p(near.skipped) + 2e-5)
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
