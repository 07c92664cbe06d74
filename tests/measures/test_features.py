"""Features: further coordinates of the cost, their weights, and what the cost has no room for."""

import numpy as np
import plain
import pytest
from numpy.testing import assert_allclose
from PIL import Image

import clmorph
from clmorph import InputError
from clmorph.cli.main import main
from clmorph.output.provenance import read_parameters
from clmorph.pipeline.maps import read_features, with_features


def pair(rng, height=8, width=10):
    return rng.random((2, height, width, 3))


def test_the_cost_compares_features(rng):
    """|w (F - G)|^2 / 2 is added to the cost of each pair, whatever their common origin."""
    a, b = pair(rng)
    one, other = rng.random((2, 8, 10, 2)) + 1000.0
    measures = plain.lift(a), plain.lift(b)
    source, target = with_features(measures, (one, other), (0.5, 2.0))

    def cost(x, y):
        return 0.5 * np.sum((x.points[:, None] - y.points[None]) ** 2, axis=2)

    apart = (one.reshape(-1, 1, 2) - other.reshape(1, -1, 2)) * (0.5, 2.0)
    wanted = cost(*measures) + 0.5 * np.sum(apart**2, axis=2)
    assert_allclose(cost(source, target), wanted, atol=1e-10)
    assert np.abs(source.features).max() < 2.1


@pytest.mark.small
def test_features_decide_where_mass_goes(any_backend, rng):
    """Gray pictures whose only difference are features: mass goes to its own feature."""
    gray = np.full((8, 10, 3), 0.5)
    left = np.zeros((8, 10))
    left[:, :5] = 1.0
    options = {"n_frames": 2, "blur": 0.05, "reach": None, "tol": 1e-2, "backend": any_backend}
    morph = plain.morph(gray, gray, features=(left, left[:, ::-1]), feature_weight=3.0, **options)
    ours, theirs = left.ravel(), left[:, ::-1].ravel()
    crossing = ours[morph.plan.rows] != theirs[morph.plan.indices]
    assert morph.plan.mass[crossing].sum() < 1e-6
    alone = plain.morph(gray, gray, **options)
    crossing = ours[alone.plan.rows] != theirs[alone.plan.indices]
    assert alone.plan.mass[crossing].sum() > 0.5
    nothing = plain.morph(gray, gray, features=(left, left[:, ::-1]), feature_weight=0.0, **options)
    assert_allclose(nothing.potentials.dual, alone.potentials.dual, atol=1e-6)


@pytest.mark.full
def test_features_at_every_size(rng):
    a, b = pair(rng, 16, 20)
    one, other = rng.random((2, 16, 20, 6))
    for form in ({}, {"size": 10}, {"solve_size": 10}, {"barycentric": True}, {"sample": 3}):
        morph = plain.morph(a, b, n_frames=2, features=(one, other), backend="numpy", **form)
        assert morph.source.points.shape[1] == morph.target.points.shape[1] == 11
        assert np.all(np.isfinite(morph.frame(0.5)))
    small = plain.morph(a, b, n_frames=2, size=10, features=(one, other), backend="numpy")
    means = one.reshape(8, 2, 10, 2, 6).mean(axis=(1, 3)).reshape(80, 6)
    spread = small.source.features - means
    assert_allclose(spread, np.broadcast_to(spread[0], spread.shape), atol=1e-12)
    found = plain.inspect(a, b, features=(one, other), n_frames=2, backend="numpy")
    assert found.divergence.value > 0


def test_features_and_landmarks_share_the_coordinates(rng):
    a, b = pair(rng, 20, 20)
    marks = [((5, 5), (6, 6)), ((14, 5), (14, 6)), ((5, 14), (5, 13))]
    options = {"n_frames": 2, "landmarks": marks, "backend": "numpy"}
    five = plain.morph(a, b, features=tuple(rng.random((2, 20, 20, 5))), **options)
    assert five.source.features.shape[1] == 6  # three landmarks share the last one
    with pytest.raises(InputError, match="landmarks need a coordinate of the cost"):
        plain.morph(a, b, features=tuple(rng.random((2, 20, 20, 6))), **options)


@pytest.mark.parametrize(
    ("features", "more", "told"),
    [
        ((np.ones((8, 10)), np.ones((8, 9))), {}, r"features of image_b have shape \(8, 9\)"),
        ((np.ones((8, 10, 7)),) * 2, {}, "7 coordinates: expected at most 6.* 11 in all"),
        ((np.ones((8, 10, 2)), np.ones((8, 10))), {}, "have 2 coordinates, those of image_b 1"),
        ((np.full((8, 10), np.nan),) * 2, {}, "features of image_a: it holds NaN"),
        ((np.full((8, 10), np.inf),) * 2, {}, "NaN or infinity"),
        ((np.ones((8, 10, 0)),) * 2, {}, "have shape"),
        ((np.eye(8, 10) * 1e9, np.ones((8, 10))), {}, "expected at most 1e"),
        ((np.ones((8, 10)),) * 2, {"feature_weight": (1, 2)}, "feature_weight has 2 numbers"),
        ((np.ones((8, 10)),) * 2, {"feature_weight": -1.0}, "feature_weight"),
        ((np.ones((8, 10)),) * 2, {"feature_weight": ()}, "expected one number, or up to 6"),
        ((np.ones((8, 10)),) * 2, {"feature_weight": (1, "x")}, "feature_weight"),
        ((np.ones((8, 10)),) * 2, {"color_metric": np.ones((8, 10))}, "cannot be combined"),
        (("a.npy", "b.npy"), {}, "is a path"),
        (np.ones((8, 10)), {}, "expected a pair of arrays"),
        ((np.ones((8, 10)), None), {}, "expected a pair of arrays"),
    ],
)
def test_features_that_cannot_be_used(rng, features, more, told):
    with pytest.raises(InputError, match=told) as caught:
        plain.morph(*pair(rng), n_frames=2, features=features, backend="numpy", **more)
    assert "\n" not in str(caught.value)


def test_labels_and_features_of_the_command_line(tmp_path, monkeypatch, capfd, rng, refused):
    monkeypatch.chdir(tmp_path)
    for name in "abc":
        Image.fromarray(rng.integers(0, 255, (12, 14, 3), np.uint8)).save(f"{name}.png")
    one, other = np.zeros((2, 12, 14), np.uint8)
    one[3:8, 4:9], other[2:9, 6:11] = 5, 5
    Image.fromarray(one).save("la.png")
    Image.fromarray(other).save("lb.png")
    Image.fromarray(40 * one).save("depth.png")
    np.save("f.npy", rng.random((12, 14)))
    np.save("two.npy", rng.random((12, 14, 2)))
    options = ["--frames", "3", "--backend", "numpy", "--preset", "photo"]
    guides = ["--labels", "la.png", "lb.png", "--features", "f.npy", "depth.png",
              "--feature-weight", "0.5"]  # fmt: skip
    assert main(["morph", "a.png", "b.png", "-o", "one.gif", *guides, *options]) == 0
    assert main(["morph", "a.png", "b.png", "-o", "bare.gif", *options]) == 0
    written = (tmp_path / "one.gif").read_bytes()
    assert written != (tmp_path / "bare.gif").read_bytes()
    known = read_parameters(tmp_path / "one.gif")
    assert [entry["file"] for entry in known["labels"]] == ["la.png", "lb.png"]
    assert [entry["file"] for entry in known["features"]] == ["f.npy", "depth.png"]
    assert known["options"]["feature_weight"] == 0.5
    # The recipe makes the file again, and so does TOML with its settings.
    assert main(["morph", "--config", "one.gif", "-o", "again.gif", "--backend", "numpy"]) == 0
    assert (tmp_path / "again.gif").read_bytes() == written
    capfd.readouterr()
    assert main(["morph", "--config", "one.gif", "--dump-config"]) == 0
    (tmp_path / "own.toml").write_text(capfd.readouterr().out)
    assert main(["morph", "--config", "own.toml", "-o", "third.gif", *options]) == 0
    assert (tmp_path / "third.gif").read_bytes() == written
    assert "labels" not in clmorph.load_options("own.toml")
    assert main(["inspect", "a.png", "b.png", "--backend", "numpy", *guides]) == 0
    assert "labels keep parts" in capfd.readouterr().out
    own = "morph", "--config", "own.toml", "--feature-weight", "0.5,1", "-o", "x.gif"
    assert "feature_weight has 2 numbers" in refused(*own)
    both = "morph", "a.png", "b.png", "-o", "x.gif"
    for text, told in {
        'labels = ["la.png"]': "labels: expected a list of two file names",
        'features = "f.npy"': "features: expected a list of two file names",
        'feature_weight = "x"': "expected a number",
    }.items():
        (tmp_path / "bad.toml").write_text(text)
        assert told in refused(*both, "--config", "bad.toml")
    for given, told in {
        ("--labels", "a.png", "b.png"): "336 different",
        ("--labels", "no.png", "lb.png"): "no.png",
        ("--features", "f.npy", "two.npy"): "have 1 coordinates, those of image_b 2",
        ("--features", "f.npy", "bad.toml"): "bad.toml",
        ("--feature-weight", "x"): "a number, or several joined by commas",
    }.items():
        assert told in refused(*both, *given, *options)
    assert "--labels is for two pictures" in refused(*both, "c.png", *guides[:3], *options)
    refused("morph", "a.png", "b.png", "-o", "la.png", *guides[:3], *options)
    assert not (tmp_path / "x.gif").exists()


def test_features_from_files(tmp_path, rng):
    gray = rng.integers(0, 65535, (4, 5), np.uint16)
    Image.fromarray(gray).save(tmp_path / "a.png")
    assert_allclose(read_features(tmp_path / "a.png"), (gray / 65535)[..., None])
    Image.fromarray(rng.integers(0, 255, (4, 5, 3), np.uint8)).save(tmp_path / "b.png")
    assert read_features(tmp_path / "b.png").shape == (4, 5, 3)
    np.save(tmp_path / "c.npy", np.full((4, 5), np.nan))
    with pytest.raises(InputError, match="NaN"):
        read_features(tmp_path / "c.npy")
    Image.new("RGBA", (2, 2), (1, 2, 3, 4)).save(tmp_path / "d.png")
    with pytest.raises(InputError, match="transparent in parts"):
        read_features(tmp_path / "d.png")
