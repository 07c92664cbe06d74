from itertools import pairwise

import numpy as np
import plain
import pytest
from clouds import smooth
from drawn_pictures import logo
from plain import lift, morph

import clmorph
from clmorph import InputError
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.kernel_width import KernelWidth, effective_count
from clmorph.frames.render import HOLE_COVERAGE, Widths, kernel_mean, render


@pytest.mark.parametrize(
    "sides", [(48, 48), (64, 16), (16, 64), (7, 7), (100, 37), (3, 1000), (1, 7)]
)
def test_canvas_sides_are_not_one_short(sides):
    """In exact arithmetic t = k / 300 often lands on an integer, where rounding must not bite."""
    start, end = sides
    for k in range(301):
        wanted = start + (k * (end - start)) // 300
        assert canvas_at(k / 300, (start, 5), (end, 5)).shape == (wanted, 5)


@pytest.mark.parametrize("extent", ["true", "unit"])
@pytest.mark.parametrize("shapes", [((5, 9), (12, 4)), ((1, 1), (7, 3)), ((6, 6), (1, 8))])
def test_both_ends_map_onto_the_pixels(shapes, extent):
    for t, shape in zip((0.0, 1.0), shapes, strict=True):
        canvas = canvas_at(t, *shapes, extent)
        positions = lift(np.zeros(shape), extent=extent).positions
        pixels = (positions - 0.5) * canvas.scale + canvas.center
        y, x = np.mgrid[: shape[0], : shape[1]]
        assert np.allclose(pixels, np.column_stack((x.ravel(), y.ravel())))


def test_kernel_width():
    canvas = Canvas((40, 40), (39.0, 39.0))
    width = KernelWidth(1.2, 0.5, 0.5, 1e9, 1e9)
    assert width.at(0.0, canvas) == 1.2
    assert width.at(1.0, canvas) == 0.5
    assert width.at(0.5, canvas) == pytest.approx(0.85 + 0.5)
    few = KernelWidth(1.2, 0.5, 0.5, 16, 4)
    assert few.at(0.0, canvas) == pytest.approx(0.5 * np.sqrt(1600 / 16))
    assert few.at(0.5, canvas) == pytest.approx(0.5 * np.sqrt(1600 / 10))
    assert KernelWidth(1.2, 0.5, 0.5, 16, 4, "fixed").at(0.5, canvas) == 1.2
    assert KernelWidth(1.2, 0.5, 0.5, 16, 4, "none").at(0.5, canvas) == 0


@pytest.mark.parametrize(
    "options",
    [
        (0, 0.5, 0.5), (-1, 0.5, 0.5), (1, np.nan, 0.5), (1, 0.5, -0.1), (1, 0.5, np.inf),
        (1, 1, 1, 1, 1, "sharp"),
    ],
)  # fmt: skip
def test_wrong_widths(options):
    with pytest.raises(InputError):
        KernelWidth(*(*options, 1.0, 1.0)[: max(5, len(options))])


def _upload(operations, positions, colors):
    """Resting particles of equal mass, positions in the common frame."""
    table = np.column_stack((positions, colors, np.full(len(colors), 0.02)))
    links = np.repeat(np.arange(len(table)), 2).reshape(-1, 2).astype(np.uint32)
    return operations.upload_particles(table, links, np.full((len(table), 2), 1 / len(table)))


@pytest.mark.parametrize("shape", [(20, 30), (8, 8), (64, 64), (256, 256)], ids=str)
def test_a_constant_image_stays_constant(device, shape):
    """Relative denominators: no absolute clamp turns many small masses into black."""
    measure = lift(np.full((*shape, 3), 0.25))
    moving = _upload(device, measure.positions, measure.colors)
    canvas = canvas_at(0.0, shape, shape)
    for sigma in (0.3, 1.0, 3.0, 12.0):
        frame, coverage, _ = render(device, moving, 1.0, 0.0, canvas, Widths(sigma))
        assert frame.shape == (*shape, 3)
        assert np.abs(frame - 0.25).max() < 1e-5
        # Narrow kernels gather more on the pixels than an even spread. At a border, where a wide
        # one is cut steeply, the sum over pixels is up to 1.2 % off its integral (Euler-Maclaurin:
        # slope / 24), and in a corner twice that.
        assert 0.2 < coverage.min() <= coverage.max() < 2
        assert np.abs(coverage - 1).max() < 0.03 or sigma < 1


def test_holes_are_filled(device):
    """Particles in one corner: the far corner is a hole, filled with the nearest color."""
    positions = np.random.default_rng(0).random((200, 2)) * 0.1
    moving = _upload(device, positions, np.tile([0.8, 0.4, 0.2], (200, 1)))
    canvas = canvas_at(0.0, (40, 40), (40, 40))
    frame, coverage, _ = render(device, moving, 1.0, 0.0, canvas, Widths(0.7))
    assert coverage[-1, -1] < HOLE_COVERAGE
    assert np.abs(frame - [0.8, 0.4, 0.2]).max() < 1e-4


@pytest.mark.parametrize("closed", [False, True])
def test_no_pixel_tips_at_a_threshold(any_backend, closed):
    """Left red, right green and ever fainter: colors follow, none jumps as its pixel is filled."""
    operations = clmorph.get_backend(any_backend)
    measure = lift(np.zeros((20, 20, 3)))
    right = measure.positions[:, 0] > 0.5
    colors = np.where(right[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    table = np.column_stack((measure.positions, colors, np.full(400, measure.spacing)))
    links = np.column_stack((np.arange(400), np.arange(400))).astype(np.uint32)
    canvas = canvas_at(0.0, (20, 20), (20, 20))

    def picture(faint):
        weights = np.where(right, faint, 1.0) / 200
        particles = operations.upload_particles(table, links, np.column_stack((weights, weights)))
        widths = Widths(0.6, closed=closed)
        return render(operations, particles, weights.sum(), 0.0, canvas, widths).colors

    low, high = 1e-5, 1.0
    ends = picture(low), picture(high)
    assert np.abs(ends[0] - ends[1])[:, 12:].max() > 0.9  # it is filled with red at last
    for _ in range(4):  # ever closer to where most happens
        steps = np.geomspace(low, high, 12)
        frames = [picture(faint) for faint in steps]
        jumps = [np.abs(b - a).max() for a, b in pairwise(frames)]
        worst = int(np.argmax(jumps))
        low, high = steps[worst], steps[worst + 1]
    assert high / low < 1.002
    assert jumps[worst] < 2 / 255


@pytest.mark.parametrize("unmatched", ["drop", "fade"])
@pytest.mark.parametrize("splatting", ["adaptive", "local"])
def test_no_pixel_depends_on_pairs_that_were_dropped(device, monkeypatch, splatting, unmatched):
    """Frames of the kept pairs are those of the whole plan, torn and empty pixels included."""
    # Whether moments pay depends on the number of particles and on the device. Their error, within
    # `KERNEL_ERROR` of the peak, is some percent of what fills a pixel at five kernel widths.
    monkeypatch.setattr(device.splatting, "method", "gather")
    images = [smooth(np.random.default_rng(seed), (24, 24)) for seed in (0, 1)]
    source, target = (lift(image, 2.0) for image in images)
    potentials = plain.sinkhorn(source, target, 0.02, 0.15, 1e-4, backend=device)
    kept, whole = (
        clmorph.transport_plan(source, target, potentials, backend=device, **options)
        for options in ({}, {"log_threshold": -80.0})
    )
    assert len(whole) > 3 * len(kept)
    width = KernelWidth(1.2, 0.5, 0.5, *map(effective_count, whole.marginals), splatting)
    for t in (0.1, 0.35, 0.6, 0.9):
        canvas = canvas_at(t, source.shape, target.shape)
        frames = []
        for plan in (kept, whole):
            moving = clmorph.particles(source, target, plan, unmatched=unmatched)
            uploaded = device.upload_particles(moving.table, moving.links, moving.weights)
            frames.append(
                render(device, uploaded, moving.mass(t), t, canvas, width.widths(t, canvas))
            )
        assert np.abs(frames[0].colors - frames[1].colors).max() <= 2 / 255
        if (t, splatting, unmatched) == (0.9, "adaptive", "drop"):
            assert frames[0].coverage.min() < HOLE_COVERAGE


def test_without_a_kernel_holes_stay_black(device):
    moving = _upload(device, np.array([[0.5, 0.5]]), np.ones((1, 3)))
    canvas = canvas_at(0.0, (5, 5), (5, 5))
    frame, coverage, _ = render(device, moving, 1.0, 0.0, canvas, Widths(0.0))
    assert frame.sum() == 3
    assert frame[2, 2].tolist() == [1, 1, 1]
    assert coverage[2, 2] == 25


@pytest.mark.parametrize("splatting", ["local", "adaptive"])
def test_thin_canvases_have_no_black_gaps(device, splatting):
    """Most of a wide kernel sticks out of a row of pixels; that is no reason for holes."""
    weights = np.zeros((1, 600))
    weights[0, [3, 590]] = 1
    image = np.full((1, 600, 3), 0.8)
    result = morph(
        image, image, n_frames=2, weights=(weights, weights), splatting=splatting,
        endpoints="paper", size=None, backend=device,
    )  # fmt: skip
    assert np.abs(result.frame(0.5) - 0.8).max() < 1e-3


def test_denominators_that_a_device_has_rounded_to_nothing_give_no_color():
    """The numerator alone may be left: their ratio would be as large as float64 allows."""
    numerator = np.array([[[1e-40, 2e-40, 0.0], [0.5, 0.25, 1.0]]])
    assert np.array_equal(
        kernel_mean(numerator, np.array([[0.0, 0.5]])), [[[0.0, 0.0, 0.0], [1.0, 0.5, 2.0]]]
    )


def test_transparent_corners_give_no_warning(device):
    """Far from all particles colors are not known, and not needed."""
    pair = [logo(name, 128, ground=None) for name in ("ring", "bars")]
    morph = clmorph.morph(*pair, preset="crossfade", n_frames=3, backend=device)
    assert np.all(np.isfinite(morph.frame(0.125)))
    assert np.abs(morph._renderer.sums(0.125).colors).max() < 10
