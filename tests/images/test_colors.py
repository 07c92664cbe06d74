import numpy as np
import pytest
import skimage.color

from clmorph import InputError
from clmorph.images.color import COLOR_SPACES, as_metric, from_space, square_root, to_space

CORNERS = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]), -1).reshape(-1, 3)


@pytest.mark.parametrize("space", COLOR_SPACES)
def test_there_and_back(rng, space):
    colors = np.concatenate((CORNERS, rng.random((500, 3))))
    assert np.abs(from_space(to_space(colors, space), space) - colors).max() < 1e-9


@pytest.mark.parametrize("space", COLOR_SPACES)
def test_distances_are_comparable(rng, space):
    """Random colors are as far apart as in sRGB: a color weight means the same everywhere."""
    x, y = rng.random((2, 20000, 3))
    distance = np.sqrt(np.mean((to_space(x, space) - to_space(y, space)) ** 2))
    assert distance == pytest.approx(np.sqrt(np.mean((x - y) ** 2)), rel=0.03)


def test_known_values():
    # IEC 61966-2-1: half the light is sRGB 188 of 255.
    middle = from_space(0.5 * to_space(np.ones(3), "linear"), "linear")
    assert np.allclose(middle * 255, 187.5, atol=0.1)
    # Ottosson's own check values of Oklab: red.
    white, red = to_space([1.0, 1.0, 1.0], "oklab"), to_space([1.0, 0.0, 0.0], "oklab")
    assert np.allclose(white[1:], 0, atol=1e-6)
    assert np.allclose(red / white[0], [0.62796, 0.22486, 0.12585], atol=1e-4)
    lab = to_space(CORNERS, "lab")
    wanted = skimage.color.rgb2lab(CORNERS[:, None])[:, 0]
    keep = np.abs(wanted) > 1
    ratio = lab[keep] / wanted[keep]
    assert np.allclose(ratio, ratio[0])


@pytest.mark.parametrize("space", COLOR_SPACES)
def test_what_no_screen_shows_is_clipped(space):
    colors = from_space(np.array([[9.0, -9.0, 9.0], [0.0, 0.0, 0.0]]), space)
    assert np.all(np.isfinite(colors))
    assert 0 <= colors.min() <= colors.max() <= 1


def test_the_path_between_red_and_green_does_not_go_through_mud():
    """Halfway, sRGB is a dark olive; Oklab and linear light keep the lightness."""
    ends = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    lightness = {
        space: to_space(from_space(to_space(ends, space).mean(axis=0), space), "lab")[0]
        for space in ("srgb", "oklab", "linear")
    }
    assert lightness["oklab"] > 1.15 * lightness["srgb"]
    assert lightness["linear"] > 1.15 * lightness["srgb"]


def test_unknown_space():
    for convert in (to_space, from_space):
        with pytest.raises(InputError, match="color space"):
            convert(np.zeros(3), "hsv")


def test_metrics(rng):
    factor = rng.random((3, 3))
    metric = factor @ factor.T
    assert np.allclose(square_root(metric) @ square_root(metric).T, metric)
    assert as_metric(metric, (4, 5)).shape == (3, 3)
    assert as_metric(np.tile(metric, (4, 5, 1, 1)), (4, 5)).shape == (20, 3, 3)
    weights = rng.random((4, 5))
    assert np.allclose(as_metric(weights, (4, 5))[7], weights[1, 2] * np.eye(3))
    for wrong in (
        np.eye(2), -np.eye(3), np.full((3, 3), np.nan), [[1, 2, 0], [0, 1, 0], [0, 0, 1]],
        "metric", np.ones((5, 4)), 1e9 * np.eye(3),
    ):  # fmt: skip
        with pytest.raises(InputError, match="metric"):
            as_metric(wrong, (4, 5))
