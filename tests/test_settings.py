"""Presets, files of settings, recipes: what decides, and that runs can be repeated."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clmorph.cli import main
from clmorph.commands.settings import layered
from clmorph.defaults import PRESETS
from clmorph.errors import InputError
from clmorph.export import FORMATS
from clmorph.formats.embedding import read_parameters


@pytest.fixture(autouse=True)
def pictures(tmp_path, monkeypatch, rng):
    """Three small pictures in the current folder."""
    monkeypatch.chdir(tmp_path)
    for name, shape in (("a.png", (6, 8, 3)), ("b.png", (9, 7, 3)), ("c.png", (8, 8, 3))):
        Image.fromarray(rng.integers(0, 255, shape, np.uint8)).save(name)
    return tmp_path


def dumped(capfd, *arguments):
    capfd.readouterr()
    assert main(["morph", *arguments, "--dump-config"]) == 0
    return tomllib.loads(capfd.readouterr().out)


def told(capfd, *arguments):
    assert main(["morph", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith(("device:", "note:"))]
    assert len(lines) == 1
    return lines[0]


def test_layers():
    assert layered([{"blur": 1, "reach": 2}, {"epsilon": 3}]) == {"reach": 2, "epsilon": 3}
    assert layered([{"epsilon": 3}, {"blur": 1}]) == {"blur": 1}
    assert layered([{"fps": 1}, {"duration": 3}]) == {"duration": 3}
    assert layered([{"blur": 1}, {"blur": 2}, {}]) == {"blur": 2}
    both = {"blur": 1, "epsilon": 2}
    assert layered([both]) == both  # the solver says that they contradict
    assert layered([{"splatting": "local"}, {"gamma": 1}])["splatting"] == "adaptive"
    assert "gamma" not in layered([{"gamma": 1}, {"splatting": "fixed"}])
    with pytest.raises(InputError, match="--gamma"):
        layered([{"gamma": 1, "splatting": "local"}])


def test_what_decides(capfd):
    """Command line, then a preset named there, then the file, then the file's preset."""
    Path("x.toml").write_text('preset = "paper"\nblur = 0.07\nframes = 9\nsplatting = "none"\n')
    assert dumped(capfd)["blur"] == PRESETS["photo"]["blur"]
    found = dumped(capfd, "--config", "x.toml")
    assert found["blur"] == 0.07
    assert found["frames"] == 9
    assert found["extent"] == "unit"
    assert "gamma" not in found
    found = dumped(capfd, "--config", "x.toml", "--preset", "balanced", "--frames", "4")
    assert found["blur"] == PRESETS["balanced"]["blur"]
    assert found["reach"] == "balanced"
    assert found["frames"] == 4
    assert dumped(capfd, "--config", "x.toml", "--epsilon", "0.01").keys().isdisjoint({"blur"})


def test_a_dump_is_a_file_of_settings(capfd):
    arguments = "a.png b.png --preset pixel-art --reach 0.3,balanced --loop ping-pong --canvas 9x9"
    first = dumped(capfd, *arguments.split())
    assert first["images"] == ["a.png", "b.png"]
    assert first["reach"] == [0.3, "balanced"]
    Path("deeper").mkdir()
    lines = [f"{name} = {json.dumps(value)}" for name, value in first.items()]
    Path("x.toml").write_text("\n".join(lines))
    again = dumped(capfd, "--config", "x.toml")
    assert again == first
    # Dashes are as good as underscores, and pictures are sought beside the file.
    Path("deeper/y.toml").write_text('images = ["../a.png", "../c.png"]\ncolor-weight = 3\n')
    found = dumped(capfd, "--config", "deeper/y.toml")
    assert found["color_weight"] == 3
    assert [Path(path).resolve().name for path in found["images"]] == ["a.png", "c.png"]


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_file_can_be_made_again_from_itself(name, capfd):
    ending = (FORMATS[name].endings or ("",))[0]
    arguments = ["a.png", "b.png", "-o", f"out{ending}", "--format", name, "--frames", "3"]
    options = ["--blur", "0.08", "--reach", "balanced", "--ease", "in", "--recipe"]
    assert main(["morph", *arguments, *options]) == 0
    for source in (f"out{ending}", f"out{ending}.json"):
        again = f"again{len(source)}{ending}"
        assert main(["morph", "--config", source, "-o", again]) == 0
        assert "note:" not in capfd.readouterr().err
        files = [Path(f"out{ending}"), Path(again)]
        if files[0].is_dir():
            contents = [[f.read_bytes() for f in sorted(folder.iterdir())] for folder in files]
        else:
            contents = [file.read_bytes() for file in files]
        assert contents[0] == contents[1]


def test_recipes_tell_no_folders_in_files_that_get_around(tmp_path):
    Path("deeper").mkdir()
    full = [str(tmp_path / name) for name in ("a.png", "b.png")]
    assert main(["morph", *full, "-o", "deeper/out.gif", "--frames", "3", "--recipe"]) == 0
    embedded = read_parameters(Path("deeper/out.gif"))
    assert [image["file"] for image in embedded["images"]] == ["a.png", "b.png"]
    beside = json.loads(Path("deeper/out.gif.json").read_text())
    assert [image["file"] for image in beside["images"]] == ["../a.png", "../b.png"]
    assert beside["clmorph"]
    assert beside["device"]
    assert main(["morph", "--config", "deeper/out.gif.json", "-o", "again.gif"]) == 0


def test_a_picture_that_has_changed_is_noted(capfd):
    assert main(["morph", "a.png", "b.png", "-o", "out.png", "--frames", "3"]) == 0
    Path("c.png").replace("b.png")
    assert main(["morph", "--config", "out.png", "-o", "again.png"]) == 0
    assert "b.png is not the file that was used then" in " ".join(capfd.readouterr().err.split())


def test_mistakes_in_files(capfd):
    cases = {
        "colour_weight = 3": "unknown setting 'colour_weight'; did you mean 'color_weight'?",
        "blur = ": "not TOML",
        'blur = "soft"': "'--blur'",
        'splatting = "big"': "--splatting",
        "images = 3": "expected a list",
        'preset = "lovely"': "--preset",
        'gamma = 1\nsplatting = "local"': "--gamma belongs",
        "blur = 0.05\nepsilon = 0.0025": "contradict|both|--epsilon",
    }
    for text, words in cases.items():
        Path("x.toml").write_text(text)
        line = told(capfd, "a.png", "b.png", "-o", "o.gif", "--config", "x.toml")
        assert any(word in line for word in words.split("|")), line
    for name, words in (
        ("missing.toml", "no such file"),
        ("a.png", "holds no parameters of clmorph"),
        (".", "folder without frames"),
    ):
        assert words in told(capfd, "a.png", "b.png", "-o", "o.gif", "--config", name)
    Path("text.json").write_text("{")
    assert "cannot be read" in told(capfd, "--config", "text.json", "-o", "o.gif")
    assert not Path("o.gif").exists()


def test_a_file_saved_from_python_holds_no_settings(capfd, rng):
    import clmorph

    clmorph.morph(*rng.random((2, 5, 5, 3)), 2).save("p.gif")
    assert "saved from Python" in told(capfd, "--config", "p.gif", "-o", "o.gif")


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_make_something(preset, capfd):
    """Ends as the pictures (but the paper's), something else in between, in every preset."""
    arguments = ["a.png", "b.png", "-o", preset, "--preset", preset, "--frames", "3"]
    assert main(["morph", *arguments]) == 0
    frames = []
    for file in sorted(Path(preset).iterdir()):
        with Image.open(file) as picture:
            frames.append(np.asarray(picture).astype(float))
    for name, frame in (("a.png", frames[0]), ("b.png", frames[2])):
        with Image.open(name) as picture:
            off = np.abs(np.asarray(picture) - frame).max()
        assert off > 20 if preset == "paper" else off <= 1
    assert math.isfinite(frames[1].std())
    assert frames[1].std() > 5


def test_crossfade_is_one(capfd):
    """Nothing moves: the middle is the mean of both (in the space in which colors fade)."""
    options = ["--preset", "crossfade", "--frames", "3", "--path-space", "srgb"]
    Image.fromarray(np.full((6, 8, 3), 255, np.uint8)).save("white.png")
    assert main(["morph", "a.png", "white.png", "-o", "frames", *options]) == 0
    with Image.open("a.png") as picture:
        start = np.asarray(picture).astype(float)
    with Image.open("frames/frame-0001.png") as picture:
        middle = np.asarray(picture).astype(float)
    assert np.abs(middle - (start + 255) / 2).max() < 3
