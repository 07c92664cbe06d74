"""The site: its examples and tools, and the built pages in a browser.

`CLMORPH_SITE` names the folder ``html`` of a build; `.ci/run` makes one and sets it.
"""

import ast
import os
import re
import sys
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from browsers import watched

ROOT = Path(__file__).parents[2]
SITE = ROOT / "tools" / "site"
sys.path.insert(0, str(SITE))
import build  # noqa: E402

#: The examples that answer the eight tasks of `tools/site/tasks.md`.
TASKS = (
    "films/photographs", "films/faces", "transport/unbalanced", "transport/gradient",
    "devices/cross_check", "transport/batch", "transport/torch_flow", "devices/choice",
)  # fmt: skip
#: Pages of each kind.
PAGES = (
    "index.html", "README.html", "gallery/index.html", "gallery/films/sprites.html",
    "gallery/transport/unbalanced.html", "clmorph-api.html", "api/clmorph.sinkhorn.html",
    "clmorph/transport/README.html", "tools/README.html",
)  # fmt: skip


# --- the source ---------------------------------------------------------------------------


def test_examples_are_many_short_and_drawn():
    examples = build.examples()
    assert len(examples) >= 24
    assert {name.split("/")[0] for name in examples} == set(build.GROUPS)
    for name, file in examples.items():
        tree = ast.parse(file.read_text("utf-8"))
        assert ast.get_docstring(tree), name
        assert file.read_text("utf-8").count("\n") < (140 if "lesson" in name else 75), name
        calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        assert calls & {"plt.subplots", "plt.figure", "found.plot"}, name


def test_a_share_runs_without_large_libraries():
    examples = build.examples()
    assert set(build.SHARE) <= set(examples)
    large = {"torch", "jax", "ott", "geomloss"}
    for name in build.SHARE:
        imported = set(re.findall(r"^(?:import|from) (\w+)", examples[name].read_text(), re.M))
        assert not imported & large, name
    paths = {name: f"/any/where/{name}.py" for name in examples}
    for run in ("all", "share", "none"):
        found = [name for name, path in paths.items() if re.search(build.pattern(run), path)]
        assert found == [name for name in examples if name in build.chosen(run)]


def test_what_is_not_installed_is_named(tmp_path):
    file = tmp_path / "example.py"
    file.write_text("import numpy.linalg\nfrom absent_library.part import thing\nimport os\n")
    assert build.missing(file) == ["absent_library"]


def test_every_public_name_has_a_place():
    text = build.reference()
    assert "   sinkhorn\n" in text
    assert "   reference.sinkhorn\n" in text


def test_pages_are_staged_at_their_places_and_nothing_stays(tmp_path):
    (tmp_path / "old.md").write_text("gone")
    (tmp_path / "gallery").mkdir()
    (tmp_path / "gallery" / "kept.md5").write_text("a result")
    build.stage(tmp_path)
    front = (ROOT / "README.md").read_text().replace("](.github/", "](github/")
    assert (tmp_path / "README.md").read_text() == front
    assert (tmp_path / "github/CONTRIBUTING.md").is_file()
    assert (tmp_path / "clmorph/transport/README.md").is_file()
    assert (tmp_path / "tools/pictures/flow.png").is_file()
    assert (tmp_path / "gallery" / "kept.md5").is_file()
    assert not (tmp_path / "old.md").exists()


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#there"></a><a href="b.html#gone"></a><img src="none.png">'
        '<a href="#here"></a><a href="#away"></a><p id="here"></p><a href="https://x.org/y"></a>'
    )
    (tmp_path / "b.html").write_text('<p id="there"></p>')
    assert build.broken_links(tmp_path) == [
        "a.html: no place b.html#gone",
        "a.html: no file none.png",
        "a.html: no place #away",
    ]


def test_output_in_the_repository_is_refused(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["build.py", str(ROOT / "out")])
    with pytest.raises(SystemExit) as ended:
        build.main()
    assert ended.value.code == 2
    assert "outside of the repository" in capsys.readouterr().err


# --- the built pages ----------------------------------------------------------------------


@pytest.fixture
def html():
    folder = os.environ.get("CLMORPH_SITE")
    if not folder:
        pytest.skip("CLMORPH_SITE names no built site")
    return Path(folder)


@pytest.fixture
def opened(browser, html):
    """A function that opens a page of the site, which may ask for files of the site alone."""
    with watched(browser) as (open_page, bad):

        def opened(name, **options):
            return open_page(f"{html.as_uri()}/{name}", [html.as_uri()], **options)

        yield opened
        # The theme tells what it does.
        assert not [each for each in bad if not each.startswith(("[PST]", "Got invalid theme"))]


def links(file):
    """The pages that a page leads to."""
    found = {urlsplit(link).path for link in build.Page(file).links if "://" not in link}
    return {(file.parent / path).resolve() for path in found if path.endswith(".html")}


def test_each_task_is_within_two_clicks(html):
    first = links(html / "index.html")
    second = set().union(*(links(page) for page in first))
    for task in TASKS:
        assert (html / "gallery" / f"{task}.html").resolve() in first, task
    for name in build.examples():
        assert (html / "gallery" / f"{name}.html").resolve() in first | second, name


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_pages_fit_and_can_be_read(opened, width, scheme):
    for name in PAGES:
        page = opened(name, color_scheme=scheme, viewport={"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        colors = page.evaluate(
            """() => [document.querySelector("article p, article li") || document.body,
                      document.body].map((e, i) =>
                getComputedStyle(e)[i ? "backgroundColor" : "color"])"""
        )
        text, ground = (np.mean([float(x) for x in re.findall(r"[\d.]+", c)[:3]]) for c in colors)
        assert (ground < 60 and text > 150) if scheme == "dark" else (ground > 200 and text < 100)
        absent = page.evaluate(
            """async () => {
                const images = [...document.images];
                images.forEach(image => { image.loading = "eager"; });
                await Promise.all(images.map(image => image.decode().catch(() => 0)));
                return images.filter(image => !image.naturalWidth).map(image => image.src);
            }"""
        )
        assert not absent, name


def test_a_film_plays_in_its_page(opened):
    page = opened("gallery/films/sprites.html")
    frame = page.frame_locator("iframe")
    frame.locator("canvas").first.wait_for()
    # The player enlarges the frames to its room when it has opened them.
    for _ in range(100):
        if frame.locator("canvas").first.bounding_box()["width"] > 100:
            break
        page.wait_for_timeout(100)
    else:
        pytest.fail("the film stays as small as it is")
    assert page.locator("iframe").get_attribute("title") == "Morph of 10 × 8 pixels"


@pytest.mark.parametrize(
    ("words", "wanted"), [("unbalanced plan", "unbalanced"), ("divergence_matrix", "matrix")]
)
def test_search_needs_no_network(opened, words, wanted):
    page = opened(f"search.html?q={words.replace(' ', '+')}")
    page.context.set_offline(True)
    results = page.locator("ul.search li a")
    results.first.wait_for()
    assert any(wanted in (link.get_attribute("href") or "") for link in results.all())
