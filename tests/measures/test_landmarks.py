"""Landmarks: what is at one goes to its partner, and only pairs that contradict are refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import plain
import pytest
from clouds import smooth
from PIL import Image

import clmorph
from clmorph import InputError
from clmorph.analysis.metrics import path_divergence
from clmorph.cli.main import main
from clmorph.measures.landmarks import HEIGHT, bump_radius, guided
from clmorph.measures.measure import check_measure
from clmorph.output.provenance import read_parameters


def misses(morph, landmarks):
    """Return how many pixels from its partner the mean destination of each landmark's pixel is."""
    width = morph.source.shape[1]
    if isinstance(morph.plan, clmorph.Barycentric):
        ends = morph.plan.positions
    else:
        ends, _ = morph.plan.mean_destinations(morph.source.positions, morph.target.positions)
    longer = max(morph.target.shape) - 1
    corner = morph.target.positions.min(axis=0)
    places = ends[[int(y) * width + int(x) for (x, y), _ in landmarks]]
    partners = [partner for _, partner in landmarks]
    return np.hypot(*((places - corner) * longer - partners).T)


@pytest.mark.parametrize("reach", [None, 0.3])
def test_landmarks_go_to_their_partners(device, rng, reach):
    """Within a pixel with the bumps; without landmarks they miss by several."""
    a, b = smooth(rng, (24, 24)), smooth(rng, (24, 24))
    landmarks = [((7, 8), (10, 10)), ((16, 9), (17, 12)), ((12, 17), (11, 15))]
    options = {"n_frames": 2, "blur": 0.05, "reach": reach, "color_weight": 0.5, "tol": 1e-2}
    guide = plain.morph(a, b, landmarks=landmarks, backend=device, **options)
    assert misses(guide, landmarks).max() < 0.5
    alone = plain.morph(a, b, backend=device, **options)
    assert misses(alone, landmarks).max() > 2.0
    assert np.abs(guide.frame(0.0) - a).max() < 1e-4
    assert np.abs(guide.frame(1.0) - b).max() < 1e-4


@pytest.mark.full
def test_landmarks_that_share_coordinates(rng):
    """With the six coordinates that are left in the cost, 24 of them stay within a pixel."""
    n = 36
    places = [(x, y) for x in range(4, 34, 6) for y in range(4, 34, 6)][:24]
    landmarks = [((x, y), (x + 2 * np.sin(y / 6), y + 2 * np.cos(x / 6))) for x, y in places]
    morph = plain.morph(
        smooth(rng, (n, n)), smooth(rng, (n, n)), n_frames=2, landmarks=landmarks, blur=0.02,
        color_weight=0.5, tol=1e-2, barycentric=True, backend="numpy",
    )  # fmt: skip
    assert morph.source.points.shape[1] == morph.target.points.shape[1] == 11
    assert misses(morph, landmarks).max() < 1.0


def test_the_warp_is_exact_and_keeps_the_mass(rng):
    """Through the landmarks, along the border, and with the Jacobian of a known affine part."""
    image = rng.random((33, 33, 3))
    source, target = clmorph.lift(image), clmorph.lift(image)
    landmarks = [((16, 16), (18, 15)), ((6, 25), (8, 25)), ((25, 8), (24, 8))]
    first, second, missed = guided(source, target, landmarks)
    assert np.abs(missed).max() < 1e-9
    warped = first.warped.reshape(33, 33, 2)
    for (x, y), partner in landmarks:
        assert warped[y, x] * 32 == pytest.approx(partner, abs=1e-6)
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1), (0, 16), (16, -1)):
        fixed = source.positions.reshape(33, 33, 2)[corner]
        assert warped[corner] == pytest.approx(fixed, abs=1e-6)
    assert first.mass == pytest.approx(source.mass, rel=1e-12)
    assert np.array_equal(first.positions, source.positions)
    assert np.array_equal(second.weights, target.weights)
    # The image of the warp has even masses: their histogram in the target's frame is flat.
    inner = np.abs(first.warped - 0.5).max(axis=1) < 0.4
    density, _, _ = np.histogram2d(*first.warped[inner].T, bins=4, weights=first.weights[inner])
    plainly, _, _ = np.histogram2d(*first.warped[inner].T, bins=4)
    assert np.std(density) / np.mean(density) < np.std(plainly) / np.mean(plainly)
    # Bumps depend on the place in the target's frame alone.
    for measure, places in ((first, first.warped), (second, second.positions)):
        squares = np.sum((places - np.array(landmarks[0][1]) / 32) ** 2, axis=1)
        bump = HEIGHT * np.exp(-squares / (2 * bump_radius(source, target) ** 2))
        assert np.abs(measure.features[:, 0] - bump).max() < 1e-9


def portrait(center, size, eyes, mouth, skin, ground):
    """Return a portrait of discs, seven landmarks, and the centers of its eyes and of its mouth."""
    parts = center + size * np.array([(-eyes[0], eyes[1]), eyes, (0, mouth)])
    y, x = np.mgrid[:48, :48]
    image = np.full((48, 48, 3), ground)
    places = np.vstack((center, parts))
    colors = skin, (0.1, 0.15, 0.75), (0.1, 0.15, 0.75), (0.8, 0.05, 0.15)
    for place, radius, color in zip(places, (0.8, 0.14, 0.14, 0.2), colors, strict=True):
        inside = np.clip(size * radius + 0.5 - np.hypot(x - place[0], y - place[1]), 0, 1)
        image += inside[..., None] * (color - image)
    corners = parts[:, None] + size * np.array([(-0.18, 0), (0.18, 0)])
    marks = [*corners.reshape(-1, 2), center + np.array((0, 0.75 * size))]
    return image, list(map(tuple, marks)), parts


def strayed(frame, parts):
    """Return the distances of eyes and mouth from their places, in pixels, and the share there.

    Nothing but eyes is blue, and nothing but mouths is red.
    """
    red, green, blue = np.moveaxis(frame[..., :3].astype(float), -1, 0)
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
    away = [np.hypot(x - place[0], y - place[1]) for place in parts]
    eyes = np.clip(blue - np.maximum(red, green) - 0.1, 0.0, None)
    lips = np.clip(red - green - 0.35, 0.0, None)
    left = away[0] < away[1]
    found = []
    for part, (mass, near) in enumerate(((eyes * left, 4.0), (eyes * ~left, 4.0), (lips, 8.0))):
        center = np.array([(mass * x).sum(), (mass * y).sum()]) / mass.sum()
        there = (mass * (away[part] < near)).sum() / mass.sum()
        found.append((np.hypot(*(center - parts[part])), there))
    return np.array(found).T


def test_a_portrait_keeps_eyes_and_mouth_at_every_time(device):
    """With seven landmarks, as layers and where particles draw it."""
    a, ours, places = portrait(
        (20, 22), 19, (0.3, -0.15), 0.5, (0.87, 0.75, 0.65), (0.6, 0.65, 0.7)
    )
    b, theirs, targets = portrait((28, 27), 16, (0.3, 0), 0.45, (0.6, 0.45, 0.35), (0.8, 0.75, 0.6))
    options = {"n_frames": 2, "solve_size": 24, "tol": 1e-2, "sample": 4, "backend": device}
    landmarks = list(zip(ours, theirs, strict=True))
    for detail in ("layers", "particles"):
        for given in (landmarks, None):
            morph = clmorph.morph(a, b, landmarks=given, preset="photo", detail=detail, **options)
            times = np.linspace(0.0, 1.0, 5)
            parts = [strayed(morph.frame(t), (1 - t) * places + t * targets) for t in times]
            distances, shares = np.stack(parts, axis=1)
            if given is None:
                assert distances.max() > 2.0
            else:
                assert distances.max() < 1.0
                assert shares.min() > 0.95


def test_no_landmarks_change_nothing(rng):
    pair = clmorph.lift(rng.random((5, 5))), clmorph.lift(rng.random((5, 5)))
    assert guided(*pair, [])[:2] == pair


def test_distant_landmarks_share_a_coordinate():
    flat = clmorph.lift(np.ones((101, 101)))
    places = [(float(x), float(y)) for x in range(10, 100, 20) for y in range(10, 100, 20)]
    source = guided(flat, flat, [(place, place) for place in places]).source
    assert source.features.shape[1] == 6
    bumps = source.features.reshape(101, 101, 6)
    owners = [int(np.argmax(bumps[int(y), int(x)])) for x, y in places]
    for k, (one, other) in enumerate(pairwise(places)):
        assert owners[k] != owners[k + 1], (one, other)


def test_landmarks_are_in_pixels_of_the_given_pictures(device, rng):
    """Also if the pictures are reduced, or their shapes differ."""
    a, b = smooth(rng, (32, 40)), smooth(rng, (48, 32))
    landmarks = [((12, 10), (10, 20)), ((28, 20), (20, 30))]
    options = {"blur": 0.05, "color_weight": 0.5, "n_frames": 2, "backend": device, "tol": 1e-2}
    morph = plain.morph(a, b, landmarks=landmarks, **options)
    assert misses(morph, landmarks).max() < 1.0
    small = plain.morph(a, b, landmarks=landmarks, size=20, **options)
    assert small.source.shape == (16, 20)
    for k, ((x, y), _) in enumerate(landmarks):
        # A pixel x of 40 is the place (x + 1/2) / 2 - 1/2 of 20, between two pixels.
        place = (np.array((x, y)) + 0.5) / 2 - 0.5
        low, high = small.source.positions.min(axis=0), small.source.positions.max(axis=0)
        there = low + place / (19, 15) * (high - low)
        near = np.argmin(np.sum((small.source.positions - there) ** 2, axis=1))
        assert small.source.features[near, k] > 0.8 * HEIGHT
    blocks = plain.morph(a, b, landmarks=landmarks, solve_size=20, **options)
    assert blocks.solved_sizes == (20, 12)
    assert misses(blocks, landmarks).max() < 2.0  # the side of a block


@pytest.mark.parametrize(
    ("landmarks", "told"),
    [
        ([((5, 5), (15, 15)), ((15, 15), (5, 5)), ((5, 15), (5, 15))], "1 and 2 contradict each"),
        ([((5, 5), (25, 5))], r"landmark 1 is at \(25, 5\), outside image_b of 20 x 18 pixels"),
        ([((-2, 5), (2, 5))], "outside image_a"),
        ([((5, 5), (5, 5)), ((5, 5.1), (9, 9))], "landmarks 1 and 2 contradict"),
        ([((5, 5), (5, 5)), ((5, 5), (15, 5))], "landmarks 1 and 2 contradict"),
        ([((5, 5), (6, 6)), ((9, 9), (6, 6))], "landmarks 1 and 2 contradict"),
        ([((5, 5), (6,))], "entry 1: expected pairs of points in pixels"),
        ([((5, 5), (6, np.nan))], "entry 1"),
        ([(5, 5, 6, 6)], "entry 1"),
        ("5,5:6,6", "expected pairs of points"),
        ({"a": 1}, "expected pairs of points"),
        ([((0, 0), (0, 0))] * 257, "257 pairs; expected at most 256"),
    ],
)
def test_landmarks_that_cannot_be_used(landmarks, told):
    image = np.ones((18, 20, 3))
    with pytest.raises(InputError, match=told):
        plain.morph(image, image, n_frames=2, landmarks=landmarks, backend="numpy")


def test_what_landmarks_exclude(rng):
    image = rng.random((8, 8, 3))
    landmarks = [((3, 3), (4, 4))]
    options = {"n_frames": 2, "landmarks": landmarks, "backend": "numpy"}
    with pytest.raises(InputError, match="landmarks cannot be combined with a color_metric"):
        plain.morph(image, image, color_metric=np.ones((8, 8)), **options)
    with pytest.raises(InputError, match="4 x 4 pixels or more"):
        plain.morph(image[:1], image, n_frames=2, landmarks=[((3, 0), (4, 4))], backend="numpy")
    measure = guided(clmorph.lift(image), clmorph.lift(image), landmarks)[0]
    features = np.full((64, 1), np.nan), np.ones((64, 7)), [[1.0]]
    for damaged in (*({"features": each} for each in features), {"warped": np.ones((3, 2))}):
        with pytest.raises(InputError, match="source has"):
            check_measure("source", replace(measure, **damaged))


def test_the_divergence_of_frames_compares_pictures(rng):
    """It has no landmarks: with and without them the last frame is the target."""
    a, b = rng.random((2, 8, 8, 3))
    morph = plain.morph(a, b, n_frames=2, landmarks=[((3, 3), (4, 4))], backend="numpy")
    assert path_divergence(morph, [1.0])[0].value < 1e-4


def test_landmarks_of_the_command_line(tmp_path, monkeypatch, capfd, rng, refused):
    monkeypatch.chdir(tmp_path)
    for name in "abc":
        Image.fromarray(rng.integers(0, 255, (12, 14, 3), np.uint8)).save(f"{name}.png")
    (tmp_path / "pairs.csv").write_text("# faces\nx,y,to x,to y\n5,5,6,6  # the nose\n\n9;7;8;8\n")
    options = ["--frames", "3", "--backend", "numpy", "--preset", "photo"]
    written = {}
    for name, given in {
        "one": ["--landmark", "5,5:6,6", "--landmark", "9,7:8,8"],
        "two": ["--landmark", "5,5:6,6; 9,7:8,8"],
        "file": ["--landmark", "pairs.csv"],
        "none": ["--landmark", "5,5:6,6", "--landmark", "none"],
        "bare": [],
    }.items():
        assert main(["morph", "a.png", "b.png", "-o", f"{name}.gif", *given, *options]) == 0
        written[name] = (tmp_path / f"{name}.gif").read_bytes()
    assert written["one"] == written["two"] == written["file"]
    assert written["none"] == written["bare"] != written["one"]
    known = read_parameters(tmp_path / "one.gif")["options"]["landmark"]
    assert known == [[[5.0, 5.0], [6.0, 6.0]], [[9.0, 7.0], [8.0, 8.0]]]
    assert main(["morph", "--config", "one.gif", "-o", "again.gif", "--backend", "numpy"]) == 0
    assert (tmp_path / "again.gif").read_bytes() == written["one"]
    capfd.readouterr()
    assert main(["morph", "--config", "one.gif", "--dump-config"]) == 0
    (tmp_path / "own.toml").write_text(capfd.readouterr().out)
    assert clmorph.load_options("own.toml")["landmarks"] == known
    (tmp_path / "bad.csv").write_text("1,2,3,4\n1,2,3\n")
    (tmp_path / "typo.csv").write_text("1O,20,30,40\n5,6,7,8\n")
    (tmp_path / "empty.csv").write_text("# nothing\nx,y,to x,to y\n\n")
    (tmp_path / "huge.csv").write_text("1,2,3,4\n" * (1 << 18))
    for given, told in {
        "bad.csv": "bad.csv, line 2: '1,2,3': expected x,y,x',y' in pixels",
        "no.csv": "no.csv: landmarks cannot be read",
        "typo.csv": "typo.csv, line 1: '1O,20,30,40': expected x,y,x',y' in pixels",
        "empty.csv": "empty.csv: it holds no landmarks",
        "huge.csv": "huge.csv: larger than",
        "5,5": "expected x,y:x',y' in pixels",
        "5,5:inf,3": "expected x,y:x',y' in pixels",
        "5,5:99,3": "outside image_b",
    }.items():
        one = "morph", "a.png", "b.png", "-o", "x.gif", "--landmark", given
        assert told in refused(*one, *options)
    chain = "morph", "a.png", "b.png", "c.png", "-o", "x.gif", "--landmark", "5,5:6,6", *options
    assert "landmarks of one morph given: expected those of 2 morphs" in refused(*chain)
    assert not (tmp_path / "x.gif").exists()
