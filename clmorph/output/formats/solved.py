"""``.npz``: results of the solver as NumPy arrays and one JSON text, without pickles."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

import numpy as np

from clmorph.output.bounded import Arrays
from clmorph.transport.certificate import Certificate
from clmorph.transport.divergence import Divergence
from clmorph.transport.gradient import Gradient
from clmorph.transport.matching import Assignment
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn_batch import PotentialsBatch, batch_of

#: The name of the JSON text among the arrays.
RECORD = "result"
#: What can be saved, and the classes of its parts.
SAVED = (Potentials, Plan, Divergence, PotentialsBatch, Assignment)
CLASSES: dict[str, Any] = {
    each.__name__: each
    for each in (Potentials, Plan, Divergence, Certificate, Gradient, Assignment)
}
#: Fields that belong to a process, or to the measures, which are not saved.
LEFT_OUT = {"measures", "passes"}
#: The largest depth of a record, and kinds of its arrays.
DEPTH, KINDS = 8, "fi"


def names_of(kind: Any) -> tuple[str, ...]:
    """Return the names of a class's fields."""
    return tuple(each.name for each in fields(kind)) if is_dataclass(kind) else kind._fields


def taken_apart(value: Any) -> dict[str, Any]:
    """Return the arrays of a result by their names, with the JSON text that joins them."""
    arrays: dict[str, Any] = {}

    def part(value: Any) -> Any:
        kind = type(value).__name__
        if isinstance(value, PotentialsBatch):
            return {"batch": [part(each) for each in value]}
        if kind in CLASSES:
            names = [name for name in names_of(type(value)) if name not in LEFT_OUT]
            return {"class": kind} | {name: part(getattr(value, name)) for name in names}
        if isinstance(value, np.ndarray):
            arrays[f"array_{len(arrays)}"] = value
            return {"array": f"array_{len(arrays) - 1}", "axes": value.ndim}
        if isinstance(value, tuple):
            return {"tuple": [part(each) for each in value]}
        return value.item() if isinstance(value, np.generic) else value

    text = json.dumps(part(value)).encode()
    return {RECORD: np.frombuffer(text, np.uint8)} | arrays


def put_together(arrays: Arrays) -> Any:
    """Return a result; ValueError and its like are raised if the file is not one of clmorph's."""
    record = json.loads(arrays.read(RECORD, 1, "u").tobytes())
    found = _joined(record, arrays, 0)
    if not isinstance(found, SAVED):
        raise ValueError("it holds no result of the solver")
    return found


def _joined(part: Any, arrays: Arrays, depth: int) -> Any:
    if depth > DEPTH:
        raise ValueError("its parts are nested too deeply")
    if not isinstance(part, dict):
        if part is None or isinstance(part, bool | int | float | str):
            return part
        raise ValueError("a part of it is of an unknown kind")
    if "array" in part:
        return arrays.read(str(part["array"]), int(part["axes"]), KINDS)
    if "tuple" in part:
        return tuple(_joined(each, arrays, depth + 1) for each in part["tuple"])
    if "batch" in part:
        batch = [_joined(each, arrays, depth + 1) for each in part["batch"]]
        if not all(isinstance(each, Potentials) for each in batch):
            raise ValueError("its batch holds something else than potentials")
        return batch_of(batch)
    kind = CLASSES[part["class"]]
    names = set(names_of(kind)) - LEFT_OUT
    if set(part) != names | {"class"}:
        raise ValueError(f"its {kind.__name__} has other fields")
    made = kind(**{name: _joined(part[name], arrays, depth + 1) for name in names})
    if not CHECKS.get(kind, lambda made: True)(made):
        raise ValueError(f"its {kind.__name__} is not valid")
    return made


def _right_types(made: Any) -> bool:
    """Return whether the simple fields of a part have the types of their annotations."""
    hints = get_type_hints(type(made))
    for name in names_of(type(made)):
        value, hint = getattr(made, name), hints[name]
        if hint in (float, int, str, bool) and not (
            isinstance(value, hint) or (hint is float and type(value) is int)
        ):
            return False
    return True


def _is_vector(*values: Any) -> bool:
    return all(isinstance(each, np.ndarray) and each.ndim == 1 for each in values)


def plan_is_valid(plan: Plan) -> bool:
    """Return whether the arrays of a plan agree."""
    vectors = (
        plan.indptr, plan.indices, plan.mass, plan.whole_row_mass, plan.whole_column_mass,
    )  # fmt: skip
    if not _is_vector(*vectors) or type(plan.shape) is not tuple or len(plan.shape) != 2:
        return False
    rows, columns = plan.shape
    indptr, indices = plan.indptr, plan.indices
    return bool(
        len(indptr) == rows + 1 == len(plan.whole_row_mass) + 1
        and columns == len(plan.whole_column_mass)
        and len(indices) == len(plan.mass)
        and indptr.dtype.kind == indices.dtype.kind == "i"
        and indptr[0] == 0
        and indptr[-1] == len(indices)
        and np.all(np.diff(indptr) >= 0)
        and np.all((indices >= 0) & (indices < columns))
    )


def _potentials_are_valid(made: Potentials) -> bool:
    of = made.certificate
    return bool(
        _right_types(made)
        and isinstance(of, Certificate)
        and _is_vector(made.f, made.g, made.residuals, of.row_mass, of.column_mass)
        and made.f.shape == of.row_mass.shape
        and made.g.shape == of.column_mass.shape
        and type(of.masses) is tuple
        and len(of.masses) == 2
        and made.blur > 0
    )


def _divergence_is_valid(made: Divergence) -> bool:
    parts = made.cross, made.source_self, made.target_self
    return (
        isinstance(made.value, float)
        and all(isinstance(each, Potentials) for each in parts)
        and isinstance(made.gradient, Gradient | None)
        and type(made.interval) is tuple
        and len(made.interval) == 2
    )


def _assignment_is_valid(made: Assignment) -> bool:
    prices, indices = made.prices, (made.rows, made.columns)
    if not (type(prices) is tuple and len(prices) == 2 and _is_vector(*prices, *indices)):
        return False
    sides = [len(price) for price in prices]
    return bool(
        _right_types(made)
        and all(
            each.dtype.kind == "i"
            and len(each) == len(np.unique(each)) == min(sides)
            and np.all((each >= 0) & (each < side))
            for each, side in zip(indices, sides, strict=True)
        )
        and np.all(np.diff(made.rows) > 0)
    )


CHECKS: dict[Any, Callable[[Any], bool]] = {
    Plan: plan_is_valid, Potentials: _potentials_are_valid, Divergence: _divergence_is_valid,
    Assignment: _assignment_is_valid,
}  # fmt: skip
