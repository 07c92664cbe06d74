"""Test the precedence of presets, files of settings and recipes, and that runs can be repeated."""

import contextlib
import json
import math
import os
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from films import contents, frames_of
from marks import full
from PIL import Image

import clmorph
from clmorph._shared.options import outside_name, specifications
from clmorph.cli.config import as_toml
from clmorph.cli.main import main
from clmorph.errors import InputError
from clmorph.output.provenance import read_parameters
from clmorph.output.save import FORMATS
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import PRESETS
from clmorph.pipeline.recipe import load_options, options_of

layered = MorphOptions.layered


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


def test_layers():
    assert layered([{"blur": 1, "reach": 2}, {"epsilon": 3}]) == {"reach": 2, "epsilon": 3}
    assert layered([{"epsilon": 3}, {"blur": 1}]) == {"blur": 1}
    assert layered([{"fps": 1}, {"duration": 3}]) == {"duration": 3}
    assert layered([{"blur": 1}, {"blur": 2}, {}]) == {"blur": 2}
    for both in ({"blur": 1, "epsilon": 2}, {"reach": None, "rho": 2}, {"fps": 1, "duration": 2}):
        with pytest.raises(InputError, match="contradict"):
            layered([both])
    assert layered([{"splatting": "local"}, {"gamma": 1}])["splatting"] == "adaptive"
    assert layered([{"gamma": 1}, {"splatting": "fixed"}])["gamma"] is None
    with pytest.raises(InputError, match="gamma"):
        layered([{"gamma": 1, "splatting": "local"}])


def test_what_is_not_given_is_a_state_of_its_own():
    """A value that happens to be the default counts as given."""
    usual = MorphOptions()
    for name, other in (("blur", "epsilon"), ("reach", "rho"), ("fps", "duration")):
        value = getattr(usual, name)
        with pytest.raises(InputError, match="contradict"):
            MorphOptions(**{name: value, other: 0.04})
        assert getattr(MorphOptions(**{other: 0.04}), name) is None
    with pytest.raises(InputError, match="blur"):
        clmorph.sinkhorn(([1], [0.0]), ([1], [0.1]), blur=0.03, epsilon=0.01, backend="numpy")


@pytest.mark.parametrize("preset", [None, *PRESETS])
def test_options_survive_a_file(preset):
    for more in (
        {}, {"rho": 0.04}, {"epsilon": 0.01}, {"duration": 9.0}, {"reach": (0.2, None)},
        {"max_memory": 3e9}, {"canvas": (9, 7)}, {"sample": 3}, {"rho": (0.1, math.inf)},
    ):  # fmt: skip
        options = MorphOptions(preset=preset, **more)
        text = json.loads(json.dumps(options.outside()))
        assert MorphOptions(**options_of(text, "x")) == options
        again = tomllib.loads(as_toml(options.outside(), []))
        assert MorphOptions(**options_of(again, "x")) == options


@pytest.mark.parametrize("preset", list(PRESETS))
def test_the_schema_describes_what_is_written(preset):
    """It accepts what files hold, and refuses what `options_of` and the classes refuse."""
    validator = jsonschema.Draft202012Validator(MorphOptions.json_schema())
    jsonschema.Draft202012Validator.check_schema(validator.schema)
    for more in ({}, {"rho": 1e-9}, {"rho": (0.04, math.inf)}, {"reach": (0.2, None)},
                 {"max_memory": 3e9}, {"canvas": (9, 7)}, {"duration": 9.0}):  # fmt: skip
        validator.validate(MorphOptions(preset=preset, **more).outside())
    for name, wrong in (("blur", "soft"), ("blur", 0), ("frames", 1), ("frames", 2.5),
                        ("reach", [1, 2, 3]), ("reach", "none"), ("max_memory", 1e10),
                        ("splatting", "big"), ("reverse", 1), ("colour", 3)):  # fmt: skip
        assert not validator.is_valid({name: wrong}), name
        with pytest.raises(InputError):
            MorphOptions(**options_of({name: wrong}, "x"))


def test_what_decides(capfd):
    """Command line, then a preset named there, then the file, then the file's preset."""
    Path("x.toml").write_text('preset = "paper"\nblur = 0.07\nframes = 9\nsplatting = "none"\n')
    assert dumped(capfd)["blur"] == MorphOptions().blur
    found = dumped(capfd, "--config", "x.toml")
    assert found == found | {"blur": 0.07, "frames": 9, "extent": "unit", "gamma": "none"}
    found = dumped(capfd, "--config", "x.toml", "--preset", "balanced", "--frames", "4")
    assert found == found | {"blur": MorphOptions().blur, "reach": "balanced", "frames": 4}
    assert dumped(capfd, "--config", "x.toml", "--epsilon", "0.01").keys().isdisjoint({"blur"})


def test_the_papers_threshold_is_a_setting(capfd, monkeypatch):
    """Of the preset, the command line, TOML and recipes, through to `clmorph.morph`."""
    assert dumped(capfd, "--preset", "paper")["log_threshold"] == -13
    assert dumped(capfd)["log_threshold"] == "relative"
    assert dumped(capfd, "--log-threshold", "-11.5")["log_threshold"] == -11.5
    Path("x.toml").write_text('preset = "paper"\nlog-threshold = -12\n')
    assert dumped(capfd, "--config", "x.toml")["log_threshold"] == -12
    seen = []
    make = ImagePair.morph

    def spy(problem, *more):
        seen.append(problem.options.log_threshold)
        return make(problem, *more)

    monkeypatch.setattr(ImagePair, "morph", spy)
    few = ["a.png", "b.png", "--frames", "2", "--preset", "paper"]
    assert main(["morph", *few, "-o", "first.gif"]) == 0
    assert main(["morph", "--config", "first.gif", "-o", "again.gif"]) == 0
    assert main(["morph", *few, "--log-threshold", "relative", "-o", "other.gif"]) == 0
    assert main(["morph", "--config", "other.gif", "-o", "same.gif"]) == 0
    assert read_parameters(Path("same.gif"))["options"]["log_threshold"] == "relative"
    assert seen == [-13, -13, None, None]


def test_draws_and_means_are_of_the_whole_plan():
    """They take the place of the preset's threshold, and it theirs; "relative" takes no place."""
    preset = {"log_threshold": -13}
    assert layered([preset, {"sample": 3}]) == {"sample": 3}
    assert layered([preset, {"barycentric": True}]) == {"barycentric": True}
    assert layered([preset, {"barycentric": False}]) == {"barycentric": False, **preset}
    assert layered([{"sample": 3}, preset]) == preset
    off = {"log_threshold": None}
    assert layered([{"sample": 3}, off]) == {"sample": 3, **off}


def test_a_threshold_that_drops_much_is_noted(capfd, rng):
    for name in "de":
        Image.fromarray(rng.integers(0, 255, (24, 24, 3), np.uint8)).save(f"{name}.png")
    arguments = ["d.png", "e.png", "--frames", "2", "--preset", "paper", "--json"]
    arguments += ["--log-threshold", "-7", "-o", "o.gif", "--backend", "numpy"]
    assert main(["morph", *arguments]) == 0
    out, err = capfd.readouterr()
    assert "note: --log-threshold -7 drops" in err
    (noted,) = json.loads(out)["notes"]
    assert "'relative'" in noted
    assert json.loads(out)["options"]["max_memory"] == "none"  # no memory gave way


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


@pytest.mark.parametrize(
    "name",
    [pytest.param(it, marks=[pytest.mark.full] if it == "webm" else []) for it in FORMATS],
)
def test_every_file_can_be_made_again_from_itself(name, capfd):
    ending = (FORMATS[name].endings or ("",))[0]
    arguments = ["a.png", "b.png", "-o", f"out{ending}", "--format", name, "--frames", "3"]
    options = ["--blur", "0.08", "--reach", "balanced", "--ease", "in", "--recipe"]
    assert main(["morph", *arguments, *options]) == 0
    # Recipes beside files do not depend on the format.
    for source in (f"out{ending}", f"out{ending}.json")[: 2 if name == "gif" else 1]:
        again = f"again{len(source)}{ending}"
        by_name = ["--format", name] if name == "tiff-folder" else []
        assert main(["morph", "--config", source, "-o", again, *by_name]) == 0
        assert "note:" not in capfd.readouterr().err
        assert contents(Path(f"out{ending}")) == contents(Path(again))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("z", "npz"), ("g.png", "gif"),
        *(pytest.param(*each, marks=pytest.mark.full) for each in (
            ("x.bin", "webm"), ("p.htm", "html"), ("m.m4v", "mp4"), ("t.tiff", "tiff"),
            ("f", "tiff-folder"))),
    ],
)  # fmt: skip
def test_what_a_file_is_called_and_what_it_becomes_is_free(name, kind):
    """Files are known by what is in them, and the next one by its own ending."""
    few = ["--frames", "3", "--backend", "numpy"]
    assert main(["morph", "a.png", "b.png", "-o", name, "--format", kind, *few]) == 0
    assert main(["morph", "--config", name, "-o", f"{name}.webp", "--backend", "numpy"]) == 0
    assert len(frames_of(f"{name}.webp")) == 3


def test_everything_that_decides_is_recorded(capfd):
    options = ["--preset", "pixel-art", "--max-pixels", "100", "--frames", "3", "--recipe"]
    assert main(["morph", "a.png", "b.png", "-o", "o.gif", *options]) == 0
    told = json.loads(Path("o.gif.json").read_text())["options"]
    wanted = {"fps": 20, "hold": 0.65, "ease": "linear", "loop": "loop",
              "mass": "foreground", "tol": 0.001, "seed": 0, "frames": 3}  # fmt: skip
    assert wanted.items() <= told.items()
    assert set(dumped(capfd)) >= {*wanted, "max_pixels"}
    # What does not change the picture is not a recipe's to say.
    assert told.keys().isdisjoint({"format", "output", "recipe", "max_pixels"})


@pytest.mark.needs_device
def test_memory_that_gave_way_is_recorded(capfd, monkeypatch):
    """On a larger device the same run would draw others."""
    rng = np.random.default_rng(8)
    for name in "de":
        Image.fromarray(rng.integers(0, 255, (32, 32, 3), np.uint8)).save(f"{name}.png")
    arguments = ["d.png", "e.png", "--frames", "3", "--blur", "0.3", "--backend", "opencl"]
    assert main(["morph", *arguments, "-o", "o.npz", "--json"]) == 0
    capfd.readouterr()
    assert main(["morph", *arguments, "-o", "o.npz", "--max-memory", "0.03", "--json"]) == 0
    out, err = capfd.readouterr()
    summary = json.loads(out)
    assert "max_memory=0.03 GB" in summary["notes"][0]
    assert "note: " in err
    assert summary["options"]["max_memory"] == 0.03
    with monkeypatch.context() as patch:
        for module in ("clmorph.pipeline.budget", "clmorph.cli.morph"):
            patch.setattr(f"{module}.default_memory", lambda operations: 0.03e9)
        assert main(["morph", *arguments, "-o", "p.npz", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["options"]["max_memory"] == 0.03
    assert told["particles"] == summary["particles"]
    assert main(["morph", "--config", "p.npz", "-o", "q.npz", "--backend", "opencl"]) == 0
    assert Path("p.npz").read_bytes() == Path("q.npz").read_bytes()


def test_flags_can_be_taken_back(capfd):
    Path("x.toml").write_text("reverse = true\nlossless = true\nrecipe = true\n")
    assert dumped(capfd, "--config", "x.toml")["reverse"] is True
    line = ["--no-reverse", "--no-lossless", "--no-recipe"]
    found = dumped(capfd, "--config", "x.toml", *line)
    assert not any(found[name] for name in ("reverse", "lossless", "recipe"))


def test_idle_options_are_noted(capfd):
    for name, options in (("o.npz", ["--canvas", "9x9"]), ("o.gif", ["--lossless"]),
                          ("o", ["--loop", "ping-pong"])):  # fmt: skip
        assert main(["morph", "a.png", "b.png", "-o", name, "--frames", "3", *options]) == 0
        assert f"note: {options[0]} makes no difference to {name}" in capfd.readouterr().err
    outputs = ["-o", "o.gif", "-o", "o.webp", "--frames", "3"]
    assert main(["morph", "a.png", "b.png", *outputs, "--lossless"]) == 0
    assert "makes no difference" not in capfd.readouterr().err


BROKEN = {
    "a.json": b'{"clmorph":"1","options":5}',
    "b.json": b'{"clmorph":"1","options":{"frames":[1]}}',
    "c.json": b'{"clmorph":"1","options":{},"images":[{"file":null}]}',
    "e.json": b'{"a":' * 100000,
    "g.toml": b"frames = 4.7",
    "k.toml": b"reverse = 1",
    "m.npz": b"PK\003\004garbage",
    "n.webm": b"\x1aE\xdf\xa3 and nothing more",
    "o.mp4": b"\0\0\0\x18ftypmp42 and nothing more",
    "p.gif": b"GIF89a",
    "q.html": b"<!DOCTYPE html>",
    "r.png": b"\x89PNG\r\n\x1a\n",
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_of_settings(name, refused):
    Path(name).write_bytes(BROKEN[name])
    line = refused("morph", "a.png", "b.png", "-o", "out.gif", "--config", name)
    assert name in line
    assert not Path("out.gif").exists()


def test_a_damaged_archive(capfd, rng):
    assert main(["morph", "a.png", "b.png", "-o", "o.npz", "--frames", "3"]) == 0
    whole = Path("o.npz").read_bytes()
    for place in range(60, len(whole), len(whole) // 25):
        Path("d.npz").write_bytes(whole[:place] + b"\xff" * 40 + whole[place + 40 :])
        for read in (clmorph.load, lambda path: read_parameters(Path(path))):
            # Harmless, or told in our words; nothing else.
            with contextlib.suppress(InputError):
                read("d.npz")
    np.save("bare.npy", np.zeros(3))
    Path("bare.npy").rename("bare.npz")
    with pytest.raises(InputError, match=r"bare\.npz"):
        clmorph.load("bare.npz")


def test_recipes_tell_no_folders_in_files_that_get_around(tmp_path):
    Path("deeper").mkdir()
    full = [str(tmp_path / name) for name in ("a.png", "b.png")]
    assert main(["morph", *full, "-o", "deeper/out.gif", "--frames", "3", "--recipe"]) == 0
    embedded = read_parameters(Path("deeper/out.gif"))
    assert [image["file"] for image in embedded["images"]] == ["a.png", "b.png"]
    beside = json.loads(Path("deeper/out.gif.json").read_text())
    assert [image["file"] for image in beside["images"]] == ["a.png", "b.png"]
    assert [image["folder"] for image in beside["images"]] == ["..", ".."]
    assert beside["clmorph"]
    assert beside["device"]
    assert main(["morph", "--config", "deeper/out.gif.json", "-o", "again.gif"]) == 0
    assert Path("deeper/out.gif").read_bytes() == Path("again.gif").read_bytes()


def test_a_picture_that_has_changed_is_noted_and_one_that_is_gone_refused(capfd, refused):
    assert main(["morph", "a.png", "b.png", "-o", "out.png", "--frames", "3"]) == 0
    Path("c.png").replace("b.png")
    assert main(["morph", "--config", "out.png", "-o", "again.png"]) == 0
    assert "b.png is not the file that was used then" in " ".join(capfd.readouterr().err.split())
    Path("b.png").unlink()
    told = refused("morph", "--config", "out.png", "-o", "again.png")
    assert "b.png: no such file, but the settings name it" in told


def test_mistakes_in_files(refused):
    cases = {
        "colour_weight = 3": "unknown option 'colour_weight'; did you mean 'color_weight'?",
        "blur = ": "not TOML",
        'blur = "soft"': "blur = 'soft': expected a finite number",
        'splatting = "big"': "splatting='big'",
        "images = 3": "expected a list",
        'preset = "lovely"': "preset = 'lovely'",
        'gamma = 1\nsplatting = "local"': "gamma=1 belongs",
        "blur = 0.05\nepsilon = 0.0025": "x.toml: blur=0.05 and epsilon=0.0025 contradict",
        "frames = 1": "x.toml: n_frames=1",
        "reach = [0.3]": "a pair",
        'device = "0:0"': "--device or --backend",
        'landmark = "1,2:3,4"': "landmark = '1,2:3,4': expected pairs of points",
        'landmark = ["1,2:3,4"]': "such as [[[120, 80], [131, 92]]], or 'auto'",
    }
    for text, words in cases.items():
        Path("x.toml").write_text(text)
        assert words in refused("morph", "a.png", "b.png", "-o", "o.gif", "--config", "x.toml")
    Path("x.toml").write_text('labels = ["a.png", "b.png"]')
    told = refused("mix", "a.png", "b.png", "-o", "o.png", "--config", "x.toml")
    assert "labels: mixes take none; remove them" in told
    for name, words in (
        ("missing.toml", "no such file"),
        ("a.png", "holds no parameters of clmorph"),
        (".", "folder without frames"),
    ):
        assert words in refused("morph", "a.png", "b.png", "-o", "o.gif", "--config", name)
    Path("text.json").write_text("{")
    assert "cannot be read" in refused("morph", "--config", "text.json", "-o", "o.gif")
    assert not Path("o.gif").exists()


def test_one_recipe_for_python_and_the_command_line(capfd, rng):
    """What Python saved, the command line repeats, and the reverse: the same bytes."""
    given = {"n_frames": 3, "blur": 0.06, "reach": None, "fps": 12.0, "backend": "numpy"}
    result = clmorph.morph(*(clmorph.read_image(f"{name}.png") for name in "ab"), **given)
    result.save("p.npz")
    result.save("p.gif", loop="ping-pong")
    arguments = ["a.png", "b.png", "--backend", "numpy"]
    assert main(["morph", *arguments, "--config", "p.npz", "-o", "q.npz"]) == 0
    np.testing.assert_equal(*(list(clmorph.load(f"{name}.npz").frames) for name in "pq"))
    assert main(["morph", *arguments, "--config", "p.gif", "-o", "q.gif"]) == 0
    assert load_options("p.gif") == load_options("q.gif")
    assert load_options("q.gif")["loop"] == "ping-pong"
    again = clmorph.morph(
        *(clmorph.read_image(f"{name}.png") for name in "ab"), backend="numpy",
        **load_options("q.gif"),
    )  # fmt: skip
    assert np.array_equal(again.frame(0.5), result.frame(0.5))


def test_python_and_the_command_line_have_the_same_defaults():
    few = ["--frames", "3", "--backend", "numpy"]
    assert main(["morph", "a.png", "b.png", "-o", "line.npz", *few]) == 0
    images = [clmorph.read_image(f"{name}.png") for name in "ab"]
    result = clmorph.morph(*images, n_frames=3, backend="numpy")
    np.testing.assert_equal(list(clmorph.load("line.npz").frames), list(result.frames))
    other = clmorph.morph(*images[::-1], n_frames=3, blur=0.2, backend="numpy")
    clmorph.save([result, other], "two.gif")
    with pytest.raises(InputError, match="different options"):
        load_options("two.gif")


def test_a_path_that_no_system_takes_is_refused():
    with pytest.raises(InputError, match="expected the path of a file"):
        load_options("x" * 5000)


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_make_something(preset, capfd):
    """Ends as the pictures (or seen through the kernel), something else in between."""
    arguments = ["a.png", "b.png", "-o", preset, "--preset", preset, "--frames", "3"]
    assert main(["morph", *arguments]) == 0
    frames = [frames_of(file)[0][..., :3].astype(float) for file in sorted(Path(preset).iterdir())]
    for name, frame in (("a.png", frames[0]), ("b.png", frames[2])):
        off = np.abs(frames_of(name)[0][..., :3] - frame).max()
        assert off > 20 if PRESETS[preset].options.get("endpoints") == "paper" else off <= 1
    assert math.isfinite(frames[1].std())
    assert frames[1].std() > 5


def test_crossfade_is_one(capfd):
    """Nothing moves: the middle is the mean of both (in the space in which colors fade)."""
    options = ["--preset", "crossfade", "--frames", "3", "--path-space", "srgb"]
    Image.fromarray(np.full((6, 8, 3), 255, np.uint8)).save("white.png")
    assert main(["morph", "a.png", "white.png", "-o", "frames", *options]) == 0
    start, middle = (frames_of(it)[0].astype(float) for it in ("a.png", "frames/frame-0001.png"))
    assert np.abs(middle - (start + 255) / 2).max() < 3


NUMERIC = [
    outside_name(name, known)
    for name, known in specifications(MorphOptions).items()
    if "number" in known.kind.metavar or "integer" in known.kind.metavar
]
NUMERIC.append("max_pixels")
#: Values as TOML and as JSON write them.
NO_NUMBERS = [
    ("inf", "Infinity"), ("-inf", "-Infinity"), ("nan", "NaN"), ("9" * 400, "9" * 400),
    ("9" * 5000, "9" * 5000), ("true", "true"), ("false", "false"), ('"x"', '"x"'), ('""', '""'),
    ("[]", "[]"), ("[[1]]", "[[1]]"), ("{a = 1}", '{"a": 1}'), ("2026-01-01", "null"),
]  # fmt: skip


@pytest.mark.parametrize("name", NUMERIC)
def test_values_of_files_that_are_no_numbers(name, refused):
    for toml, text in NO_NUMBERS:
        Path("x.toml").write_text(f"{name} = {toml}\n")
        Path("x.json").write_text(f'{{"clmorph": "1", "options": {{"{name}": {text}}}}}')
        # What a recipe says about limits counts for nothing.
        for file in ("x.toml", "x.json")[: 1 if name == "max_pixels" else 2]:
            line = refused("morph", "a.png", "b.png", "-o", "o.gif", "--config", file,
                        "--backend", "numpy")  # fmt: skip
            assert len(line) < 400
            assert any(word in line for word in (file, name, name.replace("_", "-"))), line


@pytest.mark.parametrize("value", ["5", '["a.gif", 5]', '""', '[""]', '"a\\u0000b"'])
def test_names_of_files_that_are_none(value, refused):
    Path("x.toml").write_text(f"output = {value}\n")
    refused("morph", "a.png", "b.png", "--config", "x.toml")


@pytest.mark.skipif(os.name == "nt", reason="no names of files there")
@pytest.mark.parametrize(
    "name", ["10:30.png", *full("back\\slash.png", "aux.png", "dots...", "space ")]
)
def test_a_recipe_of_ours_names_what_files_are_called(name, capfd):
    Path("a.png").rename(name)
    few = ["--frames", "2", "--backend", "numpy", "--solve-size", "4"]
    assert main(["morph", name, "b.png", "-o", "first.gif", *few]) == 0
    arguments = ["--config", "first.gif", "-o", "again.gif", "--backend", "numpy"]
    assert main(["morph", *arguments]) == 0, capfd.readouterr().err
    assert Path("again.gif").read_bytes() == Path("first.gif").read_bytes()
