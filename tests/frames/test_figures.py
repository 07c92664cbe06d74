"""Figures before a ground: outlines stay sharp, areas change evenly, sprites keep their pixels."""

import numpy as np
import pytest
from drawn_pictures import compressed, logo, sprite
from PIL import Image, ImageDraw
from scipy.ndimage import binary_erosion, label

import clmorph
from clmorph import InputError, MorphOptions
from clmorph.backends.numpy import NumPyOperations
from clmorph.frames import outline, pictures, sprites
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import Field, layer_of, led_to

TIMES = (0.0, 0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98, 1.0)
SMALL = {"solve_size": 32, "n_frames": 3}


def shares(morph):
    """Return the share of opaque, and of half transparent, pixels at `TIMES`."""
    alphas = [morph.frame(t)[..., 3] for t in TIMES]
    return [a.mean() for a in alphas], [((a > 0.05) & (a < 0.95)).mean() for a in alphas]


@pytest.fixture(scope="module")
def pair():
    return logo("star", ground=None), logo("disc", ground=None)


def disc(center, radius, color):
    """Return an anti-aliased disc on white, in 128 x 128 pixels."""
    y, x = (np.indices((512, 512)) + 0.5) / 4 - 0.5
    inside = np.hypot(y - center[0], x - center[1]) < radius
    covered = inside.reshape(128, 4, 128, 4).mean(axis=(1, 3))[..., None]
    return covered * np.array(color) + (1 - covered)


class TestLogos:
    def test_shapes_become_shapes(self, device, pair):
        """Area goes evenly from one to the other, and a frame is as opaque as its ends."""
        morph = clmorph.morph(*pair, backend=device, **SMALL)
        assert morph.detail == morph.options.detail == "layers"
        area, soft = shares(morph)
        start, end = area[0], area[-1]
        even = [(1 - t) * start + t * end for t in TIMES]
        assert np.allclose(area, even, atol=0.012)
        assert max(soft) < 1.5 * max(soft[0], soft[-1])
        # Cross-fading would show half of the star's arms in the middle.
        arms = (pair[0][..., 3] > 0.9) & (pair[1][..., 3] < 0.1)
        alpha = morph.frame(0.5)[..., 3]
        assert np.mean((alpha[arms] > 0.1) & (alpha[arms] < 0.9)) < 0.3

    @pytest.mark.parametrize("ground", [None, "white", "#203040"])
    def test_ends_are_the_images(self, device, ground):
        pair = logo("ring", ground=ground), logo("bars", 50, ground=ground)
        morph = clmorph.morph(*pair, backend=device, **SMALL)
        for t, image in zip((0.0, 1.0), pair, strict=True):
            frame = morph.frame(t)
            assert frame.shape == image.shape
            assert np.abs(frame[..., 3:] - image[..., 3:]).max(initial=0) < 1e-5
            seen = image[..., 3:] > 0 if ground is None else np.ones((*image.shape[:2], 1), bool)
            assert np.abs((frame - image)[..., :3] * seen).max() < 1e-5
        for t in TIMES:
            frame = morph.frame(t)
            assert 0 <= frame.min() <= frame.max() <= 1
            assert frame.shape[:2] == morph.canvas(t).shape

    def test_the_background_stays_and_mixes(self, device):
        pair = logo("star", ground="#ffffff"), logo("disc", ground="#000000")
        morph = clmorph.morph(*pair, backend=device, **SMALL)
        corners = [morph.frame(t)[0, 0] for t in TIMES]
        assert np.all(np.diff([corner.mean() for corner in corners]) < 0)
        assert np.ptp(morph.frame(0.5)[:4, :4], axis=(0, 1)).max() < 1e-3

    @pytest.mark.full
    def test_opaque_and_clear_backgrounds(self, device):
        """The background of the opaque one fades away."""
        pair = logo("star", ground="#ffffff"), logo("disc", ground=None)
        morph = clmorph.morph(*pair, backend=device, **SMALL)
        assert [morph.frame(t)[0, 0, 3] for t in (0.0, 0.5, 1.0)] == pytest.approx([1, 0.5, 0])
        assert morph.frame(0.5)[32, 32, 3] == pytest.approx(1.0, abs=1e-3)

    def test_translucent_shapes_stay_translucent(self, device, pair):
        glass = [image * (1, 1, 1, 0.5) for image in pair]
        morph = clmorph.morph(*glass, preset="logo", backend=device, **SMALL)
        assert morph.frame(0.5)[32, 32, 3] == pytest.approx(0.5, abs=0.01)
        assert morph.frame(0.5)[..., 3].max() < 0.51

    @pytest.mark.full
    def test_a_hole_opens_halfway(self, device):
        """It does so when half of the mass has left, however broad the first figure is there."""
        solid, ring = disc((64, 64), 44, (0.8, 0.1, 0.1)), disc((64, 64), 52, (0.9, 0.5, 0.1))
        ring[disc((64, 64), 16, (0, 0, 0))[..., 0] < 0.5] = 1
        morph = clmorph.morph(solid, ring, preset="logo", backend=device, **SMALL)
        holes = [(morph.frame(t)[44:84, 44:84, 2] > 0.9).mean() for t in (0.2, 0.52, 0.6, 0.8, 1.0)]
        assert holes[0] == 0 < holes[1] < holes[2] < holes[3] < holes[4]

    @pytest.mark.full
    def test_colors_change_up_to_the_rim(self, device):
        first, last = (0.8, 0.2, 0.2), (0.1, 0.4, 0.8)
        pair = disc((64, 64), 20.0, first), disc((80, 70), 24.0, last)
        frame = clmorph.morph(*pair, backend=device, preset="logo", **SMALL).frame(0.5)
        darkest = frame.min(axis=2)
        inside = binary_erosion(darkest < 0.9, iterations=2)
        assert np.ptp(frame[inside], axis=0).max() < 0.06

    @pytest.mark.full
    def test_what_continues_a_figure_hides_no_other_one(self, device):
        """The dark rim of a face does not spread over the meadow that grows below it."""
        y, x = np.mgrid[:96, :96] / 96 - 0.5
        face, house = np.ones((2, 96, 96, 3))
        face[np.hypot(y, 1.3 * x) < 0.30] = 0
        face[np.hypot(y, 1.3 * x) < 0.28] = 1, 0.85, 0.6
        house[60:] = 0.45, 0.7, 0.35
        house[30:67, 30:67] = 0.9, 0.8, 0.6
        morph = clmorph.morph(face, house, backend=device, preset="logo", landmarks=None)
        dark = [np.mean(morph.frame(t).max(axis=2) < 0.25) for t in (0.0, 0.25, 0.5, 0.75)]
        assert max(dark) < 1.5 * dark[0]  # 7 times as much by colors that continue the rim

    @pytest.mark.full
    def test_thin_lines_stay_lines(self, device):
        """Two thin lines that do not meet have no mean: each place shows one of them, whole."""
        images = [Image.new("L", (512, 512), 255) for _ in range(2)]
        man, tree = map(ImageDraw.Draw, images)
        line = {"fill": 40, "width": 8}
        man.ellipse((200, 60, 312, 172), outline=40, width=8)
        man.line((256, 172, 256, 320), **line)
        for hand, foot in ((160, 190), (352, 322)):
            man.line((256, 200, hand, 280), **line)
            man.line((256, 320, foot, 460), **line)
        for x in (240, 272):
            tree.line((x, 460, x, 260), **line)
        tree.arc((120, 80, 280, 240), 90, 330, **line)
        tree.arc((220, 40, 400, 220), 200, 70, **line)
        tree.arc((160, 160, 380, 300), 0, 180, **line)
        pair = [
            np.dstack([np.asarray(i.resize((128, 128), Image.Resampling.BOX)) / 255] * 3)
            for i in images
        ]
        morph = clmorph.morph(*pair, backend=device, preset="logo", landmarks=None)
        dark = [morph.frame(t)[..., 0] < 0.6 for t in (0.25, 0.375, 0.5, 0.625, 0.75)]
        # Means of both lines fall into 31 parts.
        assert sum(label(each, np.ones((3, 3)))[1] for each in dark) < 24

    @pytest.mark.full
    def test_thick_strokes_keep_smooth_outlines(self, device):
        """Where strokes do not meet, the mean of their distances has no tears."""
        pair = []
        for way in (((30, 200), (60, 50), (128, 180), (196, 50), (226, 200)),
                    ((20, 50), (70, 200), (128, 70), (186, 200), (236, 50))):  # fmt: skip
            image = Image.new("L", (256, 256), 255)
            ImageDraw.Draw(image).line(way, fill=0, width=24, joint="curve")
            pair.append(np.dstack([np.asarray(image) / 255] * 3))
        morph = clmorph.morph(*pair, backend=device, preset="logo", landmarks=None)
        rims = []
        for t in (0.0, 0.25, 0.5, 0.75, 0.875, 1.0):
            ink = morph.frame(t)[..., 0] < 0.5
            rims.append(sum(int(np.diff(ink, axis=axis).sum()) for axis in (0, 1)))
            pieces = np.bincount(label(ink)[0].ravel())[1:]
            assert (pieces > 4).sum() <= 3  # rounding decides on specks of a pixel or two
        assert max(rims[1:-1]) < 1.02 * max(rims[0], rims[-1])  # 1.06 times as long with tears

    @pytest.mark.full
    def test_rounding_does_not_change_a_film(self, device, rng):
        """What a picture does not tell is not told by its last bits."""
        images = [Image.new("RGB", (256, 256), "white") for _ in range(2)]
        fruits, ship = map(ImageDraw.Draw, images)
        fruits.ellipse((34, 70, 118, 180), fill="#c02020")
        fruits.ellipse((90, 70, 174, 180), fill="#306080")
        ship.polygon((40, 110, 216, 110, 190, 150, 66, 150), fill="#c02020")
        ship.rectangle((122, 30, 132, 110), fill="#306080")
        half = {"size": (128, 128), "resample": Image.Resampling.BOX}
        pair = [np.asarray(image.resize(**half)) / 255 for image in images]
        noisy = np.clip(pair[0] + 1e-9 * rng.standard_normal(pair[0].shape), 0.0, 1.0)
        frames = [
            clmorph.morph(first, pair[1], backend=device, preset="logo", landmarks=None).frame(0.5)
            for first in (pair[0], noisy)
        ]
        apart = np.abs(frames[1] - frames[0]).max(axis=2) > 0.06
        assert apart.mean() < 0.008  # 0.03 if windows without contrast count

    def test_nothing_comes_from_beyond_a_border(self, device):
        """A figure near the border is not mirrored there when its canvas grows."""
        first, last = np.ones((40, 64, 3)), np.ones((64, 64, 3))
        first[2:30, 20:40] = last[20:60, 20:44] = 0.0
        frame = clmorph.morph(first, last, backend=device, preset="logo", **SMALL).frame(0.5)
        assert label(frame[..., 0] < 0.5)[1] == 1

    def test_margins_of_large_pictures_are_continued_on_fewer_pixels(self, monkeypatch):
        """Distances there are the same to two of these, and the picture's own are kept."""
        y, x = np.mgrid[:96, :128]
        canvas = Canvas((96, 128), (127.0, 127.0))
        own = (30 - np.hypot(x - 64, y - 80)).astype(np.float32) / np.float32(127)
        wanted = pictures._continued(own, canvas)
        monkeypatch.setattr(pictures, "MARGIN_PIXELS", 64)
        found = pictures._continued(own, canvas)
        assert np.array_equal(found[16:-16, 16:-16], own)
        assert not np.array_equal(found, wanted)
        # A border is known to half a pixel, what goes on beyond it to three quarters of one.
        assert 127 * np.abs(found - wanted).max() < 2 * (128 / 64)

    def test_a_figure_that_reaches_a_border_ends_there(self, device):
        """Of a picture that is cut to its figure nothing goes on beyond the border."""
        first, last = np.ones((48, 48, 3)), np.ones((48, 48, 3))
        first[:20, 14:34] = last[24:40, 14:34] = 0.0
        morph = clmorph.morph(first, last, backend=device, preset="logo", **SMALL)
        for t in (0.25, 0.5, 0.75):
            dark = morph.frame(t)[:, 24, 0] < 0.5
            assert abs(dark.argmax() - 24 * t) < 3

    def test_thin_figures_at_a_border_go_on_nowhere(self, device):
        """A frame along the border, and ground within: beyond the border there is no second one."""
        first, last = np.ones((48, 48, 3)), np.ones((48, 48, 3))
        first[:4, 10:38] = first[:24, 10:14] = first[:24, 34:38] = 0.0
        last[24:44, 10:38] = 0.0
        morph = clmorph.morph(first, last, backend=device, preset="logo", **SMALL)
        for t in (0.25, 0.5, 0.75):
            assert morph.frame(t)[:3].min() > 0.95  # 0 if it went on

    @pytest.mark.full
    def test_figures_that_reach_the_same_border_stay_there(self, device):
        """Two figures that their pictures cut, as portraits: no gap opens below them."""
        first, last = np.ones((48, 48, 3)), np.ones((48, 48, 3))
        first[20:, 10:38] = last[30:, 12:36] = 0.0
        morph = clmorph.morph(first, last, backend=device, preset="logo", **SMALL)
        for t in (0.25, 0.5, 0.75):
            assert morph.frame(t)[-1, 15:33].max() < 0.1

    @pytest.mark.full
    def test_compressed_logos(self, device):
        pair = [compressed(logo(name, 200), 75) for name in ("star", "disc")]
        morph = clmorph.morph(*pair, backend=device, **SMALL)
        assert morph.detail == "layers"
        assert np.abs(morph.frame(0.0) - pair[0]).max() < 1e-5
        middle = morph.frame(0.5)
        assert np.mean(middle[:15] > 0.95) > 0.99  # no dirt in the background

    @pytest.mark.parametrize(
        "given",
        [
            {"reach": 0.2}, {"reach": 0.2, "unmatched": "grow"}, {"mass": "uniform"},
            {"sample": 2}, {"barycentric": True}, {"path_space": "linear"}, {"extent": "unit"},
            {"reach": 0.2, "unmatched": "drop"},
        ],
        ids=str,
    )  # fmt: skip
    def test_all_ways(self, device, pair, given):
        other = logo("ring", 40, ground=None)
        morph = clmorph.morph(pair[0], other, backend=device, preset="logo", **SMALL, **given)
        for t in TIMES:
            frame = morph.frame(t)
            assert 0 <= frame.min() <= frame.max() <= 1
        assert np.abs(morph.frame(0.0)[..., 3] - pair[0][..., 3]).max() < 1e-5
        assert np.abs(morph.frame(1.0)[..., 3] - other[..., 3]).max() < 1e-5

    @pytest.mark.full
    def test_mean_destinations_have_the_colors_of_the_target(self, device):
        pair = logo("disc"), logo("star")
        morph = clmorph.morph(*pair, backend=device, barycentric=True, **SMALL)
        ends = [image[32, 32] for image in pair]
        for t in (0.2, 0.8):
            away = [np.abs(morph.frame(t)[32, 32] - end).max() for end in ends]
            assert away[round(t)] < 0.7 * away[1 - round(t)]
        glass = [logo(name, ground=None) * (1, 1, 1, alpha) for name, alpha in
                 (("disc", 1.0), ("star", 0.4))]  # fmt: skip
        morph = clmorph.morph(*glass, backend=device, preset="logo", barycentric=True, **SMALL)
        assert morph.frame(0.5)[32, 32, 3] == pytest.approx(0.7, abs=0.05)

    def test_a_picture_without_background_fills_the_canvas(self, device):
        full = np.zeros((40, 40, 3))
        full[:, :20], full[:, 20:] = (0.8, 0.2, 0.1), (0.1, 0.3, 0.7)
        morph = clmorph.morph(full, logo("disc", 40), preset="logo", backend=device, **SMALL)
        white = [np.mean(morph.frame(t).min(axis=2) > 0.95) for t in TIMES]
        assert white[0] == 0
        assert np.all(np.diff(white) > -0.02)
        assert white[-1] == pytest.approx(1 - np.pi * 0.22**2, abs=0.03)


def test_outlines_lead_their_layers():
    """What stands at a layer's outline is led to that of the frame, over gaps of any sign."""
    operations, stage = NumPyOperations(), Canvas((96, 96), (95.0, 95.0))
    y, x = np.indices(stage.shape) - 47.5
    own = 25.0 - np.hypot(y, x)
    still = np.zeros((2, 96, 96, 2), np.float32)
    none = np.zeros((96, 96, 3))
    layer = layer_of(Field(none[..., :2], none, none, stage), still, operations)
    for gap in (-3.0, 3.0, 0.2):
        outline = own + gap
        led = led_to(layer, own, outline, 0.5, stage, operations)
        moved = led.moved(0.5)
        shown = 25.0 - np.hypot(y + moved[..., 0], x + moved[..., 1])
        apart = np.abs(shown - outline)[np.abs(outline) < 1.5]
        assert apart.max() < (abs(gap) / 3 if abs(gap) > 1 else 0.25)
        assert np.abs(moved[40:56, 40:56]).max() < 0.2  # the inside stays


class TestSprites:
    @pytest.mark.parametrize("block", [1, 4])
    def test_pixels_stay_pixels(self, device, block):
        """Each is opaque or clear, and in the middle none is a mixture of neighbors."""
        pair = sprite("heart", block), sprite("ghost", block)
        morph = clmorph.morph(*pair, backend=device, n_frames=3)
        assert morph.detail == "pixels"
        assert morph.frame(0.5).shape == (8, 12, 4)  # blocks are taken as pixels
        ends = [np.count_nonzero(sprite(name)[..., 3]) for name in ("heart", "ghost")]
        for t in (0.2, 0.35, 0.5, 0.65, 0.8):
            alpha = morph.frame(t)[..., 3]
            assert np.all((alpha < 1e-6) | (alpha > 1 - 1e-6))
            assert round(float(alpha.sum())) == round((1 - t) * ends[0] + t * ends[1])

    def test_frames_have_few_colors(self, device):
        pair = sprite("invader", 1, (20, 20, 40)), sprite("ghost", 1, (20, 20, 40))
        morph = clmorph.morph(*pair, backend=device, n_frames=3)
        assert morph.frame(0.5).shape[2] == 3
        for t in (0.25, 0.5, 0.75):
            assert len(np.unique(morph.frame(t).round(2).reshape(-1, 3), axis=0)) <= 7

    def test_ends_are_the_sprites(self, device):
        pair = sprite("ghost"), sprite("invader")
        morph = clmorph.morph(*pair, backend=device, n_frames=3)
        for t, image in zip((0.0, 1.0), pair, strict=True):
            frame = morph.frame(t)
            assert np.array_equal(frame[..., 3].round(6), image[..., 3])
            assert np.abs((frame - image)[image[..., 3] > 0]).max() < 1e-5

    def test_maps_keep_the_blocks(self, device):
        """A map has one entry for each pixel, so that blocks stay what they are."""
        pair = sprite("heart", 4), sprite("ghost", 4)
        weights = (pair[0][..., 3] * 1.0, None)
        morph = clmorph.morph(*pair, backend=device, weights=weights, n_frames=3)
        assert morph.frame(0.5).shape == (32, 48, 4)
        assert np.abs(morph.frame(0.0)[..., 3] - pair[0][..., 3]).max() < 1e-5


class TestThreshold:
    @pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (2, 2)])
    def test_tiny_canvases(self, shape):
        for values in (np.zeros(shape), np.ones(shape), np.arange(np.prod(shape)).reshape(shape)):
            for area in (0.01, 0.5, 1.0):
                found = sprites._inside(values.astype(float), area)
                assert found.shape == shape
                assert np.all(np.isfinite(found))
                for most in (np.inf, 0.06):
                    level = outline.level_of(values.astype(float), area, np.ones(shape), most)
                    assert np.isfinite(level)


class TestOptions:
    @pytest.mark.parametrize("detail", ["layers", "pixels"])
    @pytest.mark.parametrize("given", [{"sigma_start": 1.0}, {"gamma": 0.4}, {"splatting": "none"}])
    def test_the_kernel_of_particles_contradicts(self, detail, given):
        with pytest.raises(InputError, match=f"^detail='{detail}' and .* contradict"):
            MorphOptions(detail=detail, **given)
