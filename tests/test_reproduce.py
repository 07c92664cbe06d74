"""The paper's tables and figures: the tool that makes them, run as users run it."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

TOOLS = Path(__file__).parents[1] / "tools"
STORED = Path(__file__).parent / "data" / "geomloss_displacements.csv"
FIGURES = [f"figure-{number}" for number in range(1, 9)]
NAMES = ["table-1", "table-2", *FIGURES, "mass", "convergence"]
#: By how much a displacement may differ from GeomLoss's own, in pixels.
AGREEMENT = 0.005


def run(*arguments, cwd):
    command = [sys.executable, TOOLS / "reproduce_paper.py", *arguments]
    environment = os.environ | {"MPLCONFIGDIR": str(cwd)}
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=cwd, env=environment
    )


def rows(folder, name):
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A quick run on the bundled pair."""
    folder = tmp_path_factory.mktemp("reproduction")
    done = run("--out", "made", "--quick", "--published", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "report.html" in done.stdout
    assert not done.stderr
    assert not list(folder.glob(".reproduction-*"))
    return folder / "made"


@pytest.fixture
def paper(monkeypatch):
    """The tool's package, importable."""
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.full
def test_every_file_is_there(made):
    wanted = {f"{name}.{ending}" for name in NAMES for ending in ("png", "csv")}
    wanted |= {"report.html", "source.png", "target.png"}
    assert {path.name for path in made.iterdir()} == wanted
    for name in NAMES:
        with Image.open(made / f"{name}.png") as picture:
            assert picture.width > 800
            assert len(picture.convert("RGB").getcolors(1 << 24)) > 20
        for row in rows(made, name):
            assert None not in row
            assert None not in row.values()


@pytest.mark.full
def test_the_page_stands_alone(made):
    page = (made / "report.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/png;base64,') == len(NAMES) + 2
    assert not re.search(r"https?:|<script|<link|@import|url\(", page)
    for name in NAMES:
        assert f'<section id="{name}">' in page
    assert len(re.findall('<p class="says">[^<]{20,}</p>', page)) == len(NAMES)
    text = re.sub("<[^>]*>", " ", re.sub('src="[^"]*"', "", page))
    assert not re.search(r"\bnan\b|\binf\b|\{|None", text.split("code { overflow-wrap")[-1])


@pytest.mark.full
def test_table_1(made):
    table = {row["reach"]: row for row in rows(made, "table-1")}
    assert list(table) == ["balanced", "0.5", "0.3", "0.1", "0.05", "0.01"]
    for method in ("geomloss", "certified"):
        mass = [float(row[f"mass moved ({method})"]) for row in table.values()]
        assert all(np.diff(mass) < 0)
        means = [float(row[f"mean px ({method})"]) for row in table.values()]
        assert means[-3] > means[-2] > means[-1]
        assert means[-1] < 0.05
    assert all(float(row["residual (certified)"]) < 1e-4 for row in table.values())
    assert all(float(row["residual (geomloss)"]) > 1e-4 for row in table.values())
    assert float(table["balanced"]["mass moved (certified)"]) == pytest.approx(1, abs=1e-5)
    for row in table.values():
        for column in ("max px", "mean px"):
            ours, theirs = (float(row[f"{column} ({of})"]) for of in ("geomloss", "GeomLoss"))
            assert abs(ours - theirs) < AGREEMENT
    assert float(table["0.3"]["mean px (published)"]) == 9.55


@pytest.mark.full
def test_table_2(made):
    table = rows(made, "table-2")
    assert {row["rule"] for row in table} == {
        "fixed", "adaptive", "adaptive-text", "local", "optimal",
    }  # fmt: skip
    value = {(row["to"], row["rule"], float(row["t"])): float(row["divergence"]) for row in table}
    for row in table:
        low, high = float(row["certainly at least"]), float(row["certainly at most"])
        assert low <= float(row["divergence"]) <= high < low + 1e-4
    for rule in ("fixed", "adaptive", "adaptive-text", "local", "optimal"):
        path = [value["target", rule, t] for t in (0.0, 0.25, 0.5, 0.75, 1.0)]
        assert all(np.diff(path) < 0)
    # The paper's columns agree at both ends, where its two widths do.
    for t in (0.0, 1.0):
        fixed, adaptive = value["target", "fixed", t], value["target", "adaptive", t]
        assert adaptive == pytest.approx(fixed, rel=1e-3)
    # No width is nearer to the particles than the one chosen for that.
    for t in (0.0, 0.25, 0.5, 0.75, 1.0):
        others = [value["particles", rule, t] for rule in ("fixed", "adaptive", "adaptive-text")]
        assert value["particles", "optimal", t] <= min(others)


@pytest.mark.full
def test_frames_converge(made):
    table = rows(made, "convergence")
    for reference in ("frame", "particles"):
        for rule in ("adaptive", "fixed"):
            values = [
                float(row["divergence"])
                for row in table
                if (row["to"], row["rule"]) == (reference, rule)
            ]
            assert values[-1] < 0.7 * values[0]


@pytest.mark.parametrize("size", [20, pytest.param(48, marks=pytest.mark.full)])
def test_displacements_are_geomlosss(paper, device, tmp_path, size):
    """Its own results in float64, written by ``tools/geomloss_displacements.py``."""
    from paper.geomloss import stored
    from paper.pair import load_pair
    from paper.setting import Setting
    from paper.table1 import REACHES, entries, largest_difference

    found = entries(Setting(load_pair(None, None), size, True, device, tmp_path))
    theirs = stored(size)
    assert tuple(theirs) == REACHES
    assert largest_difference(found, theirs) < AGREEMENT


def test_resizing_is_torchs(paper, rng):
    from paper.pair import resize_as_published

    image = rng.integers(0, 256, (12, 18, 4)) / 255
    whole = resize_as_published(image[:, :12], 12)
    assert np.abs(whole - image[:, :12, :3]).max() < 1e-7
    halves = image[:, :12, :3].reshape(6, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(resize_as_published(image[:, :12], 6) - halves).max() < 1e-6
    # Twice as large: pixels stand a quarter beside the old ones, and the border is held.
    row = np.array([[0.0, 1.0]]).repeat(2, axis=0)[..., None].repeat(3, axis=2)
    assert resize_as_published(row, 4)[0, :, 0] == pytest.approx([0, 0.25, 0.75, 1], abs=1e-6)
    # At any size: linear between the centers of pixels.
    y, x = ((np.arange(7) + 0.5) * side / 7 - 0.5 for side in (12, 18))
    wanted = [
        map_coordinates(
            image[..., channel], np.meshgrid(y, x, indexing="ij"), order=1, mode="nearest"
        )
        for channel in range(3)
    ]
    assert np.abs(resize_as_published(image, 7) - np.moveaxis(wanted, 0, -1)).max() < 1e-6


def test_any_two_images(tmp_path, rng):
    """One opaque and wide, one partly transparent and tall."""
    wide = rng.integers(0, 256, (9, 21, 3), dtype=np.uint8)
    tall = rng.integers(0, 256, (30, 14, 4), dtype=np.uint8)
    Image.fromarray(wide).save(tmp_path / "a.png")
    Image.fromarray(tall).save(tmp_path / "b.png")
    done = run(
        "--source", "a.png", "--target", "b.png", "--out", "made", "--quick", "--size", "8",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "made" / "report.html").read_text(encoding="utf-8")
    assert "a.png" in page
    assert "GeomLoss itself" not in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--out"),
        (["--out", "x", "--size", "2"], "--size 2"),
        (["--out", "x", "--size", "large"], "--size"),
        (["--out", "x", "--source", "a.png"], "--target"),
        (["--out", "x", "--source", "no.png", "--target", "no.png"], "no.png"),
        (["--out", "x", "--device", "nobody's"], "nobody's"),
        (["--out", "full"], "new or empty"),
        (["--out", "missing/x"], "missing"),
        (["--out", "x", "--unknown"], "--unknown"),
    ],
)
def test_mistakes(tmp_path, arguments, words):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("kept")
    done = run(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "x").exists()
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]
