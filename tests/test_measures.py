import numpy as np
import pytest

from clmorph import InputError, lift
from clmorph.measures import pixel_positions


def test_square_images_span_the_unit_square():
    positions = pixel_positions((3, 3))
    assert positions[0].tolist() == [0, 0]
    assert positions[1].tolist() == [0.5, 0]
    assert positions[-1].tolist() == [1, 1]


def test_the_longer_side_spans_and_the_shorter_is_centered():
    positions = pixel_positions((3, 5))
    assert positions[:, 0].min() == 0
    assert positions[:, 0].max() == 1
    assert positions[:, 1].tolist() == [0.25] * 5 + [0.5] * 5 + [0.75] * 5


def test_unit_extent_stretches_both_axes():
    positions = pixel_positions((3, 5), "unit")
    assert positions.min(axis=0).tolist() == [0, 0]
    assert positions.max(axis=0).tolist() == [1, 1]


@pytest.mark.parametrize("extent", ["true", "unit"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1)])
def test_one_pixel_sides_stand_in_the_middle(shape, extent):
    positions = pixel_positions(shape, extent)
    for axis, side in ((0, shape[1]), (1, shape[0])):
        if side == 1:
            assert np.all(positions[:, axis] == 0.5)


def test_lift(rng):
    image = rng.random((4, 6, 3))
    measure = lift(image, 1.5)
    assert measure.shape == (4, 6)
    assert len(measure) == 24
    assert np.array_equal(measure.colors.reshape(4, 6, 3), image)
    assert np.array_equal(measure.points[:, 2:], 1.5 * measure.colors)
    assert np.array_equal(measure.points[:, :2], measure.positions)
    assert measure.mass == pytest.approx(1)


def test_given_weights(rng):
    weights = rng.random((4, 6))
    weights[0] = 0
    assert np.array_equal(lift(np.zeros((4, 6)), weights=weights).weights, weights.ravel())


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
    ],
)
def test_wrong_options(options):
    with pytest.raises(InputError):
        lift(np.zeros((4, 4, 3)), **options)


def test_more_points_than_any_backend_takes():
    with pytest.raises(InputError, match=r"clmorph\.fit"):
        lift(np.broadcast_to(np.uint8(0), (20000, 20000, 3)))
