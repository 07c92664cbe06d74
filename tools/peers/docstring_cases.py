"""The examples in a library's own documentation strings, as tests.

Two forms are read from the installed package's sources: ``>>>`` lines, and ``.. testcode::`` with
``.. testoutput::``. Text must be as it is printed there, numbers within a tolerance: examples
show what the library's own solver prints, at its own stopping rule.
"""

import ast
import contextlib
import doctest
import importlib
import importlib.util
import io
import os
import re
import textwrap
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from peers.plugin import LIBRARY

#: Of each library: modules with examples of transport, and the absolute tolerance of numbers.
#: GeomLoss's 1,000 iterations leave 1.2 percent in its example at reg=0.001.
SOURCES: dict[str, tuple[tuple[str, ...], float]] = {
    "pot": (
        (
            "ot.bregman._sinkhorn", "ot.bregman._empirical", "ot.unbalanced._sinkhorn",
            "ot.unbalanced._lbfgs", "ot.unbalanced._mm", "ot.solvers._linear",
        ), 2e-4,
    ),
    "geomloss": (
        ("geomloss.ot._implementations.matrix", "geomloss.ot._implementations.sample"), 2e-2,
    ),
    "ott": ((), 0.0),
}  # fmt: skip
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def docstrings(module: str) -> Iterator[tuple[str, str]]:
    """Yield names and documentation strings of a module's functions and classes."""
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        return
    for node in ast.walk(ast.parse(Path(found.origin).read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            text = ast.get_docstring(node)
            if text:
                yield f"{module}.{node.name}", text


def examples(text: str) -> list[tuple[str, str]]:
    """Return pieces of code of a documentation string, each with what it prints."""
    pieces = [(e.source, e.want) for e in doctest.DocTestParser().get_examples(text)]
    lines = text.splitlines()
    for number, line in enumerate(lines):
        kind = re.match(r"(\s*)\.\. (testcode|testoutput)::", line)
        if kind is None:
            continue
        block = []
        for following in lines[number + 1 :]:
            if following.strip() and not following.startswith(kind[1] + " "):
                break
            block.append(following)
        content = textwrap.dedent("\n".join(block)).strip("\n") + "\n"
        if kind[2] == "testcode":
            pieces.append((content, ""))
        elif pieces:
            pieces[-1] = pieces[-1][0], content
    return pieces


def same(printed: str, wanted: str, tolerance: float) -> bool:
    """Return whether two texts differ by blanks and by little in their numbers alone."""
    plain = [re.sub(r"np\.float\d+|array|[()]", " ", text) for text in (printed, wanted)]
    texts = [re.sub(r"\s+", "", NUMBER.sub("#", text)) for text in plain]
    numbers = [[float(n) for n in NUMBER.findall(text)] for text in plain]
    return texts[0] == texts[1] and all(
        abs(x - y) <= tolerance * max(1.0, abs(y)) for x, y in zip(*numbers, strict=True)
    )


def cases() -> list[tuple[str, str]]:
    """Return names and documentation strings with examples, of the library under test."""
    modules, _ = SOURCES[os.environ.get(LIBRARY, "ott")]
    found = [each for module in modules for each in docstrings(module)]
    return [(name, text) for name, text in found if examples(text)]


@pytest.mark.parametrize(("name", "text"), [pytest.param(*case, id=case[0]) for case in cases()])
def test_docstring_example(name: str, text: str) -> None:
    _, tolerance = SOURCES[os.environ[LIBRARY]]
    # As doctest has it, an example sees what its module does.
    shared: dict[str, object] = dict(vars(importlib.import_module(name.rpartition(".")[0])))
    for source, wanted in examples(text):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                value = eval(source.strip(), shared)
                if value is not None:
                    print(repr(value))
            except SyntaxError:
                exec(source, shared)
        if wanted:
            assert same(printed.getvalue(), wanted, tolerance), (
                f"{source}printed {printed.getvalue()}, expected {wanted}"
            )
