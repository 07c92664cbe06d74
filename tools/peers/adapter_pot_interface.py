"""POT's `solve_sample`, replaced by ``clmorph.pot.solve_sample`` itself."""

from typing import Any

import ot
import ot.solvers

import clmorph
import clmorph.pot
from peers.bridge import TALLY, Declined, backend
from peers.pot_values import numbers

#: The module whose functions are replaced.
PACKAGE = "ot"
ARRAYS = ("X_a", "X_b", "a", "b")
NAMES = (*ARRAYS, "metric", "reg")


class Result:
    """A result whose arrays are of POT's backend, as in POT."""

    def __init__(self, found: clmorph.pot.OTResult, nx: Any) -> None:
        self._found, self._backend = found, nx

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._found, name)
        if name in ("plan", "potential_a", "potential_b", "marginal_a", "marginal_b"):
            return self._backend.from_numpy(value)
        return value


def solve_sample(*arguments: Any, **options: Any) -> Any:
    """Answer by clmorph, where the problem is entropic and has no other method."""
    given = dict(zip(NAMES, arguments, strict=False)) | options
    for name in ("method", "debias", "scaler"):
        if given.pop(name, None):
            raise Declined(f"solve_sample with {name}")
    present = [name for name in ARRAYS if given.get(name) is not None]
    nx, arrays = numbers(*(given[name] for name in present))
    refused = given.get("lazy") or "unbalanced_type" in given
    if given.get("reg") is None and not refused:
        raise Declined("no entropy")
    TALLY.calls += 1
    found = clmorph.pot.solve_sample(
        **given | dict(zip(present, arrays, strict=True)), backend=backend()
    )
    return Result(found, nx)


def replacements() -> dict[Any, Any]:
    """Return what stands for POT's function."""
    return {ot.solvers.solve_sample: solve_sample}
