"""Frames whose fine detail is carried from both images along the mean motion."""

import numpy as np
import pytest
from picture_pairs import deformed, picture, psnr
from scipy.ndimage import gaussian_filter, shift

import clmorph
from clmorph import InputError, MorphOptions
from clmorph._shared.enlarging import enlarged
from clmorph.analysis.metrics import crumbs, mean_gradient, step_sizes
from clmorph.frames import bands, carried_detail, halfway
from clmorph.frames.bands import Bands, band_width
from clmorph.frames.canvas import canvas_at
from clmorph.frames.carried_detail import CarriedDetail
from clmorph.frames.ends import ends_of
from clmorph.frames.halfway import Halfway, register
from clmorph.images.pixels import fit
from clmorph.pipeline.options import preset_options

WHOLE = {"solve_size": None, "max_particles": None}


def textured(shape, seed=0):
    """Return a picture with detail at several scales."""
    rng = np.random.default_rng(seed)
    layers = [
        gaussian_filter(rng.normal(size=(*shape, 3)), (width, width, 0)) * width
        for width in (1.0, 3.0, 8.0)
    ]
    total = sum(layers)
    return np.clip(0.5 + 0.25 * total / total.std(), 0, 1)


class TestMotion:
    def test_registration_finds_a_shift(self):
        image = textured((96, 128))[..., 0]
        moved = shift(image, (3.0, -4.0), order=3, mode="nearest")
        canvas = canvas_at(0.0, image.shape, image.shape)
        nothing = np.zeros((*image.shape, 2))
        found = register((image, moved), (canvas, canvas), nothing, canvas)
        inner = found.displacement[12:-12, 12:-12] * canvas.scale
        assert np.abs(inner - (-4.0, 3.0)).max() < 0.5

    @pytest.mark.parametrize("seed", [0, 1])
    def test_registration_does_not_take_a_line_for_the_next_one(self, monkeypatch, seed):
        """A page whose lines are 16 pixels apart, moved by a line: details alone stay there."""
        shape, spacing = (160, 200), 16
        rng = np.random.default_rng(seed)
        words = gaussian_filter(rng.normal(size=shape), (0.5, spacing / 3)) > 0
        paragraphs = gaussian_filter(rng.normal(size=shape), spacing) > 0
        lines = np.arange(shape[0])[:, None] % spacing < spacing / 2
        page = gaussian_filter((lines & words & paragraphs).astype(float), 1.0)
        moved = shift(page, (spacing, 0.0), order=1, mode="nearest")
        canvas = canvas_at(0.0, shape, shape)

        def share_of_wrong():
            found = register((page, moved), (canvas, canvas), np.zeros((*shape, 2)), canvas)
            border = found.displacement.shape[0] // 10
            inner = found.displacement[border:-border, border:-border] * canvas.scale
            return np.mean(np.abs(inner - (0.0, spacing)).max(axis=-1) > 1.0)

        assert share_of_wrong() < 0.5
        monkeypatch.setattr(halfway, "TRIALS", halfway.TRIALS[:1])
        assert share_of_wrong() > 0.9

    def test_pictures_with_nothing_in_common_are_hardly_bent(self, monkeypatch):
        first, second = (textured((200, 256), seed)[..., 0] for seed in (1, 2))
        canvas = canvas_at(0.0, first.shape, first.shape)
        before = np.full((*first.shape, 2), 0.02)

        def bent():
            found = register((first, second), (canvas, canvas), before, canvas)
            return np.mean(np.linalg.norm(found.displacement - 0.02, axis=-1)) * max(canvas.scale)

        with_trust = bent()
        monkeypatch.setattr(halfway, "COMMON", 2.0)
        monkeypatch.setattr(halfway, "FOREIGN", 3.0)
        assert with_trust < 0.3 * bent(), (with_trust, bent())  # pixels

    @pytest.mark.parametrize("t", [0.0, 0.2, 0.5, 0.9, 1.0])
    def test_both_ends_of_a_point_are_the_same_at_all_times(self, t):
        """What is sampled at time t are the ends of the path through this position."""
        canvas = canvas_at(0.5, (60, 80), (60, 80))
        middle = canvas.positions()
        field = 0.1 * np.stack((np.sin(4 * middle[..., 1]), np.cos(3 * middle[..., 0])), axis=-1)
        motion = Halfway(field, canvas)
        inner = middle[15:-15, 15:-15]
        found = motion.at(t, inner + (t - 0.5) * field[15:-15, 15:-15])
        assert np.abs(found - field[15:-15, 15:-15]).max() * max(canvas.scale) < 0.05  # pixels

    @pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3), (15, 16), (40, 17)])
    def test_pixels_and_positions_are_inverse(self, shape):
        canvas = canvas_at(0.3, shape, (7, 5))
        places = canvas.places(canvas.positions())
        assert np.allclose(places, np.mgrid[: canvas.shape[0], : canvas.shape[1]], atol=1e-9)
        small = canvas.reduced(8)
        assert max(small.shape) <= 8
        # The corners of the smaller canvas are where those of the canvas are, to half a pixel.
        corner = canvas.places(small.positions()[0, 0])
        assert np.all(np.abs(corner) <= 0.5 * np.array(canvas.shape) / small.shape)


def at_rest(bands, canvas):
    """Return the detail of an image that does not move."""
    return bands.detail_at(bands.motion(canvas, np.zeros((1, 1, 2))), slice(0, canvas.shape[0]))


class TestBands:
    @pytest.mark.parametrize("shape", [(40, 53), (300, 210), (1, 9), (400, 3)])
    def test_their_sum_is_the_image(self, shape):
        image = textured((max(shape), max(shape)))[: shape[0], : shape[1]]
        canvas = canvas_at(0.0, shape, shape)
        bands = Bands.of(image, canvas)
        assert max(bands.coarse.shape) <= max(shape)
        assert max(shape) < 150 or max(bands.coarse.shape) < 0.6 * max(shape)
        smooth = bands.smooth_at(bands.coarse.positions())
        detail = at_rest(bands, canvas)
        assert not smooth.lacking.any()
        assert np.abs(detail + enlarged(smooth.low, shape) - image).max() < 1e-5
        assert np.all(smooth.variance >= 0)
        width = 4 * band_width(shape)
        assert np.abs(gaussian_filter(detail, (width, width, 0))).max() < 0.05

    def test_a_flat_image_has_no_detail(self):
        flat = np.full((200, 300, 3), 0.3)
        canvas = canvas_at(0.0, (200, 300), (200, 300))
        bands = Bands.of(flat, canvas)
        assert np.abs(at_rest(bands, canvas)).max() < 1e-6
        assert np.abs(bands.smooth_at(bands.coarse.positions()).low - 0.3).max() < 1e-6

    def test_a_coarser_grid_changes_nothing_that_is_seen(self, device, monkeypatch):
        ends = [fit(picture(name), 200) for name in ("portrait", "cat")]
        frames = []
        for fineness in (bands.FINENESS, 100.0):
            monkeypatch.setattr(bands, "FINENESS", fineness)
            morph = clmorph.morph(*ends, n_frames=3, backend=device)
            frames.append([morph.frame(t) for t in (0.3, 0.5)])
        for coarse, fine in zip(*frames, strict=True):
            assert psnr(coarse, fine) > 45.0


@pytest.mark.parametrize(("name", "seed"), [("cat", 0), ("rocket", 1)])
def test_a_picture_and_its_own_deformation(device, name, seed):
    """The frame halfway is much nearer to the true middle than a cross-fade is."""
    first = fit(picture(name), 128)
    truth, last = deformed(first, seed)
    middle = clmorph.morph(first, last, n_frames=3, backend=device).frame(0.5)
    assert psnr(middle, truth) > psnr((first + last) / 2, truth) + 4.0


@pytest.mark.parametrize(
    "names",
    [
        ("portrait", "photographer"),
        pytest.param(("portrait", "cat"), marks=pytest.mark.full),
        pytest.param(("rocket", "coffee"), marks=pytest.mark.full),
        pytest.param(("camera", "rocket"), marks=pytest.mark.full),
    ],
)
def test_frames_are_sharp_and_clean_at_all_times(device, names):
    ends = [picture(name) for name in names]
    morph = clmorph.morph(*ends, n_frames=3, backend=device)
    for t in (0.25, 0.5, 0.75):
        frame = morph.frame(t)
        gradient, specks = (
            measure(frame) / ((1 - t) * measure(ends[0]) + t * measure(ends[1]))
            for measure in (mean_gradient, crumbs)
        )
        assert 0.85 < gradient < 1.15
        assert specks < 1.1


@pytest.mark.parametrize(
    "names",
    [
        ("portrait", "photographer"),
        pytest.param(("portrait", "cat"), marks=pytest.mark.full),
    ],
)
def test_features_of_portraits_stay_nearer_to_their_places(device, names):
    ends = [picture(name) for name in names]
    moved = []
    for preset in ("portrait", "photo"):
        morph = clmorph.morph(*ends, n_frames=3, preset=preset, backend=device)
        links, mass = morph.particles.links, morph.particles.weights.mean(axis=1)
        here, there = (morph.particles.table[links[:, end], :2] for end in (0, 1))
        moved.append(np.average(np.linalg.norm(there - here, axis=1), weights=mass))
        middle = morph.frame(0.5)
        assert 0.85 < mean_gradient(middle) / np.mean([mean_gradient(end) for end in ends]) < 1.15
    assert moved[0] < 0.8 * moved[1]


@pytest.mark.parametrize(
    ("first", "last"),
    [((40, 56), (48, 33)), ((1, 1), (3, 3)), ((1, 20), (20, 1)), ((5, 7), (30, 20))],
)
def test_ends_are_the_images(device, first, last):
    """Whatever their sizes; frames between have no NaN and stay within the colors."""
    ends = textured((64, 64))[: first[0], : first[1]], textured((64, 64), 1)[: last[0], : last[1]]
    morph = clmorph.morph(*ends, n_frames=3, backend=device)
    for t, image in zip((0.0, 1.0), ends, strict=True):
        assert np.abs(morph.frame(t) - image).max() < 1e-5
    for t in (0.01, 0.3, 0.5, 0.99):
        frame = morph.frame(t)
        assert frame.shape[:2] == morph.canvas(t).shape
        assert 0 <= frame.min() <= frame.max() <= 1


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"mass": "luminance"},
        {"unmatched": "drop"},
        {"unmatched": "drop", "reach": 0.1},
        {"barycentric": True},
        {"sample": 2},
        {"extent": "unit"},
        {"reach": None},
        *({"path_space": space} for space in ("srgb", "linear", "lab", "luv")),
    ],
    ids=str,
)
def test_hardly_anything_of_the_ends_rests(device, given):
    """What particles lack at the ends travels: a resting correction would be a ghost."""
    first, last = np.full((2, 40, 40, 3), 0.1) + 0.1 * textured((40, 40))
    first[6:16, 6:16] += 0.7
    last[20:30, 20:30] += 0.6
    morph = clmorph.morph(first, last, n_frames=3, backend=device, **WHOLE, **given)
    assert morph.options.detail == "carried"
    rest = morph._renderer._first._correction._rest
    assert all(missing is None or np.abs(missing).max() < 0.02 for missing in rest)
    for t, image in ((0.0, first), (1.0, last)):
        assert np.abs(morph.frame(t) - image).max() < 1e-5


@pytest.mark.parametrize("level", [0.0, 0.4, 1.0])
def test_flat_images_stay_flat(level):
    flat, other = np.full((2, 24, 24, 3), level)
    frame = clmorph.morph(flat, other, n_frames=3, backend="numpy").frame(0.5)
    assert np.abs(frame - level).max() < 1e-5


def test_equal_images_stay_as_they_are(device):
    image = textured((48, 48))
    morph = clmorph.morph(image, image, n_frames=3, backend=device, **WHOLE)
    for t in (0.1, 0.5, 0.8):
        assert np.abs(morph.frame(t) - image).max() < 2e-3


def test_first_and_last_steps_are_as_smooth_as_others(device):
    ends = fit(picture("portrait"), 96), fit(picture("cat"), 96)
    morph = clmorph.morph(*ends, n_frames=31, ease="linear", backend=device)
    steps = step_sizes([morph.frame(t) for t in morph.times])
    assert steps.max() < 1.5 * np.median(steps)


def test_backends_agree(device):
    ends = textured((24, 28)), textured((22, 30), 1)
    numpy, other = (
        clmorph.morph(*ends, n_frames=3, backend=backend, **WHOLE) for backend in ("numpy", device)
    )
    for t in (0.2, 0.5, 0.9):
        assert np.abs(numpy.frame(t) - other.frame(t)).max() < 2 / 255
        assert np.array_equal(other.frame(t), other.frame(t))


def test_brightness_changes_evenly(device):
    """Detail has no mean, so a frame is as bright as what the particles show."""
    ends = fit(picture("rocket"), 64), fit(picture("coffee"), 64)
    carried, plain = (
        clmorph.morph(*ends, n_frames=3, detail=way, backend=device).frame(0.5)
        for way in ("carried", "particles")
    )
    assert abs(carried.mean() - plain.mean()) < 0.005


def test_particles_draw_pictures_with_opacity():
    opaque = textured((16, 16))
    clear = np.dstack((opaque, np.tile(np.linspace(0, 1, 16), (16, 1))))
    first, second = (
        clmorph.morph(opaque, clear, n_frames=3, detail=way, backend="numpy", **WHOLE).frame(0.4)
        for way in ("carried", "particles")
    )
    assert np.array_equal(first, second)
    assert clmorph.morph(opaque, clear, n_frames=3, backend="numpy").detail == "particles"


def test_frames_do_not_depend_on_the_unit_of_the_color_space(monkeypatch):
    """In a space three times as large as Oklab, frames are three times as large."""
    ends = clmorph.lift(textured((16, 20))), clmorph.lift(textured((16, 20), 1))
    potentials = clmorph.sinkhorn(*ends, blur=0.1, backend="numpy", reach=0.3)
    plan = clmorph.transport_plan(*ends, potentials, backend="numpy")
    canvases = tuple(canvas_at(t, (16, 20), (16, 20)) for t in (0.0, 0.5, 1.0))
    original = carried_detail.to_space

    def enlarged(colors, space):
        return (3.0 if space == "srgb" else 1.0) * original(colors, "oklab")

    for module in (bands, carried_detail):
        monkeypatch.setattr(module, "to_space", enlarged)
    shown = np.random.default_rng(0).random((3, 16, 20, 3))
    frames = [
        CarriedDetail(
            ends_of(ends), clmorph.particles(*ends, plan, path_space=space), canvases,
            (unit * shown[0], unit * shown[1]),
        ).frame(0.4, canvases[1], unit * shown[2]) / unit
        for space, unit in (("oklab", 1.0), ("srgb", 3.0))
    ]  # fmt: skip
    assert np.abs(frames[0] - frames[1]).max() < 1e-5


def test_the_band_is_a_share_of_the_picture_but_never_below_a_pixel():
    assert band_width((1000, 500)) == 2 * band_width((250, 500))
    assert band_width((3, 3)) == band_width((9, 9)) > 1
    ends = clmorph.lift(textured((10, 80))), clmorph.lift(textured((110, 8)))
    potentials = clmorph.sinkhorn(*ends, blur=0.2, backend="numpy", reach=0.3)
    plan = clmorph.transport_plan(*ends, potentials, backend="numpy")
    canvases = tuple(canvas_at(t, (10, 80), (110, 8)) for t in (0.0, 0.5, 1.0))
    shown = np.zeros((10, 80, 3)), np.zeros((110, 8, 3))
    carried = CarriedDetail(ends_of(ends), clmorph.particles(*ends, plan), canvases, shown)
    assert carried.kernel_width(0.0, canvases[0]) == band_width((10, 80))
    assert carried.kernel_width(1.0, canvases[2]) == band_width((110, 8))


class TestOptions:
    @pytest.mark.parametrize(
        "given",
        [
            {"splatting": "local"},
            {"splatting": "none"},
            {"sigma_start": 1.0},
            {"sigma_end": 2.0},
            {"gamma": 0.5},
            {"sigma": "optimal"},
            {"endpoints": "paper"},
            {"preset": "paper"},
            {"preset": "crossfade"},
            {"preset": "logo", "sigma_start": 1.0},
            {"preset": "pixel-art", "splatting": "local"},
        ],
    )
    def test_the_kernel_of_particles_implies_them(self, given):
        options = MorphOptions(**given)
        assert options.detail == "particles"
        assert options.replace(n_frames=9).detail == "particles"

    @pytest.mark.parametrize(
        "given",
        [{}, {"sigma_start": "auto"}, {"endpoints": "exact"}, {"gamma": None}, {"blur": 0.01},
         {"preset": "balanced"}],
    )  # fmt: skip
    def test_others_do_not(self, given):
        options = MorphOptions(**given)
        assert options.detail == "carried"
        assert options.replace(blur=0.02).detail == "carried"

    @pytest.mark.parametrize(
        ("layers", "detail"),
        [
            # As a file and a preset of the command line are.
            (({"sigma": "optimal"}, preset_options("balanced")), "particles"),
            ((preset_options("paper"), {"detail": "carried"}), "carried"),
            (({"splatting": "none"}, preset_options("photo")), "carried"),
            ((preset_options("photo"), {"sigma_end": 1.0}), "particles"),
            ((preset_options("photo"), {"detail": "particles"}, {"blur": 0.02}), "particles"),
        ],
    )
    def test_later_layers_win(self, layers, detail):
        settings = MorphOptions.layered(layers)
        assert settings["detail"] == detail
        options = MorphOptions(**settings)
        assert options.detail == detail
        assert options.replace(n_frames=7).detail == detail

    def test_carried_detail_resets_the_kernel(self):
        options = MorphOptions(preset="paper").replace(detail="carried")
        assert (options.splatting, options.sigma_start, options.gamma) == ("local", "auto", None)
        assert options.endpoints == "exact"
        assert options.blur == 0.05

    @pytest.mark.parametrize(
        "given",
        [{"sigma_start": 1.0}, {"splatting": "adaptive"}, {"gamma": 0.5}, {"endpoints": "paper"}],
    )
    def test_both_contradict(self, given):
        ((name, _),) = given.items()
        with pytest.raises(InputError, match=rf"^detail='carried' and .*{name}=.* contradict.*$"):
            MorphOptions(detail="carried", **given)


def discs(places, side=48):
    """Two discs of the same stripes on a smooth ground, and their labels 1 and 2."""
    y, x = np.mgrid[:side, :side]
    image = np.stack([0.3 + 0.2 * y / side] * 3, axis=-1)
    labels = np.zeros((side, side), int)
    for label, (column, row) in enumerate(places, start=1):
        inside = np.hypot(x - column, y - row) < 7
        image[inside] = np.where((x + y)[inside] % 3 < 1, 0.9, 0.5)[:, None] * (1.0, 0.8, 0.5)
        labels[inside] = label
    return image, labels


def test_detail_goes_with_its_label(device):
    """Discs that change sides meet in the middle, with their stripes; without labels none does."""
    (a, ours), (b, theirs) = (
        discs(places) for places in (((10, 20), (37, 27)), ((37, 20), (10, 27)))
    )
    y, x = np.mgrid[:48, :48]
    middle = np.hypot(x - 23.5, y - 23.5) < 12
    shares = {}
    for name, labels in (("with", (ours, theirs)), ("without", None)):
        morph = clmorph.morph(
            a, b, labels=labels, n_frames=2, preset="photo", reach=1.0, tol=1e-2, backend=device
        )
        assert morph.detail == "carried"
        assert np.abs(morph.frame(0.0) - a).max() < 1e-5
        assert np.abs(morph.frame(1.0) - b).max() < 1e-5
        frame = morph.frame(0.5).astype(float)
        fine = ((frame - gaussian_filter(frame, (2, 2, 0))) ** 2).sum(axis=-1)
        shares[name] = fine[middle].sum() / fine.sum()
    assert shares["with"] > 0.4, shares
    assert shares["without"] < 0.3, shares


def test_many_labels_are_drawn_by_particles(rng):
    image = rng.random((18, 18, 3))
    labels = np.add.outer(np.arange(18) // 4 * 5, np.arange(18) // 4)
    morph = clmorph.morph(
        image, image[::-1], labels=(labels, labels), n_frames=2, preset="photo", backend="numpy"
    )
    assert len(np.unique(labels)) > 16
    assert morph.detail == "particles"
    assert np.all(np.isfinite(morph.frame(0.5)))
    few = tuple((labels > each).astype(int) for each in (7, 90))  # the second picture has one
    morph = clmorph.morph(
        image, image[::-1], labels=few, n_frames=2, preset="photo", backend="numpy"
    )
    assert morph.detail == "carried"
    for t, end in ((0.0, image), (1.0, image[::-1])):
        assert np.abs(morph.frame(t) - end).max() < 1e-5
    assert np.all(np.isfinite(morph.frame(0.5)))
