"""Landmarks that are found, in morphs, chains, mixes and the command line, and in their recipes."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sights import photograph, seen_again

import clmorph
from clmorph import InputError, MorphOptions
from clmorph.analysis.figures import draw_inspection
from clmorph.cli.main import main
from clmorph.images.finding import common, mesh
from clmorph.pipeline.guides import guides
from clmorph.pipeline.maps import Maps

SMALL = {"preset": "photo", "size": 24, "n_frames": 2, "backend": "numpy", "tol": 1e-2}


@pytest.fixture(autouse=True)
def no_mesh(monkeypatch):
    """Results must not depend on whether the extra ``faces`` is installed."""
    monkeypatch.setattr(common, "mesh_missing", lambda: "a mesh is missing")


@pytest.fixture(scope="module")
def views():
    """Three views of a cat, and one of gravel."""
    rng = np.random.default_rng(3)
    cat = photograph("chelsea.png")
    return [cat, seen_again(cat, rng)[0], seen_again(cat, rng)[0], photograph("gravel.png")]


def test_two_views_are_warped_into_each_other(views):
    morph = clmorph.morph(*views[:2], **SMALL)
    assert morph.found.startswith("the same thing in both pictures: ")
    marks = morph.options.landmarks
    assert 8 <= len(marks) <= 24
    assert morph.source.warped is not None
    assert morph.misses.shape == (len(marks),)
    # The result's options make the same film without any search.
    again = clmorph.morph(*views[:2], morph.options, backend="numpy")
    assert again.found == ""
    assert np.array_equal(again.frame(0.5), morph.frame(0.5))


@pytest.mark.full
def test_pictures_with_nothing_in_common_are_morphed_as_before(views, tmp_path):
    for landmarks in ("auto", None):
        morph = clmorph.morph(views[0], views[3], landmarks=landmarks, **SMALL)
        assert morph.found == ""
        assert morph.options.landmarks is None
        morph.save(tmp_path / f"{landmarks}.gif")
    assert (tmp_path / "auto.gif").read_bytes() == (tmp_path / "None.gif").read_bytes()


def test_who_has_none():
    assert MorphOptions().landmarks == "auto"
    assert all(MorphOptions(preset=name).landmarks is None for name in ("crossfade", "paper"))
    assert MorphOptions(preset="paper", landmarks="auto").landmarks == "auto"


def test_arrays_that_leave_no_room(views):
    pair = [(0, 1)]
    images = views[:2]
    shapes = [image.shape[:2] for image in images]
    for maps in (
        Maps(color_metric=np.ones(shapes[0])),
        Maps(features=tuple(np.zeros((*shape, 6)) for shape in shapes)),
    ):
        assert guides(images, pair, MorphOptions(), maps).options.landmarks is None
    maps = Maps(features=tuple(np.zeros(shape) for shape in shapes))
    assert guides(images, pair, MorphOptions(), maps).options.landmarks


@pytest.mark.full
def test_chains_have_landmarks_for_each_morph(views, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for name, view in zip("abcd", (views[0], views[1], views[3], views[2]), strict=True):
        clmorph.write_image(f"{name}.png", view)
    options = ["--size", "24", "--frames", "2", "--backend", "numpy", "--preset", "photo"]
    chain = ["a.png", "b.png", "c.png", "d.png"]
    assert main(["morph", *chain, "-o", "one.gif", "--recipe", *options]) == 0
    said = capfd.readouterr().err
    assert "landmarks: pictures 1 and 2: the same thing in both pictures: " in said
    assert "pictures 2 and 3" not in said
    marks = json.loads((tmp_path / "one.gif.json").read_text())["options"]["landmark"]
    assert len(marks) == 3
    assert marks[0]
    assert marks[1:] == [[], []]
    monkeypatch.setattr(common, "features", None)  # it must not be sought again
    assert main(["morph", "--config", "one.gif", "-o", "two.gif", "--backend", "numpy"]) == 0
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()
    assert clmorph.load_options("one.gif")["landmarks"] == marks
    # Python's chains have the same recipe.
    pictures = [clmorph.read_image(name) for name in chain]
    monkeypatch.undo()
    legs = [clmorph.morph(a, b, **SMALL) for a, b in itertools.pairwise(pictures)]
    clmorph.save(legs, tmp_path / "three.gif")
    saved = clmorph.load_options(tmp_path / "three.gif")["landmarks"]
    assert [len(each) for each in saved] == [len(each) for each in marks]
    with pytest.raises(InputError, match="landmarks of 3 morphs given: expected those of one"):
        clmorph.morph(*pictures[:2], **SMALL, landmarks=saved)


@pytest.mark.full
def test_mixes_have_landmarks_for_each_pair(views):
    images = [views[0], views[3], views[1]]
    mixes = clmorph.mix(images, [[1, 0, 1], [1, 1, 1]], **SMALL)
    assert "pictures 1 and 3: the same thing" in mixes.found
    given = mixes.options.landmarks
    assert [len(each) > 0 for each in given] == [False, True, False]
    morph = clmorph.morph(images[0], images[2], **SMALL)
    assert np.array_equal(mixes[0], morph.frame(0.5))
    assert mixes.morph(2, 0).options.landmarks == tuple(pair[::-1] for pair in given[1])
    again = clmorph.mix(images, [1, 1, 1], mixes.options, backend="numpy")
    assert again.found == ""
    assert np.array_equal(again[0], mixes[1])
    plain = clmorph.mix(images, [1, 0, 1], landmarks=None, **SMALL)
    assert not np.array_equal(plain[0], mixes[0])
    with pytest.raises(InputError, match="landmarks of one morph given: expected those of 3"):
        clmorph.mix(images, landmarks=morph.options.landmarks, **SMALL)


def test_missed_landmarks_are_said(tmp_path, monkeypatch, capfd, rng):
    monkeypatch.chdir(tmp_path)
    for name in "ab":
        Image.fromarray(rng.integers(0, 255, (64, 64, 3), np.uint8)).save(f"{name}.png")
    marks = ["20,20:20,20", "20,20:22,20", "40,40:40,40", "50,20:50,20"]
    line = [part for mark in marks for part in ("--landmark", mark)]
    options = ["--size", "32", "--frames", "2", "--backend", "numpy", "-o", "x.gif"]
    options += ["--max-iter", "1"]  # the warp is a matter of the landmarks alone
    assert main(["morph", "a.png", "b.png", *line, *options]) == 0
    assert "the warp misses 2 landmarks, most of all landmark" in capfd.readouterr().err


def test_labels_of_what_is_not_transparent(rng):
    """And a clear error where a person is to be sought without the extra."""
    clear = rng.random((12, 14, 4))
    clear[..., 3] = 0.0
    clear[3:9, 4:10, 3] = 1.0
    opaque = rng.random((12, 14, 3))
    morph = clmorph.morph(clear, clear[:, ::-1], labels="auto", n_frames=2, backend="numpy")
    first, second = morph.particles.labels
    assert first.sum() == second.sum() == 36
    with pytest.raises(InputError, match="labels='auto' cannot look for people: a mesh is missing"):
        clmorph.morph(clear, opaque, labels="auto", n_frames=2, backend="numpy")


@pytest.mark.full
def test_inspection_says_and_draws_landmarks(views, tmp_path):
    options = {name: value for name, value in SMALL.items() if name != "n_frames"}
    drawn = {}
    for landmarks in ("auto", None):
        found = clmorph.inspect(*views[:2], landmarks=landmarks, divergence=False, **options)
        draw_inspection(found, tmp_path / "a.png")
        drawn[landmarks] = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
        said = [line for line in found.lines() if line.startswith("landmarks ")]
        assert said == ([f"landmarks     {found.marks.text}"] if landmarks else [])
        pairs = found.summary()["landmarks"]["pairs"]
        assert len(pairs) == len(found.marks.pairs)
        assert bool(pairs) == (landmarks == "auto")
    # Dots of this color stand on the first picture, top left, which is brown and gray.
    height, width, _ = drawn[None].shape
    corner = np.s_[height // 10 : height // 2, : width // 4]
    dots = [np.abs(each[corner] - (0x56, 0xB4, 0xE9)).sum(axis=2) < 60 for each in drawn.values()]
    assert dots[0].sum() > 100
    assert dots[1].sum() == 0


def test_recipes_of_the_version_before_mean_none():
    data = Path(__file__).parents[1] / "data"
    for path in data.glob("recipe_0.2.0_*.json"):
        assert clmorph.load_options(path)["landmarks"] is None


@pytest.mark.parametrize(
    ("version", "told"),
    [((3, 11, 7), 'pip install "clmorph[faces]"'), ((3, 13, 0), "with Python 3.12 or older")],
)
def test_what_a_missing_extra_is_told(monkeypatch, version, told):
    monkeypatch.setattr(mesh, "find_spec", lambda name: None)
    monkeypatch.setattr(mesh.sys, "version_info", version)
    assert told in mesh.mesh_missing()
