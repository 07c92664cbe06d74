"""Large pictures as layers: particles come from smaller copies of them."""

import numpy as np
import pytest
from benching import photographs

import clmorph
from clmorph.pipeline import prepare

OPTIONS = {"preset": "photo", "size": None, "n_frames": 3}
OPTIONS |= {"solve_size": 16, "max_particles": 60_000}


@pytest.fixture
def few(monkeypatch):
    """Pictures above 24 pixels are large."""
    monkeypatch.setattr(prepare, "MOST_CARRIED", 24)


@pytest.mark.small
def test_frames_are_as_large_as_the_pictures_and_end_in_them(few, any_backend):
    a, b = photographs((48, 36))[0], photographs((40, 60))[1]
    morph = clmorph.morph(a, b, backend=any_backend, **OPTIONS)
    assert morph.source.shape == (24, 18)
    assert max(morph.target.shape) == 24
    assert morph.given_shapes == ((48, 36), (40, 60))
    assert "36 x 48 into 60 x 40 pixels" in repr(morph)
    assert np.abs(morph.frame(0.0) - a).max() < 1e-6
    assert np.abs(morph.frame(1.0) - b).max() < 1e-6
    assert morph.frame(0.5).shape == (*morph.canvas(0.5).shape, 3)
    assert morph.coverage(0.5).shape == morph.canvas(0.5).shape
    # The kernels of particles that lie two pixels apart are twice as wide.
    assert np.mean(morph.coverage(0.0) < 0.1) < 0.01


@pytest.mark.full
def test_they_look_as_if_pixels_were_lifted(monkeypatch):
    a, b = photographs((80, 80))
    frames = []
    for most in (40, 512):
        monkeypatch.setattr(prepare, "MOST_CARRIED", most)
        morph = clmorph.morph(a, b, backend="numpy", **OPTIONS)
        assert (morph.pictures is None) == (most == 512)
        frames.append([morph.frame(t) for t in (0.25, 0.5, 0.75)])
    for one, other in zip(*frames, strict=True):
        assert np.sqrt(np.mean((one - other) ** 2)) < 0.03
        steps = [np.abs(np.diff(frame.mean(axis=2))).mean() for frame in (one, other)]
        assert steps[0] == pytest.approx(steps[1], rel=0.03)


@pytest.mark.in_turns
@pytest.mark.parametrize(
    "given",
    [
        {"detail": "particles"},
        {"solve_size": None},
        {"solve_size": 25},
        {"endpoints": "paper"},
        {"weights": (np.ones((30, 30)), None)},
        {"labels": (np.zeros((30, 30), int), np.zeros((30, 30), int))},
        {"color_metric": np.ones((30, 30))},
    ],
)
def test_where_pixels_themselves_are_lifted(few, given):
    a, b = photographs((30, 30))
    options = OPTIONS | {"solve_size": None if "color_metric" in given else 16} | given
    morph = clmorph.morph(a, b, backend="numpy", **options)
    assert morph.pictures is None
    assert morph.source.shape == (30, 30)


def test_opaque_pictures_alone(few):
    a, b = photographs((30, 30))
    a = np.dstack((a, np.linspace(0, 1, 900).reshape(30, 30)))
    assert clmorph.morph(a, b, backend="numpy", **OPTIONS).pictures is None


@pytest.mark.full
def test_files_and_chains(few, tmp_path):
    a, b = photographs((30, 30))
    first = clmorph.morph(a, b, backend="numpy", **OPTIONS)
    second = clmorph.morph(b, a, backend="numpy", **OPTIONS)
    clmorph.save([first, second], tmp_path / "out.html")
    clmorph.save([first, second], tmp_path / "out.gif")
    clmorph.save(first, tmp_path / "out.npz")
    assert clmorph.load(tmp_path / "out.npz").frames[0].shape == (30, 30, 3)
