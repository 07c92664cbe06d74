"""Films show one picture at each place, which moves along the plan."""

import numpy as np
import pytest
from drawn_pictures import logo
from picture_pairs import deformed, picture, psnr
from scipy.ndimage import binary_opening
from skimage.transform import resize

import clmorph
from clmorph import InputError
from clmorph.analysis.metrics import ghost
from clmorph.backends.numpy import NumPyOperations
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.pictures import stage_of
from clmorph.frames.switching import switched, switching_times, turns

TIMES = (0.0, 0.25, 0.5, 0.8, 1.0)
SMALL = {"solve_size": 16, "n_frames": 5}


def photo(name, side=32):
    return np.clip(resize(picture(name), (side, side), anti_aliasing=True), 0, 1)


@pytest.fixture(scope="module")
def pair():
    return photo("portrait"), photo("coffee")


def test_ends_are_the_pictures_to_the_bit(device, pair):
    morph = clmorph.morph(*pair, backend=device, **SMALL)
    for t, image in zip((0.0, 1.0), pair, strict=True):
        np.testing.assert_array_equal(morph.frame(t), image.astype(np.float32))
    # And frames approach them.
    for t, image in zip((1e-3, 1 - 1e-3), pair, strict=True):
        assert np.abs(morph.frame(t) - image).mean() < 0.01


@pytest.mark.parametrize(
    ("name", "side"), [("cat", 48), ("face", 64), pytest.param("face", 128, marks=pytest.mark.full)]
)
def test_a_deformation_is_warped(name, side, device):
    image = photo(name, side)
    truth, last = deformed(image, 0)
    frame = clmorph.morph(image, last, backend=device, n_frames=3).frame(0.5)
    assert psnr(frame, truth) > psnr((image + last) / 2, truth) + 6


@pytest.mark.full
def test_unlike_pictures_are_not_seen_through_each_other(device):
    ends = photo("portrait", 128), photo("cat", 128)
    morph = clmorph.morph(*ends, backend=device, n_frames=3)
    times = 0.3, 0.5, 0.7
    found = np.mean([ghost(morph.frame(t), *ends) for t in times])
    fade = np.mean([ghost((1 - t) * ends[0] + t * ends[1], *ends) for t in times])
    assert found < 0.2 * fade


@pytest.mark.parametrize("detail", [None, "particles"])
def test_white_stays_white(detail, device):
    first = np.ones((64, 64, 3))
    last = first.copy()
    first[10:30, 10:30] = 0
    last[30:55, 30:55] = 0
    given = {} if detail is None else {"detail": detail}
    frame = clmorph.morph(first, last, backend=device, **SMALL, **given).frame(0.5)
    np.testing.assert_allclose(frame[2, -4], 1, atol=1e-4)


@pytest.mark.parametrize(
    "shapes", [((40, 24), (20, 48)), ((1, 30), (20, 20)), ((2, 2), (9, 5)), ((1, 1), (3, 3))]
)
@pytest.mark.parametrize("extent", ["true", "unit"])
def test_all_shapes(shapes, extent, any_backend):
    rng = np.random.default_rng(1)
    images = [rng.random((*shape, 3)) for shape in shapes]
    morph = clmorph.morph(*images, extent=extent, backend=any_backend, n_frames=3)
    assert morph.detail == "layers"
    for t in TIMES:
        frame = morph.frame(t)
        assert frame.shape == (*morph.canvas(t).shape, 3)
        assert 0 <= frame.min() <= frame.max() <= 1


@pytest.mark.parametrize(
    "options",
    [
        {"reach": None}, {"barycentric": True}, {"sample": 2}, {"unmatched": "grow"},
        {"unmatched": "drop"}, {"path_space": "srgb"}, {"path_space": "lab"}, {"reach": 1e-3},
    ],
)  # fmt: skip
def test_all_options(options, any_backend, pair):
    images = [resize(image, (24, 24), anti_aliasing=True) for image in pair]
    morph = clmorph.morph(*images, backend=any_backend, n_frames=3, **options)
    assert morph.detail == "layers"
    frames = [morph.frame(t) for t in TIMES]
    assert np.isfinite(frames).all()
    np.testing.assert_allclose(frames[0], images[0], atol=1e-6)
    assert np.std(frames[2]) > 0.05


def test_layers_are_those_of_layers_alone(pair):
    morph = clmorph.morph(*pair, backend="numpy", solve_size=16)
    assert morph.layers.times.shape == morph.layers.agreement.shape
    other = clmorph.morph(*pair, backend="numpy", solve_size=16, detail="particles")
    with pytest.raises(InputError, match='expected "layers"'):
        _ = other.layers


def test_a_stage_covers_both_pictures():
    canvases = [canvas_at(t, (10, 40), (40, 10)) for t in (0.0, 1.0)]
    stage = stage_of(canvases)
    assert stage.shape == (40, 40)
    places = np.vstack([stage.places(each.positions()).reshape(-1, 2) for each in canvases])
    assert -1 < places.min() <= places.max() < 40


class TestTurns:
    @pytest.mark.parametrize("shares", [(0.3, 0.7), (0.2, 0.0, 0.5, 0.3), (1.0, 0.0), (0.0, 1.0)])
    def test_weights_add_up(self, shares):
        rng = np.random.default_rng(2)
        times, agreement = rng.random((2, 12, 15))
        weights = turns(times, agreement, shares)
        np.testing.assert_allclose(sum(weights), 1)
        assert min(weight.min() for weight in weights) > -1e-12
        for weight, share in zip(turns(times, np.ones((12, 15)), shares), shares, strict=True):
            np.testing.assert_allclose(weight, share)

    def test_the_second_picture_takes_over(self):
        rng = np.random.default_rng(3)
        stage = Canvas((32, 48), (47.0, 47.0))
        halves = [resize(rng.random((8, 12, 3)), (32, 48)) for _ in range(2)]
        times = switching_times(halves, np.array([1.0, 0, 0]), stage, NumPyOperations())
        assert 0 <= times.min() < 0.05
        assert 0.95 < times.max() <= 1
        none = np.zeros_like(times)
        seen = [switched(times, none, t) for t in np.linspace(0, 1, 21)]
        assert np.all(seen[0] == 0)
        assert np.all(seen[-1] == 1)
        assert np.all(np.diff(seen, axis=0) >= 0)
        # Most places show one picture alone.
        assert all(np.mean((w > 0.02) & (w < 0.98)) < 0.3 for w in seen)

    def test_the_order_of_thin_lines_does_not_follow_their_edges(self):
        """A region that ended at the edge of a line would cut off its side."""
        stage = Canvas((96, 96), (95.0, 95.0))
        halves = [np.ones((96, 96, 3)) for _ in range(2)]
        for across, down in ((20, 60), (50, 30), (70, 80)):
            halves[0][across : across + 3] = 0
            halves[1][:, down : down + 3] = 0
        given = halves, np.array([1.0, 0, 0]), stage, NumPyOperations()
        times = [switching_times(*given, thin=np.full((96, 96), thin)) for thin in (0.0, 1.0)]
        steepest = [np.abs(np.diff(each, axis=0)).max() for each in times]
        assert steepest[1] < 0.5 * steepest[0]


def test_figures_keep_their_colors_beyond_the_ground(device):
    """A logo on white becomes one on black: no rim of the other ground is seen."""
    ends = logo("disc", 48, ground="white"), logo("disc", 48, ground="black")
    frame = clmorph.morph(*ends, backend=device, **SMALL).frame(0.5)
    inside = np.abs(ends[0] - 1).max(axis=2) > 0.3
    ground = frame[~inside & (np.abs(ends[0] - 1).max(axis=2) < 0.01)]
    assert np.ptp(ground.mean(axis=1)) < 0.05


@pytest.mark.full
def test_edges_that_lose_contrast_have_no_halos(device):
    """A disc on a light ground goes into a gray picture: no pixel is beyond both colors."""
    y, x = np.indices((384, 384)) / 384 - 0.5
    distance = np.hypot(y, x)
    edge = np.clip((distance - 0.26) * 384 / 1.5, 0, 1)[..., None]
    disc, gray = 0.1 + 0.8 * edge * np.ones(3), (0.5 + 0.2 * x)[..., None] * np.ones(3)
    film = clmorph.morph(disc, gray, n_frames=3, size=None, preset="photo", backend=device)
    for t in (0.4, 0.6):
        frame = film.frame(t)[..., 0]
        assert frame.min() > frame[distance < 0.2].min() - 0.06
        assert frame.max() < frame[distance > 0.32].max() + 0.04


@pytest.mark.full
def test_fine_lines_are_seen_before_the_end(device):
    y, x = np.mgrid[:128, :128] - 63.5
    disc, grid = np.ones((2, 128, 128, 3))
    disc[np.hypot(x, y) < 40] = 0
    grid[
        (np.maximum(abs(x), abs(y)) < 40) & ((x // 8 * 8 + 0.5 == x) | (y // 8 * 8 + 0.5 == y))
    ] = 0
    film = clmorph.morph(disc, grid, n_frames=9, backend=device)
    few, many = (_fine(film.frame(t)) for t in (0.25, 0.75))
    assert few > 0.05 * _fine(grid)
    assert many > 0.5 * _fine(grid)


def _fine(frame):
    """Return the number of dark pixels of a frame that stand in lines of at most two pixels."""
    dark = frame[..., 0] < 0.5
    return np.count_nonzero(dark & ~binary_opening(dark, np.ones((3, 3))))
