"""Every public function with every argument, and values that callers give by mistake.

`CASES` names the public functions with good arguments; `NASTY` the values that take an argument's
place. A call may do one of two things: return a result without NaN, or raise one of clmorph's
errors with one printable line. `check` judges one call by that, and by what it must leave alone:
its arguments, and the state that the process shares.

For a fuzzer: ``for description, call in calls(rng): check(description, call)`` draws calls
without end, with one to three arguments replaced; `rng` is a `numpy.random.Generator`. All of
them run in this process, on the NumPy backend, with images of 3 x 3 pixels; some write files into
the working directory, so run them in an empty one, after `furnish()`. ``ConvergenceWarning`` is
to be ignored.
"""

import dataclasses
import decimal
import inspect
import locale
import os
import random
import signal
import time
import types
import warnings
from collections.abc import Callable, Iterator
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.sparse import csr_array

import clmorph
import clmorph.analysis.channel_baseline
import clmorph.analysis.metrics
from clmorph.backends.opencl.devices.find import find_devices

#: Seconds that a call may take at most; the tiniest morph takes a hundredth of one.
PATIENCE = 20.0
#: Characters of a message.
LONGEST_MESSAGE = 1000

# --- the public functions -----------------------------------------------------------------

#: Modules that are documented beside the package's own names.
MODULES = {
    "clmorph": clmorph,
    "quality": clmorph.analysis.metrics,
    "baseline": clmorph.analysis.channel_baseline,
    "reference": clmorph.reference,
    "batch": clmorph.batch,
}


def public_functions() -> dict[str, Callable[..., Any]]:
    """Return all public functions, and methods of public classes, by name.

    Not those of `NumPyOperations`, a backend: they take what the functions above have checked.
    Nor constructors: public classes are results, and what takes one checks it.
    """
    found: dict[str, Callable[..., Any]] = {}
    for prefix, module in MODULES.items():
        names = getattr(module, "__all__", None) or [
            name
            for name, value in vars(module).items()
            if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
        ]
        for name in names:
            value = getattr(module, name)
            options = clmorph.MorphOptions, clmorph.RearrangeOptions, clmorph.RecolorOptions
            if value in options:  # its other methods are for the stages
                found |= {f"{name}.{each}": getattr(value, each) for each in ("replace", "as_dict")}
            elif isinstance(value, type):
                made_here = name != "NumPyOperations" and not issubclass(value, Exception)
                found |= _methods(value) if made_here else {}
            elif inspect.isfunction(value):
                found[name if prefix == "clmorph" else f"{prefix}.{name}"] = value
    return found


def _methods(kind: type) -> dict[str, Callable[..., Any]]:
    return {
        f"{kind.__name__}.{name}": value
        for owner in reversed(kind.__mro__)
        if owner.__module__.partition(".")[0] == "clmorph"
        for name, value in vars(owner).items()
        if inspect.isfunction(value) and not name.startswith("_")
    }


@cache
def examples() -> dict[str, Any]:
    """Return one good object of every kind, made once: no call may change them."""
    a = np.linspace(0.0, 1.0, 27).reshape(3, 3, 3)
    b = a[::-1] ** 2
    source, target = clmorph.lift(a), clmorph.lift(b)
    potentials = clmorph.sinkhorn(source, target, backend="numpy")
    morph = clmorph.morph(a, b, n_frames=2, backend="numpy")
    reference = clmorph.reference.morph(a, b, n_frames=2)
    divergence = clmorph.sinkhorn_divergence(source, target, backend="numpy")
    cells = clmorph.grid_measure(np.eye(3))
    return {
        "cells": cells,
        "of_cells": clmorph.sinkhorn(cells, cells, 0.5, 1.0, backend="numpy"),
        "a": a,
        "b": b,
        "source": source,
        "target": target,
        "potentials": potentials,
        "own": clmorph.sinkhorn(source, source, backend="numpy"),
        "plan": clmorph.transport_plan(source, target, potentials, backend="numpy"),
        "morph": morph,
        "sums": morph.sums(0.5),
        "channels": clmorph.analysis.channel_baseline.channel_morph(
            a, b, n_frames=2, backend="numpy"
        ),
        "reference": reference,
        "divergence": divergence,
        "direction": clmorph.Gradient(np.ones((9, 5)), np.zeros(9), np.ones((9, 5)), np.zeros(9)),
        "inspection": clmorph.inspect(a, b, n_frames=2, backend="numpy"),
        "grid": np.eye(3),
        "path": clmorph.density_path(np.eye(3), np.eye(3)[:, ::-1], backend="numpy"),
        "plain": (np.ones(3), np.arange(6.0).reshape(3, 2)),
        "queue": _any_queue(),
        "lut": clmorph.Lut(np.zeros((3, 3, 3, 3))),
        "mixes": clmorph.mix([a, b, a[::-1]], [[1, 0, 0], [1, 1, 0]], n_frames=2, backend="numpy"),
        "rearranged": clmorph.rearrange(a, b, n_frames=2, backend="numpy"),
    }


def _any_queue() -> Any:
    """Return the operations on a usable device, which have a queue; those of NumPy without one."""
    usable = [device.index for device in find_devices() if device.usable]
    return clmorph.get_backend(usable[0] if usable else "numpy")


#: Options that several functions share.
STRENGTHS = {"blur": 0.05, "reach": 0.3, "epsilon": None, "rho": None}
SOLVER = {"tol": 1e-3, "max_iter": 2000}
PROBLEM = STRENGTHS | SOLVER
WIDTHS = {"sigma_start": 1.2, "sigma_end": 0.5, "gamma": 0.5}
SIZES = {"size": None, "solve_size": None, "max_particles": None}
#: All options of `morph` and its like; None turns an alternative of another one off.
MORPH = STRENGTHS | {"duration": None} | clmorph.MorphOptions(
    **PROBLEM, **WIDTHS, **SIZES, n_frames=2, splatting="adaptive",
    detail="particles", path_space="srgb", color_space="srgb", color_weight=2.0, extent="true",
).as_dict()  # fmt: skip
#: Options of `clmorph.recolor`.
RECOLOR = {
    "strength": 0.5, "color_space": "oklab", "blur": 0.1, "reach": 1.0, "feather": 1.0,
    "reference_frame": None,
}  # fmt: skip


def cases() -> dict[str, dict[str, Any]]:
    """Return good arguments, all of them, of every public function."""
    some = examples()
    images = {"image_a": some["a"], "image_b": some["b"]}
    film = [some["a"], some["b"], some["a"]]
    measures = {"source": some["source"], "target": some["target"]}
    both = {"measures": [some["source"], some["target"]]}
    batches = {"sources": [some["source"], some["plain"]],
               "targets": [some["target"], some["plain"]]}  # fmt: skip
    planned = measures | {"potentials": some["potentials"]}
    recolored = {"like": some["b"]} | RECOLOR
    of_morph = {"morph": some["morph"]}
    own: dict[str, dict[str, Any]] = {
        "morph": images | MORPH,
        "morph_clip": MORPH | {
            "source": [some["a"]] * 3, "target": some["b"], "fps": 2.0, "detail": "layers",
            "splatting": "local",
        },
        "inspect": images | {
            name: MORPH[name] for name in inspect.signature(clmorph.inspect).parameters
            if name in MORPH
        },
        "rearrange": images | {"duration": None} | clmorph.RearrangeOptions(
            n_frames=2, size=None
        ).as_dict(),
        "mix": MORPH | {"images": [some["a"], some["b"]], "weights": [[1.0, 1.0]]},
        "Mixes.frame": {"self": some["mixes"], "weights": [1.0, 1.0, 0.0]},
        "Mixes.morph": {"self": some["mixes"], "first": 0, "second": 1},
        "Mixes.path": {"self": some["mixes"], "stops": "ab"},
        "Mixes.save": {"self": some["mixes"], "path": "out.png"},
        "recolor": recolored | {"image": some["a"], "mask": np.ones((3, 3))},
        "recolor_clip": recolored | {"clip": "none.mp4", "path": "out.mp4"},
        "fit_lut": recolored | {"image": some["a"], "size": 3, "mask": np.ones((3, 3))},
        "apply_lut": {"image": some["a"], "lut": some["lut"], "mask": np.ones((3, 3))},
        "read_lut": {"path": "none.cube"},
        "write_lut": {"path": "out.cube", "lut": some["lut"]},
        "RecolorOptions.replace": {
            "self": clmorph.RecolorOptions(), "strength": 0.5, "reach": None,
        },
        "RecolorOptions.as_dict": {"self": clmorph.RecolorOptions()},
        "write_image": {"path": "out.png", "image": some["a"]},
        "RearrangeOptions.replace": {
            "self": clmorph.RearrangeOptions(), "gap": 0.01, "color_weight": 2.0,
        },
        "RearrangeOptions.as_dict": {"self": clmorph.RearrangeOptions()},
        "Rearrangement.iter_frames": {"self": some["rearranged"]},
        "Rearrangement.save": {"self": some["rearranged"], "path": "out.png"},
        "MorphOptions.replace": {"self": clmorph.MorphOptions()} | PROBLEM,
        "MorphOptions.as_dict": {"self": clmorph.MorphOptions()},
        "sinkhorn": measures | PROBLEM,
        "sinkhorn_divergence": measures | PROBLEM | {"gradient": True},
        "gradient": planned,
        "hessian_product": measures | {
            "solved": some["divergence"], "direction": some["direction"],
        },
        "assignment": {
            "x": some["grid"], "y": some["grid"][::-1], "weights": np.ones(len(some["grid"])),
        },
        "barycenter": STRENGTHS | both | {
            "weights": [1.0, 2.0], "support": 3, "tol": 0.1, "max_iter": 3,
        },
        "density": {"values": some["grid"]},
        "grid_measure": {
            "values": some["grid"], "spacing": 0.5, "origin": (0.0, 1.0), "mask": some["grid"] > 0,
        },
        "Grid.array": {"self": some["cells"], "values": some["cells"].weights},
        "Grid.with_masses": {"self": some["cells"], "masses": some["grid"]},
        "displacement_field": {
            "source": some["cells"], "target": some["cells"], "potentials": some["of_cells"],
        },
        "density_path": SOLVER | {
            "source": some["grid"], "target": some["grid"].T, "blur": 0.05, "reach": 0.3,
        },
        "DensityPath.at": {"self": some["path"], "t": 0.5},
        "sinkhorn_batch": batches | PROBLEM,
        "sinkhorn_divergence_batch": batches | PROBLEM | {"gradient": True},
        # Without a client, which is checked last, so that every other value is.
        "batch.morph": {"pairs": [("a.png", "b.png", "out.gif")], "client": None},
        "batch.divergence_matrix": both | PROBLEM | {"client": None, "block": 2},
        "batch.barycenters": PROBLEM | {
            "groups": [both["measures"]], "client": None, "weights": [1.0, 1.0], "support": 3,
        },
        "divergence_matrix": both | PROBLEM,
        "transport_plan": planned,
        "sample_plan": planned | {"draws": 2},
        "barycentric_plan": planned,
        "displacement_statistics": measures | {"plan": some["plan"]},
        "particles": measures | {"plan": some["plan"]},
        "lift": {"image": some["a"]},
        "fit": {"image": some["a"], "size": 2},
        "read_image": {"path": "a.png"},
        "read_labels": {"path": "a.png"},
        "load": {"path": "a.npz"},
        "load_options": {"path": "a.npz"},
        "get_backend": {},
        "save": {"morphs": some["morph"], "path": "out.png"} | {
            name: MORPH[name] for name in ("fps", "duration", "hold", "loop", "reverse", "canvas",
                                           "scaling", "background", "lossless")
        },
        "Morph.device_frame": {"self": some["morph"], "t": 0.5, "queue": some["queue"]},
        "Morph.iter_frames": {"self": some["morph"]},
        "Morph.save": {"self": some["morph"], "path": "out.png"},
        "Plan.mean_destinations": {
            "self": some["plan"], "source": some["source"].positions,
            "target": some["target"].positions,
        },
        "Plan.to_device": {"self": some["plan"], "queue": some["queue"]},
        "Particles.mass": {"self": some["morph"].particles, "t": 0.5},
        "Potentials.map": {
            "self": some["potentials"], "points": some["source"].points, "target": some["target"],
            "own": some["own"],
        },
        "Potentials.swapped": {"self": some["potentials"]},
        "Potentials.to_device": {
            "self": some["potentials"], "queue": some["queue"], "dtype": "float32",
        },
        "Divergence.closer_than": {"self": some["divergence"], "other": some["divergence"]},
        "Inspection.save": {"self": some["inspection"], "path": "report.svg"},
        "quality.frame_measure": of_morph | {"t": 0.5, "sums": some["sums"]},
        "quality.particle_measure": of_morph | {"t": 0.5},
        "quality.path_divergence": of_morph | {"times": [0.5]},
        "quality.hole_fraction": {"coverage": np.ones((3, 3))},
        "quality.step_sizes": {"frames": [some["a"], some["b"]]},
        "quality.film_measures": {"frames": film, "particles": film, "times": (0.5,)},
        "quality.low_band_distance": {"frame": some["a"], "particles": some["b"]},
        "baseline.channel_morph": images | PROBLEM | WIDTHS | {"n_frames": 2, "extent": "true"},
        "ChannelMorph.iter_frames": {"self": some["channels"]},
        "reference.morph": images | PROBLEM | WIDTHS | {
            "n_frames": 2, "color_weight": 2.0, "extent": "true", "unmatched": "fade",
            "log_threshold": None,
        },
        "reference.sinkhorn": measures | PROBLEM,
        "reference.transport_plan": planned,
        "reference.cost_matrix": measures,
        "reference.render": measures | {"plan": some["reference"].plan, "t": 0.5, "sigma": 1.0},
    }  # fmt: skip
    frame, half = {"frame": some["a"]}, {"t": 0.5}
    for kind, names, good in (
        ("quality", "sharpness crumbs mean_gradient", frame),
        ("quality", "ghost crossfade_share", frame | images),
        ("quality", "relative_sharpness relative_crumbs", frame | images | half),
        ("quality", "unevenness flicker", {"frames": film}),
        ("Inspection", "summary lines entries plot", {"self": some["inspection"]}),
        ("Morph", "frame coverage canvas sums", {"self": some["morph"]} | half),
        ("Rearrangement", "frame canvas sums", {"self": some["rearranged"]} | half),
        ("ReferenceMorph", "frame", {"self": some["reference"]} | half),
        ("ChannelMorph", "frame", {"self": some["channels"]} | half),
        ("Plan", "to_scipy toarray", {"self": some["plan"]}),
        ("Mixes", "sheet drawn", {"self": some["mixes"]}),
    ):
        own |= {f"{kind}.{name}": good for name in names.split()}
    functions = public_functions()
    return {name: _usual(functions[name]) | good for name, good in own.items()}


def _usual(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the arguments of a function that have a default; all is calculated by NumPy."""
    usual = {
        each.name: each.default
        for each in inspect.signature(function).parameters.values()
        if each.default is not each.empty
    }
    fixed = {"backend": "numpy", "progress": lambda *told: None}
    return usual | {name: value for name, value in fixed.items() if name in usual}


# --- the values -----------------------------------------------------------------------------


class Hostile:
    """An object whose conversions all raise an error."""

    def _refuse(self, *arguments: Any, **more: Any) -> Any:
        raise RuntimeError("this object\ncannot be used")

    __float__ = __index__ = __array__ = __len__ = __iter__ = __repr__ = __fspath__ = _refuse


class OnDevice:
    """An array that is not on the host, as tensors can be."""

    shape = (3, 3, 3)

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


class OnlyDLPack:
    """An array of another library that has DLPack alone, in memory of a type (1: the host's)."""

    def __init__(self, values: Any, kind: Any = 1) -> None:
        self.values, self.kind = values, kind

    def __dlpack__(self, **options: Any) -> Any:
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.kind, 0


class Frame:
    """What a data frame does to become an array."""

    def __init__(self, values: Any) -> None:
        self.values = values

    def __array__(self, dtype: Any = None) -> Any:
        return np.asarray(self.values, dtype)


def read_only(value: Any) -> Any:
    """Return an array that may not be written to."""
    array = np.array(value)
    array.flags.writeable = False
    return array


def _endless_list() -> list[Any]:
    result: list[Any] = []
    result.append(result)
    return result


def _picture(value: float = 0.5) -> Any:
    return np.full((3, 3, 3), value)


def _always(values: dict[str, Any]) -> dict[str, Callable[[], Any]]:
    return {name: lambda value=value: value for name, value in values.items()}


#: Each makes a value: generators serve once, and lists could be changed.
NASTY: dict[str, Callable[[], Any]] = {
    **_always({
        "None": None, "True": True, "np.False_": np.False_, "0": 0, "-0.0": -0.0, "-1": -1,
        "0.5": 0.5, "3": 3, "1e-300": 1e-300, "1e300": 1e300, "nan": float("nan"),
        "inf": float("inf"), "-inf": float("-inf"), "10**400": 10**400, "-10**5000": -(10**5000),
        "1j": 1j, "Decimal 0.5": Decimal("0.5"), "Decimal 2": Decimal(2),
        "Decimal NaN": Decimal("NaN"), "Decimal sNaN": Decimal("sNaN"),
        "Decimal 1e999": Decimal("1e999"), "Fraction 1/2": Fraction(1, 2),
        "Fraction 10**400": Fraction(10**400, 3), "float32": np.float32(0.5),
        "float16": np.float16(0.5), "longdouble": np.longdouble(0.5), "int64": np.int64(2),
        "uint8": np.uint8(2), "timedelta": np.timedelta64(5), "masked": np.ma.masked,
        "pair": (0.3, 0.4), "ragged pair": ((1, 2), 3), "pair with None": (0.3, None),
        "pair of texts": ("x", "y"), "range": range(3), "Ellipsis": ..., "module": types,
        "class": clmorph.reference.NumPyOperations,
    }),
    "0-d 3": lambda: np.array(3),
    "0-d 0.5": lambda: np.array(0.5),
    "0-d text": lambda: np.array("0.5"),
    "0-d object": lambda: np.array(Decimal("0.5"), object),
    "0-d masked": lambda: np.ma.array(0.5, mask=True),
    "one in a list": lambda: [0.5],
    "one in an array": lambda: np.array([0.5]),
    "triple": lambda: [1, 2, 3],
    **_always({
        "empty text": "", "x": "x", "text": "no such text", "0.5 as text": "0.5", "auto": "auto",
        "escape": "a\nb\x1b[31m\x00", "surrogate": "\ud800", "long text": "y" * 5000,
        "bytes": b"", "path": Path("x.png"),
    }),
    "empty list": lambda: [],
    "empty dict": lambda: {},
    "dict": lambda: {"a": 1, 2: object()},
    "set": lambda: {1, 2},
    "object": object,
    "generator": lambda: (number for number in (1, 2)),
    "function": lambda: lambda *told: None,
    "hostile": Hostile,
    "on a device": OnDevice,
    "DLPack": lambda: OnlyDLPack(_picture()),
    "DLPack on a device": lambda: OnlyDLPack(_picture(), 2),
    "ragged": lambda: [[1.0, 2.0], [3.0]],
    "endless": _endless_list,
    "empty array": lambda: np.zeros((0, 3)),
    "nan picture": lambda: _picture(np.nan),
    "picture": _picture,
    "gray": lambda: np.eye(3),
    "float16 picture": lambda: _picture().astype(np.float16),
    "longdouble picture": lambda: _picture().astype(np.longdouble),
    "big-endian picture": lambda: _picture().astype(">f8"),
    "big-endian bytes": lambda: np.full((3, 3), 9, ">u2"),
    "Fortran picture": lambda: np.asfortranarray(_picture()),
    "strided picture": lambda: np.full((6, 6, 6), 0.5)[::2, ::-2, ::2],
    "complex picture": lambda: _picture() + 1j,
    "text picture": lambda: _picture().astype("U"),
    "masked picture": lambda: np.ma.array(_picture(), mask=_picture() > 0),
    "rows, one masked": lambda: [np.ma.array([0.5] * 3, mask=[0, 1, 0]), [0.5] * 3, [0.5] * 3],
    "nothing masked": lambda: np.ma.array(np.eye(3), mask=False),
    "object picture": lambda: np.full((3, 3), Fraction(1, 2), object),
    "objects": lambda: np.array([None, "x", object()], object),
    "structured": lambda: np.zeros((3, 3), [("r", float), ("g", float)]),
    "dates": lambda: np.zeros((3, 3), "datetime64[s]"),
    "sparse": lambda: csr_array(np.eye(3)),
    "data frame": lambda: Frame(np.eye(3)),
    "data frame of texts": lambda: Frame([["a"]]),
    "palette": lambda: Image.new("P", (3, 3)),
    "CMYK": lambda: Image.new("CMYK", (3, 3)),
    "Pillow": lambda: Image.new("RGB", (3, 3)),
    "weights and points": lambda: (np.ones(3), np.arange(6.0).reshape(3, 2)),
    "swapped pair": lambda: (np.arange(6.0).reshape(3, 2), np.ones(3)),
    "nan points": lambda: (np.ones(3), np.full((3, 5), np.nan)),
    "9 points": lambda: (np.ones(9), np.linspace(0, 1, 45).reshape(9, 5)),
    "1025 dimensions": lambda: (np.ones(3), np.zeros((3, 1025))),
    "negative weights": lambda: (-np.ones(3), np.zeros((3, 5))),
    "masked points": lambda: (np.ones(3), np.ma.array(np.zeros((3, 5)), mask=True)),
    "own points": lambda: clmorph.WeightedPoints([[0.0, 1.0]], [1.0]),
    "other image": lambda: clmorph.lift(np.eye(4)),
    "own potentials": lambda: examples()["potentials"],
    "own plan": lambda: examples()["plan"],
    "own morph": lambda: examples()["morph"],
}  # fmt: skip


#: Values that every argument meets in the quick run.
CORE = {"None", "True", "text", "nan", "-1", "10**400", "-10**5000", "0-d masked", "object",
        "masked picture"}  # fmt: skip


def damaged(kind: str) -> Iterator[tuple[str, Any]]:
    """Return examples of a public class, each with one part replaced."""
    good = examples()[kind]
    parts: dict[str, Any] = {"None": None, "text": "x", "list": [1.0, 2.0], "number": -1}
    arrays = {"nan": np.full(9, np.nan), "short": np.ones(2)}
    for field in dataclasses.fields(good):
        for name, value in (parts | arrays).items():
            changed = dataclasses.replace(good, **{field.name: value})
            yield f"{kind} with {field.name}={name}", changed


#: Which arguments are objects of public classes; damaged ones take their place too.
KINDS = {name: name for name in ("source", "target", "potentials", "plan")}
KINDS |= dict.fromkeys(("start", "cross"), "potentials")


def is_fit(argument: str, label: str) -> bool:
    """Whether a value may take an argument's place."""
    if argument == "backend":
        return label not in ("empty text", "auto", "x", "0.5 as text")  # devices of the machine
    return not (argument == "progress" and label == "class")  # which is called, with anything


def single(name: str, every: int = 1) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Return calls of a public function with one argument replaced, for all arguments.

    Of the values beside `CORE` only each `every`-th is taken, others for other arguments.
    """
    function, good = public_functions()[name], cases()[name]
    for position, argument in enumerate(good):
        if argument == "self":
            continue
        for number, (label, make) in enumerate(NASTY.items()):
            taken = label in CORE or (number + position) % every == 0
            if taken and is_fit(argument, label):
                yield f"{name}({argument}={label})", _call(function, good, {argument: make})
        kind = KINDS.get(argument)
        if kind and (kind != "source" or isinstance(good[argument], clmorph.Measure)):
            for number, (label, value) in enumerate(damaged(kind)):
                if not name.startswith("reference.render") and (number + position) % every == 0:
                    call = _call(function, good, {argument: lambda value=value: value})
                    yield f"{name}({argument}={label})", call


def calls(rng: np.random.Generator) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Draw calls without end: what is called, and a function without arguments that calls it.

    One to three arguments of a public function are replaced by values of `NASTY`.
    """
    functions, good = public_functions(), cases()
    names = [name for name in good if set(good[name]) - {"self"}]
    labels = list(NASTY)
    while True:
        name = names[rng.integers(len(names))]
        own = [argument for argument in good[name] if argument != "self"]
        chosen = rng.permutation(own)[: rng.integers(1, 4)]
        drawn = {str(argument): labels[rng.integers(len(labels))] for argument in chosen}
        drawn = {name: label for name, label in drawn.items() if is_fit(name, label)}
        told = ", ".join(f"{argument}={label}" for argument, label in drawn.items())
        replaced = {argument: NASTY[label] for argument, label in drawn.items()}
        yield f"{name}({told})", _call(functions[name], good[name], replaced)


def _call(
    function: Callable[..., Any], good: dict[str, Any], replaced: dict[str, Callable[[], Any]]
) -> Callable[[], Any]:
    def call() -> Any:
        arguments = good | {name: make() for name, make in replaced.items()}
        before = [_digest(value) for value in arguments.values()]
        try:
            result = function(**arguments)
            if isinstance(result, clmorph.Morph):
                return result, result.frames, result.coverage(0.5)
            return list(result) if isinstance(result, types.GeneratorType) else result
        finally:
            after = [_digest(value) for value in arguments.values()]
            assert before == after, f"{function.__name__} changed its arguments"

    return call


# --- the judge ------------------------------------------------------------------------------


def check(description: str, call: Callable[[], Any]) -> str:
    """Judge one call; return the message of its error, empty if it returned a result."""
    before, began = shared_state(), time.monotonic()
    message = ""
    try:
        result = call()
    except clmorph.ClmorphError as error:
        message = str(error)
        assert message.strip(), f"{description}: no message"
        assert message.isprintable(), f"{description}: {message!r}"
        assert len(message) <= LONGEST_MESSAGE, f"{description}: {message[:80]}… is too long"
    except AssertionError:
        raise
    except Exception as error:
        raise AssertionError(f"{description}: {type(error).__name__}: {error}") from error
    else:
        flaws = list(not_finite(result))
        assert not flaws, f"{description}: NaN at {flaws[0]}"
    seconds = time.monotonic() - began
    assert seconds < PATIENCE, f"{description} took {seconds:.1f} s"
    after = shared_state()
    changed = [name for name in before if before[name] != after[name]]
    assert not changed, f"{description} changed {changed}"
    return message


def shared_state() -> dict[str, Any]:
    """Return what all of a process shares, and no call may change."""
    generator = np.random.get_state()  # noqa: NPY002 - the one that all share
    return {
        "numpy's errors": np.geterr(),
        "numpy's printing": np.get_printoptions(),
        "numpy's generator": (generator[1].tobytes(), generator[2:]),
        "random": random.getstate(),
        "warnings": list(warnings.filters),
        "locale": locale.setlocale(locale.LC_ALL),
        "folder": Path.cwd(),
        "environment": dict(os.environ),
        "decimal": repr(decimal.getcontext()),
        "Pillow's limit": Image.MAX_IMAGE_PIXELS,
        "interrupts": signal.getsignal(signal.SIGINT),
    }


def not_finite(value: Any, path: str = "result", depth: int = 0) -> Iterator[str]:
    """Return where a result holds NaN, or infinity in an array."""
    if isinstance(value, float) and value != value:
        yield path
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and not np.all(np.isfinite(value)):
            yield path
    elif depth > 4:
        return
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from not_finite(getattr(value, field.name), f"{path}.{field.name}", depth + 1)
    elif isinstance(value, list | tuple):
        for index, part in enumerate(value):
            yield from not_finite(part, f"{path}[{index}]", depth + 1)


def _digest(value: Any, depth: int = 0) -> Any:
    """Return what says whether a value has changed."""
    if value is np.ma.masked:
        return "masked"
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            return value.dtype, value.shape, [id(entry) for entry in value.flat]
        masks = np.ma.getmaskarray(value).tobytes() if np.ma.isMaskedArray(value) else b""
        return value.dtype, value.shape, value.strides, value.tobytes(), masks
    if depth > 4:
        return id(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return [_digest(getattr(value, field.name), depth + 1) for field in fields]
    if isinstance(value, list | tuple):
        return [_digest(part, depth + 1) for part in value]
    if isinstance(value, dict):
        return [(id(key), _digest(part, depth + 1)) for key, part in value.items()]
    return id(value)


def furnish() -> None:
    """Write into the working directory the files that good arguments name."""
    Image.new("RGB", (3, 3)).save("a.png")
    examples()["morph"].save("a.npz")
