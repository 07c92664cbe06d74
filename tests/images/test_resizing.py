"""Pictures are reduced as scikit-image reduces them, and large ones in bands."""

import time
import tracemalloc

import numpy as np
import pytest
from PIL import Image, ImageDraw
from skimage.transform import resize

from clmorph import fit
from clmorph.images.kind import kind_of
from clmorph.images.pixels import as_pixels, read_visible
from clmorph.images.resizing import resized

SHAPES = [
    ((50, 70), (20, 30)), ((50, 70), (50, 30)), ((7, 9), (20, 3)), ((1, 9), (1, 4)),
    ((300, 200), (13, 9)), ((2, 2), (5, 5)), ((40, 1), (3, 1)), ((64, 64), (63, 64)),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after"), SHAPES)
def test_what_scikit_image_computes(rng, before, after):
    image = rng.random((*before, 3))
    want = resize(image, (*after, 3), order=1, anti_aliasing=True)
    assert np.abs(resized(image, after, "mirror") - want).max() < 1e-14
    want = resize(image, (*after, 3), order=1, mode="edge")
    assert np.abs(resized(image, after) - want).max() < 1e-14


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_integers_are_reduced_as_their_floats(rng, dtype, channels):
    largest = np.iinfo(dtype).max
    image = rng.integers(0, largest, (90, 70, channels), dtype, endpoint=True)
    want = fit(image / float(largest), 16)
    assert np.abs(fit(image, 16) - want).max() < 1e-14
    assert kind_of(as_pixels(image)) == kind_of(np.broadcast_to(image, (90, 70, max(3, channels))))


@pytest.mark.full
@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
def test_large_flat_pictures_are_reduced_in_bands(tmp_path, mode):
    """A logo of 25 megapixels took a minute and 3.8 GB."""
    picture = Image.new(mode, (5000, 4981), "white")
    ImageDraw.Draw(picture).ellipse((500, 500, 4000, 4200), fill=(240, 80, 20))
    if mode == "RGBA":
        opacity = Image.new("L", picture.size, 0)
        ImageDraw.Draw(opacity).rectangle((300, 300, 4500, 4500), fill=255)
        picture.putalpha(opacity)
    picture.save(tmp_path / "a.png", compress_level=1)
    size = 5000 * 4981 * len(mode)
    del picture
    began = time.process_time()
    whole = read_visible(tmp_path / "a.png")
    assert kind_of(whole) == "drawing"
    small = fit(whole, 96)
    assert time.process_time() - began < 10
    assert small.shape == (96, 96, len(mode))
    tracemalloc.start()
    try:
        kind_of(whole)
        fit(whole, 96)
        assert tracemalloc.get_traced_memory()[1] < 2 * size
    finally:
        tracemalloc.stop()
