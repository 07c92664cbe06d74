"""What results show in a notebook: their own pictures, which load nothing."""

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

import clmorph
from clmorph._shared import notebook
from clmorph._shared.notebook import CELLS, interval, table
from clmorph.analysis.figures import check_plotting
from clmorph.errors import OutputError


def shown(html):
    """The picture and the line of an HTML representation, which must be well formed."""
    root = ET.fromstring(re.sub(r"(<img [^>]*)>", r"\1/>", html))
    assert not re.search(r"https?://|<script", html)
    uri = root.find(".//img").get("src")
    assert uri.startswith("data:image/png;base64,")
    picture = Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2])))
    return np.asarray(picture.convert("RGB")), "".join(root.find(".//figcaption").itertext())


@pytest.fixture(scope="module")
def pair():
    left, right = np.zeros((2, 6, 8, 3))
    left[:, :4] = right[:, 4:, 1] = 1.0
    return left, right


def test_a_plan_shows_where_its_masses_are():
    points = np.linspace(0, 1, 6)
    masses = np.full(6, 1 / 6)
    potentials = clmorph.sinkhorn((masses, points), (masses, points), 0.02, backend="numpy")
    plan = clmorph.transport_plan((masses, points), (masses, points), potentials, backend="numpy")
    pixels, line = shown(plan._repr_html_())
    assert pixels.shape[:2] == (6, 6)
    dark = pixels.sum(axis=2) < 300
    assert np.array_equal(dark, np.eye(6, dtype=bool))
    assert line == repr(plan)[1:-1]


def test_a_large_plan_sums_neighbors(rng):
    rows, columns = rng.integers(0, 1000, 500), rng.integers(0, 7, 500)
    pixels, line = shown(table(rows, columns, np.ones(500), (1000, 7), "a < b & c"))
    assert pixels.shape[:2] == (CELLS, 7)
    assert pixels.min() == 0  # the largest sum is the darkest shade
    assert line == "a < b & c"
    empty, _ = shown(table(rows[:0], columns[:0], np.zeros(0), (1000, 7), "nothing"))
    assert (empty == 255).all()


@pytest.mark.parametrize(
    ("value", "low", "high"),
    [(0.5, 0.4, 0.6), (0.0, -0.1, 0.1), (0.0, 0.0, 0.0), (1.0, 0.5, np.inf), (1e-12, -np.inf, 1)],
)
def test_an_interval_is_drawn_on_a_line(value, low, high):
    root = ET.fromstring(interval(value, low, high, "S"))
    rect, circle = root.find(".//rect"), root.find(".//circle")
    left, width = float(rect.get("x")), float(rect.get("width"))
    assert left - 2 <= float(circle.get("cx")) <= left + width + 2
    whole = float(root.find("svg").get("width"))
    assert left >= 0
    assert left + width <= whole


def test_a_divergence_shows_its_interval():
    masses, points = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    found = clmorph.sinkhorn_divergence(
        (masses, points), (masses, points + 0.3), 0.1, 0.3, backend="numpy"
    )
    root = ET.fromstring(found._repr_html_())
    assert f"{found.value:.5g}" in [text.text for text in root.iter("text")]
    assert "certainly within" in "".join(root.itertext())


def test_mixes_show_their_sheet(pair):
    mixes = clmorph.mix(pair, grid=3, backend="numpy")
    pixels, line = shown(mixes._repr_html_())
    assert np.array_equal(pixels, mixes.sheet())
    assert line == "Mixes of 2 images, 3 pictures"


def test_a_recolored_picture_is_shown_and_remains_an_array(pair):
    found = clmorph.recolor(*pair, backend="numpy")
    assert isinstance(found, clmorph.Recolored)
    pixels, line = shown(found._repr_html_())
    assert np.array_equal(pixels, np.rint(255 * np.asarray(found)).astype(np.uint8))
    assert line == "Recolored picture, 8 × 6 pixels"
    # What is no picture any more shows its numbers.
    assert found[..., 0]._repr_html_() is None
    changed = found.copy()
    changed[0, 0] = 2.0
    assert changed._repr_html_() is None
    assert type(found - 1) is np.ndarray  # what is calculated from it is a plain array
    assert type(found.sum(axis=0)) is np.ndarray
    assert found[:0]._repr_html_() is None
    assert isinstance(found.mean(), float)


def test_films_are_titled_by_what_they_are(pair):
    morph = clmorph.morph(*pair, n_frames=2, blur=0.1, backend="numpy")
    assert morph.title == "Morph of 8 × 6 pixels"
    wider = clmorph.morph(pair[0], np.ones((6, 9, 3)), n_frames=2, blur=0.1, backend="numpy")
    assert wider.title == "Morph of 8 × 6 into 9 × 6 pixels"
    mosaic = clmorph.morph(*pair, preset="mosaic", n_frames=2, backend="numpy")
    assert mosaic.title == "Mosaic of 8 × 6 pixels"
    rearranged = clmorph.rearrange(*pair, n_frames=2, backend="numpy")
    assert rearranged.title == "Rearrangement of 8 × 6 pixels"
    html = rearranged._repr_html_()
    assert 'title="Rearrangement of 8 × 6 pixels"' in html
    assert "&lt;title&gt;Rearrangement of 8 &amp;#215; 6 pixels" in html


@pytest.mark.full
def test_an_inspection_is_drawn_shown_and_saved(pair, tmp_path, monkeypatch):
    import matplotlib.pyplot as plt
    from matplotlib.testing.compare import compare_images

    found = clmorph.inspect(*pair, blur=0.1, backend="numpy")
    open_before, settings = plt.get_fignums(), dict(plt.rcParams)
    pixels, line = shown(found._repr_html_())
    found.save(tmp_path / "saved.png")
    assert plt.get_fignums() == open_before  # nothing is left to pyplot
    saved = np.asarray(Image.open(tmp_path / "saved.png").convert("RGB"))
    assert np.array_equal(pixels, saved)
    assert line == repr(found)[1:-1]

    # Ticks are drawn later, in the settings of then; all else is the same.
    figure = found.plot()
    assert plt.get_fignums() == [*open_before, figure.number]
    figure.savefig(tmp_path / "plotted.png", dpi=130)
    plt.close(figure)
    assert dict(plt.rcParams) == settings
    assert compare_images(tmp_path / "saved.png", tmp_path / "plotted.png", 5) is None
    with pytest.raises(OutputError, match="unknown ending"):
        found.save(tmp_path / "report.gif")


def test_an_inspection_without_matplotlib_shows_its_numbers(pair, monkeypatch):
    found = clmorph.inspect(*pair, blur=0.1, divergence=False, backend="numpy")

    def missing(name):
        raise ImportError("none")

    monkeypatch.setattr("clmorph.analysis.figures.importlib.import_module", missing)
    assert found._repr_html_().startswith("<pre>source")
    for draw in (found.plot, lambda: found.save("report.png"), check_plotting):
        with pytest.raises(OutputError, match=r'pip install "clmorph\[plot\]"'):
            draw()


def test_small_pictures_are_enlarged_as_squares():
    html = notebook.picture(np.zeros((4, 8, 3), np.uint8), "x")
    assert "width:360px" in html
    assert "pixelated" in html
    large = notebook.picture(np.zeros((4, 800, 3), np.uint8), "x")
    assert "pixelated" not in large
    huge, _ = shown(notebook.picture(np.zeros((30, 4096, 3), np.uint8), "x"))
    assert huge.shape == (8, notebook.LARGEST, 3)
