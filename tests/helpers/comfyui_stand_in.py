"""A stand-in for ComfyUI: how it loads folders of nodes, checks a graph, and runs it.

Written after its public documentation of custom nodes: the loader imports each folder of
``custom_nodes`` by its ``__init__.py``; the executor calls a node's `FUNCTION` with the outputs of
other nodes, once for each element of lists, and keeps results until `IS_CHANGED` differs.
"""

import importlib.util
import inspect
import sys
import types
from pathlib import Path
from typing import ClassVar

#: What widgets hold, and the settings that they may have.
KINDS = {"INT": int, "FLOAT": float, "STRING": str, "BOOLEAN": bool}
SETTINGS = {"default", "min", "max", "step", "round", "tooltip", "multiline"}


class Interrupted(Exception):  # noqa: N818 (as ComfyUI calls it)
    """ComfyUI's exception for a run that the user stops."""


class Bar:
    """A progress bar that keeps what it shows."""

    shown: ClassVar = []

    def __init__(self, total):
        self.total = total

    def update_absolute(self, value, total=None, preview=None):
        assert 0 <= value <= (total or self.total)
        Bar.shown.append(value / (total or self.total))


def make_folder(folder):
    """Make what tells a folder of ComfyUI."""
    (folder / "custom_nodes").mkdir(parents=True)
    (folder / "comfy").mkdir()
    for name in ("main.py", "nodes.py"):
        (folder / name).write_text("")
    return folder


def install(monkeypatch, stop_after=None, inputs="."):
    """Put the modules of ComfyUI that nodes use in their places."""
    Bar.shown = []
    comfy, utils, management = (
        types.ModuleType(name) for name in ("comfy", "comfy.utils", "comfy.model_management")
    )
    utils.ProgressBar = Bar

    def throw_exception_if_processing_interrupted():
        if stop_after is not None and len(Bar.shown) >= stop_after:
            raise Interrupted

    management.throw_exception_if_processing_interrupted = throw_exception_if_processing_interrupted
    folders = types.ModuleType("folder_paths")
    folders.get_input_directory = lambda: str(inputs)
    for module in (comfy, utils, management, folders):
        monkeypatch.setitem(sys.modules, module.__name__, module)


def load(comfyui):
    """Return the classes and the names of all folders in ``custom_nodes``."""
    classes, names = {}, {}
    for folder in sorted((Path(comfyui) / "custom_nodes").iterdir()):
        name = str(folder).replace(".", "_x_")
        spec = importlib.util.spec_from_file_location(name, folder / "__init__.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        try:
            spec.loader.exec_module(module)
        finally:
            del sys.modules[spec.name]
        classes |= module.NODE_CLASS_MAPPINGS
        names |= getattr(module, "NODE_DISPLAY_NAME_MAPPINGS", {})
    return classes, names


def check_class(kind):
    """Fail unless a class keeps the contract of a node."""
    inputs = kind.INPUT_TYPES()
    assert set(inputs) <= {"required", "optional", "hidden"}
    assert isinstance(kind.RETURN_TYPES, tuple)
    assert all(isinstance(each, str) for each in kind.RETURN_TYPES)
    assert len(kind.RETURN_NAMES) == len(kind.OUTPUT_TOOLTIPS) == len(kind.RETURN_TYPES)
    assert isinstance(kind.CATEGORY, str)
    assert kind.CATEGORY
    assert kind.DESCRIPTION.endswith(".")
    named = {name: each for part in inputs.values() for name, each in part.items()}
    for name, (type_of, settings) in named.items():
        assert settings["tooltip"], name
        assert set(settings) <= SETTINGS, name
        if isinstance(type_of, list):
            assert settings["default"] in type_of, name
        elif type_of in KINDS:
            assert type(settings["default"]) is KINDS[type_of], name
            if "min" in settings:
                assert settings["min"] <= settings["default"] <= settings["max"], name
        else:
            assert "default" not in settings, name
    function = inspect.signature(getattr(kind, kind.FUNCTION))
    function.bind(None, **dict.fromkeys(inputs["required"]))
    function.bind(None, **dict.fromkeys(named))


class Graph:
    """A graph of nodes: ``{id: (class, {input: value or (id, number)})}``."""

    def __init__(self, classes):
        self.classes, self._kept, self.runs = classes, {}, []

    def faults(self, graph):
        """Return what is wrong with a graph, in texts, before anything runs."""
        found = []
        for key, (name, given) in graph.items():
            kind = self.classes[name]
            inputs = kind.INPUT_TYPES()
            both = inputs["required"] | inputs.get("optional", {})
            found += [f"{key}: {each} is missing" for each in set(inputs["required"]) - set(given)]
            values = {}
            for each, value in given.items():
                type_of, settings = both[each]
                if isinstance(value, tuple):
                    origin = self.classes[graph[value[0]][0]]
                    if origin.RETURN_TYPES[value[1]] != type_of:
                        found.append(f"{key}: {each} has the wrong type")
                    continue
                values[each] = value
                if isinstance(type_of, list):
                    if value not in type_of:
                        found.append(f"{key}: {each} is not in the list")
                elif not isinstance(value, KINDS[type_of]):
                    found.append(f"{key}: {each} is no {type_of}")
                elif "min" in settings and not settings["min"] <= value <= settings["max"]:
                    found.append(f"{key}: {each} is out of range")
            check = getattr(kind, "VALIDATE_INPUTS", None)
            if check is not None:
                asked = inspect.signature(check).parameters
                verdict = check(**{each: values[each] for each in asked if each in values})
                if verdict is not True:
                    found.append(f"{key}: {verdict}")
        return found

    def run(self, graph, key):
        """Return the outputs of a node, each a list with an element for each call."""
        assert self.faults(graph) == []
        return self._outputs(graph, key)

    def _outputs(self, graph, key):
        name, given = graph[key]
        kind = self.classes[name]
        lists, marks = {}, []
        for each, value in given.items():
            if isinstance(value, tuple):
                lists[each] = self._outputs(graph, value[0])[value[1]]
                marks.append((each, id(lists[each])))
            else:
                lists[each] = [value]
                marks.append((each, value))
        if hasattr(kind, "IS_CHANGED"):
            asked = inspect.signature(kind.IS_CHANGED).parameters
            marks.append(kind.IS_CHANGED(**{each: lists[each][0] for each in asked}))
        if key in self._kept and self._kept[key][0] == (name, marks):
            return self._kept[key][1]
        self.runs.append(key)
        node, calls = kind(), []
        for number in range(max(map(len, lists.values()))):
            arguments = {each: of[min(number, len(of) - 1)] for each, of in lists.items()}
            calls.append(getattr(node, kind.FUNCTION)(**arguments))
        outputs = []
        as_lists = getattr(kind, "OUTPUT_IS_LIST", (False,) * len(kind.RETURN_TYPES))
        for number, is_list in enumerate(as_lists):
            parts = [call[number] for call in calls]
            outputs.append([each for part in parts for each in part] if is_list else parts)
        self._kept[key] = (name, marks), outputs
        return outputs
