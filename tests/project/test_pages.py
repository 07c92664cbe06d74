"""Every command and every block of Python in the pages runs without changes, and names exist.

Photographs are so large beside the limits that they are reduced, and solved between blocks of
pixels.
"""

import ast
import importlib
import itertools
import re
import shlex
import signal
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import av
import numpy as np
import pytest
from comfyui_stand_in import make_folder
from conftest import NO_DEVICE, TESTED
from PIL import Image
from skimage import data

import clmorph
from clmorph.cli.main import cli, main
from clmorph.output.save import FORMATS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS

ROOT = Path(__file__).parents[2]
#: Every page by its path.
PAGES = {
    str(path.relative_to(ROOT)): path.read_text("utf-8")
    for pattern in ("*.md", ".github/*.md", "clmorph/**/*.md", "tools/*.md", "tests/*.md")
    for path in sorted(ROOT.glob(pattern))
}
#: The main page, and what changed in the past, which may name what is no longer there.
README, CHANGES = "README.md", "CHANGELOG.md"
#: The limits of the default preset, so much smaller that all commands together take seconds.
#: Photographs are larger and their plans have more pairs all the same, as with its own limits.
LIMITS = {"size": 48, "solve_size": 24, "max_particles": 12_000}
TOOLS = "tests/project/test_tools.py"
#: Commands that take minutes or install something: what runs them, and words that show it there.
ELSEWHERE = {
    r"python3 -m venv .* && \.venv/bin/clmorph demo": (".ci/run", "readme_command 1"),
    r"python3 -m venv .* && \.venv/bin/pytest": (".ci/run", "readme_command 2"),
    r"ruff (check|format) \.": (".ci/run", "ruff format --check ."),
    r"lint-imports": (".ci/run", "bin/lint-imports"),
    r"mypy": (".ci/run", "bin/mypy"),
    r"pytest": (".ci/run", "readme_command 2"),
    r"python tools/fuzz\.py (images|configs|api) --count \d+": (TOOLS, "fuzz.py"),
    r"python tools/faults\.py .*": (TOOLS, "import faults"),
    r"python tools/cross_check\.py .*": ("tests/project/test_cross_check.py", "import cross_check"),
    r"clmorph batch .*": ("tests/batch/test_dask_batches.py", '["batch", '),
    r"python tools/site/build\.py .*": (".ci/run", "tools/site/build.py"),
    r"python tools/compare_peers\.py .*": (TOOLS, "import compare_peers"),
}
PICTURES = {"a.png": "astronaut", "b.jpg": "coffee", "c.png": "chelsea", "d.jpg": "rocket"}


def blocks(page):
    """Fenced blocks of a page as (heading, kind, text), whatever they hold."""
    heading, kind, lines = "", None, []
    for line in PAGES[page].splitlines():
        if kind is None and line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("```") and kind is None:
            kind, lines = line[3:], []
        elif line.startswith("```"):
            yield heading, kind, "\n".join(lines) + "\n"
            kind = None
        elif kind is not None:
            lines.append(line)
    assert kind is None, f"{page}: a block that does not end"


BLOCKS = [(page, *block) for page in PAGES for block in blocks(page)]
#: Commands as (page, line).
COMMANDS = [
    (page, line)
    for page, _, kind, text in BLOCKS
    if kind == "sh"
    for line in text.splitlines()
    if line.strip()
]
#: Commands that start workers; tests of their own run them.
BATCHES = "clmorph batch "
OURS = {
    page: [
        line
        for other, line in COMMANDS
        if other == page and line.startswith("clmorph ") and not line.startswith(BATCHES)
    ]
    for page in PAGES
}
#: Words in code, without line breaks; blocks are left out.
CODE = {
    page: re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    for page, text in PAGES.items()
}


def write_pictures(longer=None):
    """Make the pictures that the pages name, in the current folder."""
    for name, photograph in PICTURES.items():
        picture = Image.fromarray(getattr(data, photograph)())
        if longer:
            picture.thumbnail((longer, longer))
        picture.save(name)
    for name, sprite in (("cat.png", "cat"), ("dog.png", "toadstool")):
        with Image.open(ROOT / f"clmorph/cli/samples/{sprite}.png") as picture:
            picture.save(name)
    clip = av.open("clip.mp4", "w")
    stream = clip.add_stream("libx264", rate=5, width=96, height=64, pix_fmt="yuv420p")
    for k in range(5):
        picture = Image.fromarray(data.chelsea()).crop((9 * k, 9 * k, 300 + 9 * k, 200 + 9 * k))
        clip.mux(stream.encode(av.VideoFrame.from_image(picture.resize((96, 64)))))
    clip.mux(stream.encode(None))
    clip.close()


def set_limits(monkeypatch):
    """Let photographs have these limits."""
    for name, limit in LIMITS.items():
        assert limit < getattr(MorphOptions(), name)
        monkeypatch.setitem(PRESETS["photo"].options, name, limit)


def test_there_is_nothing_that_is_not_run():
    """Each block is of a kind that is run here, and each command is run here or elsewhere."""
    assert {kind for _, _, kind, _ in BLOCKS} == {"sh", "python", "text"}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = extras["optional-dependencies"]
    for page, line in COMMANDS:
        line = re.sub(r"\s+#.*", "", line)
        named = re.search(r'pip install (?:-e )?"\.\[([\w,]+)\]"', line)
        if named:
            assert set(named[1].split(",")) <= set(extras), line
        if line.startswith("clmorph ") and not line.startswith(BATCHES):
            continue
        if named and line == named[0]:
            continue  # an installation alone
        places = [place for text, place in ELSEWHERE.items() if re.fullmatch(text, line)]
        assert len(places) == 1, f"{page}: nothing runs {line!r}"
        path, words = places[0]
        assert words in (ROOT / path).read_text(), f"{path} runs {line!r} no longer"
    starts = [line for page, line in COMMANDS if line.startswith("python3 -m venv")]
    assert len(starts) == 2  # what .ci/run counts
    assert "clmorph demo" in starts[0]
    assert "pytest" in starts[1]


def test_the_main_page_is_short():
    assert PAGES[README].count("\n") <= 150


def test_options_that_are_named_exist():
    """Options of clmorph, or of the tools and tests on the pages about these."""
    known = {"--version", "--help", "--no-"}
    for command in cli.commands.values():
        for parameter in command.params:
            known |= {*parameter.opts, *parameter.secondary_opts}
    scripts = [*(ROOT / "tools").rglob("*.py"), ROOT / "tests" / "conftest.py"]
    of_scripts = set(re.findall(r'"(--[a-z][a-z-]*)"', "".join(map(Path.read_text, scripts))))
    total = set()
    for page, code in CODE.items():
        named = {
            option
            for text in code
            if "tools/" not in text
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)
        }
        others = set() if page in (README, "clmorph/cli/README.md") else of_scripts
        unknown = {option for option in named - known - others if page != CHANGES}
        assert not unknown, f"{page}: {unknown}"
        total |= named
    assert len(total) > 40


@pytest.mark.parametrize("page", sorted(set(PAGES) - {CHANGES}))
def test_commands_of_tools_name_tools_and_their_options(page):
    lines = [line for other, line in COMMANDS if other == page] + CODE[page]
    for line in lines:
        found = re.match(r"python (tools/\w+\.py)(.*)", line)
        if not found:
            continue
        assert (ROOT / found[1]).exists(), f"{page}: {line}"
        text = (ROOT / found[1]).read_text()
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", re.sub(r"\s#.*", "", found[2])):
            assert f'"{option}"' in text, f"{page}: {line}"


@pytest.mark.parametrize("page", sorted(set(PAGES) - {CHANGES}))
def test_links_and_files_that_are_named_exist(page):
    """Links lead somewhere; what looks like a file in code is one, here or below the package."""
    folder = (ROOT / page).parent
    for target in re.findall(r"\]\(([^)\s]+)\)", PAGES[page]):
        if "://" not in target:
            assert (folder / target.partition("#")[0]).exists(), f"{page}: {target}"
    package = ROOT / "clmorph"
    for text in CODE[page]:
        if not re.fullmatch(r"[\w./-]+(\.(py|pyi|cl|md|toml|cff)|/)", text) or "NAME" in text:
            continue
        if "/" in text:
            places = (folder / text, ROOT / text, package / text)
            assert any(path.exists() for path in places), f"{page}: {text}"
        else:
            found = [*ROOT.glob(text)] + [
                path for top in ("clmorph", "tests", "tools", "cl_kernels")
                for path in (ROOT / top).rglob(text)
            ]  # fmt: skip
            assert found, f"{page}: {text}"


def test_names_in_the_package_that_are_named_exist():
    """`clmorph.x` and `module.name` in the pages."""
    for page, code in CODE.items():
        for text in code:
            found = re.match(r"clmorph\.(\w+)", text)
            if found and page != CHANGES:
                assert hasattr(clmorph, found[1]) or found[1] == "analysis", f"{page}: {text}"


def test_tools_are_listed():
    listed = set(re.findall(r"`(\w+\.py)`", PAGES["tools/README.md"]))
    assert {path.name for path in (ROOT / "tools").glob("*.py")} <= listed


def test_presets_formats_and_options_are_listed():
    for preset in (AUTO, *PRESETS):
        assert f"| `{preset}`" in PAGES[README]
    for format in FORMATS.values():
        assert all(f"`{ending}`" in PAGES[README] for ending in format.endings[:1] if ending)
    sys.path.insert(0, str(ROOT / "tools"))
    table = importlib.import_module("make_option_table")
    for options in table.STARTS:
        written = table.STARTS[options] + table.table(options) + table.END
        assert written in PAGES["clmorph/cli/README.md"], "run tools/make_option_table.py"


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    version = project["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {version}" in PAGES[CHANGES].splitlines()[2]


def assert_served(command):
    """A command that serves until a signal ends it says where, and ends."""
    command = [sys.executable, "-m", "clmorph", *command, "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        timer = threading.Timer(60, process.kill)
        timer.start()
        try:
            assert "http://127.0.0.1:" in process.stderr.readline(), command
        finally:
            process.terminate()
            timer.cancel()
        assert process.wait(20) == 128 + signal.SIGTERM


@pytest.mark.full
@pytest.mark.parametrize("page", [page for page, lines in OURS.items() if lines])
def test_commands(page, tmp_path, monkeypatch, capfd):
    """All of them, one after the other in one folder, as somebody types them."""
    monkeypatch.chdir(tmp_path)
    # Larger than the limits, and small where every pixel is moved.
    write_pictures(80)
    set_limits(monkeypatch)
    for line in OURS[page]:
        command = shlex.split(line, comments=True)[1:]
        if command[0] in ("devices", "check") and not TESTED:
            continue
        command = [TESTED[0].index if word == "NAME" else word for word in command]
        if command[0] == "check" and "--kernel" not in command:
            command += ["--kernel", "color_table"]  # `tests/cli/test_check.py` compares all
        if command[0] == "studio":
            assert_served(command)
            continue
        if command[0] == "comfyui":
            make_folder(Path(command[1]))
            assert main(command) == 0
            continue
        assert main(command) == 0, (line, capfd.readouterr().err)
        pairs = itertools.pairwise(command)
        outputs = [word for option, word in pairs if option in ("-o", "--report")]
        assert all(Path(name).stat().st_size > 1000 for name in outputs)
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        if command[0] in ("devices", "check"):
            assert command[0] == "devices" or "nearest its tolerance" in out, line
            continue
        assert outputs or "inspect" in command
        assert all(name in out for name in outputs)
    if not Path("again.gif").exists():
        return
    with Image.open("out.gif") as once, Image.open("again.gif") as again:
        assert once.n_frames == again.n_frames > 20
        for number in range(once.n_frames):
            once.seek(number)
            again.seek(number)
            assert np.array_equal(once.convert("RGB"), again.convert("RGB"))


@pytest.mark.full
def test_inspecting_photographs_within_the_presets_own_limits(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    write_pictures(256)
    assert main(["inspect", "a.png", "b.jpg"]) == 0
    assert "256 x 256 pixels in 64 x 64 " in capfd.readouterr().out


def photographs(side):
    return [clmorph.fit(clmorph.read_image(name), side) for name in ("a.png", "b.jpg")]


def two(side, *names):
    """Two photographs by the names that a page gives them."""
    return dict(zip(names, photographs(side), strict=True))


def solver_names(names):
    """What the reader of the page about the solver has."""
    rng = np.random.default_rng(5)
    source, target = map(clmorph.lift, photographs(10))
    other = clmorph.sinkhorn_divergence(target, target, blur=0.05, reach=0.3)
    return {
        **{"a": rng.dirichlet(np.ones(90)), "x": rng.random((90, 3))},
        **{"b": rng.dirichlet(np.ones(70)), "y": rng.random((70, 3))},
        **{"source": source, "target": target, "other": other},
    }


def barycenter_names(names):
    """Two densities on the grid of the page."""
    y, x = np.mgrid[0:16, 0:16] / 15
    places = ("bump_a", 0.3, 0.4), ("bump_b", 0.7, 0.6)
    bumps = {name: np.exp(-((x - a) ** 2 + (y - b) ** 2) / 0.02) for name, a, b in places}
    return {name: bump / bump.sum() for name, bump in bumps.items()}


def many_names(names):
    """What the reader has where many problems are solved at once."""
    rng = np.random.default_rng(6)
    return {
        **{"all_a": rng.random((4, 9)), "all_x": rng.random((4, 9, 3))},
        **{"all_b": rng.random((4, 7)), "all_y": rng.random((4, 7, 3))},
        "sources": [(rng.random(n), rng.random((n, 3))) for n in (5, 1, 8, 3)],
        "targets": [(rng.random(n), rng.random((n, 3))) for n in (2, 6, 8, 1)],
        "measures": [(rng.random(n), rng.random((n, 3))) for n in (5, 1, 8)],
    }


def host_names(names):
    """What a program with arrays on a device has."""
    from pyopencl.array import to_device

    rng = np.random.default_rng(5)
    operations = clmorph.get_backend()
    if not hasattr(operations, "queue"):
        pytest.skip(NO_DEVICE)
    queue = operations.queue
    arrays = {f"picture_{each}": rng.random((12, 16, 3), np.float32) for each in "ab"}
    arrays |= {f"points_{each}": rng.random((90, 2), np.float32) for each in "ab"}
    arrays |= {f"masses_{each}": np.full(90, 1 / 90, np.float32) for each in "ab"}
    made = {name: to_device(queue, array) for name, array in arrays.items()}
    return {"queue": queue, **made}


def density_names(names):
    y, x = np.mgrid[:24, :24] / 23
    first, second = (np.exp(-50 * ((x - at) ** 2 + (y - 0.5) ** 2)) for at in (0.3, 0.7))
    total = second.sum() / first.sum()
    return {"clmorph": clmorph, "histogram_a": first * total, "histogram_b": second}


def batch_names(names):
    """A client, whose scheduler and worker are threads of this process."""
    from distributed import Client

    client = Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None)
    OPEN.append(client)
    rng = np.random.default_rng(0)
    return {"client": client, "measures": [(rng.random(n), rng.random((n, 2))) for n in (3, 4)]}


#: Names that blocks use and do not define, by their pages and headings.
GIVEN = {
    ("clmorph/frames/README.md", "Densities"): density_names,
    ("clmorph/batch/README.md", "From Python"): batch_names,
    ("clmorph/adapters/README.md", "Interfaces of other libraries"): lambda names: dict(
        zip(("X_a", "X_b"), np.random.default_rng(0).random((2, 20, 2)), strict=True)
    ),
    ("clmorph/backends/README.md", "In your own OpenCL program"): host_names,
    ("clmorph/pipeline/README.md", "What decides what moves, and how"): lambda names: {
        **two(10, "a", "b"),
        "M": np.diag([1.0, 2.0, 1.0]),
        "map_a": np.ones((10, 10)),
    },
    ("clmorph/pipeline/README.md", "Landmarks"): lambda names: two(40, "face_a", "face_b"),
    ("clmorph/pipeline/README.md", "Labels"): lambda names: {
        "np": np,
        **two(40, "first", "second"),
    },
    ("clmorph/transport/README.md", "The solver alone"): solver_names,
    ("clmorph/transport/README.md", "Barycenters"): barycenter_names,
    ("clmorph/transport/README.md", "Many problems at once"): many_names,
    ("clmorph/transport/README.md", "Maps"): lambda names: {
        "points": np.random.default_rng(7).random((30, names["target"].points.shape[1]))
    },
}
#: Clients of Dask that a page has opened.
OPEN = []
#: Files that blocks leave.
LEFT = {
    README: ("out.gif",),
    "clmorph/pipeline/README.md": (
        "out.gif",
        "tour.webp",
        "out.npz",
        "recolored.png",
        "look.cube",
        "recolored.mp4",
    ),
}


@pytest.mark.full
@pytest.mark.parametrize(
    "page", list(dict.fromkeys(page for page, _, kind, _ in BLOCKS if kind == "python"))
)
def test_python(page, tmp_path, monkeypatch):
    """All blocks of a page in order, in one namespace; nothing of them warns."""
    monkeypatch.chdir(tmp_path)
    set_limits(monkeypatch)
    write_pictures(64)
    names, seen = {}, set()
    for other, heading, kind, text in BLOCKS:
        if (other, kind) != (page, "python"):
            continue
        where = f"{page}, {heading!r}"
        if (page, heading) in GIVEN and heading not in seen:
            given = GIVEN[page, heading](names)
            seen.add(heading)
            used = {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}
            assert set(given) <= used, f"{where}: {set(given) - used} is not used"
            names.update(given)
        for statement in ast.parse(text, where).body:
            shown = isinstance(statement, ast.Expr)
            if shown and isinstance(statement.value, ast.Name):  # as a notebook shows it
                shown_page = names[statement.value.id]._repr_html_()
                assert "<canvas" in shown_page or "<iframe" in shown_page
            exec(compile(ast.Module([statement], []), where, "exec"), names)
    assert seen == {heading for other, heading in GIVEN if other == page}
    while OPEN:
        OPEN.pop().close()
    for file in LEFT.get(page, ()):
        assert Path(file).stat().st_size > 1000
