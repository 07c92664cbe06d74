"""What is found in pictures: faces and things in both, and nothing where there is nothing."""

import numpy as np
import pytest
from sights import FACELESS, photograph, seen_again, without_faces

from clmorph.images.finding import common
from clmorph.images.finding.cascade import cascade_faces
from clmorph.images.finding.common import SEARCHED, Finder
from clmorph.images.finding.matches import features, matches
from clmorph.images.finding.reduced import small_copy


@pytest.fixture
def no_mesh(monkeypatch):
    """Take the extra ``faces`` away, if it is there."""
    monkeypatch.setattr(common, "mesh_missing", lambda: "a mesh is missing")


def test_the_astronaut_has_one_face():
    """A single pass of the cascade finds four."""
    (face,) = cascade_faces(small_copy(photograph("astronaut.png"), SEARCHED))
    eyes, mouth = face[:2].mean(axis=0) * 2, face[3:].mean(axis=0) * 2  # in pixels of 512
    assert eyes == pytest.approx((226, 101), abs=6)
    assert mouth == pytest.approx((224, 143), abs=8)


@pytest.mark.full
def test_no_face_is_found_where_there_is_none(rng):
    """In 100 pictures of textures, coins, gravel, a cat, drawings and letters."""
    found = [cascade_faces(small_copy(each, SEARCHED)) for each in without_faces(rng, 100)]
    assert sum(map(len, found)) == 0


def test_faces_of_the_cascade_are_paired(no_mesh):
    """The same face at another place and half the size."""
    woman = photograph("astronaut.png")
    small = np.full((250, 220, 3), 0.5)
    small[30:, :200] = woman[:440:2, :400:2]
    found = Finder([woman, small]).common(0, 1)
    assert found.text.startswith("one face in each picture: 5 points, of place and size alone; a m")
    assert np.abs(found.ends - (found.starts / 2 + (0, 30))).max() < 6.0


@pytest.mark.parametrize("name", ["chelsea.png", "coffee.png", "page.png", "rocket.jpg"])
def test_two_views_of_a_thing_are_matched(no_mesh, rng, name):
    """Within a hundredth of the longer side, over most of the picture."""
    picture = photograph(name)
    view, mapped = seen_again(picture, rng)
    found = Finder([picture, view]).common(0, 1)
    assert found.text == f"the same thing in both pictures: {len(found.starts)} points"
    assert 8 <= len(found.starts) <= 24
    missed = np.hypot(*(mapped(found.starts) - found.ends).T) / max(picture.shape)
    assert np.median(missed) < 0.005
    assert missed.max() < 0.02


def test_different_things_are_not_matched():
    """Among 120 pairs of pictures that have nothing in common."""
    known = [features(small_copy(photograph(name), SEARCHED)) for name in FACELESS]
    pairs = [(one, other) for k, one in enumerate(known) for other in known[:k]]
    assert len(pairs) == 120
    assert all(not len(matches(one, other)[0]) for one, other in pairs)


@pytest.mark.parametrize("shape", [(1, 1), (2, 300), (47, 500), (64, 64), (700, 60)])
def test_pictures_without_contrast_and_of_any_size(no_mesh, shape, rng):
    for image in (np.zeros((*shape, 3)), rng.random((*shape, 4))):
        assert Finder([image, image * 0.5 + 0.2]).common(0, 1).text == ""


@pytest.mark.full
def test_large_pictures_are_reduced(no_mesh):
    """Of 16 megapixels the same points are found."""
    large = np.kron(photograph("astronaut.png"), np.ones((8, 8, 1)))
    found = Finder([large, large]).common(0, 1)
    assert "one face" in found.text
    assert np.array_equal(found.starts, found.ends)
