"""No value of any argument of any public function gets past a result or an error of ours."""

import inspect

import api_values
import pytest
from api_values import cases, check, public_functions, single

import clmorph

FUNCTIONS = public_functions()


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working directory with a picture and a morph to read."""
    monkeypatch.chdir(tmp_path)
    api_values.furnish()
    return tmp_path


def test_no_function_and_no_argument_is_forgotten():
    given = cases()
    assert set(FUNCTIONS) == set(given), set(FUNCTIONS) ^ set(given)
    for name, function in FUNCTIONS.items():
        parameters = inspect.signature(function).parameters.values()
        wanted = {each.name for each in parameters if each.kind is not each.VAR_KEYWORD}
        assert set(given[name]) == wanted, name
    for name in clmorph.__all__:
        value = getattr(clmorph, name)
        assert not callable(value) or name in FUNCTIONS or isinstance(value, type)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.parametrize("name", list(FUNCTIONS))
def test_every_value_of_every_argument(name):
    check(name, api_values._call(FUNCTIONS[name], cases()[name], {}))
    messages = [check(description, call) for description, call in single(name, every=8)]
    if set(cases()[name]) - {"self"}:
        assert any(messages)
