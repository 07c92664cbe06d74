"""Test the names at the top of the package, and that there are no circular imports.

``lint-imports`` checks the imports between packages; `pyproject.toml` says which are allowed.
"""

import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "clmorph"
#: Folders of the package; the kernels lie beside it and are only linked or installed into it.
ROOMS = {path.parent.name for path in PACKAGE.glob("*/__init__.py")} - {"cl_kernels"}


def test_the_top_of_the_package_is_read_at_a_glance():
    assert len(ROOMS) <= 15
    assert len(list(PACKAGE.glob("*.py"))) <= 4


def test_each_room_has_its_tests():
    """Rooms and folders of tests have the same names."""
    tested = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    assert tested == ROOMS | {"project"}


def test_all_folders_are_installed():
    """The list in ``pyproject.toml`` is written by hand: the kernels come from another folder."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {".".join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob("*.py")}
    assert found | {"clmorph.cl_kernels"} == set(listed)


def test_no_circle_of_files():
    """Imports inside functions count, and so do those of a folder's ``__init__.py``."""
    graph = grimp.build_graph("clmorph", cache_dir=None)
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        pytest.fail("a circle of imports: " + " <- ".join(error.args[1]))
