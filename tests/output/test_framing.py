"""Test how frames of many sizes are fitted onto one canvas."""

import numpy as np
import pytest

from clmorph.images.detail import is_pixel_art
from clmorph.output.framing import FrameStyle, Framing, enlargement_note
from clmorph.output.options import as_canvas

SHAPES = [(6, 8, 3), (9, 8, 3), (12, 8, 3)]


def framed(frame, pixelated=False, **look):
    """A frame on a canvas, as an array."""
    return np.asarray(Framing(FrameStyle(**look), [frame.shape], pixelated)(frame))


def test_sizes():
    assert Framing(FrameStyle(), SHAPES, False, 48).size == (32, 48)
    assert Framing(FrameStyle(), SHAPES, True, 40).size == (32, 48)  # whole pixels
    assert Framing(FrameStyle(), SHAPES, False, 40).size == (27, 40)
    assert Framing(FrameStyle(), SHAPES, False, 40, even=True).size == (28, 40)
    assert Framing(FrameStyle(canvas="source"), SHAPES, False, 99).size == (8, 6)
    assert Framing(FrameStyle(canvas="target"), SHAPES, False, 99).size == (8, 12)
    assert Framing(FrameStyle(canvas="31x20"), SHAPES, False, 99).size == (31, 20)
    assert as_canvas((31, 20)) == as_canvas("31×20") == (31, 20)


def test_an_odd_border_is_repeated(rng):
    frame = rng.integers(0, 256, (5, 7, 3), np.uint8)
    framing = Framing(FrameStyle(canvas="source"), [frame.shape], False, even=True)
    picture = np.asarray(framing(frame))
    assert picture.shape == (6, 8, 3)
    assert np.array_equal(picture[:5, :7], frame)
    assert np.array_equal(picture[5], picture[4])
    assert np.array_equal(picture[:, 7], picture[:, 6])


def test_pixels_of_pixel_art_stay_squares_of_one_size(rng):
    """Between the ends frames fit the canvas by no whole factor."""
    frame = rng.integers(1, 256, (6, 7, 3), np.uint8)
    clear = np.dstack((frame, np.full((6, 7), 255, np.uint8)))
    for own, background, ground in (
        (frame, None, [0] * 3), (frame, "#000102", [0, 1, 2]), (clear, None, [0] * 4),
    ):  # fmt: skip
        look = {"canvas": "40x30", "background": background}
        picture = framed(own, True, **look)
        assert np.array_equal(framed(own, **look, scaling="nearest"), picture)
        assert np.array_equal(picture[:, 2:37], np.kron(own, np.ones((5, 5, 1))))
        assert np.all(picture[:, :2] == ground)
        assert np.all(picture[:, 37:] == ground)
    even = np.asarray(Framing(FrameStyle(canvas="39x29"), [frame.shape], True, even=True)(frame))
    assert even.shape == (30, 40, 3)
    assert np.count_nonzero(even) == (4 * 6) * (4 * 7) * 3
    smooth = framed(frame, canvas="40x30")
    assert np.count_nonzero(smooth.any(-1).any(0)) == 35  # as large as fits
    assert len(np.unique(smooth.reshape(-1, 3), axis=0)) > 48


def test_what_is_pixel_art(rng):
    from skimage import data

    colors = rng.random((6, 3))
    sprite = colors[rng.integers(0, 6, (16, 16))]
    assert is_pixel_art(sprite)
    assert is_pixel_art(np.kron(sprite, np.ones((4, 4, 1))))
    assert not is_pixel_art(data.chelsea()[100:164, 100:164] / 255)
    assert not is_pixel_art(rng.random((16, 16, 3)))
    large = np.zeros((300, 300, 3))
    large[:, :7] = 1
    assert not is_pixel_art(large)


def test_a_canvas_that_enlarges_all_frames_is_noted():
    shapes = [(192, 256, 3), (256, 256, 3)]
    said = enlargement_note(FrameStyle(canvas="1280x720"), shapes, False, 256)
    assert said == (
        "frames of up to 256x256 pixels are enlarged 2.8 times to fit the canvas of 1280x720; for "
        "sharper frames, which take longer, add --size 720"
    )
    for size in (300, None):
        small = enlargement_note(FrameStyle(canvas="1280x720"), shapes, False, size)
        assert "the pictures themselves have no more pixels" in small
    for style, pixelated in (
        (FrameStyle(canvas="1280x720"), True),
        (FrameStyle(canvas="1280x720", scaling="nearest"), False),
        (FrameStyle(canvas="256x256"), False), (FrameStyle(canvas="target"), False),
        (FrameStyle(), False),
    ):  # fmt: skip
        assert enlargement_note(style, shapes, pixelated, 256) is None


@pytest.mark.parametrize("color", [(240, 236, 229), (200, 120, 60), (9, 30, 250)])
@pytest.mark.parametrize("factor", [0.6, 2, 3.7])
def test_figures_with_opacity_have_no_rim(color, factor):
    """Overshoot of opacity was clipped and that of colors was not; nor do hidden colors bleed."""
    y, x = np.mgrid[:40, :40]
    alpha = np.clip((14 - np.hypot(x - 19.5, y - 19.5)) + 0.5, 0, 1)
    frame = np.dstack((*(np.full((40, 40), each) for each in color), np.rint(255 * alpha)))
    frame[frame[..., 3] == 0, :3] = 255 - np.array(color)
    frame, look = frame.astype(np.uint8), {"canvas": (round(40 * factor),) * 2, "scaling": "smooth"}
    made = framed(frame, **look).astype(int)
    seen = made[..., 3] > 0
    assert seen.any()
    assert np.abs(made[seen][:, :3] - color).max() <= 2
    assert np.all(framed(frame, **look, background="black") <= np.array(color) + 2)
