"""Recoloring a picture by the colors of another one."""

import json
from pathlib import Path

import numpy as np
import pytest
from marks import full
from PIL import Image
from skimage import data

import clmorph
from clmorph.cli.main import main
from clmorph.errors import InputError
from clmorph.images.color import COLOR_SPACES, into_gamut, to_space
from clmorph.pipeline import recolor as module
from clmorph.pipeline.color_map import color_map

#: Half a level of 8 bits.
LEVEL = 0.5 / 255


def scene(seed, size=24):
    """A picture of smooth patches of many colors, (size, size, 3)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] / size
    waves = rng.uniform(1, 5, (3, 2)), rng.uniform(0, 6, 3)
    values = [np.sin(u * x + v * y + p) for (u, v), p in zip(*waves, strict=True)]
    return 0.5 + 0.35 * np.stack(values, axis=2) * rng.uniform(0.3, 1.0, 3)


def test_devices_agree(device):
    a, b = scene(0), scene(1)
    want = clmorph.recolor(a, b, blur=0.1, backend="numpy")
    got = clmorph.recolor(a, b, blur=0.1, backend=device)
    # Both solve to the same residual, from which the map can differ by about this share.
    np.testing.assert_allclose(got, want, rtol=0, atol=4 * LEVEL)
    assert np.abs(want - a).mean() > 0.05


@pytest.mark.parametrize("space", COLOR_SPACES)
def test_the_result_has_the_colors_of_the_other(space):
    a, b = scene(2), scene(3)
    found = clmorph.recolor(a, b, blur=0.05, reach=None, color_space=space, backend="numpy")
    ours, theirs, before = (to_space(each.reshape(-1, 3), space) for each in (found, b, a))
    for moment in (np.mean, np.std):
        missed = np.abs(moment(ours, axis=0) - moment(theirs, axis=0)).max()
        assert missed < 0.15 * np.abs(moment(before, axis=0) - moment(theirs, axis=0)).max()


def test_a_change_of_all_colors_is_found():
    """Colors that all moved by one step move by it again, at the first and the last of them too."""
    a = scene(4)
    step = np.array([0.08, -0.05, 0.1])
    found = clmorph.recolor(a, a + step, color_space="srgb", reach=None, backend="numpy")
    np.testing.assert_allclose(found, a + step, rtol=0, atol=0.004)


def test_strength_nothing_returns_the_picture():
    a = np.random.default_rng(0).integers(0, 256, (9, 8, 4), np.uint8)
    found = clmorph.recolor(a, scene(1), strength=0, backend="numpy")
    np.testing.assert_array_equal(found, a / 255)
    np.testing.assert_array_equal(np.rint(255 * found).astype(np.uint8), a)


def test_strength_is_a_share_of_the_way():
    a, b = scene(5), scene(6)
    whole, half = (
        clmorph.recolor(a, b, strength=share, color_space="srgb", blur=0.1, backend="numpy")
        for share in (1.0, 0.5)
    )
    inside = np.all((whole > 0) & (whole < 1), axis=2)
    np.testing.assert_allclose(half[inside], 0.5 * (a + whole)[inside], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "options", [{}, {"reach": 0.2}, {"reach": None}, {"blur": 0.04}, {"color_space": "lab"}]
)
def test_a_picture_is_itself_in_its_own_colors(options):
    a = np.rint(255 * scene(7)) / 255
    found = clmorph.recolor(a, a, backend="numpy", **options)
    assert np.abs(found - a).max() < LEVEL


def test_gradients_stay_smooth():
    """A ramp over 256 pixels takes colors of many kinds, without a band or an edge."""
    ramp = np.linspace([0.1, 0.2, 0.3], [0.9, 0.7, 0.5], 256)[None]
    found = clmorph.recolor(ramp, scene(8), backend="numpy")[0]
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    bends = np.linalg.norm(np.diff(found, 2, axis=0), axis=1)
    assert np.linalg.norm(found[-1] - found[0]) > 0.2
    assert steps.max() < 6 / 255
    assert bends.max() < 0.5 / 255


def test_one_color_stays_one_color():
    a = scene(9)
    a[3:9, 5:12] = [0.3, 0.6, 0.2]
    found = clmorph.recolor(a, scene(1), backend="numpy")
    assert np.ptp(found[3:9, 5:12].reshape(-1, 3), axis=0).max() < 1e-12


def test_colors_without_a_counterpart_stay_within_reach():
    gray = np.repeat(np.linspace(0.2, 0.8, 400).reshape(20, 20, 1), 3, axis=2)
    a = gray.copy()
    a[:2, :4] = [0.9, 0.1, 0.1]
    b = 0.9 * gray + [0.0, 0.02, 0.06]
    forced, free = (
        clmorph.recolor(a, b, blur=0.05, reach=reach, backend="numpy") for reach in (None, 0.1)
    )
    red = np.s_[:2, :4]
    assert np.abs(free - a)[red].max() < 0.25 * np.abs(forced - a)[red].max()
    # The others, which have counterparts, still move.
    others = np.s_[4:]
    assert np.abs(free - a)[others].mean() > 0.5 * np.abs(forced - a)[others].mean()


def test_masks():
    a, b = scene(10), scene(11)
    mask = np.zeros(a.shape[:2], bool)
    mask[:12] = True
    found = clmorph.recolor(a, b, mask=mask, backend="numpy")
    np.testing.assert_array_equal(found[12:], a[12:])
    assert np.abs(found[:12] - a[:12]).mean() > 0.05
    # Colors that are masked do not count.
    alone = clmorph.recolor(a[:12], b, backend="numpy")
    np.testing.assert_allclose(found[:12], alone, rtol=0, atol=1e-9)
    of_bytes = clmorph.recolor(a, b, mask=255 * mask.astype(np.uint8), backend="numpy")
    np.testing.assert_array_equal(of_bytes, found)
    soft = clmorph.recolor(a, b, mask=mask, feather=6.0, backend="numpy")
    jump = np.abs(np.diff(soft - a, axis=0)).max(axis=(1, 2))
    assert jump.max() < 0.5 * np.abs(np.diff(found - a, axis=0)).max()
    nothing = clmorph.recolor(a, b, mask=np.zeros(a.shape[:2]), backend="numpy")
    np.testing.assert_array_equal(nothing, a)


def test_opacity_is_kept_and_invisible_colors_do_not_count():
    a, b = scene(12), scene(13)
    opacity = np.linspace(0, 1, 24 * 24).reshape(24, 24, 1)
    opacity[:4] = 0.0
    found = clmorph.recolor(np.dstack((a, opacity)), b, backend="numpy")
    np.testing.assert_array_equal(found[..., 3:], opacity)
    other = a.copy()
    other[:4] = [1.0, 0.0, 1.0]
    again = clmorph.recolor(np.dstack((other, opacity)), b, backend="numpy")
    np.testing.assert_allclose(again[4:], found[4:], rtol=0, atol=1e-9)
    hidden = np.dstack((b, np.ones((24, 24))))
    hidden[:12, :, 3] = 0.0
    of_half = clmorph.recolor(a, hidden, backend="numpy")
    want = clmorph.recolor(a, b[12:], backend="numpy")
    np.testing.assert_allclose(of_half, want, rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (3, 4)])
def test_small_pictures(shape):
    a = np.linspace(0, 1, shape[0] * shape[1]).reshape(shape)
    for like in (scene(1, 5), np.zeros((1, 1)), np.ones((2, 2, 3))):
        found = clmorph.recolor(a, like, backend="numpy")
        assert found.shape == (*shape, 3)
        assert 0 <= found.min() <= found.max() <= 1
    found = clmorph.recolor(a, np.full((1, 1, 3), 0.25), reach=None, backend="numpy")
    assert found.mean() == pytest.approx(0.25, abs=0.02)


def test_gray_pictures_and_pictures_of_16_bits():
    gray = np.linspace(0, 65535, 24 * 24).reshape(24, 24).astype(np.uint16)
    b = scene(3)
    found = clmorph.recolor(gray, b, backend="numpy")
    want = clmorph.recolor(np.repeat(gray[..., None] / 65535, 3, axis=2), b, backend="numpy")
    np.testing.assert_array_equal(found, want)
    assert np.ptp(found, axis=2).max() > 0.1
    assert np.ptp(clmorph.recolor(b, gray, backend="numpy"), axis=2).max() < 0.5 * np.ptp(b)


def test_pictures_of_8_bits_are_recolored_color_by_color():
    a, b = np.rint(255 * scene(16)).astype(np.uint8), scene(17)
    found = clmorph.recolor(a, b, backend="numpy")
    # With a fractional mask or other numbers every pixel is computed by itself.
    slightly = np.clip(a / 255 + 1e-12, 0, 1)
    by_pixels = clmorph.recolor(slightly, b, backend="numpy")
    np.testing.assert_allclose(found, by_pixels, rtol=0, atol=1e-9)
    some = np.random.default_rng(0).random(a.shape[:2]) > 0.3
    masked = clmorph.recolor(a, b, mask=some, backend="numpy")
    np.testing.assert_array_equal(masked[~some], a[~some] / 255)
    want = clmorph.recolor(slightly, b, mask=some, backend="numpy")
    np.testing.assert_allclose(masked, want, rtol=0, atol=1e-9)


@pytest.mark.parametrize("reach", [None, 1.0])
def test_the_lattice_shows_the_map_itself(reach):
    """Between its nodes too, to half a level: the steps of the map at the pixels' own colors."""
    operations = clmorph.get_backend("numpy")
    points = [to_space(scene(seed).reshape(-1, 3), "oklab") for seed in (18, 19)]
    source, target = (clmorph.WeightedPoints(each, np.ones(len(each))) for each in points)
    change = color_map(source, target, 0.1, reach, operations, lambda share: None)
    own, cross = (
        clmorph.sinkhorn(*pair, 0.1, reach, backend=operations)
        for pair in ((source, source), (source, target))
    )
    want = cross.map(points[0], own=own, backend=operations) - points[0]
    shares = np.exp(-np.maximum(cross.f - own.f, 0.0) / (reach or np.inf) ** 2)
    want *= shares[:, None]
    # Beside the lattice, the clusters differ from the pixels: they are half a blur wide.
    missed = np.abs(change.steps(points[0]) - want)
    assert missed.max() < 4 * LEVEL
    assert missed.mean() < 0.5 * LEVEL


def test_large_pictures_are_sampled_and_recolored_in_parts(monkeypatch):
    a, b = scene(14, 40), scene(15, 40)
    want = clmorph.recolor(a, b, backend="numpy")
    monkeypatch.setattr(module, "CHUNK", 77)
    np.testing.assert_array_equal(clmorph.recolor(a, b, backend="numpy"), want)
    monkeypatch.setattr(module, "SAMPLES", 500)
    sampled = clmorph.recolor(a, b, backend="numpy")
    assert np.abs(sampled - want).mean() < 0.03
    # A mask that no sampled pixel is in.
    mask = np.zeros((40, 40))
    mask[1, 1] = 1.0
    assert np.isfinite(clmorph.recolor(a, b, mask=mask, backend="numpy")).all()


@pytest.mark.parametrize("space", COLOR_SPACES)
def test_colors_beyond_srgb_keep_hue_and_lightness(space):
    rng = np.random.default_rng(0)
    inside = rng.random((200, 3))
    again = into_gamut(to_space(inside, space), space)
    np.testing.assert_allclose(again, inside, rtol=0, atol=1e-4)
    far = 3.0 * (to_space(inside, space) - to_space([[0.5, 0.5, 0.5]], space))
    far += to_space([[0.5, 0.5, 0.5]], space)
    found = into_gamut(far, space)
    assert 0 <= found.min() <= found.max() <= 1
    if space not in ("srgb", "linear"):
        got = to_space(found, space)
        shown = (far[:, 0] > 0.05) & (far[:, 0] < to_space([[0.95] * 3], space)[0, 0])
        assert shown.sum() > 20
        np.testing.assert_allclose(got[shown, 0], far[shown, 0], atol=5e-3)
        chroma, wanted = got[shown, 1:], far[shown, 1:]
        cross = chroma[:, 0] * wanted[:, 1] - chroma[:, 1] * wanted[:, 0]
        assert np.abs(cross / np.linalg.norm(wanted, axis=1)).max() < 5e-3


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"strength": 1.5}, "strength"),
        ({"blur": 0.0}, "blur"),
        ({"reach": -1}, "reach"),
        ({"color_space": "cmyk"}, "color_space"),
        ({"feather": np.nan}, "feather"),
        ({"n_frames": 3}, "n_frames"),
        ({"options": clmorph.MorphOptions()}, "RecolorOptions"),
        ({"mask": np.ones((2, 2))}, r"mask has shape \(2, 2\)"),
        ({"mask": np.full((24, 24), 2.0)}, "mask holds values"),
        ({"image": np.zeros((0, 3, 3))}, "image"),
        ({"like": "like.jpg"}, "like is a path"),
        ({"like": np.zeros((2, 2, 4))}, "like: every pixel is transparent"),
        ({"progress": 3}, "progress"),
    ],
)
def test_mistakes_are_named(wrong, words):
    given = {"image": scene(0), "like": scene(1), "backend": "numpy"} | wrong
    with pytest.raises(InputError, match=words) as caught:
        clmorph.recolor(**given)
    assert "\n" not in str(caught.value)


def test_command(tmp_path, monkeypatch, capfd, refused):
    monkeypatch.chdir(tmp_path)
    for name, seed in (("photo.png", 0), ("like.png", 1)):
        clmorph.write_image(name, scene(seed))
    mask = np.zeros((24, 24), np.uint8)
    mask[:12] = 255
    Image.fromarray(mask).save("mask.png")
    both, plain = ["photo.png", "like.png"], ["--backend", "numpy"]
    given = [*both, "--strength", "0.5", "--mask", "mask.png", *plain, "--json"]
    assert main(["recolor", *given, "-o", "out.png", "-o", "out.jpg", "--recipe"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert (summary["size"], summary["options"]["strength"]) == ([24, 24], 0.5)
    before, after, like = map(clmorph.read_image, ("photo.png", "out.png", "like.png"))
    np.testing.assert_array_equal(after[12:], before[12:])
    assert 255 * np.abs(after[:12] - before[:12]).mean() > 5
    want = clmorph.recolor(before, like, mask=mask, strength=0.5, backend="numpy")
    np.testing.assert_array_equal(np.rint(255 * after), np.rint(255 * want))
    assert json.loads(Path("out.png.json").read_text())["command"] == "recolor"
    for file in ("out.png", "out.jpg", "out.png.json"):
        assert clmorph.load_options(file) == clmorph.RecolorOptions(strength=0.5).as_dict()
        assert main(["recolor", "--config", file, "-o", "again.png", *plain]) == 0
        assert Path("again.png").read_bytes() == Path("out.png").read_bytes()
    assert "24 x 24 pixels" in capfd.readouterr().out
    Image.fromarray(mask[:5]).save("small.png")
    for wrong, words in (
        ([*both], "no output"),
        (["photo.png", "-o", "x.png"], "expected two"),
        ([*both, "-o", "x.gif"], "unknown ending '.gif'"),
        ([*both, "-o", "photo.png"], "photo.png"),
        ([*both, "-o", "x.png", "--strength", "2"], "--strength"),
        ([*both, "-o", "x.png", "--mask", "small.png"], "small.png has 24 x 5 pixels"),
        ([*both, "-o", "x.png", "--mask", "none.png"], "none.png"),
        (["photo.png", "none.png", "-o", "x.png"], "none.png"),
        (["--config", "out.png", "-o", "like.png"], "like.png"),
        (["--config", "out.png", "-o", "x.png", "--morph"], "made by clmorph recolor"),
    ):
        command = "morph" if "--morph" in wrong else "recolor"
        assert words in refused(command, *(word for word in wrong if word != "--morph"), *plain)
    assert not Path("x.png").exists()


# --- noise near black is not amplified, and maps of other pictures hardly change ---------------

PHOTOGRAPHS = "astronaut", "coffee", "rocket", "chelsea"


def photograph(name):
    return getattr(data, name)()[::6, ::6, :3] / 255


def noisy(picture):
    noise = np.random.default_rng(0).normal(0, 1.5 / 255, picture.shape)
    return np.rint(255 * np.clip(picture + noise, 0, 1)) / 255


def steps(values):
    """How much neighbors differ: the deviation of their differences, whatever gradient there is."""
    return np.diff(values, axis=1).std()


@pytest.mark.parametrize("level", [0.0, 4 / 255, 8 / 255])
@pytest.mark.parametrize("other", ["coffee", "astronaut"])
def test_noise_near_black_is_not_amplified(device, level, other):
    picture = photograph("chelsea")
    picture[:25] = level
    picture = noisy(picture)
    found = clmorph.recolor(picture, photograph(other), backend=device)
    assert np.abs(found - picture)[30:].mean() > 0.05
    assert steps(found[:25]) <= 1.02 * steps(picture[:25])


def test_a_mask_that_is_soft_is_limited_too():
    picture = photograph("chelsea")
    picture[:25] = 0.0
    picture = noisy(picture)
    mask = np.full(picture.shape[:2], 0.5)
    mask[:, 40:] = 1.0
    found = clmorph.recolor(picture, photograph("coffee"), mask=mask, backend="numpy")
    assert steps(found[:25, :40]) <= 1.02 * steps(picture[:25, :40])
    assert steps(found[:25, 40:]) <= 1.02 * steps(picture[:25, 40:])


@pytest.mark.parametrize("pair", [(0, 1), *full((1, 2), (2, 3), (3, 0))])
def test_maps_of_photographs_hardly_change(monkeypatch, pair):
    a, b = (photograph(PHOTOGRAPHS[k]) for k in pair)
    limited = clmorph.recolor(a, b, backend="numpy")
    monkeypatch.setattr(module, "SLOPE_BETWEEN", 1e6)
    monkeypatch.setattr(module, "DARK", 1e-9)
    free = clmorph.recolor(a, b, backend="numpy")
    # The astronaut has a sixth of its pixels near black.
    assert 255 * np.abs(limited - free).mean() < (1.0 if pair == (0, 1) else 0.1)
    bright = a.max(axis=2) > 0.4
    np.testing.assert_array_equal(limited[bright], free[bright])


def test_the_limit_is_continuous():
    """From near black on no step between neighboring levels is steeper than 4 times a level."""
    picture = photograph("chelsea")
    picture[:25] = 0.0
    ramp = np.full((40, *picture.shape[1:]), np.arange(40)[:, None, None] / 255)
    both = np.vstack((noisy(picture), ramp))
    look = clmorph.recolor(both, photograph("coffee"), backend="numpy")[-40:, 0]
    assert 255 * np.abs(np.diff(look, axis=0)).max() < 4.01
