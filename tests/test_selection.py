"""What is tested without ``--full``: each value of each parameter, on each device."""

from types import SimpleNamespace

import pytest
from conftest import OF_DEVICES, _share


def items(**parameters):
    """Return stand-ins of a grid's items: all combinations of the values of each parameter."""
    grids = [{}]
    for name, values in parameters.items():
        grids = [{**grid, name: value} for grid in grids for value in values]
    return [SimpleNamespace(callspec=SimpleNamespace(params=grid)) for grid in grids]


@pytest.mark.parametrize("name", OF_DEVICES)
def test_each_value_is_tested_on_each_device(name):
    axes = {"a": "xyz", "b": [1.0, 2.0], "c": [None, True, False, 4, 5]}
    chosen = [item.callspec.params for item in _share(items(**{name: "PQR"}, **axes))]
    for device in "PQR":
        own = [params for params in chosen if params[name] == device]
        assert len(own) == 5
        for axis, values in axes.items():
            assert {params[axis] for params in own} == set(values)


def test_parameters_that_are_set_together_stay_together():
    grid = items(device="PQ", pair=[("x", 1), ("x", 2), ("y", 1)])
    for item in grid:
        params = item.callspec.params
        params["one"], params["other"] = params.pop("pair")
    assert _share(grid) == grid


def test_tests_without_a_grid_stay():
    alone = [SimpleNamespace()]
    assert _share(alone) == alone
    row = items(device="P", a=range(7))
    assert _share(row) == row
