"""Single pictures as files."""

import numpy as np
import pytest

import clmorph
from clmorph.errors import InputError, OutputError
from clmorph.output.provenance import read_parameters

PARAMETERS = {"clmorph": "1", "options": {"strength": 1.0}}


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("ending", [".png", ".webp", ".tif", ".TIFF"])
def test_pictures_come_back(tmp_path, rng, ending, channels):
    path = tmp_path / f"out{ending}"
    image = rng.integers(0, 256, (12, 17, channels), np.uint8)
    clmorph.write_image(path, image, parameters=PARAMETERS)
    np.testing.assert_array_equal(clmorph.read_image(path), image / 255)
    assert read_parameters(path) == PARAMETERS


def test_tiff_has_16_bits(tmp_path):
    image = np.linspace(0, 1, 1000).reshape(10, 100)
    clmorph.write_image(tmp_path / "out.tif", image)
    got = clmorph.read_image(tmp_path / "out.tif")[..., 0]
    np.testing.assert_allclose(got, image, rtol=0, atol=0.51 / 65535)


def test_jpeg_is_near_and_lies_on_white(tmp_path):
    y, x = np.mgrid[:16, :24] / 24
    image = np.stack([x, y, 1 - x, np.ones_like(x)], axis=2)
    image[:8, :8, 3] = 0.0
    clmorph.write_image(tmp_path / "out.jpg", image, parameters=PARAMETERS)
    got = clmorph.read_image(tmp_path / "out.jpg")
    assert np.abs(got[8:] - image[8:, :, :3]).max() < 0.04
    assert got[:7, :7].min() > 0.95
    assert read_parameters(tmp_path / "out.jpg") == PARAMETERS


def test_gray_pictures_and_those_without_parameters(tmp_path):
    clmorph.write_image(tmp_path / "out.png", np.eye(3))
    assert clmorph.read_image(tmp_path / "out.png").shape == (3, 3, 3)
    with pytest.raises(InputError, match="no parameters"):
        read_parameters(tmp_path / "out.png")


@pytest.mark.parametrize(
    ("name", "image", "options", "error", "words"),
    [
        ("out.gif", np.eye(3), {}, OutputError, "unknown ending"),
        ("out", np.eye(3), {}, OutputError, "unknown ending"),
        ("none/out.png", np.eye(3), {}, OutputError, "no folder"),
        ("out.png", np.full((2, 2), np.nan), {}, InputError, "NaN"),
        ("out.png", "a.png", {}, InputError, "path"),
        ("out.png", np.eye(3), {"parameters": 3}, InputError, "parameters"),
        ("out.png", np.eye(3), {"parameters": {"a": object()}}, InputError, "JSON"),
        ("out.webp", np.zeros((1, 20000)), {}, InputError, "too large for WebP"),
    ],
)
def test_mistakes_leave_no_file(tmp_path, name, image, options, error, words):
    with pytest.raises(error, match=words):
        clmorph.write_image(tmp_path / name, image, **options)
    assert not list(tmp_path.iterdir())
