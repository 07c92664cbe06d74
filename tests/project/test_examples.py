"""The examples in docstrings run without changes, and every public name has examples."""

import doctest
import importlib
import inspect
import types
from pathlib import Path

import pytest

import clmorph

PACKAGE = Path(clmorph.__file__).parent
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def examples():
    """Return the examples of each docstring; only modules that have some are imported."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        if ">>>" not in path.read_text("utf-8"):
            continue
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        module = importlib.import_module(".".join(part for part in parts if part != "__init__"))
        docstrings = doctest.DocTestFinder(exclude_empty=True).find(module)
        found += [docstring for docstring in docstrings if docstring.examples]
    return found


@pytest.mark.parametrize("example", examples(), ids=lambda example: example.name)
def test_examples(example, tmp_path, monkeypatch):
    """Each runs in a separate folder and without a device, so that "auto" is NumPy."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CLMORPH_DEVICE", "numpy")
    report = []
    runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
    runner.run(example, out=report.append)
    assert runner.failures == 0, "".join(report)


def test_everything_public_has_examples():
    public = {name: getattr(clmorph, name) for name in clmorph.__all__}
    missing = [
        name
        for name, value in public.items()
        if not isinstance(value, str | types.ModuleType)
        and "\nExamples\n--------\n" not in (inspect.getdoc(value) or "")
    ]
    assert not missing, f"no Examples section: {', '.join(missing)}"
