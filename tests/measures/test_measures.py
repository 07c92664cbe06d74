import numpy as np
import pytest
from plain import lift

from clmorph import InputError
from clmorph.images.color import COLOR_SPACES, to_space
from clmorph.measures.lift import pixel_positions
from clmorph.measures.points import as_measure


@pytest.mark.parametrize(
    ("shape", "extent", "x", "y"),
    [
        ((3, 3), "true", [0, 0.5, 1], [0, 0.5, 1]),
        # The longer side spans, and the shorter one is centered; "unit" stretches both.
        ((3, 5), "true", [0, 0.25, 0.5, 0.75, 1], [0.25, 0.5, 0.75]),
        ((3, 5), "unit", [0, 0.25, 0.5, 0.75, 1], [0, 0.5, 1]),
        # A side of one pixel stands in the middle.
        ((1, 1), "true", [0.5], [0.5]),
        ((1, 1), "unit", [0.5], [0.5]),
        ((1, 3), "true", [0, 0.5, 1], [0.5]),
        ((3, 1), "unit", [0.5], [0, 0.5, 1]),
    ],
)
def test_positions(shape, extent, x, y):
    assert pixel_positions(shape, extent).tolist() == [[a, b] for b in y for a in x]


def test_lift(rng):
    image = rng.random((4, 6, 3))
    measure = lift(image, 1.5)
    assert measure.shape == (4, 6)
    assert len(measure) == 24
    assert np.array_equal(measure.colors.reshape(4, 6, 3), image)
    assert np.array_equal(measure.points[:, 2:], 1.5 * measure.colors)
    assert np.array_equal(measure.points[:, :2], measure.positions)
    assert measure.mass == pytest.approx(1)


def test_masses(rng):
    image = rng.random((4, 6, 4))
    image[0, :, 3] = 0
    opaque = image[..., :3]
    assert np.allclose(lift(opaque).weights, 1 / 24)
    alpha = image[..., 3].ravel()
    for mass in ("uniform", "alpha"):
        assert np.allclose(lift(image, mass=mass).weights, alpha / alpha.sum())
    light = np.where(opaque <= 0.04045, opaque / 12.92, ((opaque + 0.055) / 1.055) ** 2.4)
    luminance = (light @ [0.2126, 0.7152, 0.0722]).ravel()
    assert np.allclose(lift(opaque, mass="luminance").weights, luminance / luminance.sum())
    both = luminance * alpha
    assert np.allclose(lift(image, mass="luminance").weights, both / both.sum())
    given = rng.random((4, 6))
    assert np.allclose(lift(image, weights=given).weights, given.ravel() * alpha)
    assert lift(opaque).alpha is None
    for wrong, words in (
        ((opaque, "alpha"), "opaque"), ((np.zeros((2, 2, 4)), "uniform"), "transparent"),
        ((np.zeros((2, 2, 3)), "luminance"), "black"), ((opaque, "weight"), "mass"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            lift(wrong[0], mass=wrong[1])


def test_lifting_into_color_spaces_and_metrics(rng):
    image = rng.random((4, 6, 3))
    for space in COLOR_SPACES:
        measure = lift(image, 1.5, color_space=space)
        assert np.allclose(measure.points[:, 2:], 1.5 * to_space(image, space).reshape(-1, 3))
    factor = rng.random((3, 3))
    metric = factor @ factor.T
    measure = lift(image, 1.5, color_metric=metric)
    difference = measure.colors[:, None] - measure.colors
    wanted = 1.5**2 * np.einsum("ijk,kl,ijl->ij", difference, metric, difference)
    lifted = measure.points[:, None, 2:] - measure.points[:, 2:]
    assert np.allclose(np.sum(lifted**2, axis=2), wanted)


@pytest.mark.parametrize(
    "options",
    [
        {"weights": np.ones((3, 3))},
        {"weights": np.zeros((4, 4))},
        {"weights": -np.ones((4, 4))},
        {"weights": np.full((4, 4), np.nan)},
        {"color_weight": -1},
        {"color_weight": np.nan},
        {"color_weight": "two"},
        {"extent": "square"},
        {"color_space": "hsv"},
        {"color_metric": np.ones((3, 4))},
        {"mass": "heavy"},
    ],
)
def test_wrong_options(options):
    with pytest.raises(InputError):
        lift(np.zeros((4, 4, 3)), **options)


def test_more_points_than_any_backend_takes():
    with pytest.raises(InputError, match=r"clmorph\.fit"):
        lift(np.broadcast_to(np.uint8(0), (20000, 20000, 3)))


@pytest.mark.parametrize("shape", [(5,), (5, 2)])
def test_points_alone(rng, shape):
    """Each has as much mass; shapes of foreign arrays may be of a type of their own."""
    points = rng.random(shape)

    class Foreign:
        def __init__(self):
            self.shape = list(points.shape)

        def __array__(self, dtype=None, copy=None):
            return points

    for given in (points, Foreign()):
        found = as_measure("source", given)
        assert np.array_equal(found.points, points.reshape(5, -1))
        assert np.array_equal(found.weights, np.full(5, 1 / 5))


def test_no_points_and_no_weights():
    for given in (np.zeros((3, 4, 3)), np.zeros((0, 2)), np.float64(3), (1, 2, 3)):
        with pytest.raises(InputError, match=r"an array of points \(N, D\)"):
            as_measure("source", given)
    with pytest.raises(InputError, match="its weights is a NoneType"):
        as_measure("source", (None, np.ones((5, 2))))
