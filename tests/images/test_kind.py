"""The kind of a picture, and its flat regions."""

import numpy as np
import pytest
from drawn_pictures import SPRITES, compressed, logo, sprite
from picture_pairs import CUTS, DRAWINGS, picture
from skimage import data
from skimage.transform import resize

from clmorph.images.flat_colors import background_color, foreground, palette
from clmorph.images.kind import kind_of
from clmorph.images.pixels import block_size

LOGOS = ("star", "disc", "ring", "bars")


@pytest.mark.parametrize("name", CUTS)
def test_photographs(name):
    image = picture(name)
    assert kind_of(image) == "photograph"
    assert kind_of(compressed(image, 60)) == "photograph"


@pytest.mark.parametrize("name", ["portrait", "cat"])
def test_a_photographed_object_is_no_drawing(name):
    """Neither on white, nor cut out."""
    image = picture(name)
    y, x = np.mgrid[-1:1:256j, -1:1:256j]
    cut = np.clip((0.5 - np.hypot(x, y)) * 60, 0, 1)[..., None]
    assert kind_of(cut * image + 1 - cut) == "photograph"
    assert kind_of(np.dstack((image, cut))) == "photograph"


@pytest.mark.parametrize("name", [*LOGOS[1:], *sum(DRAWINGS, ())])
def test_drawings(name):
    image = logo(name, 200) if name in LOGOS else picture(name)
    assert kind_of(image) == "drawing"
    assert kind_of(compressed(image, 75)) == "drawing"
    if name in LOGOS:
        assert kind_of(logo(name, 200, ground=None)) == "drawing"


@pytest.mark.parametrize(("name", "side", "ground"), [("star", 900, "#102030"), ("disc", 60, None)])
def test_large_and_small_drawings(name, side, ground):
    assert kind_of(logo(name, side, ground=ground)) == "drawing"


def test_a_shaded_drawing_with_opacity_is_one():
    y, x = np.mgrid[-1:1:120j, -1:1:120j]
    ball = np.clip(np.dstack((0.9 - 0.4 * np.hypot(x, y), 0.4 + 0 * x, 0.3 + 0.2 * y)), 0, 1)
    assert kind_of(np.dstack((ball, np.hypot(x, y) < 0.7))) == "drawing"


@pytest.mark.parametrize("name", SPRITES)
@pytest.mark.parametrize("block", [1, 3, 8])
@pytest.mark.parametrize("ground", [None, (20, 20, 40)])
def test_sprites(name, block, ground):
    assert kind_of(sprite(name, block, ground)) == "sprite"


def smoothed(inside, color, ground, size=40):
    """Return a picture in which a figure, given by what is inside, is anti-aliased."""
    y, x = (np.indices((4 * size, 4 * size)) + 0.5) / 4 - 0.5
    covered = inside(y, x).reshape(size, 4, size, 4).mean(axis=(1, 3))[..., None]
    return np.rint(255 * (covered * np.array(color) + (1 - covered) * ground)) / 255


def test_a_small_drawing_with_soft_edges_is_no_sprite():
    image = smoothed(lambda y, x: np.hypot(y - 20, x - 20) < 15, (0.2, 0.3, 0.8), np.ones(3))
    image = smoothed(lambda y, x: np.hypot(y - 16, x - 20) < 5, (0.9, 0.8, 0.1), image)
    assert kind_of(np.rint(image * 15) / 15) == "drawing"  # few colors, as after a palette


def test_hidden_colors_make_no_difference(rng):
    image = sprite("heart", 30)
    hidden = image[..., 3] == 0
    image[hidden, :3] = rng.random((hidden.sum(), 3))
    assert kind_of(image) == "sprite"
    assert block_size(image) == 30


@pytest.mark.parametrize("margins", [(100, 100), (60, 40), (61, 39)])
def test_a_rectangle_is_no_sprite(margins):
    image = np.pad(np.zeros((200, 200, 3)), (margins, (100, 100), (0, 0)), constant_values=1)
    assert kind_of(image) == "drawing"


@pytest.mark.parametrize("shape", [(400, 900), (60, 120), (256, 256), (800, 1200)])
@pytest.mark.parametrize("end", [0.4, 0.8])
def test_a_gradient_is_no_flat_picture(shape, end):
    """There are no regions of one color in it."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    for ramp in (x / shape[1], y / shape[0], (x + y) / sum(shape)):
        gray = np.rint(255 * (0.2 + (end - 0.2) * ramp)) / 255
        assert kind_of(np.dstack((gray, gray, gray))) == "photograph"


@pytest.mark.parametrize("shape", [(1, 5000), (3, 5000), (2047, 1025)])
@pytest.mark.parametrize("channels", [3, 4])
def test_long_pictures(shape, channels, rng):
    assert kind_of(rng.random((*shape, channels))) == "photograph"


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 9, 3), (2, 2, 4), (3, 1, 3)])
def test_tiny_pictures_have_a_kind(shape, rng):
    assert kind_of(rng.random(shape)) in ("sprite", "drawing", "photograph")
    assert kind_of(np.ones(shape)) in ("sprite", "drawing", "photograph")


def test_large_photographs_are_reduced(monkeypatch):
    """What is judged has at most about a million pixels."""
    seen = []
    monkeypatch.setattr(
        "clmorph.images.kind.foreground",
        lambda colors, alpha: seen.append(colors.shape) or foreground(colors, alpha),
    )
    kind_of(np.asarray(data.astronaut())[:, :100].repeat(3, axis=0).repeat(2, axis=1) / 255.0)
    assert all(max(shape) <= 1024 for shape in seen)
    assert seen


class TestForeground:
    def test_it_is_what_was_drawn(self):
        """To a pixel along the edge; a ring's inside belongs to the background."""
        opaque, clear = logo("ring"), logo("ring", ground=None)
        solid = clear[..., 3] >= 0.5
        assert np.allclose(background_color(opaque), 1.0)
        assert np.array_equal(foreground(clear[..., :3], clear[..., 3]), solid)
        assert np.mean(foreground(opaque) != solid) < 0.02
        assert not foreground(opaque)[32, 32]

    @pytest.mark.parametrize("ground", ["black", "#808080", "#ff7f00"])
    def test_any_background(self, ground):
        inside = foreground(logo("disc", ground=ground))
        assert inside.mean() == pytest.approx(np.pi * 0.22**2, rel=0.05)

    def test_pictures_without_one(self):
        image = picture("gravel")
        assert background_color(image) is None
        assert foreground(image).all()
        assert foreground(np.full((5, 6, 3), 0.3)).all()  # nothing stands before it
        assert foreground(image[:1, :1]).all()

    def test_sprites_keep_colors_near_that_of_the_background(self):
        image = sprite("ghost", 1, (20, 20, 40))
        before = sprite("ghost")[..., 3] > 0
        assert np.array_equal(foreground(image), before)

    def test_a_light_surface_behind_a_dark_outline_belongs_to_it(self):
        image = smoothed(lambda y, x: np.hypot(y - 20, x - 20) < 16, (0.1, 0.1, 0.3), np.ones(3))
        image = smoothed(lambda y, x: np.hypot(y - 20, x - 20) < 14, (0.95, 0.8, 0.65), image)
        y, x = np.mgrid[:40, :40]
        assert foreground(image)[np.hypot(y - 20, x - 20) < 15].mean() > 0.98

    @pytest.mark.parametrize("name", ["star", "ring"])
    def test_what_compression_leaves_is_none(self, name):
        image = logo(name, 200)
        dirt = foreground(compressed(image, 50)) & (np.abs(image - image[0, 0]).max(axis=2) < 0.01)
        assert dirt.sum() < 0.004 * dirt.size

    def test_faint_lines_stay(self):
        """Only what is beside something strong can come from its compression."""
        image = np.ones((64, 64, 3))
        image[10:30, 10:30] = np.linspace(0.1, 0.4, 20)[:, None, None]
        image[50, 5:60] = 0.92
        assert foreground(image)[50, 5:60].all()


@pytest.mark.parametrize("side", [64, 80, 96, 128, 200])
def test_what_an_outline_parts_from_the_ground_is_no_edge(side):
    """The skin beside a thin dark outline, and beside the white of an eye."""
    image = resize(picture("face"), (side, side), anti_aliasing=True)
    skin = np.abs(image - image[side // 2, side // 2]).max(axis=2) < 0.02
    assert skin.mean() > 0.2
    assert foreground(image)[skin].all()


def test_palette(rng):
    colors = np.repeat([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9], [0.92, 0.1, 0.1]], [50, 30, 5], axis=0)
    labels, each = palette(colors, 6)
    assert set(labels) == {0, 1}
    assert labels[0] == labels[-1]  # alike colors are one
    assert np.abs(each - colors).max() < 0.03
    assert palette(rng.random((500, 3)), 4)[0].max() <= 3
