"""Rearranging the pixels of one image to form another."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import clmorph
from clmorph.cli.main import main
from clmorph.errors import InputError

#: Weights of red, green and blue in luminance.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def _images(height: int = 12, width: int = 14) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:height, 0:width] / max(height, width)
    return np.stack([x, y, x * y], axis=2), np.stack([1 - x, y * y, y], axis=2)


@pytest.mark.parametrize("channels", [3, 4])
def test_last_frame_has_the_very_pixels_of_a(device, channels):
    """They keep their opacity, too."""
    a, b = _images()
    opacity = np.linspace(0, 1, a[..., 0].size).reshape(a.shape[:2])
    a = np.dstack((a, opacity))[..., :channels]
    found = clmorph.rearrange(a, b, n_frames=4, backend=device)
    assert len(found) == 4
    assert found.frame(0.5).shape == a.shape
    np.testing.assert_array_equal(found[0], a.astype(np.float32))
    last = found[-1].reshape(-1, channels)
    wanted = a.astype(np.float32).reshape(last.shape)
    np.testing.assert_array_equal(last[found.assignment], wanted)
    assert sorted(found.assignment) == list(range(len(last)))
    assert 0 < found.lower_bound <= found.cost <= 1.01 * found.lower_bound


def test_cost_is_near_the_exact_optimum(device):
    a, b = _images(20, 20)
    found = clmorph.rearrange(a, b, color_weight=2.0, backend=device)
    source, target = (clmorph.lift(each, color_weight=2.0).points for each in (a, b))
    cost = cdist(source, target, "sqeuclidean") / 2
    optimum = cost[linear_sum_assignment(cost)].mean()
    own = cost[np.arange(400), found.assignment].mean()
    # Of the pictures given, and not of their float32 values.
    assert found.cost == pytest.approx(own, rel=1e-12)
    assert found.lower_bound <= optimum
    assert found.cost <= 1.01 * optimum


def test_last_frame_looks_like_b():
    """The pixels of a mirrored image can form it well, and do."""
    a, _ = _images(24, 24)
    a = 0.5 + 0.5 * np.sin(9 * a)
    b = a[:, ::-1]
    last = clmorph.rearrange(a, b, backend="numpy")[-1]
    before, after = (np.sqrt(np.mean(((each - b) @ LUMINANCE) ** 2)) for each in (a, last))
    assert after < 0.5 * before


def test_same_image_stays():
    a, _ = _images()
    found = clmorph.rearrange(a, a, backend="numpy")
    assert found.cost == 0.0
    np.testing.assert_array_equal(found.frame(0.5), a.astype(np.float32))


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 1), (7, 3)])
def test_b_takes_the_size_of_a(shape):
    a = np.linspace(0, 1, shape[0] * shape[1]).reshape(shape)
    found = clmorph.rearrange(a, _images()[1], backend="numpy")
    for t in (0.0, 0.3, 1.0):
        assert found.frame(t).shape == (*shape, 3)
        assert np.isfinite(found.frame(t)).all()
        assert found.canvas(t).shape == shape


def test_every_frame_shows_colors_of_a_alone():
    a, b = _images()
    colors = {tuple(pixel) for pixel in a.astype(np.float32).reshape(-1, 3)}
    for frame in clmorph.rearrange(a, b, n_frames=5, backend="numpy"):
        assert {tuple(pixel) for pixel in frame.reshape(-1, 3)} <= colors


@pytest.mark.parametrize("t", [0.2, 0.5, 0.8])
def test_frames_have_neither_holes_nor_patches(device, t):
    """Pixels of two halves that change places: each shows its own color, and not its neighbor's."""
    a, b = _images(24, 32)
    found = clmorph.rearrange(a, b, backend=device)
    halves = np.roll(np.arange(24 * 32).reshape(24, 32), 16, axis=1).ravel()
    found = dataclasses.replace(found, assignment=halves)
    frame = found.frame(t)
    equal = np.all(frame[:, 1:] == frame[:, :-1], axis=2)
    assert np.count_nonzero(equal[:, 1:] & equal[:, :-1]) == 0
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 0.3 * 24 * 32


def test_an_empty_place_goes_on_as_a_does():
    """A is mirrored: halfway all pixels stand in the middle, and what they leave is like A."""
    a, b = _images(10, 40)
    found = clmorph.rearrange(a, b, backend="numpy")
    mirror = np.arange(400).reshape(10, 40)[:, ::-1].ravel()
    frame = dataclasses.replace(found, assignment=mirror).frame(0.5)
    steps = np.abs(np.diff(frame, axis=1)).max(axis=(0, 2))
    assert steps[:18].min() > 0
    assert steps[22:].min() > 0


def test_opaque_pixels_go_where_b_is_opaque():
    a = np.ones((6, 12, 4))
    a[:, 6:] = 0.0
    b = a[:, ::-1]
    last = clmorph.rearrange(a, b, color_weight=3.0, backend="numpy")[-1]
    np.testing.assert_array_equal(last[..., 3], b[..., 3])


@pytest.mark.parametrize("ending", [".gif", ".webp", ".apng", ".html", ".png", ".npz", ".tif", ""])
def test_formats_and_recipes(tmp_path, ending):
    a, b = _images(6, 6)
    found = clmorph.rearrange(a, b, n_frames=3, gap=0.5, backend="numpy")
    path = tmp_path / f"out{ending}"
    found.save(path, fps=10)
    if not ending:
        assert len(list(path.glob("*.png"))) == 3
        return
    options = clmorph.load_options(path)
    assert (options["gap"], options["fps"]) == (0.5, 10.0)
    again = clmorph.rearrange(a, b, **options, backend="numpy")
    np.testing.assert_array_equal(again.assignment, found.assignment)


def test_chain(tmp_path):
    a, b = _images()
    first = clmorph.rearrange(a, b, n_frames=3, backend="numpy")
    second = clmorph.rearrange(first[-1], a, n_frames=3, backend="numpy")
    clmorph.save([first, second], tmp_path / "out.npz")
    archive = clmorph.load(tmp_path / "out.npz")
    assert len(archive.frames) == 5
    np.testing.assert_array_equal(archive.frames[2], first[-1])


def test_splats_of_the_pixels_cover_the_ends():
    a, b = _images()
    found = clmorph.rearrange(a, b, backend="numpy")
    assert found.sums(0.0).coverage.min() > 0.9
    assert found.sums(1.0).coverage.min() > 0.9


@pytest.mark.parametrize("weight", [0.0, 1e-3, 30.0, 1e3])
def test_extreme_color_weights(device, weight):
    a, b = _images()
    found = clmorph.rearrange(a, b, color_weight=weight, backend=device)
    assert 0 <= found.lower_bound <= found.cost <= max(1e-15, 1.05 * found.lower_bound)


def test_large_images_are_solved_between_blocks(monkeypatch, device):
    monkeypatch.setattr("clmorph.pipeline.rearrange.SOLVE_SIZE", 8)
    a, b = _images(16, 13)
    found = clmorph.rearrange(a, b, backend=device)
    assert 0 < found.lower_bound <= found.cost <= 1.1 * found.lower_bound


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"n_frames": 1}, "n_frames"),
        ({"gap": np.nan}, "gap"),
        ({"seed": -1}, "seed"),
        ({"blur": 0.1}, "blur"),
        ({"fps": 3.0, "duration": 2.0}, "fps=3 and duration=2"),
        ({"options": clmorph.MorphOptions()}, "RearrangeOptions"),
        ({"image_a": np.zeros((0, 3, 3))}, "image_a"),
        ({"image_b": np.full((2, 2, 3), np.nan)}, "image_b"),
    ],
)
def test_mistakes_are_named(wrong, words):
    a, b = _images()
    with pytest.raises(InputError, match=words) as caught:
        clmorph.rearrange(**{"image_a": a, "image_b": b, "backend": "numpy"} | wrong)
    assert "\n" not in str(caught.value)


def test_options_replace_their_alternatives():
    options = clmorph.RearrangeOptions(duration=2.0)
    assert options.fps is None
    assert options.replace(fps=5.0).as_dict()["fps"] == 5.0
    assert options.replace(gap=0.1).duration == 2.0


def test_command(tmp_path, monkeypatch, capfd, refused):
    monkeypatch.chdir(tmp_path)
    for name, image in zip("ab", _images(), strict=True):
        clmorph.write_image(f"{name}.png", image)
    given = ["--frames", "3", "--backend", "numpy"]
    assert main(["rearrange", "a.png", "b.png", "-o", "out.gif", "--json", *given]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["frames"] == 3
    assert summary["assignments"][0]["cost"] <= 1.01 * summary["assignments"][0]["lower_bound"]
    assert main(["rearrange", "--config", "out.gif", "-o", "again.gif", "--backend", "numpy"]) == 0
    assert Path("again.gif").read_bytes() == Path("out.gif").read_bytes()
    assert main(["rearrange", "a.png", "b.png", "a.png", "-o", "frames", "--recipe", *given]) == 0
    assert len(list(Path("frames").glob("*.png"))) == 5
    assert json.loads(Path("frames.json").read_text())["command"] == "rearrange"
    for wrong, words in (
        (["a.png", "-o", "x.gif"], "expected two or more"),
        (["a.png", "b.png"], "no output"),
        (["a.png", "b.png", "-o", "x.gif", "--gap", "-1"], "--gap"),
        (["a.png", "b.png", "-o", "a.png"], "a.png"),
        (["a.png", "none.png", "-o", "x.gif"], "none.png"),
    ):
        assert words in refused("rearrange", *wrong)
    assert not Path("x.gif").exists()


def test_its_page_is_called_what_it_is(tmp_path):
    for function, name in ((clmorph.rearrange, "Rearrangement"), (clmorph.morph, "Morph")):
        function(*_images(4, 5), n_frames=3, backend="numpy").save(tmp_path / "a.html")
        assert f"<title>{name} of " in (tmp_path / "a.html").read_text()
