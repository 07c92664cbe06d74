"""Both ends of a morph are its images, and the frames near them change smoothly."""

from importlib import resources

import numpy as np
import pytest
import skimage.data
from benching import photographs
from plain import morph

from clmorph import fit, read_image
from clmorph.analysis.metrics import step_sizes
from clmorph.images.pixels import as_rgb


def _psnr(frame, image):
    return -10 * np.log10(np.mean((frame - image) ** 2) + 1e-20)


@pytest.fixture(scope="module")
def images():
    """A photograph and pixel art, with edges and texture; 32 x 32."""
    photo = fit(as_rgb(skimage.data.astronaut()[:256, 128:384]), 32)
    art = np.kron(np.random.default_rng(1).random((8, 8, 3)), np.ones((4, 4, 1)))
    return photo, art


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sigma_start": 0.3, "sigma_end": 0.3},
        {"sigma_start": 6.0, "sigma_end": 6.0},
        {"sigma_start": "auto", "sigma_end": "auto", "splatting": "local"},
        {"splatting": "fixed", "sigma_start": 2.0},
        {"splatting": "none"},
        {"unmatched": "drop"},
        {"unmatched": "drop", "reach": 0.05},
        {"barycentric": True},
        {"sample": 2},
        {"path_space": "oklab"},
        {"path_space": "lab", "color_space": "luv"},
        {"extent": "unit", "mass": "luminance"},
        {"reach": None, "blur": 0.1},
    ],
    ids=str,
)
def test_exact_ends(device, images, options):
    result = morph(*images, n_frames=2, backend=device, **options)
    # Close to the ends too: the correction does not vanish at once.
    for end, near, image in zip((0.0, 1.0), (1e-3, 1 - 1e-3), images, strict=True):
        assert _psnr(result.frame(end), image) >= 45
        assert _psnr(result.frame(near), image) >= 30


def test_paper_ends_are_blurred(device, images):
    result = morph(*images, n_frames=2, endpoints="paper", sigma_start=1.2, backend=device)
    assert _psnr(result.frames[0], images[0]) < 30
    assert result.frames[0].shape == images[0].shape


def test_halfway_a_frame_is_the_papers(device, images):
    exact, paper = (
        morph(*images, n_frames=2, endpoints=endpoints, backend=device).frame(0.5)
        for endpoints in ("exact", "paper")
    )
    assert np.abs(exact - paper).max() < 1e-6


@pytest.mark.full
@pytest.mark.parametrize("sigma", [0.5, 1.2, 3.0])
@pytest.mark.parametrize("splatting", ["adaptive", "local"])
def test_first_and_last_steps_are_not_jumps(device, sigma, splatting):
    """At most 1.5 times the median step, in 30 frames, of photographs and to and from a sprite."""
    with resources.as_file(resources.files("clmorph.cli.samples") / "cat.png") as file:
        sprite = read_image(file)
    first, second = photographs((32, 32))
    for pair in ((first, second), (second, sprite), (sprite, first)):
        result = morph(
            *pair, n_frames=30, sigma_start=sigma, sigma_end=sigma, splatting=splatting,
            backend=device,
        )  # fmt: skip
        steps = step_sizes(result.frames)
        assert max(steps[0], steps[-1]) <= 1.5 * np.median(steps)
