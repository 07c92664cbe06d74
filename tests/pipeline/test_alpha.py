"""For images with opacity, transparent pixels have no mass, and frames have opacity."""

import numpy as np
import pytest
from plain import lift, morph

from clmorph import InputError


def _disc(size, center, radius, color):
    """An anti-aliased disc on nothing; what cannot be seen is green."""
    y, x = np.mgrid[:size, :size]
    distance = np.hypot(x - center[0], y - center[1])
    image = np.zeros((size, size, 4))
    image[..., 3] = np.clip(radius + 0.5 - distance, 0, 1)
    image[..., :3] = np.where(image[..., 3:] > 0, color, (0, 1, 0))
    return image


@pytest.fixture(scope="module")
def discs():
    return _disc(24, (8, 8), 6, (0.9, 0.2, 0.1)), _disc(24, (15, 14), 7, (0.2, 0.2, 0.9))


@pytest.mark.parametrize("splatting", ["adaptive", "local", "none"])
@pytest.mark.parametrize("mass", ["uniform", "luminance"])
def test_frames_have_opacity(device, discs, splatting, mass):
    result = morph(
        *discs, n_frames=5, splatting=splatting, mass=mass, sigma_start=0.6, backend=device
    )
    assert all(frame.shape == (24, 24, 4) for frame in result.frames)
    for frame, image in ((result.frames[0], discs[0]), (result.frames[-1], discs[1])):
        seen = image[..., 3] > 0
        assert np.abs(frame[..., 3] - image[..., 3]).max() < 1e-3
        assert np.abs(frame - image)[seen].max() < 1e-3


def test_a_moving_disc_stays_opaque_and_of_its_size(device, discs):
    """Mass moves as a whole: halfway there is one disc between both, not two ghosts."""
    result = morph(
        *discs, n_frames=3, reach=None, blur=0.03, splatting="local", path_space="srgb",
        backend=device,
    )  # fmt: skip
    alpha = result.frames[1][..., 3]
    areas = [image[..., 3].sum() for image in discs]
    assert 0.9 * min(areas) < alpha.sum() < 1.25 * max(areas)
    y, x = np.mgrid[:24, :24]
    center = [(axis * alpha).sum() / alpha.sum() for axis in (x, y)]
    assert np.allclose(center, [11.5, 11], atol=0.5)
    assert alpha[11, 11] > 0.99
    assert max(alpha[0, 0], alpha[-1, -1]) < 1e-6
    # Nothing of the unseen green.
    seen = alpha > 0.5
    assert result.frames[1][seen][:, 1].max() < 0.3


def test_one_opaque_image(device, discs, rng):
    opaque = rng.random((20, 20, 3))
    result = morph(discs[0], opaque, n_frames=3, backend=device)
    assert result.frames[-1].shape == (20, 20, 4)
    assert result.frames[-1][..., 3].min() > 0.999
    assert np.abs(result.frames[-1][..., :3] - opaque).max() < 1e-3
    assert morph(opaque, opaque, n_frames=2, backend=device).frames[0].shape == (20, 20, 3)


def test_transparent_pixels_do_not_take_part(device, discs):
    """Whatever stands in them, the plan is the same."""
    other = discs[0].copy()
    other[other[..., 3] == 0] = [0.3, 0.1, 0.7, 0.0]
    films = [morph(image, discs[1], n_frames=2, backend=device) for image in (discs[0], other)]
    plan, again = (film.plan.toarray() for film in films)
    assert np.allclose(plan, again, rtol=1e-3, atol=1e-9)
    clear = discs[0][..., 3].ravel() == 0
    assert plan[clear].sum() == lift(discs[0]).weights[clear].sum() == 0


@pytest.mark.parametrize("options", [{}, {"splatting": "local"}, {"sigma_start": 4.0}], ids=str)
def test_what_rests_keeps_its_opacity(device, options):
    """Corners are not thin, glass is not condensed, and black has no mass but opacity."""
    still = np.full((16, 16, 4), 0.5)
    still[0, 0, 3] = 0
    still[6:10, 6:10, :3] = 0
    for mass in ("uniform", "luminance"):
        result = morph(still, still, n_frames=2, mass=mass, backend=device, **options)
        for t in (0.1, 0.25, 0.5):
            alpha = result.frame(t)[..., 3]
            assert np.abs(alpha[5:, 5:] - 0.5).max() < 0.01


@pytest.mark.parametrize("which", [0, 1])
def test_errors_name_the_picture_that_is_transparent(which):
    images = [np.ones((4, 4, 3)), np.ones((4, 4, 3))]
    images[which] = np.zeros((4, 4, 4))
    with pytest.raises(InputError, match=f"every pixel of image_{'ab'[which]} is transparent"):
        morph(*images, 3)
