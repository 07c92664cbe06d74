"""Test the page in a browser, opened from a file and operated like by a user."""

import base64
import io
import re
import time

import numpy as np
import pytest
from browsers import watched
from films import frames_of, noise
from marks import full
from PIL import Image
from plain import morph

from clmorph._shared.printable import printable
from clmorph.images.pixels import to_bytes
from clmorph.measures.landmark_options import check_landmarks, read_landmarks
from clmorph.output.html.page import page
from clmorph.output.html.scene import Curve, Field, Marks, Scene
from clmorph.output.html.summary import repr_html, scene_of
from clmorph.output.save import save

PHONE = {
    "viewport": {"width": 360, "height": 740},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
}


@pytest.fixture
def show(browser, tmp_path):
    """Open a scene, or text of a page, from a file; watch for requests, errors, messages."""
    with watched(browser) as (open_page, bad):

        def shown(scene, name="page.html", before="", **options):
            path = tmp_path / name
            path.write_text(scene if isinstance(scene, str) else page(scene), encoding="utf-8")
            desk = {"viewport": {"width": 1280, "height": 800}, "color_scheme": "light"}
            opened = open_page(path.as_uri(), [path.as_uri()], before, **desk | options)
            if options.get("java_script_enabled", True) and name != "notebook.html":
                opened.evaluate("clmorph.ready")
            return opened

        yield shown
    # That warning is about these tests, which read the canvas.
    assert [text for text in bad if "Multiple readback" not in text] == []


def scene_with(frames, **options):
    return Scene(frames, np.linspace(0, 1, len(frames)), **options)


def pixels(opened, name="canvas"):
    """What a canvas holds: (H, W, 4) array."""
    shape, data = opened.evaluate(
        """(name) => { const c = document.getElementById(name);
        const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
        let text = "";
        for (let k = 0; k < d.length; k += 8192)
            text += String.fromCharCode(...d.subarray(k, k + 8192));
        return [[c.height, c.width, 4], btoa(text)]; }""",
        name,
    )
    return np.frombuffer(base64.b64decode(data), np.uint8).reshape(shape)


def photographed(opened, selector="#box", **options):
    """What the screen shows of an element."""
    shot = opened.locator(selector).screenshot(**options)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def until(opened, condition, seconds=60.0):
    """Wait for a condition; the driver's own way needs eval, which the page forbids."""
    end = time.monotonic() + seconds
    while not opened.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, condition
        time.sleep(0.01)


def index(opened):
    return opened.evaluate("clmorph.index")


def center(opened, selector):
    box = opened.locator(selector).bounding_box()
    return np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])


def test_plays_by_a_click_and_holds_by_another(rng, show):
    opened = show(scene_with(noise(rng), fps=20, hold=0))
    assert index(opened) == 0
    assert opened.evaluate("clmorph.playing") is False  # asked for less motion
    opened.get_by_role("button", name="Play").click()
    until(opened, "clmorph.index >= 2")
    opened.get_by_role("button", name="Pause").click()
    held = index(opened)
    before = pixels(opened)
    opened.wait_for_timeout(200)
    assert index(opened) == held
    assert np.array_equal(pixels(opened), before)


def test_plays_by_itself_unless_motion_is_unwanted(rng, show):
    scene = scene_with(noise(rng), fps=20, hold=0)
    opened = show(scene, reduced_motion="no-preference")
    until(opened, "clmorph.playing && clmorph.index >= 1")
    still = show(scene)
    still.wait_for_timeout(300)
    assert index(still) == 0


def test_the_canvas_holds_every_frame_exactly(rng, show):
    frames = noise(rng, 4) + noise(rng, 2, (7, 31, 3)) + noise(rng, 1, (1, 1, 3))
    opened = show(scene_with(frames))
    for k in (0, 3, 4, 6, 5, 1):
        opened.evaluate("k => clmorph.show(k)", k)
        got = pixels(opened)
        assert np.array_equal(got[..., :3], frames[k])
        assert np.all(got[..., 3] == 255)


def test_opacity_is_kept_exactly_and_shows_a_checkerboard(rng, show):
    frames = noise(rng, 3, (16, 16, 4))
    frames[1][..., 3] = 0
    opened = show(scene_with(frames))
    for k in (0, 2):
        opened.evaluate("k => clmorph.show(k)", k)
        got, want = pixels(opened), frames[k]
        seen = want[..., 3] > 0
        assert np.array_equal(got[..., 3], want[..., 3])
        assert np.array_equal(got[seen], want[seen])
    opened.evaluate("clmorph.show(1)")
    assert not pixels(opened)[..., 3].any()
    opened.keyboard.press("1")
    board = photographed(opened)
    assert len(np.unique(board.reshape(-1, 3), axis=0)) == 2


def test_scrubbing(rng, show):
    frames = noise(rng, 9)
    opened = show(scene_with(frames))
    slider = opened.get_by_role("slider", name="Frame")
    opened.mouse.click(*center(opened, "#scrub"))
    until(opened, "clmorph.index === 4")
    assert np.array_equal(pixels(opened)[..., :3], frames[4])
    assert opened.locator("#time").inner_text() == "0.50"
    assert opened.locator("#frame").inner_text() == "5 / 9"
    assert slider.get_attribute("aria-valuetext") == "frame 5 of 9, t = 0.50"
    opened.evaluate("clmorph.seek(0.76)")
    assert index(opened) == 6
    assert opened.evaluate("clmorph.time") == 0.75
    opened.get_by_role("button", name="Last frame").click()
    until(opened, "clmorph.index === 8")
    opened.get_by_role("button", name="First frame").click()
    until(opened, "clmorph.index === 0")


def test_stepping(rng, show):
    opened = show(scene_with(noise(rng, 25)))

    def pressed(key, wanted):
        opened.keyboard.press(key)
        until(opened, f"clmorph.index === {wanted}")

    pressed("ArrowRight", 1)
    pressed("ArrowRight", 2)
    pressed("ArrowLeft", 1)
    pressed("End", 24)
    pressed("ArrowRight", 24)
    pressed("PageUp", 14)
    pressed("Home", 0)
    pressed("ArrowLeft", 0)
    # On the slider too, once for each press.
    opened.locator("#scrub").focus()
    pressed("ArrowRight", 1)
    pressed("End", 24)
    opened.get_by_role("button", name="One frame back").click()
    until(opened, "clmorph.index === 23")
    opened.keyboard.press(" ")  # the button's own key
    until(opened, "clmorph.index === 22")
    opened.locator("h1").click()
    opened.keyboard.press(" ")
    # Held in the same moment: later it may be at the first frame.
    until(opened, "clmorph.playing && clmorph.index > 22 && (clmorph.pause(), true)")
    pressed("ArrowLeft", index(opened) - 1)
    assert opened.evaluate("clmorph.playing") is False


def course(opened, count):
    """Frames in the order in which they are shown, from a playing page."""
    return opened.evaluate(
        """(count) => new Promise((resolve) => {
        const seen = [clmorph.index];
        const look = () => {
            if (clmorph.index !== seen[seen.length - 1]) seen.push(clmorph.index);
            if (seen.length >= count || !clmorph.playing) resolve(seen);
            else requestAnimationFrame(look);
        };
        clmorph.play();
        look();
        })""",
        count,
    )


@pytest.mark.full
def test_ping_pong_loop_and_once(rng, show):
    # A quarter of a second is the most that counts at once: however slow the machine, no frame
    # is skipped.
    opened = show(scene_with(noise(rng, 4), fps=4, hold=0.05))
    assert opened.evaluate("clmorph.loop") == "ping-pong"
    assert course(opened, 8) == [0, 1, 2, 3, 2, 1, 0, 1]
    opened.evaluate("clmorph.pause()")
    opened.get_by_role("combobox", name="After the last frame").select_option("loop")
    opened.evaluate("clmorph.set('direction', 1); clmorph.show(0)")
    assert course(opened, 6) == [0, 1, 2, 3, 0, 1]
    opened.evaluate("clmorph.pause()")
    opened.get_by_role("button", name="Backwards").click()
    opened.evaluate("clmorph.show(1)")
    assert course(opened, 5) == [1, 0, 3, 2, 1]
    opened.evaluate("clmorph.pause()")
    opened.locator("h1").click()
    opened.keyboard.press("l")
    opened.keyboard.press("r")
    assert opened.evaluate("[clmorph.loop, clmorph.direction]") == ["once", 1]
    opened.evaluate("clmorph.show(0)")
    assert course(opened, 99) == [0, 1, 2, 3]
    assert opened.evaluate("clmorph.playing") is False
    # And again, from the start.
    assert course(opened, 99)[-3:] == [1, 2, 3]


@pytest.mark.full
def test_speed(rng, show):
    opened = show(scene_with(noise(rng, 40, (4, 4, 3)), fps=40, hold=0, loop="once"))

    def seconds():
        return opened.evaluate(
            """async () => { await clmorph.show(0); const from = performance.now();
            clmorph.play();
            while (clmorph.playing) await new Promise(requestAnimationFrame);
            return (performance.now() - from) / 1000; }"""
        )

    plain = seconds()
    assert plain >= 0.9
    opened.get_by_role("combobox", name="Speed").select_option("4")
    # A machine that stalls for a moment does not do so every time.
    assert any(seconds() < plain / 2 for _ in range(20))
    opened.locator("h1").click()
    for _ in range(9):
        opened.keyboard.press(",")
    assert opened.evaluate("clmorph.speed") == 0.25


def test_at_zoom_one_the_screen_shows_the_frame_exactly(rng, show):
    frames = noise(rng, 2, (40, 60, 3))
    for dark in ("light", "dark"):
        opened = show(scene_with(frames), color_scheme=dark)
        opened.keyboard.press("1")
        assert opened.evaluate("clmorph.zoom") == 1
        assert np.array_equal(photographed(opened), frames[0])


@pytest.mark.full
def test_squares_and_smoothness(rng, show):
    frames = noise(rng, 2, (20, 30, 3))
    opened = show(scene_with(frames, pixelated=True))
    opened.keyboard.press("1")
    for wanted in (1.5, 2, 3, 4, 6, 8):
        opened.get_by_role("button", name="Zoom in").click()
        assert opened.evaluate("clmorph.zoom") == pytest.approx(wanted)
    squares = np.kron(frames[0], np.ones((8, 8, 1), np.uint8))
    assert np.array_equal(photographed(opened), squares)
    opened.get_by_role("button", name="Pixels as squares").click()
    assert opened.evaluate("clmorph.pixelated") is False
    smooth = photographed(opened).astype(float)
    assert smooth.shape == squares.shape
    # Neighbors differ little now, and the middle of each pixel keeps its color.
    assert np.abs(np.diff(smooth, axis=1)).max() < 60 < np.diff(squares.astype(int), axis=1).max()
    assert np.abs(smooth[4::8, 4::8] - frames[0]).mean() < 25
    opened.locator("h1").click()
    opened.keyboard.press("p")
    assert np.array_equal(photographed(opened), squares)
    # Fitted, squares of a still canvas are of whole pixels.
    opened.keyboard.press("0")
    fitted = photographed(opened)
    side = fitted.shape[0] // 20
    assert side > 8
    assert np.array_equal(fitted, np.kron(frames[0], np.ones((side, side, 1), np.uint8)))


@pytest.mark.full
def test_wheel_and_drag(rng, show):
    opened = show(scene_with(noise(rng, 2, (40, 100, 3))))
    # Along the other axis it fits, and stays centered.
    x, y = np.add(center(opened, "#stage"), (60, 0))

    def under():
        """The place in the picture that is under the mouse."""
        at = opened.locator("#box").bounding_box()
        return np.array([(x - at["x"]) / at["width"], (y - at["y"]) / at["height"]])

    before, zoom = under(), opened.evaluate("clmorph.zoom")
    opened.mouse.move(x, y)
    opened.mouse.wheel(0, -100)
    until(opened, f"clmorph.zoom > {zoom * 1.2}")
    assert np.abs(under() - before).max() < 0.01
    left = opened.locator("#box").bounding_box()["x"]
    opened.mouse.down()
    opened.mouse.move(x - 30, y, steps=4)
    opened.mouse.up()
    assert opened.locator("#box").bounding_box()["x"] == pytest.approx(left - 30, abs=1.5)
    assert opened.evaluate("clmorph.playing") is False  # a drag is no tap
    opened.mouse.click(x, y)
    assert opened.evaluate("clmorph.playing") is True
    for _ in range(20):
        opened.mouse.wheel(0, -100)
    until(opened, "clmorph.zoom === 16")
    for _ in range(40):
        opened.mouse.wheel(0, 100)
    until(opened, "clmorph.zoom === 1")


@pytest.mark.full
def test_pinch(rng, show):
    opened = show(scene_with(noise(rng, 2, (64, 64, 3))), **PHONE)
    session = opened.context.new_cdp_session(opened)
    x, y = center(opened, "#stage")

    def touch(kind, *offsets):
        points = [{"x": x + dx, "y": y, "id": k} for k, dx in enumerate(offsets)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    before = opened.evaluate("clmorph.zoom")
    touch("touchStart", -30, 30)
    for spread in (35, 40, 45, 50, 55, 60):
        touch("touchMove", -spread, spread)
    touch("touchEnd")
    assert opened.evaluate("clmorph.zoom") == pytest.approx(2 * before, rel=0.05)
    assert opened.evaluate("clmorph.playing") is False
    opened.touchscreen.tap(x, y)
    assert opened.evaluate("clmorph.playing") is True


@pytest.mark.full
def test_a_changing_canvas_stands_still(rng, show):
    """From portrait to landscape: true scale, one center, no jump, inside the stage."""
    images = [rng.random((24, 12, 3)), rng.random((15, 30, 3))]
    result = morph(*images, n_frames=13, blur=0.2)
    opened = show(scene_of(result))
    stage = opened.locator("#stage").bounding_box()
    sizes = []
    for k, t in enumerate(result.times):
        opened.evaluate("k => clmorph.show(k)", k)
        assert np.array_equal(pixels(opened)[..., :3], to_bytes(result.frame(t)))
        assert np.abs(center(opened, "#box") - center(opened, "#stage")).max() < 1
        box = opened.locator("#box").bounding_box()
        assert box["width"] <= stage["width"]
        assert box["height"] <= stage["height"]
        sizes.append((box["width"], box["height"]))
    sizes = np.array(sizes)
    height, width = result.canvas(0.5).shape
    assert np.allclose(
        sizes[6] / sizes[0], [width / 26 / (12 / 23), height / 26 / (24 / 23)], rtol=5e-3
    )
    # Never by more than the motion of a frame and the canvas's whole pixels.
    assert np.abs(np.diff(sizes, axis=0)).max() < 0.12 * sizes.max()


def arrows_shown(opened):
    """Where arrows are, ways still to go left out: (H, W) array of bool; None if hidden."""
    if opened.locator("#arrows").is_hidden():
        return None
    return pixels(opened, "arrows")[..., 3] > 220


@pytest.mark.full
def test_arrows_travel(rng, show):
    field = Field([[0.25, 0.5]], [[0.5, 0.0]])
    opened = show(scene_with(noise(rng, 3, (33, 33, 3)), fields=[field]))
    assert arrows_shown(opened) is None
    assert opened.locator("#field-note").is_hidden()
    opened.get_by_role("button", name="Displacements as arrows").click()
    assert opened.evaluate("clmorph.field") is True
    assert opened.locator("#field-note").is_visible()
    box, stage = opened.locator("#box").bounding_box(), opened.locator("#stage").bounding_box()
    unit = box["width"] * 32 / 33
    heads = []
    for t in (0, 0.5, 1):
        opened.evaluate("t => clmorph.seek(t)", t)
        rows, columns = np.nonzero(arrows_shown(opened))
        assert abs(rows.mean() - stage["height"] / 2) < 2
        heads.append((columns.max() - stage["width"] / 2) / unit + 0.5)
    assert np.allclose(heads, [0.25, 0.5, 0.75], atol=0.02)
    opened.locator("h1").click()
    opened.keyboard.press("f")
    assert arrows_shown(opened) is None


@pytest.mark.full
def test_close_arrows_are_drawn_as_their_mean(rng, show):
    x, y = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 64))
    places = np.column_stack((x.ravel(), y.ravel()))
    field = Field(places, 0 * places)
    opened = show(scene_with(noise(rng, 2, (64, 64, 3)), fields=[field]), **PHONE)
    opened.keyboard.press("f")
    drawn = arrows_shown(opened)
    from scipy.ndimage import label

    dots = label(drawn)[1]
    side = opened.locator("#box").bounding_box()["width"]
    assert (side / 30) ** 2 < dots < (side / 15) ** 2


@pytest.mark.full
def test_a_page_without_arrows_or_curves_has_no_place_for_them(rng, show):
    opened = show(scene_with(noise(rng)))
    assert opened.locator("#field").is_hidden()
    assert opened.locator("#charts").is_hidden()
    assert opened.locator("#parameters").is_hidden()
    opened.keyboard.press("f")
    assert arrows_shown(opened) is None


def test_curves(rng, show):
    curves = [
        Curve("kernel width", "pixels", [1.0, 2.0, 1.5]),
        Curve("mass dying", "%", [20.0, 10.0, 0.0]),
        Curve("mass born", "%", [0.0, 5.0, 10.0]),
        Curve("drift", "nats", [-1e-7, 0.0, 1e-7]),
        Curve("nothing", "none", [0.0, 0.0, 0.0]),
    ]
    opened = show(scene_with(noise(rng, 3), curves=curves, fps=10))
    charts = opened.locator(".chart")
    assert charts.count() == 4
    assert charts.nth(1).get_attribute("aria-label") == "mass dying, mass born, in %, over time"
    opened.evaluate("clmorph.seek(0.5)")
    assert charts.nth(0).locator("output").all_inner_texts() == ["2.00"]
    assert charts.nth(1).locator("output").all_inner_texts() == ["10.0", "5.0"]
    assert charts.nth(2).locator("output").all_inner_texts() == ["0"]
    plot = charts.nth(1).locator("svg")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()

    def cursor():
        at = charts.nth(1).locator(".cursor").bounding_box()
        return (at["x"] + at["width"] / 2 - box["x"]) / box["width"]

    assert cursor() == pytest.approx(0.5, abs=0.02)
    opened.mouse.move(box["x"] + 3, box["y"] + 40)
    opened.mouse.down()
    until(opened, "clmorph.index === 0")
    opened.mouse.move(box["x"] + box["width"] - 3, box["y"] + 40, steps=3)
    until(opened, "clmorph.index === 2")
    opened.mouse.up()
    assert cursor() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("size", [(1160, 560), *full((1280, 720), (1920, 1080))])
def test_on_a_desk_all_is_in_sight(rng, show, size):
    curves = [Curve(f"curve {k}", f"unit {k}", rng.random(4)) for k in range(5)]
    scene = scene_with(
        noise(rng, 4), curves=curves, notes=["A note"] * 2,
        fields=[Field([[0.5, 0.5]], [[0.1, 0]])],
        parameters={f"parameter {k}": k for k in range(40)},
    )  # fmt: skip
    opened = show(scene, viewport={"width": size[0], "height": size[1]})
    opened.keyboard.press("f")
    opened.locator("summary").click()
    root = "document.documentElement"
    assert opened.evaluate(f"[{root}.scrollWidth, {root}.scrollHeight]") == list(size)
    assert opened.locator("#stage").bounding_box()["height"] >= 200
    for name in ("#show-help", "#notes"):
        box = opened.locator(name).bounding_box()
        assert box["y"] + box["height"] <= size[1]
    opened.locator("#parameters tr").last.scroll_into_view_if_needed()
    assert opened.locator("#parameters tr").last.bounding_box()["y"] < size[1]


@pytest.mark.full
def test_a_phone(rng, show):
    images = [rng.random((20, 12, 4)), rng.random((12, 20, 3))]
    result = morph(*images, n_frames=4, blur=0.2)
    scene = scene_of(result, title="A title_that_is_very_long_and_has_no_place_to_break " * 2)
    opened = show(scene, **PHONE)
    opened.locator("summary").tap()
    opened.get_by_role("button", name="Displacements as arrows").tap()
    width = opened.evaluate("[document.documentElement.scrollWidth, document.body.scrollWidth]")
    assert max(width) <= 360
    for kind in ("button", "select", "summary", "input"):
        for control in opened.locator(f"{kind}:visible").all():
            box = control.bounding_box()
            assert box["width"] >= 40, control.evaluate("e => e.id")
            assert box["height"] >= 40, control.evaluate("e => e.id")
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= 360
    stage, play = (opened.locator(name).bounding_box() for name in ("#stage", "#play"))
    assert stage["y"] < play["y"] < 740  # all of it in sight
    opened.locator("#play").tap()
    until(opened, "clmorph.index >= 1")
    opened.get_by_role("button", name="Keys").tap()
    assert opened.locator("#help").bounding_box()["width"] <= 360


@pytest.mark.full
def test_help_and_names(rng, show):
    opened = show(scene_with(noise(rng)))
    for button in opened.locator("button:visible").all():
        assert button.get_attribute("aria-label"), button.evaluate("e => e.id")
    opened.keyboard.press("?")
    assert opened.get_by_role("dialog", name="Keys").is_visible()
    opened.keyboard.press("ArrowRight")
    assert index(opened) == 0  # the page behind rests
    opened.keyboard.press("Escape")
    assert opened.get_by_role("dialog").count() == 0
    opened.keyboard.press("Tab")
    outline = "e => getComputedStyle(e).outlineStyle"
    assert opened.locator(":focus-visible").evaluate(outline) == "solid"


def luminance(color):
    channels = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast(rng, show, scheme):
    """Ratios of WCAG 2.2: text 4.5, what is drawn 3."""
    opened = show(scene_with(noise(rng, 2)), color_scheme=scheme)

    def ratio(front, back):
        style = "(name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim()"
        values = [luminance(opened.evaluate(style, f"--{name}")) for name in (front, back)]
        return (max(values) + 0.05) / (min(values) + 0.05)

    for text in ("text", "soft", "error"):
        for back in ("page", "panel"):
            assert ratio(text, back) >= 4.5, (text, back)
    assert ratio("on-accent", "accent") >= 4.5
    for drawn in ("accent", "edge", "curve-0", "curve-1", "curve-2", "curve-3"):
        assert ratio(drawn, "panel") >= 3, drawn
    assert opened.evaluate("getComputedStyle(document.body).backgroundColor") == (
        "rgb(244, 245, 247)" if scheme == "light" else "rgb(16, 19, 24)"
    )


HOSTILE = (
    '</script><img src="http://127.0.0.1/x" onerror=alert(1)>&amp;\'"<b>\u2028\u00e9\U0001f431'
)


def test_hostile_texts_are_only_texts(rng, show):
    scene = scene_with(
        noise(rng, 2), title=HOSTILE, parameters={HOSTILE: [HOSTILE]}, notes=[HOSTILE],
        curves=[Curve(HOSTILE, HOSTILE, [1, 2])],
    )  # fmt: skip
    opened = show(scene)
    text = printable(HOSTILE)
    assert text == HOSTILE.replace("\u2028", "\\u2028")
    assert opened.title() == text
    assert opened.locator("h1").text_content() == text
    assert opened.locator("#notes li").text_content() == text
    assert opened.locator("#parameters th").text_content() == text
    assert opened.locator(".legend li").text_content().startswith(HOSTILE)
    assert opened.locator("img, b:not(#time)").count() == 0


@pytest.mark.full
def test_chains(rng, show):
    times = np.array([0, 0.5, 1, 1.5, 2])
    fields = [Field([[0.5, 0.5]], [[0.2, 0]]), Field([[0.5, 0.5]], [[0, 0.2]], begin=1, end=2)]
    frames = noise(rng, 5, (20, 20, 3))
    curve = Curve("kernel width", "pixels", [1, 2, 1, 2, 1])
    opened = show(Scene(frames, times, fields=fields, curves=[curve]))
    opened.keyboard.press("f")
    shown = []
    for t in (0.5, 1.5):
        opened.evaluate("t => clmorph.seek(t)", t)
        assert opened.evaluate("clmorph.time") == t
        rows, columns = np.nonzero(arrows_shown(opened))
        shown.append(np.ptp(columns) > np.ptp(rows))
    assert shown == [True, False]
    assert opened.locator(".label.last").inner_text() == "2"
    # One mark on the slider, where both meet.
    assert center(opened, ".tick")[0] == pytest.approx(center(opened, "#scrub")[0], abs=1.5)


def test_a_saved_frame_is_the_frame(rng, show):
    frames = noise(rng, 3, (9, 11, 4))
    frames[1][..., 3] |= 1
    opened = show(scene_with(frames))
    opened.evaluate("clmorph.show(1)")
    with opened.expect_download() as download:
        opened.get_by_role("button", name="Save this frame").click()
    assert re.fullmatch(r"frame-0001\.(webp|png)", download.value.suggested_filename)
    assert np.array_equal(frames_of(download.value.path())[0], frames[1])


@pytest.mark.full
def test_a_long_morph_starts_at_once_and_forgets(rng, show):
    """More than is kept decoded: 300 megabytes of pixels."""
    frames = [np.full((1000, 1000, 3), k, np.uint8) for k in range(76)]
    count = """window.open = { made: 0, closed: 0 };
        const make = window.createImageBitmap, { close } = ImageBitmap.prototype;
        window.createImageBitmap = (...all) => { window.open.made += 1; return make(...all); };
        ImageBitmap.prototype.close = function () { window.open.closed += 1; close.call(this); };"""
    opened = show(scene_with(frames, fps=60, hold=0, loop="once"), before=count)
    assert opened.evaluate("open.made") < 20
    opened.evaluate("clmorph.play()")
    until(opened, "!clmorph.playing")
    assert index(opened) == 75
    assert opened.evaluate("open.closed") >= 76 - 64
    assert opened.evaluate("open.made - open.closed") <= 64
    for k in (0, 75, 40):
        opened.evaluate("k => clmorph.show(k)", k)
        assert np.all(pixels(opened)[..., :3] == k)


@pytest.mark.full
def test_the_last_of_several_requests_is_shown(rng, show):
    frames = noise(rng, 40)
    opened = show(scene_with(frames))
    opened.evaluate("Promise.all([...Array(40).keys()].reverse().map((k) => clmorph.show(k)))")
    assert index(opened) == 0
    assert np.array_equal(pixels(opened)[..., :3], frames[0])


@pytest.mark.full
def test_a_broken_frame_is_told(rng, show):
    text = page(scene_with(noise(rng, 40), fps=50, hold=0))
    blocks = list(re.finditer(r'class="frame">([^<]*)<', text))
    broken = blocks[30]
    opened = show(text[: broken.start(1)] + "AAAA" + text[broken.end(1) :])
    assert opened.locator("#failure").is_hidden()
    opened.evaluate("clmorph.play()")
    opened.locator("#failure").wait_for()
    assert "frame 31 cannot be decoded" in opened.locator("#failure").inner_text()
    assert opened.evaluate("[clmorph.playing, clmorph.index]") == [False, 29]


def test_one_frame(rng, show):
    frames = noise(rng, 1)
    opened = show(Scene(frames, np.zeros(1), curves=[Curve("a", "b", [1])]))
    assert opened.locator("#play").is_disabled()
    opened.evaluate("clmorph.play()")
    opened.keyboard.press("ArrowRight")
    assert np.array_equal(pixels(opened)[..., :3], frames[0])


def test_without_javascript_it_says_so(rng, show):
    opened = show(scene_with(noise(rng), parameters={"blur": 0.03}), java_script_enabled=False)
    assert "switched off" in opened.locator("noscript").inner_text()
    opened.locator("summary").click()
    assert opened.locator("#parameters td").inner_text() == "0.03"


@pytest.mark.full
def test_a_notebook(rng, show):
    result = morph(rng.random((9, 12, 3)), rng.random((12, 9, 3)), n_frames=4)
    text = f"<!doctype html><meta charset=utf-8><h1>Notebook</h1>{repr_html(result)}"
    opened = show(text, "notebook.html")
    frame = opened.frames[1]
    until(frame, "window.clmorph")
    frame.evaluate("clmorph.ready")
    # A browser may tell a frame of another process too late that motion is not wanted: it plays.
    button = frame.locator("#play")
    if button.get_attribute("aria-label") == "Play":
        button.click()
    frame.evaluate("clmorph.play()")  # if the click held a film that had just begun
    until(frame, "clmorph.index >= 1")
    button.click()
    until(frame, "!clmorph.playing")
    # Nothing of the notebook is within its reach.
    outside = "() => { try { return parent.document.title; } catch { return null; } }"
    assert frame.evaluate(outside) is None
    # The wheel scrolls the notebook.
    zoom = frame.evaluate("clmorph.zoom")
    frame.locator("#stage").hover()
    opened.mouse.wheel(0, 100)
    opened.wait_for_timeout(150)
    assert frame.evaluate("clmorph.zoom") == zoom


@pytest.mark.full
def test_a_saved_chain_backwards(rng, show, tmp_path):
    """Times ascend from 0 while frames start at the last picture; a canvas may be requested."""
    images = rng.random((3, 8, 8, 3))
    chain = [morph(*pair, 4) for pair in (images[:2], images[1:])]
    told = {"clmorph": "1", "images": [{"file": f"{name}.png"} for name in "abc"]}
    save(chain, tmp_path / "out.html", reverse=True, parameters=told, canvas="16x16",
         scaling="nearest")  # fmt: skip
    opened = show((tmp_path / "out.html").read_text("ascii"))
    assert opened.title() == "c → b → a"
    assert np.allclose(opened.evaluate("Array.from(clmorph.times)"), np.linspace(0, 2, 7))
    for place, morphed, frame in ((0, 1, 3), (2, 1, 1), (6, 0, 0)):
        opened.evaluate(f"clmorph.seek(clmorph.times[{place}])")
        until(opened, f"clmorph.index === {place}")
        large = np.kron(to_bytes(chain[morphed].frames[frame]), np.ones((2, 2, 1)))
        assert np.array_equal(pixels(opened)[..., :3], large)


def clicked(opened, side, x, y, shape):
    """Click a pixel of a picture (height, width) in the panel of landmarks."""
    box = opened.locator(f"#marks-{side}").bounding_box()
    opened.mouse.click(
        box["x"] + (x + 0.5) / shape[1] * box["width"],
        box["y"] + (y + 0.5) / shape[0] * box["height"],
    )


def test_landmarks_are_shown_set_moved_deleted_and_copied(rng, show):
    shapes = ((60, 80), (90, 50))
    frames = [*noise(rng, 2, (30, 40, 3)), *noise(rng, 1, (45, 25, 3))]
    opened = show(scene_with(frames, marks=Marks([[(10, 20), (30, 40)]], shapes)))
    opened.get_by_role("button", name="Landmarks").click()
    assert opened.evaluate("clmorph.landmarks") == [[[10, 20], [30, 40]]]
    until(opened, "document.getElementById('marks-a').width > 300")
    # Both pictures have the mark, each where it belongs, and their own shape.
    for side, (x, y), shape in (("a", (10, 20), shapes[0]), ("b", (30, 40), shapes[1])):
        seen = pixels(opened, f"marks-{side}")
        assert seen.shape[1] / seen.shape[0] == pytest.approx(shape[1] / shape[0], rel=0.02)
        there = seen[
            int((y + 0.5) / shape[0] * len(seen)), int((x + 0.5) / shape[1] * len(seen[0]))
        ]
        assert np.ptp(there[:3].astype(int)) > 60  # the color of the mark
    clicked(opened, "a", 70, 50, shapes[0])
    assert len(opened.evaluate("clmorph.landmarks")) == 1  # its partner is missing
    assert "partner of landmark 2 in picture B" in opened.locator("#marks-status").inner_text()
    clicked(opened, "b", 5, 80, shapes[1])
    found = np.array(opened.evaluate("clmorph.landmarks"))
    # A screen pixel is less than a third of a pixel here.
    assert np.abs(found - [[(10, 20), (30, 40)], [(70, 50), (5, 80)]]).max() < 0.35
    # What is copied is what the command line and Python take.
    line, python = (opened.locator(f"#marks-{name}").input_value() for name in ("line", "python"))
    assert line.count("--landmark ") == 2
    assert read_landmarks(line.replace("--landmark ", "")) == check_landmarks("it", found.tolist())
    assert eval(f"dict({python})") == {"landmarks": list(check_landmarks("it", found.tolist()))}
    # It says so for two seconds, which a slow machine may miss.
    opened.evaluate(
        """() => { window.told = new Promise((resolve) => {
        const button = document.getElementById("copy-line");
        const watch = new MutationObserver(() => resolve(button.textContent));
        watch.observe(button, { childList: true }); }); }"""
    )
    opened.locator("#copy-line").click()
    assert opened.evaluate("told") in ("Copied", "Press Ctrl+C")
    # A point is dragged, and stays inside its picture.
    box = opened.locator("#marks-b").bounding_box()
    at = [box["x"] + 5.5 / 50 * box["width"], box["y"] + 80.5 / 90 * box["height"]]
    opened.mouse.move(*at)
    opened.mouse.down()
    opened.mouse.move(at[0] - 500, at[1])
    opened.mouse.up()
    assert opened.evaluate("clmorph.landmarks")[1][1] == [0, pytest.approx(80, abs=0.35)]
    opened.get_by_role("button", name="Delete landmark 1").click()
    assert len(opened.evaluate("clmorph.landmarks")) == 1
    opened.locator("#marks-title").click()
    opened.keyboard.press("Delete")
    assert opened.evaluate("clmorph.landmarks") == []
    assert opened.locator("#marks-python").input_value() == "landmarks=[]"
    opened.keyboard.press("m")
    assert not opened.locator("#marks").is_visible()


def test_the_page_of_a_morph_knows_its_landmarks(rng, show, tmp_path):
    a, b = rng.random((2, 24, 32, 3))
    made = morph(a, b, n_frames=2, size=16, landmarks=[((9, 9), (11, 12))], backend="numpy")
    for reverse in (False, True):
        save(made, tmp_path / "a.html", reverse=reverse)
        opened = show((tmp_path / "a.html").read_text(), f"{reverse}.html")
        opened.keyboard.press("m")
        assert opened.evaluate("clmorph.landmarks") == [[[9, 9], [11, 12]]]
        until(opened, "document.getElementById('marks-a').width > 300")
        first = pixels(opened, "marks-a")[2, 2, :3] / 255
        assert np.abs(first - made.frame(0.0)[0, 0]).max() < 0.03
        clicked(opened, "a", 31, 0, (24, 32))
        clicked(opened, "b", 31, 0, (24, 32))
        assert np.abs(np.array(opened.evaluate("clmorph.landmarks"))[1] - (31, 0)).max() < 0.2
    # Framed pictures, and chains, have other pixels than the pictures.
    save(made, tmp_path / "a.html", canvas="40x40")
    framed = show((tmp_path / "a.html").read_text())
    assert not framed.get_by_role("button", name="Landmarks").is_visible()
    framed.keyboard.press("m")
    assert not framed.locator("#marks").is_visible()
    assert framed.evaluate("clmorph.landmarks") == []


@pytest.mark.full
def test_landmarks_on_a_phone(rng, show):
    shapes = ((40, 40), (40, 40))
    scene = scene_with(noise(rng, 2, (40, 40, 3)), marks=Marks(np.zeros((0, 2, 2)), shapes))
    opened = show(scene, **PHONE)
    opened.locator("#show-marks").tap()
    for side in "ab":
        canvas = opened.locator(f"#marks-{side}")
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        assert box["width"] > 200
        opened.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    found = np.array(opened.evaluate("clmorph.landmarks"))
    assert np.abs(found - 19.5).max() < 0.2
    assert opened.evaluate("document.documentElement.scrollWidth") <= 360
