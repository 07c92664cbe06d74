"""Presets that the pictures choose, and first looks."""

import json

import pytest
from drawn_pictures import logo, sprite
from picture_pairs import picture

import clmorph
from clmorph import InputError, MorphOptions
from clmorph.cli.main import main
from clmorph.pipeline.prepare import as_options
from clmorph.pipeline.presets import DRAFT, PRESETS, preset_for

SMALL = {"n_frames": 3, "solve_size": 16, "backend": "numpy"}


def kinds():
    """Return pairs of pictures, and the preset for each."""
    photo = picture("cat")[:48, :48]
    return {
        "pixel-art": (sprite("heart"), sprite("ghost")),
        "logo": (logo("star", 40), logo("disc", 40)),
        "photo": (photo, photo[::-1]),
    }


@pytest.mark.parametrize("name", ["pixel-art", "logo", "photo"])
def test_pictures_choose(name):
    pair = kinds()[name]
    # Nothing is found in these, so that the result has no landmarks.
    wanted = MorphOptions(preset=name, n_frames=3, solve_size=16, landmarks=None)
    assert clmorph.morph(*pair, **SMALL).options == wanted
    given = {key: value for key, value in SMALL.items() if key != "backend"}
    for preset in ("auto", None):
        assert as_options(None, preset, given, pair) == wanted.replace(landmarks="auto")
    # What is given stays, and an object of options is complete.
    chosen = as_options(None, None, {**given, "detail": "particles"}, pair)
    assert chosen.detail == "particles"
    assert as_options(MorphOptions(n_frames=3), None, {}, pair) == MorphOptions(n_frames=3)


def test_pairs_of_two_kinds():
    assert preset_for(["sprite", "drawing"]) == "logo"
    assert preset_for(["sprite", "photograph"]) == "photo"
    assert preset_for(["drawing", "photograph", "sprite"]) == "photo"
    found = clmorph.morph(sprite("heart"), logo("disc", 40), **SMALL)
    assert found.options == MorphOptions(preset="logo", n_frames=3, solve_size=16, landmarks=None)


def test_auto_needs_pictures():
    with pytest.raises(InputError, match="preset='auto' is chosen by the pictures"):
        MorphOptions(preset="auto")
    with pytest.raises(InputError, match="unknown option 'blurr'"):
        clmorph.morph(*kinds()["logo"], blurr=1, **SMALL)


class TestDraft:
    def test_it_reduces_what_is_not_given(self):
        draft = MorphOptions(draft=True)
        for name, value in DRAFT.items():
            assert getattr(draft, name) == value
        assert draft.tol == 1e-2
        assert MorphOptions(draft=True, size=200, tol=1e-4).size == 200
        assert MorphOptions(draft=True, preset="paper").size == PRESETS["paper"].options["size"]
        with pytest.raises(InputError, match="draft"):
            MorphOptions(draft=1.5)
        with pytest.raises(InputError, match="construct MorphOptions"):
            draft.replace(draft=True)
        with pytest.raises(InputError, match="contradict"):
            clmorph.morph(*kinds()["logo"], draft, draft=True)

    def test_morph(self):
        image = picture("cat")[:128, :128]
        found = clmorph.morph(image, image[:, ::-1], draft=True, solve_size=8, backend="numpy")
        assert max(found.source.shape) == 96
        assert len(found.times) == 12


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, pair in kinds().items():
        for number, image in enumerate(pair):
            clmorph.write_image(f"{name}{number}.png", image)
    return tmp_path


OPTIONS = ["--frames", "3", "--solve-size", "16", "--backend", "numpy"]


class TestCommand:
    @pytest.mark.full
    @pytest.mark.parametrize("name", ["pixel-art", "logo", "photo"])
    def test_it_says_what_it_took(self, files, capfd, name):
        pair = [f"{name}{number}.png" for number in (0, 1)]
        assert main(["morph", *pair, "-o", "out.gif", "--json", *OPTIONS]) == 0
        shown = capfd.readouterr()
        assert f"preset: {name}, for what the pictures show" in shown.err
        summary = json.loads(shown.out)
        assert summary["preset"] == name
        given = ["--preset", name]
        assert main(["morph", *pair, "-o", "given.gif", *given, *OPTIONS]) == 0
        assert "preset:" not in capfd.readouterr().err
        assert (files / "out.gif").read_bytes() == (files / "given.gif").read_bytes()
        # A recipe holds all options, whatever the pictures show.
        assert main(["morph", "--config", "out.gif", "-o", "again.gif", "--backend", "numpy"]) == 0
        assert "preset:" not in capfd.readouterr().err
        assert (files / "out.gif").read_bytes() == (files / "again.gif").read_bytes()

    @pytest.mark.full
    def test_files_of_settings(self, files, capfd):
        (files / "mine.toml").write_text('preset = "auto"\nblur = 0.07\n')
        pair = ["logo0.png", "logo1.png"]
        for preset in ([], ["--preset", "auto"]):
            command = ["morph", *pair, "-o", "out.gif", "--config", "mine.toml", "--json"]
            assert main([*command, *preset, *OPTIONS]) == 0
            shown = capfd.readouterr()
            options = json.loads(shown.out)["options"]
            assert options["detail"] == "layers"
            # A preset of the command line replaces what a file says of its options.
            assert options["blur"] == (0.02 if preset else 0.07)
            others = "solve_size" if preset else "blur, solve_size"
            told = f"preset: logo, for what the pictures show; given otherwise: {others}\n"
            assert told in shown.err

    def test_dumped_settings_are_those_of_the_pictures(self, files, capfd):
        assert main(["morph", "logo0.png", "logo1.png", "--dump-config"]) == 0
        assert 'detail = "layers"' in capfd.readouterr().out
        assert main(["morph", "--dump-config"]) == 0
        shown = capfd.readouterr()
        assert 'detail = "layers"' in shown.out
        assert "name pictures" in shown.err

    @pytest.mark.full
    def test_draft(self, files, capfd):
        pair = ["photo0.png", "photo1.png"]
        command = ["morph", *pair, "-o", "out.gif", "--draft", "--json", "--backend", "numpy"]
        assert main([*command, "--solve-size", "8", "--size", "40"]) == 0
        found = json.loads(capfd.readouterr().out)
        assert found["frames"] == 12
        assert found["options"]["size"] == 40
        assert found["options"]["tol"] == 1e-2
        (files / "mine.toml").write_text("frames = 5\nsize = 400\n")
        assert main([*command, "--solve-size", "8", "--config", "mine.toml"]) == 0
        found = json.loads(capfd.readouterr().out)
        assert (found["frames"], found["options"]["size"]) == (5, 96)

    @pytest.mark.full
    def test_inspect(self, files, capfd):
        pair = ["logo0.png", "logo1.png"]
        command = ["inspect", *pair, "--backend", "numpy", "--solve-size", "16", "--json"]
        assert main(command) == 0
        shown = capfd.readouterr()
        assert "preset: logo, for what the pictures show" in shown.err
        auto = json.loads(shown.out)
        assert main([*command, "--preset", "logo"]) == 0
        given = json.loads(capfd.readouterr().out)
        assert auto["source"] == given["source"]
        # The background has no mass.
        assert auto["source"]["points_with_mass"] < auto["source"]["points"]
