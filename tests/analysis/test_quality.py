import numpy as np
import pytest
from plain import morph, sinkhorn_divergence
from several import pictures

from clmorph import InputError
from clmorph.analysis.metrics import (
    crumbs,
    frame_measure,
    hole_fraction,
    mean_gradient,
    particle_measure,
    path_divergence,
    sharpness,
    step_sizes,
)


@pytest.fixture(scope="module")
def images():
    return pictures((14, 14))


@pytest.fixture
def result(device, images):
    return morph(*images, n_frames=5, backend=device)


def test_exact_frames_are_the_images_as_measures(result):
    for t, measure in ((0.0, result.source), (1.0, result.target)):
        frame = frame_measure(result, t, weights="uniform")
        assert np.abs(frame.points - measure.points).max() < 1e-3
        assert np.allclose(frame.weights, measure.weights)
        kernel = frame_measure(result, t)
        assert kernel.mass == pytest.approx(result.particles.mass(t))


def test_particles_as_a_measure(result):
    whole, none = particle_measure(result, 0.3, max_points=1 << 20)
    assert none == 0
    assert whole.mass == pytest.approx(result.particles.mass(0.3))
    merged, spread = particle_measure(result, 0.3, max_points=200)
    assert len(merged) <= 200
    assert merged.mass == pytest.approx(whole.mass)
    assert np.allclose(whole.weights @ whole.points, merged.weights @ merged.points)
    # Merging takes from the variance what it says.
    variance = [
        measure.weights @ np.sum(measure.points**2, axis=1) / measure.mass
        for measure in (whole, merged)
    ]
    assert variance[0] - variance[1] == pytest.approx(spread**2, rel=1e-6)


def test_divergences_along_the_path(result):
    times = (0.0, 0.5, 1.0)
    to_target = path_divergence(result, times)
    values = [float(divergence) for divergence in to_target]
    assert values[2] < 1e-6
    want = sinkhorn_divergence(
        result.source, result.target, result.potentials.blur, result.potentials.reach,
        backend=result.operations,
    )  # fmt: skip
    assert values[0] == pytest.approx(float(want), rel=1e-2)
    for divergence in to_target + path_divergence(result, times, "particles"):
        assert divergence.interval[0] <= divergence.value <= divergence.interval[1]
        assert divergence.interval[1] - divergence.interval[0] < 1e-4
    at_the_ends = path_divergence(result, (0.0, 1.0), "particles", weights="uniform")
    assert max(float(divergence) for divergence in at_the_ends) < 1e-5


def test_more_blur_is_farther_from_the_particles(device, images):
    """The paper's argument turned round: where nothing is torn, a wide kernel only averages."""
    options, away = {"n_frames": 2, "gamma": 0, "endpoints": "paper", "backend": device}, []
    for sigma in (0.5, 1.5, 4.0):
        blurred = morph(*images, sigma_start=sigma, sigma_end=sigma, **options)
        away += path_divergence(blurred, [0.5], "particles")
    assert away[0].closer_than(away[1])
    assert away[1].closer_than(away[2])


def test_wrong_use(result):
    for wrong in (
        lambda: path_divergence(result, [0.5], "source"),
        lambda: path_divergence(result, [2.0]),
        lambda: frame_measure(result, 0.5, weights="alpha"),
        lambda: particle_measure(result, 0.5, max_points=3),
    ):
        with pytest.raises(InputError):
            wrong()


def test_hole_fraction():
    coverage = np.ones((20, 20))
    assert hole_fraction(coverage) == 0
    coverage[5, 5] = 0.01
    coverage[8:10, 3] = 0
    assert hole_fraction(coverage) == pytest.approx(3 / 400)
    assert hole_fraction(1e-2 * np.ones((9, 9))) == 0  # thin, but evenly
    assert hole_fraction(np.zeros((9, 9))) == 1


def test_crumbs_are_specks_and_not_outlines():
    halves = np.zeros((20, 20, 3))
    halves[:, 10:] = 1.0
    assert crumbs(halves) == 0
    faint, bright = halves.copy(), halves.copy()
    faint[5, 5], bright[5, 5] = 0.05, 0.07
    assert crumbs(faint) == 0
    assert crumbs(bright) == pytest.approx(1 / 400)


def test_the_mean_gradient_grows_with_contrast_and_length_of_outlines():
    one, two = np.zeros((2, 21, 21, 3))
    one[:, 10:] = two[:, 5:] = 1.0
    two[:, 15:] = 0.0
    assert mean_gradient(one) == pytest.approx(1 / 20)
    assert mean_gradient(0.5 * one) == pytest.approx(0.5 / 20)
    assert mean_gradient(two) == pytest.approx(2 / 20)
    with pytest.raises(InputError, match=r"expected at least \(2, 2\)"):
        mean_gradient(np.zeros((1, 5, 3)))


def test_sharpness_and_steps():
    board = np.indices((8, 8)).sum(axis=0) % 2
    board = np.repeat(board[..., None], 3, axis=2).astype(float)
    assert sharpness(board) == pytest.approx(1)
    assert sharpness(0.5 * board) == pytest.approx(0.5)
    assert sharpness(np.full((1, 1, 3), 0.3)) == 0
    assert step_sizes([board, 0 * board, 0 * board]).tolist() == pytest.approx([np.sqrt(0.5), 0])
    assert step_sizes([np.zeros((4, 4, 3)), np.ones((8, 8, 3))]).tolist() == [1]
