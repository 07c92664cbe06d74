"""Compare solutions with closed forms, and with other libraries on the same problem."""

from pathlib import Path

import numpy as np
import pytest
from plain import sinkhorn

from clmorph.transport.sinkhorn import geomloss_blurs

GEOMLOSS = np.load(Path(__file__).parents[1] / "data" / "geomloss.npz")


# --- unbalanced Gaussians: Janati, Muzellec, Peyré, Cuturi (2020) ------------------------


def gaussian_potentials(masses, means, variances, epsilon, rho):
    """Potentials f(x) = sum_d (-F_d x_d^2 / 2 + l_d x_d) + f0 between two Gaussians.

    A soft minimum of a quadratic over a Gaussian is a quadratic, so the fixed point is one
    quadratic equation and two linear ones.
    """
    damping = rho / (rho + epsilon)
    s_a, s_b = (epsilon / v for v in variances)
    alpha = 1 - damping
    k = s_b + alpha
    half = k * (s_a - alpha)
    root = np.sqrt(half**2 + 4 * k * (k * alpha * s_a + damping * (alpha + s_a)))
    p = (root - half) / (2 * k)  # 1 + F
    q = alpha + damping / (s_a + p)  # 1 + G
    scaled = s_b + q, s_a + p  # epsilon times the precision of each Gaussian integral
    slopes = []
    for d in range(len(p)):
        matrix = [[1, damping / scaled[0][d]], [damping / scaled[1][d], 1]]
        right = [
            -damping * s_b[d] * means[1][d] / scaled[0][d],
            -damping * s_a[d] * means[0][d] / scaled[1][d],
        ]
        slopes.append(np.linalg.solve(matrix, right))
    f1, g1 = np.transpose(slopes)

    def constant(mean, variance, s, scale, slope, mass):
        terms = 0.5 * s * mean**2 + 0.5 * epsilon * np.log(variance * scale / epsilon)
        terms = terms - 0.5 * (s * mean + slope) ** 2 / scale
        return damping * (terms.sum() - epsilon * np.log(mass))

    right = [
        constant(means[1], variances[1], s_b, scaled[0], g1, masses[1]),
        constant(means[0], variances[0], s_a, scaled[1], f1, masses[0]),
    ]
    f0, g0 = np.linalg.solve([[1, damping], [damping, 1]], right)
    return (p - 1, f1, f0), (q - 1, g1, g0)


def on_grid(mass, mean, variance, side, low=-1.5, high=1.5):
    axis = np.linspace(low, high, side)
    points = np.stack(np.meshgrid(*[axis] * len(mean), indexing="ij"), -1).reshape(-1, len(mean))
    density = np.exp(-0.5 * np.sum((points - mean) ** 2 / variance, axis=1))
    density /= np.prod(np.sqrt(2 * np.pi * variance))
    return mass * density * (axis[1] - axis[0]) ** len(mean), points


@pytest.mark.parametrize(("dimension", "side"), [(1, 400), (2, 36)])
@pytest.mark.parametrize(("blur", "reach"), [(0.3, 0.5), (0.2, 2.0), (0.5, 0.3)])
def test_unbalanced_gaussians(any_backend, dimension, side, blur, reach):
    masses = 0.7, 1.6
    means = np.array([-0.2, 0.1])[:dimension], np.array([0.25, -0.05])[:dimension]
    variances = np.array([0.02, 0.04])[:dimension], np.array([0.05, 0.025])[:dimension]
    pair = [on_grid(*measure, side) for measure in zip(masses, means, variances, strict=True)]
    got = sinkhorn(*pair, blur, reach, 1e-5, backend=any_backend)
    epsilon, rho = blur**2, reach**2
    exact = gaussian_potentials(masses, means, variances, epsilon, rho)
    values = []
    for potential, (weights, points), (curve, slope, level) in zip(
        (got.f, got.g), pair, exact, strict=True
    ):
        want = points @ slope - 0.5 * points**2 @ curve + level
        inside = weights > 1e-4 * weights.max()  # farther out the grid's end is felt
        assert np.abs(potential - want)[inside].max() < 2e-4 * epsilon
        values.append(weights @ np.exp(-want / rho))
    assert values[0] == pytest.approx(values[1], rel=1e-6)
    assert got.transported_mass == pytest.approx(values[0], rel=1e-4)
    optimum = rho * sum(masses) + epsilon * masses[0] * masses[1]
    optimum -= (rho + epsilon / 2) * sum(values)
    assert got.dual == pytest.approx(optimum, abs=1e-6)
    assert got.dual - 1e-6 <= optimum <= got.primal + 1e-6


# --- GeomLoss: its schedule, step by step ------------------------------------------------


@pytest.mark.parametrize("scaling", [0.9, 0.5])
@pytest.mark.parametrize("reach", [None, 0.01, 0.05, 0.1, 0.3, 0.5])
def test_geomloss(any_backend, reach, scaling):
    """Its own results in float64, written by ``tools/geomloss_reference.py``."""
    pair = (GEOMLOSS["a"], GEOMLOSS["x"]), (GEOMLOSS["b"], GEOMLOSS["y"])
    got = sinkhorn(*pair, 0.05, reach, method="geomloss", scaling=scaling, backend=any_backend)
    for ours, name in ((got.f, "f"), (got.g, "g")):
        theirs = GEOMLOSS[f"{name} reach {reach} scaling {scaling}"]
        assert np.abs(ours - theirs).max() < 1e-3 * got.epsilon
    assert got.status in ("schedule", "converged")
    assert "GeomLoss" in got.message


def test_geomloss_schedule_of_points_at_one_place():
    assert geomloss_blurs(0.0, 0.05, 0.5) == [0.05, 0.05]
