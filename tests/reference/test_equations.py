"""The table from equations to functions names files and functions that exist."""

import re
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "clmorph"
PAGE = (PACKAGE / "reference" / "README.md").read_text("utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("| ") and not line.startswith("| paper")
]


def defines(text, name):
    """Whether a module defines a function, a class, or a method by its dotted name."""
    return all(re.search(rf"(def|class) {part}\b", text) for part in name.split("."))


def test_every_function_of_the_reference_is_there():
    named = [m for row in ROWS for m in re.findall(r"`(transport|pipeline)\.(\w+)`", row[2])]
    assert len(named) > 15
    for module, name in named:
        assert defines((PACKAGE / "reference" / f"{module}.py").read_text("utf-8"), name), name


def test_every_function_of_the_fast_path_is_there():
    found = 0
    for row in ROWS:
        folder, text = PACKAGE, ""
        for name in re.findall(r"`([^`]+)`", row[3]):
            if name.endswith((".py", ".cl")):
                top = PACKAGE.parent if name.startswith("cl_kernels/") else PACKAGE
                file = top / name if "/" in name else folder / name
                folder, text = file.parent, file.read_text("utf-8")
            elif re.fullmatch(r"[\w.]+", name):
                assert defines(text, name), f"{name} in {row[1]}"
                found += 1
    assert found > 35
