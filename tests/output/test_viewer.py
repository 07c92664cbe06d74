"""Test the text of the page and its parts; test_viewer_page.py tests its behavior."""

import base64
import hashlib
import io
import json
import re

import numpy as np
import plain
import pytest
from films import noise
from PIL import Image
from plain import morph

import clmorph
from clmorph import InputError, OutputError, displacement_statistics
from clmorph._shared.items import MadeItems
from clmorph._shared.printable import printable
from clmorph._shared.threads import MOST_THREADS
from clmorph.frames.canvas import canvas_at
from clmorph.images.pixels import to_bytes
from clmorph.output.html.page import (
    QUALITIES,
    Encoder,
    frame_boxes,
    page,
    read_metadata,
    write_page,
)
from clmorph.output.html.scene import Curve, Scene
from clmorph.output.html.summary import repr_html, scene_of
from clmorph.output.provenance import read_parameters

HOSTILE = '</script><img src="http://127.0.0.1/x" onerror=alert(1)>&amp;\'"\u2028\u00e9\U0001f431\0'


def decoded(text):
    """Frames of a page, as arrays."""
    blocks = re.findall(r'<script type="image/\w+" class="frame">([^<]*)</script>', text)
    pictures = [Image.open(io.BytesIO(base64.b64decode(block))) for block in blocks]
    return [np.asarray(picture.convert("RGBA")) for picture in pictures]


def known(text):
    """What the script of a page knows."""
    return json.loads(re.search(r'id="clmorph-scene">([^<]*)</script>', text)[1])


def small_morph(rng, shapes=((9, 12), (14, 10)), **options):
    images = [rng.random((*shape, 3)) for shape in shapes]
    return morph(*images, n_frames=5, backend="numpy", blur=0.1, **options)


def test_without_webp_frames_are_png(rng, monkeypatch):
    from PIL import features

    monkeypatch.setattr(features, "check", lambda name: name != "webp")
    frames = noise(rng, 4)
    text = page(Scene(frames, np.arange(4.0)))
    assert text.count('type="image/png"') == 4
    assert np.array_equal(np.array(decoded(text))[..., :3], frames)
    with pytest.raises(OutputError, match="more than"):
        page(Scene(frames, np.arange(4.0)), max_bytes=400)


def test_a_page_has_at_most_the_bytes_it_may_have(rng):
    smooth = np.clip(np.add.outer(np.arange(96), np.arange(96))[..., None] + [0, 20, 40], 0, 255)
    frames = [
        np.clip(smooth + rng.normal(0, 6, smooth.shape), 0, 255).astype(np.uint8) for _ in range(6)
    ]
    frames[0] = np.zeros_like(frames[0])
    whole = sum(len(text) for _, text in Encoder(len(frames), 1e9).encode(frames))
    limit = 0.4 * whole
    text = page(Scene(frames, np.arange(6.0)), max_bytes=limit)
    assert sum(map(len, re.findall(r'class="frame">([^<]*)<', text))) <= limit
    (note,) = known(text)["notes"]
    lossy = int(note.split()[0])
    got = decoded(text)
    different = [not np.array_equal(a[..., :3], b) for a, b in zip(got, frames, strict=True)]
    assert sum(different) == lossy > 0
    # Never back and forth.
    assert different == sorted(different)
    assert not different[0]
    for a, b in zip(got, frames, strict=True):
        assert np.abs(a[..., :3].astype(float) - b).mean() < 12
    assert re.search(rf"quality ({'|'.join(map(str, QUALITIES))}) or better", note)
    with pytest.raises(OutputError, match="fewer or smaller frames"):
        page(Scene(frames, np.arange(6.0)), max_bytes=2000)


def test_frames_are_read_once_in_order_and_written_at_once(rng):
    log, frames = [], noise(rng, 9)

    def read(index):
        log.append(("read", index))
        return frames[index]

    class File(io.StringIO):
        def write(self, text):
            if 'class="frame"' in text:
                assert text.count('class="frame"') == 1
                log.append(("write", None))
            return super().write(text)

    file = File()
    scene = Scene(MadeItems(read, 9), np.arange(9.0))
    assert log == []
    write_page(scene, file)
    ahead = np.cumsum([1 if what == "read" else -1 for what, _ in log])
    assert ahead[-1] == 0
    assert 0 <= ahead.min() <= ahead.max() <= MOST_THREADS + 1
    assert [index for what, index in log if what == "read"] == list(range(9))
    assert file.getvalue() == page(scene)


def test_everything_foreign_is_escaped(rng, tmp_path):
    parameters = {HOSTILE.replace("\0", ""): {"a": [HOSTILE, 1, None, True]}, "b": HOSTILE}
    scene = Scene(
        noise(rng, 2), np.arange(2.0), title=HOSTILE, parameters=parameters,
        notes=[HOSTILE], curves=[Curve(HOSTILE, HOSTILE, [1, 2])],
    )  # fmt: skip
    text = page(scene)
    assert text.isascii()
    assert "<img" not in text
    assert "\0" not in text
    # The template's own script, frames and data: not one more.
    assert text.count("<script") == text.count("</script>") == 5
    path = tmp_path / "page.html"
    path.write_text(text)
    assert json.loads(read_metadata(path)) == parameters
    assert known(text)["notes"] == [printable(HOSTILE)]
    plain = page(Scene(noise(rng, 2), np.arange(2.0), title="{{frames}} {{script}}"))
    assert "<title>{{frames}} {{script}}</title>" in plain


def test_nothing_but_the_page_itself_may_run_or_be_loaded(rng):
    text = page(Scene(noise(rng, 2), np.arange(2.0)))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data: blob:"
    for rule, tag in (("script-src", "script"), ("style-src", "style")):
        content = re.search(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    assert not re.search(r"\son\w+=", re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    # The name of SVG's elements, which is no address.
    assert set(re.findall(r"(?:https?|wss?|ftp)://[\w.]+", text)) == {"http://www.w3.org"}
    assert not re.search(r'(?:src|href)="(?!data:,")', text)


def test_parameters_are_read_from_the_page_alone(rng, tmp_path):
    bare = tmp_path / "bare.html"
    bare.write_text(page(Scene(noise(rng, 4), np.arange(4.0))))
    assert json.loads(read_metadata(bare)) == {}
    marker = '<script type="application/json" id="clmorph-parameters">'
    for wrong in ("", "<!doctype html><title>other</title>", marker + '{"a": 1', marker + "[1]<"):
        bare.write_text(wrong)
        with pytest.raises(InputError, match=r"bare\.html"):
            read_parameters(bare)


@pytest.mark.parametrize("extent", ["true", "unit"])
@pytest.mark.parametrize(
    "shapes", [((64, 48), (48, 64)), ((9, 14), (31, 20)), ((40, 40), (80, 80))]
)
def test_pixels_stand_where_the_morph_has_them(extent, shapes):
    """Common frame -> pixel -> box -> common frame is the identity, at every time."""
    times = np.linspace(0, 1, 23)
    canvases = [canvas_at(t, *shapes, extent) for t in times]
    boxes = frame_boxes([canvas.shape for canvas in canvases], times, extent)
    for canvas, (width, height, across, down) in zip(canvases, boxes, strict=True):
        # The place of a point in the frame, as a share of it, from the frame's center.
        in_frame = 0.3 * np.array(canvas.scale) / np.array(canvas.shape[::-1])
        assert np.allclose(in_frame * (width, height), 0.3 * np.array([across, down]))
    if extent == "true":
        assert np.allclose(boxes[:, 2:], 1)
    # Sides follow the motion, not the rounded canvas; true ones lack less than a pixel of it.
    ends = boxes[[0, -1]]
    assert np.allclose(ends[:, 0] / ends[:, 1], [w / h for h, w in shapes])
    if extent == "unit":
        # Along a smooth curve: second differences are tiny.
        assert np.abs(np.diff(boxes[:, 2:], 2, axis=0)).max() < 0.01


def test_boxes_of_chains_and_of_frames_that_no_morph_makes():
    times = np.array([0, 0.5, 1, 1, 1.5, 2])
    sizes = [(11, 11), (16, 16), (21, 21), (21, 21), (16, 16), (11, 11)]
    boxes = frame_boxes(sizes, times)
    assert np.allclose(boxes[:, 0], [11 / 10, 16 / 15, 21 / 20, 21 / 20, 16 / 15, 11 / 10])
    odd = frame_boxes([(11, 11), (99, 50), (11, 11)], np.array([0, 0.5, 1.0]))
    assert np.allclose(odd[1], [50 / 98, 99 / 98, 1, 1])
    assert np.all(np.isfinite(frame_boxes([(1, 1), (1, 1)], np.array([0, 1.0]))))
    for extent in ("true", "unit"):
        line = frame_boxes([(1, 12), (4, 9), (7, 7)], np.array([0, 0.5, 1.0]), extent)
        assert np.all(np.isfinite(line))
        assert np.all(line[:, :2] > 0)


@pytest.mark.parametrize("unmatched", ["fade", "drop"])
def test_curves_are_those_of_the_particles(rng, unmatched):
    result = small_morph(rng, unmatched=unmatched, reach=0.2)
    scene = scene_of(result)
    curves = {curve.name: curve for curve in scene.curves}
    assert np.allclose(curves["kernel width"].values, result.sigma)
    r, c = result.plan.marginals
    dying = np.maximum(result.source.weights - r, 0).sum() if unmatched == "fade" else 0.0
    born = np.maximum(result.target.weights - c, 0).sum() if unmatched == "fade" else 0.0
    for k, t in enumerate(result.times):
        total = result.particles.mass(t)
        values = {name: curve.values[k] for name, curve in curves.items()}
        assert values["mass dying"] == pytest.approx(100 * (1 - t) * dying / total)
        assert values["mass born"] == pytest.approx(100 * t * born / total)
        shares = [values[f"mass {name}"] for name in ("traveling", "dying", "born")]
        assert sum(shares) == pytest.approx(100)
    if unmatched == "fade":
        assert born > 0.01
        assert dying > 0.01
    assert [curve.unit for curve in scene.curves] == ["pixels"] + ["% of mass"] * 3


def test_the_kernel_is_shown_where_it_draws_the_detail(rng):
    pictures = rng.random((2, 8, 8, 3))
    for detail, shown in (("layers", False), ("particles", True)):
        result = clmorph.morph(*pictures, n_frames=3, detail=detail, backend="numpy")
        scene = scene_of(result)
        assert scene.parameters["detail"] == result.detail == detail
        assert ("sigma_start" in scene.parameters) == shown
        assert ("kernel width" in [curve.name for curve in scene.curves]) == shown


def test_arrows_are_mean_displacements(rng):
    result = small_morph(rng)
    moved = displacement_statistics(result.source, result.target, result.plan)
    field = scene_of(result).fields[0]
    # Fewer pixels than arrows: one for each pixel.
    pixels = max(result.source.shape) - 1
    assert np.allclose(field.positions, result.source.positions)
    assert np.allclose(field.displacement * pixels, moved.field.reshape(-1, 2))
    assert field.weights.max() == 1


def test_arrows_of_large_images_are_few(rng):
    result = small_morph(rng, shapes=((30, 50), (9, 9)))
    field = scene_of(result).fields[0]
    assert len(field.positions) == 10 * 17  # three by three pixels each, at most 24 along a side
    moved = displacement_statistics(result.source, result.target, result.plan)
    block = (slice(3, 6), slice(6, 9))
    mass = moved.source_mass[block]
    mean = (moved.field[block] * mass[..., None]).sum((0, 1)) / mass.sum() / 49
    assert np.allclose(field.displacement[17 + 2], mean)
    # As exact where only means of the plan are known.
    means = plain.morph(
        result.source.colors.reshape(30, 50, 3), result.target.colors.reshape(9, 9, 3),
        n_frames=5, backend="numpy", blur=0.1, barycentric=True,
    )  # fmt: skip
    again = scene_of(means).fields[0]
    assert np.allclose(again.displacement, field.displacement, atol=1e-4)


def test_scene_of_a_morph(rng, tmp_path):
    result = small_morph(rng)
    text = page(scene_of(result, title="Two"))
    assert known(text)["notes"] == []
    np.testing.assert_equal(
        [frame[..., :3] for frame in decoded(text)], [to_bytes(frame) for frame in result.frames]
    )
    (tmp_path / "page.html").write_text(text)
    parameters = read_parameters(tmp_path / "page.html")
    assert parameters["source_size"] == [12, 9]
    assert parameters["iterations"] == result.potentials.n_iter
    assert "<title>Two</title>" in text
    balanced = small_morph(rng, reach=(None, 0.4))
    assert scene_of(balanced).parameters["reach"] == ["balanced", 0.4]


def test_sprites_are_shown_as_squares(rng):
    sprite = np.kron(rng.integers(0, 2, (6, 6, 3)), np.ones((3, 3, 1))).astype(float)
    photo = rng.random((18, 18, 3))
    for pair, wanted in (
        ((sprite, sprite), True),
        ((sprite, photo), False),  # as in every other file
        ((photo, photo), False),
    ):
        result = morph(*pair, n_frames=2, backend="numpy", blur=0.2)
        assert scene_of(result).pixelated is wanted


def test_notebooks_stay_small(rng):
    result = small_morph(rng)
    whole = repr_html(result)
    assert whole.startswith("<iframe srcdoc=")
    assert 'sandbox="allow-scripts allow-downloads"' in whole
    assert "allow-same-origin" not in whole
    assert whole.count("class=&quot;frame&quot;") == 5
    few = repr_html(result, max_pixels=3 * 14 * 10)
    assert few.count("class=&quot;frame&quot;") == 3
    assert "3 of 5 frames are shown" in few
    assert "frames are shown" not in whole
    assert repr_html(result, max_pixels=1).count("class=&quot;frame&quot;") == 2
    with pytest.raises(OutputError, match="more than"):
        repr_html(result, max_bytes=50)
