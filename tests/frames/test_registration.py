"""Both pictures meet where they agree, and only there; what is at rest stays as it is."""

import numpy as np
import pytest
from drawn_pictures import logo
from picture_pairs import picture
from scipy.ndimage import gaussian_filter, label

import clmorph
from clmorph.frames import figures
from clmorph.frames.ends import End
from clmorph.frames.registration import FINE, LONGEST, SOFTENING, _flow

SMALL = {"n_frames": 3, "solve_size": 24}
RED = np.array([0.8, 0.1, 0.1])


def photo(name, side):
    return clmorph.fit(picture(name), side)


def disc(place, radius=10.0, ground=None):
    """Return a disc, with opacity if there is no ground."""
    y, x = np.mgrid[:64, :64]
    covered = np.clip(radius + 0.5 - np.hypot(x - place[0], y - place[1]), 0, 1)[..., None]
    if ground is None:
        return np.dstack((np.ones((64, 64, 1)) * RED, covered))
    return covered * RED + (1 - covered) * ground


def seen(frame):
    """Return a frame as it is seen, also where it is transparent: premultiplied by opacity."""
    if frame.shape[2] == 3:
        return frame
    return np.dstack((frame[..., :3] * frame[..., 3:], frame[..., 3]))


class TestFlow:
    def test_nothing_moves_where_nothing_is_seen(self):
        """What flat windows seem to say is noise; an edge says nothing of motion along it."""
        rng = np.random.default_rng(0)
        edge = np.repeat(np.clip((np.arange(96.0) - 48) / 8, -1, 1)[None], 96, axis=0)
        images = [gaussian_filter(edge, 2) + 1e-4 * rng.normal(size=(96, 96)) for _ in range(2)]
        assert np.abs(_flow(images, FINE.radius, LONGEST, SOFTENING)).max() < 0.1

    @pytest.mark.full
    @pytest.mark.parametrize("side", [48, 64, 96])
    def test_unlike_pictures_do_not_agree_by_chance(self, device, side):
        for names in (("portrait", "cat"), ("portrait", "photographer"), ("rocket", "coffee")):
            ends = [photo(name, side) for name in names]
            layers = clmorph.morph(*ends, backend=device, preset="photo", **SMALL).layers
            assert layers.agreement.mean() < 0.15


@pytest.mark.parametrize(
    "kind",
    [
        "photograph", "star", "glass", "soft", "small",
        *(pytest.param(f"clear {it}", marks=pytest.mark.full) for it in ("star", "bars")),
        pytest.param("drawing", marks=pytest.mark.full),
    ],
)  # fmt: skip
def test_a_picture_becomes_itself(each_device, kind):
    """To a level of 8 bits, also where edges are mixtures with the ground."""
    y, x = np.mgrid[:64, :64]
    image = {
        "photograph": lambda: photo("cat", 64),
        "drawing": lambda: photo("face", 64),
        "star": lambda: logo("star", 64),
        "clear star": lambda: logo("star", 64, ground=None),
        "clear bars": lambda: logo("bars", 64, ground=None),
        "small": lambda: disc((32, 32), 8.0, ground=1.0),
        "glass": lambda: logo("disc", 64, ground=None) * (1, 1, 1, 0.5),
        "soft": lambda: np.dstack(
            (disc((32, 32))[..., :3], np.clip(0.5 + (20 - np.hypot(x - 32, y - 32)) / 9, 0, 1))
        ),
    }[kind]()
    morph = clmorph.morph(image, image.copy(), backend=each_device, **SMALL)
    assert morph.detail == "layers"
    for t in (0.0, 0.02, 0.25, 0.5, 0.8, 1.0):
        error = np.abs(seen(morph.frame(t)) - seen(image))
        assert error.max() < 1.5 / 255, t
        assert error.mean() < 0.5 / 255


@pytest.mark.parametrize("ground", [None, (1.0, 1.0, 1.0), (0.9, 0.9, 0.8), (0.1, 0.2, 0.1)])
@pytest.mark.parametrize("places", [((18, 32), (46, 32)), ((20, 30), (44, 34))])
def test_a_disc_moves_as_one(device, ground, places):
    """It keeps its place on the way, its area and its color, and there is no second one."""
    pair = [disc(place, ground=ground) for place in places]
    morph = clmorph.morph(*pair, backend=device, **SMALL)
    y, x = np.mgrid[:64, :64]
    for t in (0.25, 0.5, 0.75):
        frame = morph.frame(t)
        there = frame[..., -1]
        if ground is not None:
            there = np.linalg.norm(frame - ground, axis=2) / np.linalg.norm(RED - ground)
        place = (1 - t) * np.array(places[0]) + t * np.array(places[1])
        center = np.array([(there * axis).sum() for axis in (x, y)]) / there.sum()
        assert np.abs(center - place).max() < 0.5
        assert there.sum() == pytest.approx(np.pi * 100, rel=0.05)
        assert label(there > 0.5)[1] == 1
        away = np.hypot(x - place[0], y - place[1])
        assert there[away > 13].max() < 0.1
        assert np.abs(frame[away < 7][:, :3] - RED).max() < 0.15


@pytest.mark.full
@pytest.mark.parametrize("kind", ["photographs", "sizes", "logos", "clear logos", "mixed"])
def test_near_frames_are_alike(device, kind):
    """There are no jumps, not even where paths, pixels or levels of a picture change."""
    first, last = {
        "photographs": lambda: (photo("cat", 64), photo("portrait", 64)),
        "sizes": lambda: (photo("standing", 120), photo("coffee", 30)),
        "logos": lambda: (logo("star", 64), logo("ring", 64)),
        "clear logos": lambda: (logo("star", 30, ground=None), logo("ring", 90, ground=None)),
        "mixed": lambda: (photo("cat", 64), logo("disc", 64, ground=None)),
    }[kind]()
    morph = clmorph.morph(first, last, backend=device, **SMALL)
    for t in np.linspace(0.0, 1.0 - 1e-4, 40):
        one, other = morph.frame(t), morph.frame(t + 1e-4)
        if one.shape == other.shape:
            change = np.abs(seen(one) - seen(other))
            assert change.mean() < 0.5 / 255, t
            assert change.max() < 10 / 255, t


@pytest.mark.parametrize("unmatched", ["fade", "grow"])
def test_labels_stay_on_their_sides(device, unmatched):
    """The border between two labels moves evenly, and neither color is beyond it."""

    def side(border, seed):
        noise = gaussian_filter(np.random.default_rng(seed).normal(size=(48, 64)), 2.0)
        noise = 0.2 * noise[..., None] / np.abs(noise).max()
        left = np.broadcast_to(np.arange(64) < border, (48, 64))
        red = RED + noise * (1.0, 0.3, 0.3)
        blue = np.array([0.1, 0.2, 0.8]) + noise * (0.3, 0.3, 1.0)
        return np.clip(np.where(left[..., None], red, blue), 0, 1), np.where(left, 3, 8)

    (first, ours), (last, theirs) = side(24, 1), side(32, 2)
    morph = clmorph.morph(
        first, last, labels=(ours, theirs), preset="photo", unmatched=unmatched, backend=device,
        **SMALL,
    )  # fmt: skip
    for t in (0.1, 0.25, 0.5, 0.75, 0.9):
        frame, border = morph.frame(t), 24 + 8 * t
        red = frame[..., 0] > frame[..., 2]
        assert red[:, : int(border) - 3].all()
        assert not red[:, int(border) + 3 :].any()


class TestOutlines:
    def test_pixels_of_an_edge_place_it(self):
        """An anti-aliased disc has its area, and distances from a circle."""
        image = disc((31.3, 30.8), 12.0)
        end = End(image[..., :3], image[..., 3], "true")
        (figure,) = figures.figures_of([clmorph.lift(image)], [end])
        assert figure.area == pytest.approx(image[..., 3].mean(), rel=1e-6)
        assert figure.softness == 1.0
        assert not figure.translucent
        y, x = np.mgrid[:64, :64]
        exact = 12.0 - np.hypot(x - 31.3, y - 30.8)
        near = np.abs(exact) < 0.45
        assert np.abs(figure.distance - exact)[near].max() < 0.06
        assert np.abs(figure.distance - exact).max() < 1.0


def test_borders_do_not_leave_the_picture(device):
    """Mass that goes to the middle takes no border along, beyond which nothing would be to show."""
    first, last = photo("cat", 64), photo("portrait", 64)
    first[:, :8] = first[:, -8:] = last[:, 28:36] = (0.9, 0.1, 0.1)
    morph = clmorph.morph(first, last, backend=device, preset="photo", **SMALL)
    for field in morph.layers.fields:
        assert field.move[:, 0, 0].max() < 0.01
        assert field.move[:, -1, 0].min() > -0.01
    assert np.abs(morph.layers.fields[0].move[..., 0]).max() > 0.1  # the rest does move


def test_borders_go_out_with_those_of_the_frame(device):
    """A flat picture becomes a tall one: it fills the frame, and mirrors nothing beyond itself."""
    first, last = photo("cat", 64), photo("portrait", 64)
    first = first[10:34]
    morph = clmorph.morph(first, last, backend=device, preset="photo", **SMALL)
    flat, tall = (field.move[..., 1] for field in morph.layers.fields)
    gap = 0.5 * (last.shape[0] - first.shape[0]) / 64
    assert flat[0].max() < -gap + 0.01
    assert flat[-1].min() > gap - 0.01
    assert tall[0].max() < gap + 0.01
    assert tall[-1].min() > -gap - 0.01
