"""Mixes of several images."""

import json

import numpy as np
import pytest
from drawn_pictures import logo, sprite
from PIL import Image

import clmorph
from clmorph.cli.main import main
from clmorph.errors import InputError, OutputError
from clmorph.pipeline.mixing.weights import grid_layout, path_weights

SIDE = 24


def _images(*shapes: tuple[int, int]) -> list[np.ndarray]:
    """Smooth pictures, each with a bright spot at another place."""
    found = []
    for number, (height, width) in enumerate(shapes):
        y, x = np.mgrid[0:height, 0:width] / max(height, width)
        x0, y0 = [(0.3, 0.3), (0.7, 0.3), (0.3, 0.7), (0.7, 0.7)][number]
        spot = np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 0.02)
        ground = np.stack((x, y, np.full_like(x, number / 4)), axis=2)
        found.append(np.clip(0.6 * ground + 0.4 * spot[..., None], 0.0, 1.0))
    return found


FOUR = _images(*[(SIDE, SIDE)] * 4)


def test_images_themselves_stand_in_the_corners(device):
    """Also where sizes are unequal, to the bit."""
    images = _images((SIDE, SIDE), (16, SIDE), (SIDE, 20))
    mixes = clmorph.mix(images, grid=2, backend=device)
    for number, image in enumerate(images):
        np.testing.assert_array_equal(mixes[number], image.astype(np.float32))


def test_the_border_of_a_grid_shows_morphs(device):
    mixes = clmorph.mix(FOUR, grid=3, backend=device)
    morph = clmorph.morph(FOUR[1], FOUR[3], backend=device)
    assert mixes.weights[5].tolist() == [0, 0.5, 0, 0.5]
    np.testing.assert_array_equal(mixes[5], morph.frame(0.5))


@pytest.mark.small
def test_mixes_go_on_smoothly_from_the_border(device):
    """A third image with a weight that nobody sees changes nothing that anybody sees."""
    mixes = clmorph.mix(FOUR[:3], [1, 1, 1], backend=device)
    for t in (0.2, 0.5):
        border = mixes.frame([1 - t, t, 0])
        beside = mixes.frame([1 - t, t - 1e-6, 1e-6])
        # What remains is a motion that is followed in other steps.
        assert np.abs(beside - border).mean() < 3e-3
    corner = mixes.frame([1.0, 1e-7, 1e-7])
    assert np.abs(corner - FOUR[0]).max() < 1e-3


@pytest.mark.full
def test_order_of_the_images_does_not_matter(device):
    """But for registration, which begins with the first of two images, and the order of turns."""
    one = clmorph.mix(FOUR, [1, 2, 3, 4], backend=device)[0]
    other = clmorph.mix(FOUR[::-1], [4, 3, 2, 1], backend=device)[0]
    assert np.abs(one - other).mean() < 0.01


def test_an_image_mixed_with_itself_is_that_image(device):
    mixes = clmorph.mix([FOUR[0]] * 3, [1, 1, 1], reach=None, blur=0.01, backend=device)
    assert np.abs(mixes[0] - FOUR[0]).max() < 0.03


def test_spots_meet_at_the_weighted_mean_of_their_places(device):
    """Balanced transport moves the spot of each image to w_0 x_0 + w_1 x_1 + w_2 x_2."""
    y, x = np.mgrid[0:32, 0:32] / 31
    places = np.array([(0.25, 0.25), (0.75, 0.3), (0.4, 0.75)])
    dark = [np.exp(-((x - a) ** 2 + (y - b) ** 2) / 0.01)[..., None] for a, b in places]
    images = [np.repeat(each, 3, axis=2) for each in dark]
    weights = np.array([0.5, 0.3, 0.2])
    options = {"reach": None, "mass": "foreground", "blur": 0.02}
    mixed = clmorph.mix(images, weights, backend=device, **options)[0][..., 0]
    bright = mixed > 0.5 * mixed.max()
    found = [x[bright].mean(), y[bright].mean()]
    np.testing.assert_allclose(found, weights @ places, atol=0.04)


def test_canvas_is_the_weighted_mean_of_the_sizes(device):
    images = _images((SIDE, SIDE), (16, SIDE), (SIDE, 12))
    mixes = clmorph.mix(images, [[2, 1, 1], [1, 1, 2]], backend=device)
    assert [each.shape[:2] for each in mixes.drawn()] == [(22, 21), (22, 18)]
    assert mixes.sheet().shape == (22, 42, 3)


@pytest.mark.parametrize("options", [{"unmatched": "grow"}, {"unmatched": "drop"}, {"reach": 0.05}])
def test_ways_of_unmatched_mass(options, any_backend):
    images = _images(*[(16, 16)] * 3)
    mixed = clmorph.mix(images, [1, 1, 1], backend=any_backend, **options)[0]
    assert mixed.shape == (16, 16, 3)
    assert np.isfinite(mixed).all()
    assert mixed.std() > 0.05


@pytest.mark.parametrize(
    "options", [{"detail": "particles"}, {"preset": "mosaic"}, {"preset": "paper", "size": 16}]
)
def test_other_details_are_mixed_step_by_step(options, any_backend):
    mixes = clmorph.mix(FOUR[:3], [1, 1, 2], backend=any_backend, **options)
    assert not mixes.carries
    size = options.get("size", SIDE)
    assert mixes[0].shape == (size, size, 3)


def test_flat_drawings_stay_flat(device):
    """A mix of three drawings has few colors, as each of them."""
    images = [logo(name, 32) for name in ("star", "disc", "ring")]
    mixes = clmorph.mix(images, [1, 1, 1], backend=device)
    assert mixes.options.detail == "layers"
    shape = mixes[0][np.abs(mixes[0] - 1.0).max(axis=2) > 0.3]
    assert 50 < len(shape) < 32 * 32
    assert shape.std(axis=0).max() < 0.1


def test_sprites_keep_their_opacity(device):
    images = [sprite(name) for name in ("heart", "ghost", "invader")]
    mixes = clmorph.mix(images, grid=3, backend=device)
    assert mixes.options.detail == "pixels"
    sheet = mixes.sheet()
    assert sheet.shape == (24, 36, 4)
    assert set(np.unique(sheet[..., 3])) == {0, 255}
    assert mixes.sheet("white").shape[2] == 3


def test_opaque_images_beside_clear_ones(device):
    clear = np.dstack((FOUR[1], np.linspace(0, 1, SIDE * SIDE).reshape(SIDE, SIDE)))
    mixes = clmorph.mix([FOUR[0], clear, FOUR[2]], [[1, 0, 0], [1, 1, 1]], backend=device)
    assert [each.shape for each in mixes] == [(SIDE, SIDE, 4)] * 2
    assert np.all(mixes[0][..., 3] == 1)


class TestWeights:
    def test_three_images_make_a_triangle(self):
        layout = grid_layout(3, 4)
        assert len(layout.weights) == 10
        np.testing.assert_allclose(layout.weights.sum(axis=1), 1.0)
        assert layout.places[0].tolist() == [1.5, 0.0]
        assert layout.weights[[0, 6, 9]].tolist() == np.eye(3).tolist()

    def test_two_images_make_a_row_or_a_column(self):
        assert grid_layout(2).size == (5, 1)
        assert grid_layout(2, (1, 7)).size == (7, 1)
        assert grid_layout(2, (7, 1)).size == (1, 7)

    @pytest.mark.parametrize(
        ("count", "grid"), [(2, (2, 3)), (2, 1), (3, (2, 3)), (4, (1, 5)), (4, (2, 2, 2)), (5, 3)]
    )
    def test_unsuitable_grids(self, count, grid):
        with pytest.raises(InputError):
            grid_layout(count, grid)

    def test_paths(self):
        assert path_weights("ab+", 3).tolist() == [[1, 0, 0], [0, 1, 0], [1 / 3] * 3]
        assert path_weights([[1, 1], [0, 2]], 2).tolist() == [[0.5, 0.5], [0, 1]]
        for bad in ("a", "abz", "", "a b", [[1, 1]]):
            with pytest.raises(InputError):
                path_weights(bad, 3)

    def test_huge_weights(self):
        mixes = clmorph.mix(FOUR[:2], [1e308, 1e308], backend="numpy")
        assert mixes.weights.tolist() == [[0.5, 0.5]]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"weights": [1, 1]}, "expected 3 weights"),
        ({"weights": [0, 0, 0]}, "not all 0"),
        ({"weights": [1, -1, 1]}, "at least 0"),
        ({"weights": [1, np.nan, 1]}, "finite"),
        ({"weights": [1, 1, 1], "grid": 3}, "contradict"),
        ({"landmarks": [((0, 0), (1, 1))]}, "landmarks"),
    ],
)
def test_mistakes(arguments, words):
    with pytest.raises(InputError, match=words):
        clmorph.mix(FOUR[:3], backend="numpy", **arguments)


def test_numbers_of_images():
    for images in ([FOUR[0]], FOUR * 3, "ab", FOUR[0]):
        with pytest.raises(InputError, match="images"):
            clmorph.mix(images, backend="numpy")


def test_formats_that_hold_no_mixes(tmp_path):
    mixes = clmorph.mix(FOUR[:2], grid=2, n_frames=3, backend="numpy")
    with pytest.raises(OutputError, match="one picture"):
        mixes.save(tmp_path / "out.gif")
    with pytest.raises(OutputError, match="two pictures"):
        mixes.save(tmp_path / "out.html", "ab")
    assert not list(tmp_path.iterdir())


class TestCommand:
    @pytest.fixture
    def files(self, tmp_path):
        names = [str(tmp_path / f"{name}.png") for name in "abcd"]
        for name, image in zip(names, FOUR, strict=True):
            clmorph.write_image(name, image)
        return names

    @pytest.mark.full
    def test_a_grid_in_one_picture(self, files, tmp_path, capsys):
        out = tmp_path / "grid.png"
        given = ["mix", *files, "--grid", "2x3", "-o", str(out), "--backend", "numpy", "--json"]
        assert main(given) == 0
        summary = json.loads(capsys.readouterr().out)
        assert summary["mixes"] == 6
        with Image.open(out) as sheet:
            pixels = np.asarray(sheet)
            assert json.loads(sheet.info["clmorph"])["command"] == "mix"
        assert pixels.shape == (2 * SIDE, 3 * SIDE, 3)
        for number, place in enumerate(((0, 0), (0, 2), (1, 0), (1, 2))):
            corner = [slice(SIDE * each, SIDE * (each + 1)) for each in place]
            with Image.open(files[number]) as image:
                np.testing.assert_array_equal(pixels[tuple(corner)], np.asarray(image))

    @pytest.mark.full
    def test_a_film_of_a_path(self, files, tmp_path, refused):
        out = tmp_path / "film.apng"
        given = ["mix", *files[:3], "--path", "ab+", "--frames", "3", "-o", str(out), "--recipe"]
        assert main([*given, "--backend", "numpy"]) == 0
        with Image.open(out) as film:
            assert film.n_frames == 5
        assert clmorph.load_options(out)["n_frames"] == 3
        again = tmp_path / "again.apng"
        assert main(["mix", "--config", str(out), "-o", str(again), "--backend", "numpy"]) == 0
        assert json.loads((tmp_path / "film.apng.json").read_text())["path"] == "ab+"
        assert again.read_bytes() == out.read_bytes()
        assert "clmorph mix" in refused("morph", "--config", out, "-o", tmp_path / "x.gif")

    @pytest.mark.full
    def test_recipes_of_sheets(self, files, tmp_path, capsys):
        out, again = tmp_path / "grid.png", tmp_path / "again.png"
        for shown in (["--grid", "3"], ["--weights", "1,0", "--weights", "1,3"]):
            given = ["mix", *files[:2], *shown, "-o", str(out), "--backend", "numpy"]
            assert main([*given, "--blur", "0.06"]) == 0
            assert main(["mix", "--config", str(out), "-o", str(again), "--backend", "numpy"]) == 0
            assert again.read_bytes() == out.read_bytes()
        clmorph.mix(FOUR[:2], [[1, 3]], backend="numpy").save(out)
        given = ["mix", *files[:2], "--config", str(out), "-o", str(again)]
        assert main([*given, "--backend", "numpy", "--json"]) == 0
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["mixes"] == 1

    @pytest.mark.parametrize(
        "given",
        [
            ["--grid", "0x2", "-o", "x.png"], ["--grid", "axb", "-o", "x.png"],
            ["--weights", "1,2", "-o", "x.png"], ["--weights", "1,2,3,x", "-o", "x.png"],
            ["--weights", "1,1,1,nan", "-o", "x.png"], ["--path", "abq", "-o", "x.gif"],
            ["--path", "ab", "--grid", "3", "-o", "x.gif"], ["-o", "x.gif"], [],
            ["--path", "ab", "-o", "x.html"], ["--path", "ab", "-o", "x.gif", "--fps", "99"],
        ],
    )  # fmt: skip
    def test_mistakes(self, given, files, tmp_path, refused, monkeypatch):
        monkeypatch.chdir(tmp_path)
        refused("mix", *files, *given, "--backend", "numpy")
        assert not list(tmp_path.glob("x.*"))


@pytest.mark.full
def test_large_images_are_drawn_from_smaller_copies(device):
    """Their particles are of copies, and their detail and corners of the images themselves."""
    large = [np.kron(image, np.ones((22, 22, 1))) for image in FOUR[:2]]  # 528 pixels
    options = {"size": None, "solve_size": 12, "max_particles": 50_000, "backend": device}
    mixes = clmorph.mix([*large, FOUR[2]], [[1, 0, 0], [2, 1, 1e-6]], **options)
    np.testing.assert_array_equal(mixes[0], large[0].astype(np.float32))
    between = mixes.frame([2, 1, 0])
    assert mixes.morph(0, 1).pictures is not None
    beside = mixes[1][: between.shape[0], : between.shape[1]]
    assert np.abs(beside - between[: len(beside), : beside.shape[1]]).mean() < 0.01
