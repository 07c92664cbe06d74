"""Displacement interpolation of densities on grids."""

import warnings

import numpy as np
import pytest

import clmorph
from clmorph import ConvergenceWarning, InputError


def gaussian(shape, center, widths):
    """Return a Gaussian of mass 1 on a grid, in image sides of the longer side."""
    height, width = shape
    y, x = np.mgrid[:height, :width] / (max(shape) - 1)
    places = np.array(((x - center[0]) / widths[0], (y - center[1]) / widths[1]))
    found = np.exp(-0.5 * np.sum(places**2, axis=0))
    return found / found.sum()


def moments(grid):
    """Return mean and standard deviation along x and y, in image sides of the longer side."""
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]] / (max(grid.shape) - 1)
    mass = grid / grid.sum()
    means = np.array([(mass * x).sum(), (mass * y).sum()])
    squares = np.array([(mass * x**2).sum(), (mass * y**2).sum()])
    return means, np.sqrt(squares - means**2)


@pytest.mark.parametrize("t", [0.25, 0.5, 0.8])
@pytest.mark.parametrize("blur", [0.01, 0.05])
def test_gaussians_stay_gaussian(device, t, blur):
    """Means and deviations go linearly, but for what the blur adds (Janati et al., 2020)."""
    shape = 41, 61
    first, last = (0.25, 0.3), (0.72, 0.4)
    narrow, wide = (0.05, 0.06), (0.1, 0.05)
    path = clmorph.density_path(
        gaussian(shape, first, narrow), gaussian(shape, last, wide), blur=blur, backend=device
    )
    mean, deviation = moments(path.at(t))
    assert mean == pytest.approx((1 - t) * np.array(first) + t * np.array(last), abs=2e-3)
    # The covariance of the entropic plan of two Gaussians of deviations a and b is
    # sqrt(a^2 b^2 + epsilon^2 / 4) - epsilon / 2; division among four cells adds u (1 - u) cells^2.
    a, b, epsilon = np.array(narrow), np.array(wide), blur**2
    together = np.sqrt(a**2 * b**2 + epsilon**2 / 4) - epsilon / 2
    variance = (1 - t) ** 2 * a**2 + t**2 * b**2 + 2 * t * (1 - t) * together
    cell = 1 / (max(shape) - 1)
    assert np.all(deviation**2 > variance - 1e-4)
    assert np.all(deviation**2 < variance + cell**2 / 4 + 1e-4)


@pytest.mark.parametrize("reach", [None, 0.1])
def test_ends_and_masses(device, rng, reach):
    source, target = rng.random((5, 9)), rng.random((8, 6))
    source[1], target[:, 2] = 0.0, 0.0
    if reach is None:
        target *= source.sum() / target.sum()
    path = clmorph.density_path(source, target, blur=0.05, reach=reach, backend=device)
    assert np.array_equal(path.at(0), source)
    assert np.array_equal(path.at(1), target)
    for t in (1e-9, 0.3, 0.5, 1 - 1e-9):
        grid = path.at(t)
        mass = (1 - t) * source.sum() + t * target.sum()
        assert grid.sum() == pytest.approx(mass, rel=1e-5)
        assert grid.min() >= 0
    assert path.at(0.5).shape == (6, 7)
    same = clmorph.density_path(source, source[::-1], blur=0.05, reach=reach, backend=device)
    assert np.abs(same.at(1e-6) - source).max() < 1e-3 * source.max()  # nothing jumps at the ends


@pytest.mark.parametrize("reach", [None, 0.2])
def test_a_loose_tolerance_adds_no_mass(device, rng, reach):
    """Rows of the plan may then exceed their cells' masses; no cell is negative for that."""
    source, target = rng.random((2, 12, 12)) ** 4
    target *= source.sum() / target.sum()
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        path = clmorph.density_path(
            source, target, blur=0.05, reach=reach, tol=0.3, max_iter=3, backend=device
        )
    for t in (0.01, 0.4, 0.99):
        grid = path.at(t)
        assert grid.min() >= 0
        assert grid.sum() == pytest.approx((1 - t) * source.sum() + t * target.sum(), rel=1e-12)


def test_the_entropic_term_is_that_of_two_gaussians(device):
    """A blur as wide as the Gaussians: the middle is wider than without it, by a closed form."""
    n, deviation, blur = 241, 0.06, 0.05
    first, last = (gaussian((1, n), (c, 0.0), (deviation, 1.0)) for c in (0.35, 0.65))
    path = clmorph.density_path(first, last, blur=blur, tol=1e-5, backend=device)
    mean, found = moments(path.at(0.5))
    epsilon, variance = blur**2, deviation**2
    together = np.sqrt(variance**2 + epsilon**2 / 4) - epsilon / 2
    # Division among neighboring cells adds at most a quarter of a cell's square.
    want, cell = 0.5 * (variance + together), 1 / (n - 1)
    assert mean[0] == pytest.approx(0.5, abs=1e-4)
    assert want + 1e-6 < variance - 10 * cell**2  # the term is far larger than the grid's part
    assert want - 1e-5 < found[0] ** 2 < want + cell**2 / 4 + 1e-5


def test_mass_out_of_reach_fades_in_place():
    source, target = np.zeros((2, 1, 21))
    source[0, 2], target[0, 18] = 1.0, 1.0
    path = clmorph.density_path(source, target, blur=0.01, reach=0.05, backend="numpy")
    middle = path.at(0.5)[0]
    assert middle[2] == pytest.approx(0.5, abs=1e-3)
    assert middle[18] == pytest.approx(0.5, abs=1e-3)
    balanced = clmorph.density_path(source, target, blur=0.01, backend="numpy").at(0.5)[0]
    assert balanced[10] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((2, 2)), "positive sum"),
        (np.array([[1.0, -1.0]]), "at least 0"),
        (np.array([[np.nan, 1.0]]), "at least 0"),
        (np.ones(3), "expected masses"),
        (np.ones((2, 2, 3)), "expected masses"),
        (np.ones((0, 3)), "expected masses"),
        ("a", "masses"),
    ],
)
def test_what_is_no_density(values, message):
    with pytest.raises(InputError, match=message):
        clmorph.density(values)
    with pytest.raises(InputError, match=f"target.*{message}|target.*expected"):
        clmorph.density_path(np.ones((2, 2)), values, backend="numpy")
