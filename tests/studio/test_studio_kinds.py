"""Test the studio's kinds of work, its brush, and what it lays over a film, in a browser."""

import hashlib
import io
import json

import numpy as np
import pytest
from PIL import Image
from studio_pages import after, fetched, fill, frame, previewed, run, same_by, take, until

import clmorph
from clmorph.studio.making import unmatched_shares
from clmorph.studio.painting import LEVEL, read_painted


def stroke(page, side, start, end):
    """Paint a line on a picture, from and to shares of its box, and wait for the preview."""
    box = page.locator("#shown .frame").nth(side).bounding_box()
    ends = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in (start, end)]

    def drawn():
        page.mouse.move(*ends[0])
        page.mouse.down()
        page.mouse.move(*ends[1], steps=5)
        page.mouse.up()

    after(page, drawn)


def painted_files(page):
    """The files with painted regions that the page offers, with their names."""
    found = []
    for link in page.locator("#painted-files a").all():
        with page.expect_download() as download:
            link.click()
        found.append((download.value.path().read_bytes(), link.get_attribute("download")))
    return found


@pytest.mark.full
def test_kinds_of_work(page, pictures, place):
    """Each tab of the page makes the same file as its command and its Python code."""
    # By keyboard, as in all lists of tabs.
    page.focus("#kind-morph")
    page.keyboard.press("ArrowRight")
    assert page.locator("#kind-rearrange").get_attribute("aria-selected") == "true"
    previewed(page)
    fill(page, size="24", frames="5")
    run(page)
    assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == 5
    gif = fetched(page, "gif")
    assert same_by(page, "command", place / "rearranged", pictures, "rearranged.gif") == gif
    # What a run has made is not offered under another tab.
    page.click("#kind-recolor")
    assert not page.is_visible("#downloads")
    previewed(page)
    plain = page.get_attribute("#views img.result", "src")
    stroke(page, 0, (0.3, 0.3), (0.6, 0.3))
    assert page.get_attribute("#views img.result", "src") != plain
    run(page)
    png = fetched(page, "png")
    painted = painted_files(page)
    assert [name for _, name in painted] == ["a one's-mask.png"]
    for which in ("command", "python"):
        folder = place / f"recolored-{which}"
        assert same_by(page, which, folder, pictures, "recolored.png", painted) == png
    before, after = (np.asarray(Image.open(each)) for each in (pictures[0], io.BytesIO(png)))
    mask = np.asarray(Image.open(io.BytesIO(painted[0][0]))) > 0
    assert 0 < mask.sum() < mask.size
    changed = (before != after).any(axis=-1)
    assert changed[mask].any()
    assert not changed[:2].any()  # far from the paint
    # Mixes, of a grid that is chosen.
    page.click("#kind-mix")
    page.fill("#grid", "0")
    until(page, "document.getElementById('failure').textContent.includes('grid')")
    page.fill("#grid", "3")
    previewed(page)
    fill(page, size="24")
    run(page)
    sheet = fetched(page, "png")
    for which in ("command", "python"):
        assert same_by(page, which, place / f"mixes-{which}", pictures, "mixes.png") == sheet
    assert Image.open(io.BytesIO(sheet)).width == 3 * 24
    recipe = json.loads(fetched(page, "json"))
    assert (recipe["command"], recipe["grid"]) == ("mix", "3")
    # The address remembers the tab; pictures are asked for anew.
    page.reload()
    page.evaluate("studio.ready")
    assert page.locator("#kind-mix").get_attribute("aria-selected") == "true"


@pytest.mark.full
def test_painted_regions_go_into_each_other(page, pictures, place):
    previewed(page)
    before = frame(page, 0.5)
    page.check("#use-brush")
    stroke(page, 0, (0.2, 0.2), (0.6, 0.2))
    stroke(page, 1, (0.5, 0.8), (0.8, 0.8))
    painted = frame(page, 0.5)
    assert painted != before
    fill(page, frames="4", size="32")
    run(page)
    assert "2 labels" in page.inner_text("#status")
    gif, labels = fetched(page, "gif"), painted_files(page)
    assert [name for _, name in labels] == ["a one's-labels.png", "b-labels.png"]
    for which in ("command", "python"):
        folder = place / f"labels-{which}"
        assert same_by(page, which, folder, pictures, "morph.gif", labels) == gif
    # A change afterwards is said beside the files; they are still those of the run.
    assert not page.is_visible("#stale")
    fill(page, frames="5")
    until(page, "!document.getElementById('stale').hidden")
    fill(page, frames="4")
    until(page, "document.getElementById('stale').hidden")
    # Other pictures, too; in the order of the run the files are again those of the command.
    for hidden in ("false", "true"):
        page.click("#swap")
        until(page, f"document.getElementById('stale').hidden === {hidden}")
        previewed(page)
    assert page.is_visible("#downloads")
    # A balanced preset gets a reach, as these regions are of different sizes.
    page.select_option("#preset", "balanced")
    until(page, "document.getElementById('command').value.includes('--reach 0.3')")
    # Another picture in the place of a painted one: what was painted on the other one stays.
    page.get_by_role("button", name="Remove picture B").click()
    until(page, "studio.state.pictures.length === 1")
    third = place / "third.png"
    Image.open(pictures[1]).save(third)
    page.set_input_files("#choose", str(third))
    until(page, "document.getElementById('command').value.includes('s-labels.png')")
    until(page, "document.getElementById('command').value.includes('third-labels.png')")
    previewed(page)
    assert page.inner_text("#failure") == ""
    # By keyboard: arrow keys move a ring, Enter paints there.
    count = page.evaluate("studio.brush.strokes")
    page.focus("#unpaint")
    canvas = page.get_by_role("application", name="Painted regions of picture B")
    canvas.focus()
    for key in ("ArrowLeft", "ArrowUp", "Enter"):
        page.keyboard.press(key)
    assert page.evaluate("studio.brush.strokes") == count + 1
    page.keyboard.press("Tab")
    # Undone strokes, and landmarks, which the brush leaves alone.
    page.click("#unpaint")
    until(page, "!document.getElementById('command').value.includes('labels')")
    assert page.evaluate("studio.landmarks.pairs().length") == 0


@pytest.mark.full
def test_a_film_beside_a_fade_and_beside_the_settings_before(page):
    previewed(page)
    page.evaluate("studio.state.view.contentWindow.clmorph.seek(0.5)")
    assert page.locator("#over option[value=previous]").is_disabled()
    page.select_option("#over", "fade")
    cut = page.get_by_role("slider", name="Divider of the comparison")
    until(page, "document.querySelectorAll('.sum img').length === 2")
    assert [
        float(image.evaluate("image => image.style.opacity"))
        for image in page.locator(".sum img").all()
    ] == pytest.approx([0.5, 0.5], abs=0.05)
    cut.focus()
    page.keyboard.press("End")
    assert cut.get_attribute("aria-valuenow") == "100"
    box = page.locator(".over").bounding_box()
    handle = cut.bounding_box()
    page.mouse.move(handle["x"] + 10, handle["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], handle["y"] + 100, steps=3)
    page.mouse.up()
    assert cut.get_attribute("aria-valuenow") == "25"
    # The settings before stay for comparison, at the same time of the morph; a finer preview of
    # the same settings does not take their place.
    was = frame(page, 0.5)
    fill(page, blur="0.2")
    until(page, "studio.compare.state.previous !== null")
    previewed(page)
    page.select_option("#over", "previous")
    until(page, "document.querySelector('.right-side').textContent === 'before: blur 0.03'")
    until(page, "Math.abs(studio.compare.state.previous.contentWindow.clmorph.time - 0.5) < 0.1")
    shown = page.evaluate(
        "studio.compare.state.previous.contentDocument.getElementById('canvas').toDataURL()"
    )
    assert shown == was != frame(page, 0.5)
    # Destroyed and created mass; balanced transport has none.
    page.select_option("#over", "masses")
    until(page, "document.querySelectorAll('.masses img').length === 2")
    assert page.is_visible("#legend")
    fill(page, reach="balanced")
    until(page, "document.querySelector('#over option[value=masses]').disabled")


def test_unmatched_shares_are_those_of_the_plan(rng):
    pair = rng.random((9, 7, 3)), rng.random((6, 8, 3))
    found = clmorph.morph(*pair, reach=0.1, solve_size=None, backend="numpy")
    destroyed, created = unmatched_shares(found)
    assert destroyed.shape == (9, 7)
    assert created.shape == (6, 8)
    lost = 1.0 - found.potentials.row_mass / found.source.weights
    np.testing.assert_allclose(destroyed.ravel(), lost, atol=2e-3)
    born = 1.0 - found.potentials.column_mass / found.target.weights
    np.testing.assert_allclose(created.ravel(), born, atol=2e-3)
    balanced = clmorph.morph(*pair, reach=None, backend="numpy")
    assert all(np.all(share == 0) for share in unmatched_shares(balanced))


def test_painted_regions_take_the_size_of_the_picture():
    canvas = np.zeros((2, 3, 4), np.uint8)
    canvas[0, 0] = LEVEL, 0, 255, 255
    canvas[1, 2] = 2 * LEVEL, 200, 0, 255
    canvas[1, 0] = 2 * LEVEL, 200, 0, 90  # more than half transparent
    file = io.BytesIO()
    Image.fromarray(canvas).save(file, "PNG")
    labels = np.asarray(read_painted(file.getvalue(), (4, 6), "labels"))
    want = np.kron([[1, 0, 0], [0, 0, 2]], np.ones((2, 2)))
    np.testing.assert_array_equal(labels, want)
    mask = np.asarray(read_painted(file.getvalue(), (4, 6), "mask"))
    np.testing.assert_array_equal(mask, 255 * (want > 0))
    for wrong in (b"", b"no picture", file.getvalue()[:40]):
        with pytest.raises(clmorph.InputError, match="PNG"):
            read_painted(wrong, (4, 6), "labels")


@pytest.mark.full
def test_waiting_work_keeps_the_paint_that_it_was_asked_with(opened, pictures):
    """Two browser tabs of different kinds: one waits for the other, and is painted on meanwhile."""
    busy, page = opened(), opened()
    take(busy, pictures)
    take(page, pictures)
    page.click("#kind-recolor")
    previewed(page)
    stroke(page, 0, (0.3, 0.3), (0.6, 0.3))
    before = page.evaluate("studio.state.pictures[0].painted.mask")
    fill(busy, frames="2000", size="64")
    busy.click("#run")
    until(busy, "document.getElementById('progress').hasAttribute('value')")
    page.click("#run")
    until(page, "document.getElementById('status').textContent.startsWith('waiting')")
    (first,) = painted_files(page)
    box = page.locator("#shown .frame").nth(0).bounding_box()
    page.mouse.move(box["x"] + 10, box["y"] + 0.8 * box["height"])
    page.mouse.down()
    page.mouse.up()
    page.evaluate("sent")  # the server has it
    busy.click("#cancel")
    until(page, "!document.getElementById('downloads').hidden")
    recipe = json.loads(fetched(page, "json"))
    assert recipe["mask"][0]["file"] == before
    assert recipe["mask"][0]["sha256"] == hashlib.sha256(first[0]).hexdigest()
    (second,) = painted_files(page)
    assert second[0] != first[0]
    assert busy.evaluate("studio.state.kind.name") == "morph"
