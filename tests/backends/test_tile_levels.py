"""Levels between tiles are formed on the device where it has float64."""

import numpy as np
import pytest

import clmorph
from clmorph.backends import records
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.kernels import row_loop
from clmorph.backends.opencl.kernels.launches import LaunchBudget


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize("operation", ["softmin", "precise", "bounded", "maxima", "moments"])
def test_levels_of_the_device_are_the_hosts(device, rng, monkeypatch, operation, listed):
    """In several launches, with points far apart, and tiles without mass; a list comes up once."""
    if not device.has_float64:
        pytest.skip("its levels are the host's")
    n, epsilon = 900, 1e-2
    weights = rng.random(n)
    weights[: 2 * device.constants.tile] = 0
    rows = device.upload(3 * np.sort(rng.random((n, 4)), axis=0), np.full(n, 1 / n))
    columns = device.upload(3 * np.sort(rng.random((n, 4)), axis=0), weights, rng.random(n))
    g = rng.normal(size=n)
    softmin = device.softmin(rows, columns, g, epsilon)

    def run():
        near = device.near_pairs(rows, columns, g, softmin, epsilon, 1e-4) if listed else None
        given = rows, columns, g, epsilon
        found = {
            "softmin": lambda: device.softmin(*given, False, near),
            "precise": lambda: device.softmin(*given, True, near),
            "bounded": lambda: device.bounded_softmin(*given, near, 1e-4)[0],
            "maxima": lambda: device.row_maxima(*given, near),
            "moments": lambda: np.hstack(
                [
                    x.reshape(n, -1)
                    for x in device.plan_moments(*given[:3], softmin, epsilon, near=near)
                ]
            ),
        }[operation]()
        return near, found

    wanted, on_host = run()
    work, uploaded = device.row_loop.work, []
    upload = work.buffer
    monkeypatch.setattr(work, "buffer", lambda *all: uploaded.append(all[0]) or upload(*all))
    monkeypatch.setattr(device.row_loop, "device_levels", 0)
    if not listed and operation != "moments":
        monkeypatch.setattr(row_loop, "_levels", None)  # the host forms none
    each = columns.stride * device.constants.tile
    monkeypatch.setattr(LaunchBudget, "pairs", lambda budget: each)
    near, found = run()
    assert np.abs(found - on_host).max() <= 1e-6 * epsilon
    if listed:
        assert sum(values is near.pairs.tiles for values in uploaded) == 1
        assert np.array_equal(near.pairs.starts, wanted.pairs.starts)
        assert np.array_equal(near.pairs.tiles, wanted.pairs.tiles)


def test_few_levels_are_the_hosts(device, rng, monkeypatch):
    """A launch takes longer than so few."""
    cloud = device.upload(rng.random((300, 3)), np.full(300, 1 / 300))
    monkeypatch.setattr(device.row_loop, "_levels_on_device", None)
    device.softmin(cloud, cloud, np.zeros(300), 0.1)
    if not device.has_float64:
        monkeypatch.setattr(device.row_loop, "device_levels", 0)
        device.softmin(cloud, cloud, np.zeros(300), 0.1)


def test_levels_are_the_hosts_where_their_program_cannot_be_built(device, rng, monkeypatch):
    """This is told once, and costs nothing else."""
    if not device.has_float64:
        pytest.skip("its levels are the host's")
    cloud, zeros = device.upload(rng.random((300, 3)), np.full(300, 1 / 300)), np.zeros(300)
    wanted = device.softmin(cloud, cloud, zeros, 0.1)
    build = program.build

    def refuse(context, name, *more):
        if name == "tile_levels.cl":
            raise records.ProgramError("refused")
        return build(context, name, *more)

    monkeypatch.setattr(program, "build", refuse)
    monkeypatch.setattr(records, "_told", set())
    monkeypatch.setattr(device.row_loop, "_kernels", {})
    monkeypatch.setattr(device.row_loop, "device_levels", 0)
    with pytest.warns(clmorph.ClmorphWarning, match="on the host.*: refused") as told:
        found = [device.softmin(cloud, cloud, zeros, 0.1) for _ in range(2)]
    assert len(told) == 1
    assert all(np.array_equal(each, wanted) for each in found)
