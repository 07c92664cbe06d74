"""Landmarks that the studio finds, and what its page keeps: points, steps, frames, a reload."""

import io
import json
import time

import numpy as np
import pytest
from PIL import Image
from sights import photograph
from studio_pages import after, fetched, fill, finished, previewed, run, same_by, take, until

import clmorph
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.studio.making import film_of


@pytest.fixture(scope="module")
def portraits(place):
    """A face, and the same face smaller and elsewhere."""
    woman = photograph("astronaut.png")
    small = np.full((250, 220, 3), 0.5)
    small[30:, :200] = woman[:440:2, :400:2]
    paths = []
    for name, picture in (("one.png", woman[::2, ::2]), ("two.png", small)):
        paths.append(place / name)
        Image.fromarray((255 * picture).astype(np.uint8)).save(paths[-1])
    return paths


def pairs(page):
    return page.evaluate("studio.landmarks.pairs()")


@pytest.mark.full
def test_found_points_are_shown_moved_removed_and_found_again(opened, portraits, place):
    page = opened()
    take(page, portraits)
    until(page, "!document.getElementById('found').hidden")
    assert page.inner_text("#found").startswith("Landmarks: one face in each picture: ")
    found = pairs(page)
    assert len(found) >= 5
    assert page.locator("#shown .mark").count() == 2 * len(found)
    previewed(page)
    # Untouched they are those that the command finds, too.
    assert "--landmark" not in page.input_value("#command")
    fill(page, size="32", frames="3")
    run(page)
    gif = fetched(page, "gif")
    for which in ("command", "python"):
        assert same_by(page, which, place / f"found-{which}", portraits, "morph.gif") == gif
    assert len(json.loads(fetched(page, "json"))["options"]["landmark"]) == len(found)
    # One is removed, one moved: then the command names them.
    page.get_by_role("button", name="Landmark 1 in A", exact=False).first.focus()
    after(page, lambda: page.keyboard.press("Delete"))
    page.get_by_role("button", name="Landmark 1 in B", exact=False).first.focus()
    after(page, lambda: page.keyboard.press("ArrowRight"))
    changed = pairs(page)
    assert len(changed) == len(found) - 1
    assert changed[0][1][0] == pytest.approx(found[1][1][0] + 1)
    assert page.input_value("#command").count("--landmark") == len(changed)
    after(page, lambda: page.click("#remark"))
    assert pairs(page) == found
    assert "--landmark" not in page.input_value("#command")
    # None at all is a choice of its own.
    after(page, lambda: page.click("#unmark"))
    assert page.input_value("#command").endswith("--landmark none")


@pytest.mark.full
def test_points_are_set_in_single_pixels_of_an_enlarged_picture(opened, place):
    """A face of 40 pixels in 1200 is as wide as the column of the pictures, or wider."""
    wide = np.random.default_rng(2).integers(0, 255, (900, 1200, 3), np.uint8)
    paths = [place / "wide.png", place / "wide-too.png"]
    for path in paths:
        Image.fromarray(wide).save(path)
        wide = wide[::-1]
    page = opened()
    page.select_option("#preset", "crossfade")
    take(page, paths)
    for _ in range(4):
        page.get_by_role("button", name="Enlarge picture A").click()
    assert page.get_by_role("button", name="Enlarge picture A").is_disabled()
    box = page.locator("#shown .frame img").nth(0).bounding_box()
    pane = page.locator("#shown .window").nth(0).bounding_box()
    assert box["width"] == pytest.approx(16 * pane["width"], rel=0.05)
    x, y = pane["x"] + pane["width"] / 2, pane["y"] + pane["height"] / 2
    page.mouse.click(x, y)
    page.locator("#shown .frame").nth(1).click(position={"x": 30, "y": 30})
    ((point, _),) = pairs(page)
    unit = box["width"] / 1200
    assert 40 * unit > 150
    wanted = (x - box["x"]) / unit - 0.5, (y - box["y"]) / unit - 0.5
    assert point == pytest.approx(wanted, abs=0.5)
    page.mouse.click(x + 12 * unit, y)
    page.locator("#shown .frame").nth(1).click(position={"x": 60, "y": 30})
    assert pairs(page)[1][0][0] - point[0] == pytest.approx(12.0, abs=0.5)


@pytest.mark.full
def test_a_reload_keeps_pictures_points_settings_and_the_result(opened, pictures):
    page = opened()
    asked = []
    page.on("dialog", lambda dialog: asked.append(dialog.type))
    take(page, pictures)
    for side in (0, 1):
        page.locator("#shown .frame").nth(side).click(position={"x": 40, "y": 40})
    fill(page, size="24")
    # What is set just before the run is kept, too.
    page.evaluate(
        """() => { const input = document.getElementById("option-frames");
        input.value = "4";
        input.dispatchEvent(new Event("input", { bubbles: true }));
        document.getElementById("run").click(); }"""
    )
    finished(page)
    gif, marks = fetched(page, "gif"), pairs(page)
    page.reload()
    page.evaluate("studio.ready")
    until(page, "!document.getElementById('downloads').hidden")
    until(page, "studio.state.shown === studio.state.number")
    assert asked == ["beforeunload"]
    names = [each["name"] for each in page.evaluate("studio.state.pictures")]
    assert names == [path.name for path in pictures]
    assert pairs(page) == marks
    assert page.input_value("#option-frames") == "4"
    assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == 4
    assert fetched(page, "gif") == gif
    # And work goes on with it.
    fill(page, frames="5")
    previewed(page)
    run(page)
    assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == 5


@pytest.mark.full
def test_undo_takes_settings_and_points_back(page):
    previewed(page)
    assert page.is_enabled("#undo") is False
    after(page, lambda: page.fill("#option-blur", "0.1"))
    page.locator("#shown .frame").nth(0).click(position={"x": 40, "y": 40})
    after(page, page.locator("#shown .frame").nth(1).click)
    assert "--blur 0.1" in page.input_value("#command")
    assert "--landmark" in page.input_value("#command")
    page.focus("#shown .frame")
    after(page, lambda: page.keyboard.press("Control+z"))
    assert pairs(page) == []
    assert "--blur 0.1" in page.input_value("#command")
    after(page, lambda: page.click("#undo"))
    assert "--blur" not in page.input_value("#command")
    assert page.is_enabled("#undo") is False


@pytest.mark.full
def test_what_the_page_says_of_presets_animations_and_sliders(opened, pictures, place):
    page = opened()
    # Before there are pictures, sliders stand at the defaults.
    value = float(page.get_by_label("Blur, as a slider").input_value())
    assert value == pytest.approx(np.log(0.01 / 0.003) / np.log(0.3 / 0.003), abs=0.35)
    assert 0.05 < float(page.get_by_label("Frames, as a slider").input_value()) < 0.6
    frames = [Image.new("RGB", (60, 48), color) for color in ("red", "blue")]
    frames[0].save(place / "two.gif", save_all=True, append_images=frames[1:])
    take(page, [place / "two.gif", pictures[1]])
    until(page, "document.getElementById('shown').innerText.includes('its first is taken')")
    assert str(place) not in page.inner_text("#shown")
    previewed(page)
    assert page.inner_text("#preset-help").startswith("The pictures choose ")


@pytest.mark.full
def test_pictures_that_are_chosen_while_the_page_loads(browser, port, pictures):
    context = browser.new_context()
    page = context.new_page()
    # The answer to the request for a tab is late.
    page.route("**/tabs?*", lambda route: (time.sleep(0.5), route.continue_()))
    page.goto(f"http://127.0.0.1:{port}/", wait_until="domcontentloaded")
    page.set_input_files("#choose", [str(path) for path in pictures])
    until(page, "studio.state.pictures.length === 2")
    assert page.is_hidden("#failure")
    context.close()


@pytest.mark.full
def test_a_still_is_the_frame_that_the_film_shows(page, pictures):
    fill(page, size="24", frames="5", fps="1")
    run(page)
    page.evaluate(
        """async () => { const viewer = studio.state.view.contentWindow.clmorph;
        viewer.pause(); await viewer.seek(0.25); }"""
    )
    shown = page.evaluate("studio.state.view.contentWindow.clmorph.time")
    still = np.asarray(Image.open(io.BytesIO(fetched(page, "still"))).convert("RGB"))
    images = [clmorph.read_image(path) for path in pictures]
    preset = page.inner_text("#preset-help").split()[3].rstrip(":")
    morph = clmorph.morph(*images, size=24, n_frames=5, preset=preset)
    wanted = np.rint(255 * np.clip(morph.frame(shown), 0, 1))
    assert still.shape == wanted.shape
    assert np.abs(still - wanted).max() <= 2


def test_frames_are_drawn_once_for_all_files(tmp_path, rng, monkeypatch):
    drawn = []
    plainly = FrameRenderer.frame
    monkeypatch.setattr(FrameRenderer, "frame", lambda of, t: drawn.append(t) or plainly(of, t))
    images = rng.random((2, 12, 12, 3))
    morph = clmorph.morph(*images, n_frames=4, preset="photo", backend="numpy")
    film = film_of([morph])
    for name in ("a.gif", "b.webp", "c.gif"):
        film.write(tmp_path / name, morph.parameters, lambda stage, share: None)
    assert len(drawn) == 4
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "c.gif").read_bytes()
    morph.save(tmp_path / "d.gif", parameters=morph.parameters)
    fresh = clmorph.morph(*images, n_frames=4, preset="photo", backend="numpy")
    fresh.save(tmp_path / "e.gif", parameters=fresh.parameters)
    assert (tmp_path / "d.gif").read_bytes() == (tmp_path / "e.gif").read_bytes()
