"""Compare the whole path from images to frames with the reference, and with itself."""

import inspect

import numpy as np
import plain
import pytest
from benching import photographs
from plain import morph, reference

import clmorph
from clmorph import InputError, PruningWarning
from clmorph.frames.render import HOLE_COVERAGE, uniform_density
from clmorph.pipeline.options import PAPER


@pytest.mark.full
def test_paper_parameters_agree_with_the_reference(device):
    """At 32 x 32: the reference takes a fifth of the time of the paper's 48."""
    images = photographs((32, 32))
    want = reference.morph(*images, n_frames=5)
    got = morph(*images, n_frames=5, endpoints="paper", backend=device)
    assert got.potentials.converged
    assert want.potentials.converged
    assert np.array_equal(got.times, want.times)
    assert np.allclose(got.sigma, want.sigma, rtol=1e-3)
    assert got.plan.total_mass == pytest.approx(want.plan.sum(), rel=1e-3)
    for t, sigma, frame in zip(want.times, want.sigma, got.frames, strict=True):
        numerator, density = reference.render(want.source, want.target, want.plan, t, sigma)
        even = uniform_density(got.particles.mass(t), got.canvas(t), sigma)
        covered = density / even >= HOLE_COVERAGE
        assert covered.mean() > 0.99
        assert np.abs(frame - numerator / density[..., None])[covered].max() <= 2 / 255


@pytest.mark.parametrize("tau", [-9.0, -8.0])
def test_the_papers_threshold_agrees_with_the_reference(device, rng, tau):
    images = _small(rng, (10, 9)), _small(rng, (8, 12))
    options = {"extent": "unit", "unmatched": "drop", "log_threshold": tau, "blur": 0.15}
    got = morph(*images, n_frames=4, tol=1e-5, endpoints="paper", backend=device, **options)
    want = reference.morph(*images, n_frames=4, tol=1e-6, **options)
    whole = reference.transport_plan(want.source, want.target, want.potentials)
    assert 0.02 < 1 - want.plan.sum() / whole.sum() < 0.25  # the threshold acts
    assert np.allclose(got.sigma, want.sigma, rtol=1e-3)
    for t, frame, exact in zip(got.times, got.frames, want.frames, strict=True):
        covered = got.coverage(t) >= HOLE_COVERAGE
        assert covered.mean() > 0.9
        assert np.abs(frame - exact)[covered].max() <= 2 / 255


@pytest.mark.parametrize("size", [24, pytest.param(48, marks=pytest.mark.full)])
def test_the_papers_preset_keeps_the_pairs_of_the_dense_rule(device, size):
    """All of them and no others, with uniform weights 1 / N."""
    images = photographs((size, size))
    options = {"n_frames": 2, "backend": device, "preset": "paper"}
    got = clmorph.morph(*images, **options)
    assert np.all(got.source.weights == 1 / size**2)
    want = reference.transport_plan(got.source, got.target, got.potentials, log_threshold=-13.0)
    kept = np.zeros(want.shape, bool)
    kept[got.plan.rows, got.plan.indices] = True
    assert np.array_equal(kept, want > 0)
    whole = reference.transport_plan(got.source, got.target, got.potentials)
    assert np.array_equal(kept, whole > np.exp(-13.0))
    relative = clmorph.morph(*images, log_threshold=None, **options)
    assert len(relative.plan) > 1.2 * len(got.plan)


def test_an_absolute_threshold_at_many_pixels(device, rng):
    """It says so in one line: before the work where that is certain, and never draws nothing."""
    small = _small(rng, (16, 16)), _small(rng, (16, 16))
    few = {"n_frames": 2, "backend": device}
    with pytest.warns(PruningWarning, match=r"=-6.5 drops \d\d % .* 256 and 256 points"):
        morph(*small, log_threshold=-6.5, **few)
    with pytest.raises(InputError, match=r"no pair of the plan exceeds it.*; lower it"):
        morph(*small, log_threshold=-5.55, **few)
    large = np.zeros((665, 666, 3)), np.zeros((666, 665, 3))  # log(1 / N) just below -13
    with pytest.raises(InputError, match=r"no pair .* can exceed it.*; lower it") as caught:
        morph(*large, log_threshold=-13.0, **few)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="can exceed it"):
        plain.inspect(*large, log_threshold=-13.0, backend=device)
    # Transport between cells of pixels is small again.
    assert len(morph(*small, log_threshold=-7.0, solve_size=8, blur=0.1, **few).plan) > 100


def _small(rng, shape):
    y, x = np.mgrid[: shape[0], : shape[1]] / max(shape)
    return np.stack([0.5 + 0.5 * np.sin(6 * x + k * y + rng.random()) for k in (1, 3, 5)], -1)


CASES = {
    "other sizes and aspects": ((10, 14), (15, 6), {}),
    "one pixel to many": ((1, 1), (9, 9), {}),
    "one row": ((1, 12), (7, 7), {}),
    "balanced": ((9, 9), (9, 9), {"reach": None, "blur": 0.2}),
    "small reach": ((9, 9), (11, 8), {"reach": 0.05}),
    "unit extent": ((10, 14), (15, 6), {"extent": "unit"}),
    "dropped": ((9, 9), (9, 9), {"unmatched": "drop"}),
    "wide blur": ((9, 9), (9, 9), {"blur": 1.0}),
    "no color": ((9, 9), (9, 9), {"color_weight": 0.0}),
}


@pytest.mark.parametrize("case", CASES)
def test_variants_agree_with_the_reference(device, rng, case):
    shape_a, shape_b, options = CASES[case]
    images = _small(rng, shape_a), _small(rng, shape_b)
    got = morph(*images, n_frames=4, tol=1e-4, endpoints="paper", backend=device, **options)
    want = reference.morph(*images, n_frames=4, tol=1e-5, **options)
    for t, frame, exact in zip(got.times, got.frames, want.frames, strict=True):
        covered = got.coverage(t) >= HOLE_COVERAGE
        assert frame.shape == exact.shape
        assert np.abs(frame - exact)[covered].max() <= 2 / 255


def test_result(device, rng):
    images = _small(rng, (10, 12)), _small(rng, (20, 8))
    result = morph(*images, n_frames=6, backend=device)
    assert result.times.tolist() == np.linspace(0, 1, 6).tolist()
    assert result.sigma.shape == (6,)
    assert len(result.frames) == 6
    assert result.frames[0].shape == (10, 12, 3)
    assert result.frames[-1].shape == (20, 8, 3)
    middle = result.frame(0.5)
    assert middle.shape == (15, 10, 3)
    assert middle.dtype == np.float32
    assert 0 <= middle.min() <= middle.max() <= 1
    for t in (-0.1, 1.1, np.nan, "half"):
        with pytest.raises(InputError, match=r"t="):
            result.frame(t)


def test_baselines(device, rng):
    images = _small(rng, (12, 12)), _small(rng, (12, 12))
    fixed = morph(*images, n_frames=3, splatting="fixed", sigma_start=0.8, backend=device)
    assert fixed.sigma.tolist() == [0.8] * 3
    none = morph(*images, n_frames=3, splatting="none", backend=device)
    assert none.sigma.tolist() == [0] * 3


def test_public_signatures_are_mirrored():
    for name in ("sinkhorn", "transport_plan", "morph"):
        ours = inspect.signature(getattr(clmorph, name)).parameters
        theirs = inspect.signature(getattr(clmorph.reference, name)).parameters
        for parameter, value in theirs.items():
            assert parameter in ours
            # The reference's morph is the paper's.
            usual = ours[parameter].default
            assert value.default == (getattr(PAPER, parameter, usual) if name == "morph" else usual)
            assert value.kind == ours[parameter].kind
    # What the reference lacks is about where and how the work is done.
    ours, theirs = (
        set(inspect.signature(each.sinkhorn).parameters) for each in (clmorph, clmorph.reference)
    )
    more = "backend progress method scaling precision start multiscale truncation verify"
    assert ours - theirs == set(more.split())


def test_a_map_of_mass_beside_none(device):
    """The image without a map has as much mass as the other, so both fade alike."""
    red, blue = np.zeros((12, 12, 3)), np.zeros((12, 12, 3))
    red[..., 0] = blue[..., 2] = 1
    result = morph(red, blue, n_frames=2, weights=(np.ones((12, 12)), None), backend=device)
    assert result.source.mass == pytest.approx(result.target.mass)
    assert result.frame(0.25)[..., 2].mean() == pytest.approx(0.25, abs=0.01)


def test_numpy_and_devices_agree(device, rng):
    images = _small(rng, (12, 10)), _small(rng, (8, 16))
    ours = morph(*images, n_frames=3, backend=device)
    theirs = morph(*images, n_frames=3, backend="numpy")
    assert ours.potentials.n_iter == theirs.potentials.n_iter
    for a, b in zip(ours.frames, theirs.frames, strict=True):
        assert np.abs(a - b).max() < 1e-3


def test_the_same_bytes_twice(device):
    images = photographs((32, 32))
    first, second = (morph(*images, n_frames=3, backend=device) for _ in range(2))
    assert np.array_equal(first.potentials.f, second.potentials.f)
    assert np.array_equal(first.frames, second.frames)
