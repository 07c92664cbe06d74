"""What POT's tests take from a conftest that its sdist leaves out: its backends and marks."""

import os
from typing import Any

import ot.backend
import pytest


def backends() -> list[Any]:
    """Return POT's backends whose library is installed, GPUs' left out."""
    return [each for each in ot.backend.get_backend_list() if each.__name__ not in ("tf", "cupy")]


def prepare(config: pytest.Config) -> None:
    """Make the marks that the tests' modules take from pytest itself."""
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    try:
        import jax

        jax.config.update("jax_enable_x64", True)
    except ImportError:
        pass
    config.addinivalue_line("markers", "peer_skip(names, values, reason, getter): see skip_arg")
    pytest.skip_arg = skip_arg
    pytest.skip_backend = skip_backend


def skip_arg(names: Any, values: Any, reason: str | None = None, getter: Any = None) -> Any:
    """Mark a test to be skipped where its arguments have some values."""
    names, values = (v if isinstance(v, tuple) else (v,) for v in (names, values))
    return pytest.mark.peer_skip(names, values, reason or f"{names} is {values}", getter)


def skip_backend(name: str, reason: str | None = None) -> Any:
    """Mark a test to be skipped with one of POT's backends."""
    return skip_arg("nx", name, reason or f"not for the backend {name}", str)


@pytest.fixture(params=backends(), ids=lambda nx: nx.__name__)
def nx(request: pytest.FixtureRequest) -> Any:
    """Return one of POT's backends."""
    return request.param


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Heed the marks."""
    for item in items:
        for mark in item.iter_markers("peer_skip"):
            names, values, reason, getter = mark.args
            given = [item.callspec.params.get(name) for name in names]
            given = [getter(value) if getter else value for value in given]
            if given == list(values):
                item.add_marker(pytest.mark.skip(reason=reason))
