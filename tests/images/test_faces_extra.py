"""What the extra ``faces`` finds: points of faces, and people before a background.

The tests are skipped where mediapipe is missing; `.ci/run` has an environment with it.
"""

import json
import time

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates, sobel
from sights import photograph, without_faces
from skimage import data

import clmorph
from clmorph.cli.main import main
from clmorph.images.finding.common import MESHED, Finder, figures
from clmorph.images.finding.mesh import MESH, mesh_faces, mesh_missing
from clmorph.images.finding.reduced import small_copy
from clmorph.measures.landmarks import guided
from clmorph.pipeline.guides import guides
from clmorph.pipeline.options import MorphOptions

pytestmark = [
    pytest.mark.skipif(bool(mesh_missing()), reason="needs the extra faces"),
    # Of mediapipe's own dependencies.
    pytest.mark.filterwarnings("ignore"),
]

#: Numbers of points of the mesh: all that are no landmarks.
HELD_OUT = tuple(number for number in range(468) if number not in MESH)


def portraits():
    """Return faces of different size, pose, light and kind; all are in scikit-image's wheel."""
    woman = photograph("astronaut.png")
    gray = gaussian_filter(woman.mean(axis=2), 1)
    lines = np.clip(1 - np.hypot(sobel(gray, 0), sobel(gray, 1)), 0, 1)
    small = [
        np.asarray(Image.fromarray(np.uint8(255 * face)).resize((200, 200), Image.LANCZOS))
        for face in data.lfw_subset()[[0, 3, 5]]
    ]
    men = [np.dstack([face / 255.0] * 3) for face in small]
    return {
        "woman": woman, "close": woman[30:230, 120:320], "far": clmorph.fit(woman, 200),
        "drawn": np.dstack([lines] * 3), "man": men[0], "other": men[1], "third": men[2],
        "dark": woman[:300, 60:400] ** 2.2,
    }  # fmt: skip


PAIRS = [
    ("woman", "man"), ("close", "other"), ("drawn", "man"), ("close", "far"), ("dark", "other"),
    ("man", "other"),
]  # fmt: skip


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_points_that_are_held_out_arrive(pair):
    """95 % of them within 3 % of the face's width, and no pair of portraits is refused."""
    images = [portraits()[name] for name in pair]
    guide = guides(images, [(0, 1)], MorphOptions())
    landmarks = guide.each[0]
    assert guide.found == f"one face in each picture: {len(landmarks)} points"
    assert len(landmarks) >= 0.9 * len(MESH)
    source, target = (clmorph.lift(clmorph.fit(image, 256)) for image in images)
    shapes = [image.shape[:2] for image in images]
    found = guided(source, target, landmarks, shapes)
    assert found.misses.max() < 1.0
    places = []
    for image in images:
        copy = small_copy(image, MESHED)
        (held,), (whole,) = (mesh_faces(copy, some) for some in (HELD_OUT, tuple(range(468))))
        places.append(copy.whole(held))
        width = np.ptp(copy.whole(whole)[:, 0])
    # From pixels of A to its frame, by the warp, and from the frame of B to its pixels.
    rows, columns = source.shape
    at = (places[0] + 0.5) / shapes[0][::-1] * (columns, rows) - 0.5
    field = found.source.warped.reshape(rows, columns, 2)
    arrived = np.stack(
        [map_coordinates(field[..., k], at.T[::-1], order=1, mode="nearest") for k in (0, 1)], -1
    )
    low = target.positions.min(axis=0)
    arrived = (arrived - low) * (max(target.shape) - 1)
    arrived = (arrived + 0.5) / target.shape[::-1] * shapes[1][::-1] - 0.5
    missed = np.hypot(*(arrived - places[1]).T) / width
    assert missed.mean() < 0.015
    assert np.quantile(missed, 0.95) < 0.03


def test_no_face_is_found_where_there_is_none(rng):
    assert not any(mesh_faces(small_copy(each, MESHED)) for each in without_faces(rng, 60))


def test_a_small_face_a_face_that_fills_the_picture_and_two(rng):
    woman = photograph("astronaut.png")
    face = woman[40:180, 160:290]
    found = Finder([face, woman]).common(0, 1)
    # The close-up begins at (160, 40): points are the same but for that.
    assert np.median(np.hypot(*(found.starts - found.ends + np.array((160, 40))).T)) < 3.0
    far = np.full((600, 900, 3), 0.6)
    far[200:400, 300:500] = clmorph.fit(woman, 200)
    (only,) = mesh_faces(small_copy(far, MESHED))
    assert np.ptp(only[:, 0]) * 900 / MESHED == pytest.approx(42, abs=8)
    two = np.hstack((woman[:300, 100:350], woman[:300, 349:99:-1]))
    pair = Finder([two, two[:, ::-1]]).common(0, 1)
    assert pair.text == f"2 faces in each picture: {2 * len(MESH)} points"
    # Each is paired with the one at its own place.
    assert np.abs(pair.starts - pair.ends).mean() < 30


def test_it_takes_less_than_two_seconds():
    """Where nothing else runs; here four times as long at most."""
    large = np.kron(photograph("astronaut.png"), np.ones((8, 8, 1)))
    began = time.perf_counter()
    assert "one face" in Finder([large, large]).common(0, 1).text
    assert time.perf_counter() - began < 8.0


def test_a_person_moves_as_a_person(rng):
    images = [portraits()[name] for name in ("woman", "dark")]
    masks = figures(images)
    assert [mask.shape for mask in masks] == [image.shape[:2] for image in images]
    assert 0.3 < masks[0].mean() < 0.8
    assert masks[0][150, 220]  # the face
    assert not masks[0][30, 20]
    morph = clmorph.morph(*images, labels="auto", size=24, n_frames=2, backend="numpy")
    assert morph.arrays == ("labels",)
    one, other = (labels.ravel() for labels in morph.particles.labels)
    assert np.array_equal(one[morph.plan.rows], other[morph.plan.indices])
    assert figures([images[0], photograph("gravel.png")]) is None


def test_the_command_line_makes_the_film_again_without_the_detector(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for name in ("close", "other"):
        clmorph.write_image(f"{name}.png", portraits()[name])
    options = ["--size", "20", "--frames", "3", "--backend", "numpy", "--labels", "auto"]
    assert main(["morph", "close.png", "other.png", "-o", "a.gif", *options]) == 0
    said = capfd.readouterr().err
    assert f"landmarks: one face in each picture: {len(MESH)} points" in said
    assert "labels: " in said
    assert "TensorFlow" not in said
    assert main(["morph", "close.png", "other.png", "-o", "b.gif", "--recipe", *options]) == 0
    recipe = json.loads((tmp_path / "b.gif.json").read_text())
    assert len(recipe["options"]["landmark"]) == len(MESH)
    assert recipe["labels"] == "auto"
    monkeypatch.setattr("clmorph.images.finding.common.mesh_faces", None)
    assert main(["morph", "--config", "a.gif", "-o", "c.gif", "--backend", "numpy"]) == 0
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "c.gif").read_bytes()
