import numpy as np
import pytest
from PIL import Image

from clmorph import InputError, fit, read_image
from clmorph.images.pixels import as_pixels, as_rgb, block_size


@pytest.mark.parametrize(
    "array",
    [
        np.full((4, 5), 255, np.uint8),
        np.full((4, 5, 1), 65535, np.uint16),
        np.ones((4, 5, 3), bool),
        np.ones((4, 5, 3), np.float32),
        np.ones((4, 5, 4)),
        np.ones((4, 5, 3)).tolist(),
    ],
)
def test_kinds_of_arrays(array):
    pixels = as_rgb(array)
    assert pixels.shape == (4, 5, 3)
    assert pixels.dtype == np.float64
    assert np.all(pixels == 1)


def test_opacity_is_kept_where_there_is_some_or_laid_on_white():
    image = np.zeros((1, 2, 4), np.uint8)
    image[0, 1] = 0, 0, 0, 255
    assert as_rgb(image).tolist() == [[[1, 1, 1], [0, 0, 0]]]
    image = np.full((2, 3, 4), 0.5)
    assert np.array_equal(as_pixels(image), image)
    image[..., 3] = 1
    assert as_pixels(image).shape == (2, 3, 3)


def test_reducing_does_not_show_what_is_transparent():
    """A red disc on fully transparent blue: no blue comes in at its edge."""
    y, x = np.mgrid[:64, :64] - 31.5
    inside = np.hypot(x, y) < 20
    image = np.zeros((64, 64, 4))
    image[..., 2] = ~inside
    image[..., 0] = image[..., 3] = inside
    small = fit(image, 16)
    assert small.shape == (16, 16, 4)
    seen = small[..., 3] > 1e-3
    assert np.abs(small[seen] - [1, 0, 0, 0])[:, :3].max() < 1e-6
    assert small[..., 3].mean() == pytest.approx(inside.mean(), abs=0.02)


def test_fit_keeps_the_aspect_and_smooths(rng):
    stripes = np.zeros((100, 200, 3))
    stripes[:, ::2] = 1
    small = fit(stripes, 20)
    assert small.shape == (10, 20, 3)
    # Nearest or plain bilinear sampling would give black or white stripes.
    assert np.abs(small - 0.5).max() < 0.05
    assert fit(np.zeros((1, 500, 3)), 20).shape == (1, 20, 3)  # a thin image keeps a row
    image = rng.random((7, 9, 3))
    assert np.array_equal(fit(image, 9), image)


def test_large_files_are_refused_before_they_are_decoded(tmp_path, monkeypatch):
    Image.new("1", (20000, 20000)).save(tmp_path / "vast.png")
    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "load", None)  # decoding would fail
        with pytest.raises(InputError, match=r"20000 x 20000 pixels.*max-pixels"):
            read_image(tmp_path / "vast.png")
    Image.new("1", (30, 30)).save(tmp_path / "small.png")
    with pytest.raises(InputError, match="at most 100 in all"):
        read_image(tmp_path / "small.png", max_pixels=100)
    assert read_image(tmp_path / "small.png", max_pixels=900).shape == (30, 30, 3)


@pytest.mark.parametrize("k", [2, 3, 7])
def test_sprites_are_reduced_exactly(rng, k):
    sprite = rng.random((6, 10, 3))
    enlarged = np.kron(sprite, np.ones((k, k, 1)))
    assert block_size(enlarged) == k
    assert np.array_equal(fit(enlarged, 10), sprite)
    if k == 7:
        assert np.array_equal(fit(enlarged, 35), np.kron(sprite, np.ones((3, 3, 1))))
    # One different pixel, and it is a picture like any other.
    enlarged[0, 0] = 1 - enlarged[0, 0]
    assert block_size(enlarged) == 1


def test_one_color_is_no_sprite():
    assert block_size(np.ones((8, 8, 3))) == 1
    assert fit(np.ones((8, 8, 3)), 3).shape == (3, 3, 3)
