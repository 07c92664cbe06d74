"""Every command and every block of Python in the README, run as they stand there.

Pictures are such that the commands take the branches that photographs take: they are reduced,
solved between cells of pixels, drawn by a sample of the plan, with a kernel width for each
particle.
"""

import ast
import functools
import itertools
import re
import shlex
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage import data

import clmorph
from clmorph.analysis import inspect as inspection
from clmorph.cli.main import cli, main
from clmorph.pipeline import budget as planning
from clmorph.pipeline import presets as defaults

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
#: The limits of the default preset, so much smaller that all commands together take seconds.
#: Photographs are larger and their plans have more pairs all the same, as with its own limits.
LIMITS = {"size": 48, "solve_size": 24, "max_particles": 12_000}
#: Commands that take minutes or install something: what runs them, and words that show it there.
ELSEWHERE = {
    r"python3 -m venv .* && \.venv/bin/clmorph demo": (".ci/run", "readme_command 1"),
    r"python3 -m venv .* && \.venv/bin/pytest": (".ci/run", "readme_command 2"),
    r"python tools/reproduce_paper\.py (--source a\.png --target b\.jpg )?--out reproduction": (
        "tests/project/test_reproduce.py",
        "reproduce_paper",
    ),
}
PICTURES = {"a.png": "astronaut", "b.jpg": "coffee", "c.png": "chelsea", "d.jpg": "rocket"}


def blocks():
    """Fenced blocks as (heading, kind, text), whatever they hold."""
    heading, kind, lines = "", None, []
    for line in README.splitlines():
        if kind is None and line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("```") and kind is None:
            kind, lines = line[3:], []
        elif line.startswith("```"):
            yield heading, kind, "\n".join(lines) + "\n"
            kind = None
        elif kind is not None:
            lines.append(line)
    assert kind is None, "a block that does not end"


BLOCKS = list(blocks())
COMMANDS = [
    line for _, kind, text in BLOCKS if kind == "sh" for line in text.splitlines() if line.strip()
]
OURS = [line for line in COMMANDS if line.startswith("clmorph ")]


def write_pictures(longer=None):
    """Make the pictures that the README names, in the current folder."""
    for name, photograph in PICTURES.items():
        picture = Image.fromarray(getattr(data, photograph)())
        if longer:
            picture.thumbnail((longer, longer))
        picture.save(name)
    for name, sprite in (("cat.png", "cat"), ("dog.png", "toadstool")):
        with Image.open(ROOT / f"clmorph/cli/samples/{sprite}.png") as picture:
            picture.save(name)


@pytest.fixture
def ways(monkeypatch):
    """How plans are made: pixels of a cell, and draws in place of all pairs."""
    found = []
    choose = planning.choose_way

    @functools.wraps(choose)
    def spy(source, target, *arguments, **options):
        way = choose(source, target, *arguments, **options)
        found.append((planning.finest_pixels(source, target), way))
        return way

    for module in (planning, inspection):
        monkeypatch.setattr(module, "choose_way", spy)
    return found


@pytest.fixture
def widths(monkeypatch):
    """Kinds of kernel widths that morphs are drawn with."""
    found = []
    module = sys.modules["clmorph.morph"]
    make = module.KernelWidth

    def spy(*arguments):
        width = make(*arguments)
        found.append(width.splatting)
        return width

    monkeypatch.setattr(module, "KernelWidth", spy)
    return found


def test_there_is_nothing_that_is_not_run():
    """Each block is of a kind that is run here, and each command is run here or elsewhere."""
    assert {kind for _, kind, _ in BLOCKS} == {"sh", "python"}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = extras["optional-dependencies"]
    for line in COMMANDS:
        line = re.sub(r"\s+#.*", "", line)
        named = re.search(r'pip install (?:-e )?"\.\[([\w,]+)\]"', line)
        if named:
            assert set(named[1].split(",")) <= set(extras), line
        if line in [re.sub(r"\s+#.*", "", other) for other in OURS]:
            continue
        if named and line == named[0]:
            continue  # an installation alone
        places = [place for text, place in ELSEWHERE.items() if re.fullmatch(text, line)]
        assert len(places) == 1, f"nothing runs {line!r}"
        path, words = places[0]
        assert words in (ROOT / path).read_text(), f"{path} runs {line!r} no longer"
    starts = [line for line in COMMANDS if line.startswith("python3 -m venv")]
    assert len(starts) == 2  # what .ci/run counts
    assert "clmorph demo" in starts[0]
    assert "pytest" in starts[1]


def test_options_that_are_named_exist():
    known = {"--version", "--help"}
    for command in cli.commands.values():
        for parameter in command.params:
            known |= {*parameter.opts, *parameter.secondary_opts}
    code = re.findall(r"`[^`\n]+`", README)
    named = {
        option
        for text in code
        if "tools/" not in text
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)
    }
    # Of tools/reproduce_paper.py and of the tests.
    scripts = {"--published": "tools", "--geomloss": "tools", "--quick": "tools", "--full": "tests"}
    assert len(named) > 40
    assert named - known <= set(scripts)
    for option, folder in scripts.items():
        assert any(f'"{option}"' in file.read_text() for file in (ROOT / folder).rglob("*.py"))


@pytest.mark.full
def test_commands(tmp_path, monkeypatch, capfd, ways, widths):
    """All of them, one after the other in one folder, as somebody types them."""
    assert len(OURS) >= 7
    monkeypatch.chdir(tmp_path)
    write_pictures()
    for name, limit in LIMITS.items():
        assert limit < defaults.PRESETS["photo"][name]
        monkeypatch.setitem(defaults.PRESETS["photo"], name, limit)
    for line in OURS:
        command = shlex.split(line, comments=True)[1:]
        ways.clear()
        widths.clear()
        assert main(command) == 0, (line, capfd.readouterr().err)
        pairs = itertools.pairwise(command)
        outputs = [word for option, word in pairs if option == "-o"]
        assert all(Path(name).stat().st_size > 1000 for name in outputs)
        assert outputs or "inspect" in command
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        assert all(name in out for name in outputs)
        sprites = "cat.png" in command or "--config" in command
        morphs = sum(name in PICTURES for name in command) - 1
        assert len(ways) == (1 if sprites else morphs), line
        if sprites:
            assert ways == [(1, {})]
        else:
            for finest, way in ways:
                assert finest == 4, line
                assert way.get("sample", 0) > 1, line
        if "inspect" not in command:
            assert set(widths) == {"local"}, line
    with Image.open("out.gif") as once, Image.open("again.gif") as again:
        assert once.n_frames == again.n_frames > 20
        for number in range(once.n_frames):
            once.seek(number)
            again.seek(number)
            assert np.array_equal(once.convert("RGB"), again.convert("RGB"))


@pytest.mark.full
def test_inspecting_photographs_within_the_presets_own_limits(tmp_path, monkeypatch, capfd, ways):
    """As small as they can be and still be drawn by a sample between cells."""
    monkeypatch.chdir(tmp_path)
    write_pictures(140)
    assert main(["inspect", "a.png", "b.jpg"]) == 0
    ((finest, way),) = ways
    assert finest == 4
    assert way["sample"] > 1
    assert "140 x 140 pixels in 70 x 70 cells" in capfd.readouterr().out


def photographs(side):
    return [clmorph.fit(clmorph.read_image(name), side) for name in ("a.png", "b.jpg")]


def tour_names(names):
    """What the reader of "A short tour" has."""
    a, b = photographs(10)
    return {"a": a, "b": b, "M": np.diag([1.0, 2.0, 1.0]), "map_a": np.ones(a.shape[:2])}


def solver_names(names):
    """What the reader of "The solver alone" has."""
    rng = np.random.default_rng(5)
    other = clmorph.sinkhorn_divergence(names["target"], names["target"], blur=0.05, reach=0.3)
    return {
        **{"a": rng.random(90), "x": rng.random((90, 3))},
        **{"b": rng.random(70), "y": rng.random((70, 3))},
        "other": other,
    }


#: Names that blocks use and do not define, by their headings.
GIVEN = {"A short tour": tour_names, "The solver alone": solver_names}


@pytest.mark.full
def test_python(tmp_path, monkeypatch):
    """All blocks in order, in one namespace; nothing of them warns."""
    monkeypatch.chdir(tmp_path)
    write_pictures()
    python = [(heading, text) for heading, kind, text in BLOCKS if kind == "python"]
    assert len(python) >= 4
    names = {}
    seen = set()
    for heading, text in python:
        where = f"README, {heading!r}"
        if names and heading in GIVEN:
            given = GIVEN[heading](names)
            seen.add(heading)
            used = {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}
            assert set(given) <= used, f"{where}: {set(given) - used} is not used"
            names.update(given)
        for statement in ast.parse(text, where).body:
            shown = isinstance(statement, ast.Expr)
            if shown and isinstance(statement.value, ast.Name):  # as a notebook shows it
                page = names[statement.value.id]._repr_html_()
                assert "<canvas" in page or "<iframe" in page
            exec(compile(ast.Module([statement], []), where, "exec"), names)
    assert seen == set(GIVEN)
    assert names["potentials"].converged
    for file in ("out.gif", "tour.webp", "out.npz"):
        assert Path(file).stat().st_size > 1000
