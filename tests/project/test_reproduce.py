"""Run the tool that makes the paper's tables and figures as users run it."""

import csv
import html
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

import clmorph

TOOLS = Path(__file__).parents[2] / "tools"
STORED = Path(__file__).parents[1] / "data" / "geomloss_displacements.csv"
FIGURES = [f"figure-{number}" for number in range(1, 9)]
CLAIMS = ["pruning", "debiasing", "readings", "threshold", "mass", "convergence"]
NAMES = ["table-1", "table-2", *FIGURES, *CLAIMS]
RULES = ("fixed", "adaptive", "adaptive-text", "none", "local", "optimal")
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
    for name in NAMES:
        assert f"\n{name}: " in done.stdout
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
    assert {row["rule"] for row in table} == set(RULES)
    value = {(row["to"], row["rule"], float(row["t"])): float(row["divergence"]) for row in table}
    for row in table:
        low, high = float(row["certainly at least"]), float(row["certainly at most"])
        assert low <= float(row["divergence"]) <= high < low + 1e-4
    for rule in RULES:
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
def test_what_is_said_of_splatting_follows_from_the_numbers(made):
    """Adaptive widths against fixed ones, and against no splatting (4.3)."""
    table = rows(made, "table-2")
    assert rows(made, "figure-7") == table
    own, fixed, none = (
        {
            float(row["t"]): [float(row[f"certainly at {end}"]) for end in ("least", "most")]
            for row in table
            if (row["to"], row["rule"]) == ("target", rule)
        }
        for rule in ("adaptive", "fixed", "none")
    )
    page = (made / "report.html").read_text(encoding="utf-8")
    said = re.search(
        "On this setup, between the ends, frames of the adaptive width are (.*?)Of 5", page
    )
    against = re.split("than those", said[1])
    for text, others in zip(against, (fixed, none), strict=False):
        nearer = {t for t in (0.25, 0.5, 0.75) if own[t][1] < others[t][0]}
        farther = {t for t in (0.25, 0.5, 0.75) if own[t][0] > others[t][1]}
        for word, times in (
            ("nearer to the target at t = ", nearer),
            ("farther from it at t = ", farther),
        ):
            found = re.search(f"{word}([0-9., and]*)", text)
            told = set(map(float, re.findall(r"\d+\.\d+", found[1]))) if found else set()
            assert told == times
    assert len(against) == 3
    assert "disproven" not in page


@pytest.mark.full
def test_readings_of_the_printed_parameters(made):
    table, one = rows(made, "readings"), rows(made, "table-1")
    for row, own in zip(table, one, strict=True):
        for column in ("max px", "mean px"):
            ours = float(row[f"{column} (blur and reach, cost ½d²)"])
            assert ours == pytest.approx(float(own[f"{column} (geomloss)"]), abs=1e-6)
    # The published 0.00 px at 0.01 are no epsilon and rho.
    literal = [float(table[-1][f"mean px (ε and ρ, cost {cost})"]) for cost in ("½d²", "d²")]
    assert min(literal) > 1 > 0.1 > float(table[-1]["mean px (blur and reach, cost ½d²)"])


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


@pytest.fixture
def small(paper, tmp_path):
    """The bundled pair at a size at which everything is quick, in float64."""
    from paper.pair import load_pair
    from paper.setting import Setting

    numpy = clmorph.get_backend("numpy")
    return Setting(load_pair(None, None), 10, True, numpy, tmp_path, published=True)


def test_the_authors_pair_is_recognized_by_its_table(small, monkeypatch):
    """By Table 1 to its last digit, at the published size; anything else is said to be that."""
    from paper import recognition
    from paper.setting import PUBLISHED_DISPLACEMENTS
    from paper.table1 import REACHES, entries, recognized, table_1

    unknown = recognized(small)
    assert unknown.same is None
    assert "10 × 10" in unknown.text
    monkeypatch.setattr(recognition, "PUBLISHED_SIZE", 10)
    other = recognized(small)
    assert other.same is False
    off = max(
        abs(value - published)
        for reach in REACHES
        for value, published in zip(
            (entries(small)["geomloss", reach].masked.max,
             entries(small)["geomloss", reach].masked.mean),
            PUBLISHED_DISPLACEMENTS[reach], strict=True,
        )
    )  # fmt: skip
    assert f"by up to {off:.2f} px" in other.text
    assert "another pair" in other.text
    (section,) = table_1(small)
    assert other.text in section.says
    assert "authors' pair</th>" in section.table.replace("&#x27;", "'")
    for reach in REACHES:
        masked = entries(small)["geomloss", reach].masked
        printed = round(masked.max, 2), round(masked.mean, 2)
        monkeypatch.setitem(PUBLISHED_DISPLACEMENTS, reach, printed)
    own = recognized(small)
    assert own.same
    assert "they are the authors' pair" in own.text
    (section,) = table_1(small)
    assert own.text in section.says
    assert ">published</th>" in section.table
    # One number that is not within its last digit is enough.
    largest, mean = PUBLISHED_DISPLACEMENTS[0.1]
    monkeypatch.setitem(PUBLISHED_DISPLACEMENTS, 0.1, (largest, mean + 0.02))
    assert recognized(small).same is False
    assert "at reach 0.1" in recognized(small).text


def test_which_reading_gives_the_published_table(small, monkeypatch):
    from paper import recognition
    from paper.readings import READINGS, readings
    from paper.setting import PUBLISHED_DISPLACEMENTS
    from paper.table1 import REACHES, entries

    (section,) = readings(small)
    assert "ends with 0.00 px at ρ = 0.01" in section.says
    monkeypatch.setattr(recognition, "PUBLISHED_SIZE", 10)
    for reach in REACHES:
        masked = entries(small)["geomloss", reach].masked
        monkeypatch.setitem(PUBLISHED_DISPLACEMENTS, reach, (masked.max, masked.mean))
    (section,) = readings(small)
    assert "to its last digit by blur and reach, cost ½d²; it is missed" in section.says
    assert sum(name in section.says for name in READINGS) == len(READINGS)


def test_readings_are_what_they_are_called(paper, rng):
    """Of the cost d², by points that are sqrt(2) as far apart."""
    from paper.readings import READINGS

    a, b = np.full(6, 1 / 6), np.full(7, 1 / 7)
    x, y = rng.random((6, 2)), rng.random((7, 2))
    for name, read in READINGS.items():
        own = {"blur": read(0.2), "reach": read(0.5)}
        words = {"blur": 0.2, "reach": 0.5}
        if name.startswith("ε"):
            words = {"epsilon": 0.2, "rho": 0.5}
        factor = 1.0 if name.endswith("½d²") else np.sqrt(2)
        plans = []
        for scale, options in ((1.0, own), (factor, words)):
            pair = (a, scale * x), (b, scale * y)
            potentials = clmorph.reference.sinkhorn(*pair, tol=1e-9, **options)
            plans.append(clmorph.reference.transport_plan(*pair, potentials))
        np.testing.assert_allclose(*plans, rtol=1e-6)


def test_debiased_potentials(small):
    """Against dense plans."""
    from paper.debiasing import _leak
    from paper.table1 import lifted

    source, target = lifted(small)
    for reach in (0.3, 0.8):
        cross, own, other = (
            clmorph.sinkhorn(*pair, 0.05, reach, 1e-5, backend="numpy")
            for pair in ((source, target), (source, source), (target, target))
        )
        plan = clmorph.reference.transport_plan(source, target, cross)
        factors = np.exp(-own.f / 0.05**2)[:, None] * np.exp(-other.g / 0.05**2)
        assert plan.sum() == pytest.approx(cross.transported_mass)
        leaky = plan * factors
        found = _leak(small, reach)
        assert found.mass == pytest.approx(plan.sum(), rel=1e-3)
        assert found.debiased_mass == pytest.approx(leaky.sum(), rel=1e-2)
        for axis, error in zip((1, 0), found.errors, strict=True):
            marginals = plan.sum(axis=axis), leaky.sum(axis=axis)
            wanted = np.abs(marginals[1] - marginals[0]).sum() / marginals[0].sum()
            assert error == pytest.approx(wanted, rel=1e-3)


def test_two_diracs_have_no_threshold(small, monkeypatch):
    """What is measured of two Diracs alone is the formula, on either side of 2 rho."""
    from paper import threshold

    for level in (0.25, 0.95, 1.05, 3.05):
        distance = np.sqrt(2 * level * 2 * 0.1**2)
        pair = [
            clmorph.WeightedPoints(np.array([[0.0]]), np.array([0.7])),
            clmorph.WeightedPoints(np.array([[distance]]), np.array([1.3])),
        ]
        monkeypatch.setattr(threshold, "lifted", lambda setting, pair=pair: pair)
        found = threshold._profile(small, 0.1)
        place = int(level * 10)
        assert found.moved[place] == pytest.approx(1)
        assert found.beyond == pytest.approx(float(level > 1))
        assert found.share[place] == pytest.approx(found.formula[place], rel=1e-3)


def test_transported_shares_by_cost(small):
    """Against the dense plan."""
    from paper.table1 import lifted
    from paper.threshold import EDGES, _profile

    source, target = lifted(small)
    cost = clmorph.reference.cost_matrix(source, target)
    potentials = clmorph.reference.sinkhorn(source, target, 0.05, 0.1, 1e-6)
    plan = clmorph.reference.transport_plan(source, target, potentials)
    shares = plan.sum(axis=1) / source.weights, plan.sum(axis=0) / target.weights
    both = np.sqrt(shares[0][:, None] * shares[1])
    level, found = cost / (2 * 0.1**2), _profile(small, 0.1)
    assert found.beyond == pytest.approx(plan[level >= 1].sum() / plan.sum(), rel=1e-3)
    some = 0
    for k, moved in enumerate(found.moved):
        inside = (level >= EDGES[k]) & (level < EDGES[k + 1])
        mass = plan[inside].sum()
        assert moved == pytest.approx(mass / plan.sum(), abs=1e-3)
        if mass > 0.01 * plan.sum():
            some += 1
            assert found.share[k] == pytest.approx((both * plan)[inside].sum() / mass, rel=1e-2)
    assert some > 5


def test_pruned_pairs(small):
    from paper.pruned import QUICK_SIDES, pruned

    (section,) = pruned(small)
    assert [row[0] for row in section.rows] == list(QUICK_SIDES)
    images = small.pair.as_published(QUICK_SIDES[0])
    source, target = (clmorph.lift(image, 2.0, extent="unit") for image in images)
    potentials = clmorph.sinkhorn(source, target, 0.05, 0.3, backend=small.operations)
    dense = clmorph.reference.transport_plan(source, target, potentials)
    _, absolute, relative, both, dropped, _ = section.rows[0]
    kept = dense > np.exp(-13)
    assert absolute == kept.sum()
    assert dropped == pytest.approx(100 * (1 - dense[kept].sum() / dense.sum()), abs=0.01)
    assert 0 < both <= min(absolute, relative)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
def test_the_whole_report_of_a_recognized_pair(small, monkeypatch, capfd, tmp_path):
    import reproduce_paper
    from paper import recognition
    from paper.setting import PUBLISHED_DISPLACEMENTS
    from paper.table1 import REACHES, entries

    monkeypatch.setattr(recognition, "PUBLISHED_SIZE", small.size)
    options = ["--quick", "--size", str(small.size), "--published"]
    for wanted, words in ((False, "another pair than the authors'"), (True, "the authors' pair.")):
        if wanted:
            for reach in REACHES:
                masked = entries(small)["geomloss", reach].masked
                printed = round(masked.max, 2), round(masked.mean, 2)
                monkeypatch.setitem(PUBLISHED_DISPLACEMENTS, reach, printed)
        folder = tmp_path / f"made-{wanted}"
        assert reproduce_paper.main(["--out", str(folder), *options]) == 0
        page = html.unescape((folder / "report.html").read_text(encoding="utf-8"))
        for text in (page, capfd.readouterr().out):
            assert words in text
            assert "at hand" not in text
            assert ("another pair" in text) != wanted


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


@pytest.mark.needs_device
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
    for text in (page, done.stdout):
        assert "The published Table 1 is of images of 48 × 48 pixels" in text
        assert "at hand" not in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--out"),
        (["--out", "x", "--size", "2"], "--size 2"),
        (["--out", "x", "--size", "large"], "--size"),
        (["--out", "x", "--source", "a.png"], "--target"),
        (["--out", "x", "--source", "no.png", "--target", "no.png"], "no.png"),
        pytest.param(
            ["--out", "x", "--device", "nobody's"], "nobody's", marks=pytest.mark.needs_device
        ),
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
