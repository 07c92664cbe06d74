"""Recipes that clmorph 0.2.0 wrote still make films, with a note about what has a new name."""

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from drawn_pictures import logo
from films import frames_of
from marks import full
from PIL import Image
from scipy.ndimage import gaussian_filter

import clmorph
from clmorph.cli.main import main

NOTE = (
    "note: --detail '{}' means --detail 'layers' now, and works until version 1.0: write 'layers'"
)


@pytest.fixture(params=["carried", "shapes"])
def former(request, tmp_path, monkeypatch, rng):
    """A value of `detail` in 0.2.0, in a folder with a recipe of it, r.json, and two pictures."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(Path(__file__).parents[1] / f"data/recipe_0.2.0_{request.param}.json", "r.json")
    noise = gaussian_filter(rng.normal(size=(2, 24, 32, 3)), (0, 2, 2, 0))
    pictures = np.clip(0.5 + 0.2 * noise / noise.std(), 0, 1)
    if request.param == "shapes":
        pictures = [logo(name, 24) for name in ("star", "disc")]
    for name, image in zip("ab", pictures, strict=True):
        Image.fromarray(np.rint(255 * image).astype(np.uint8)).save(f"{name}.png")
    return request.param


@pytest.mark.parametrize("former", ["shapes", *full("carried")], indirect=True)
def test_they_make_films(former, capfd):
    given = ["a.png", "b.png", "--config", "r.json", "--backend", "numpy"]
    assert main(["morph", *given, "-o", "out.gif", "--recipe", "--json"]) == 0
    shown = capfd.readouterr()
    assert shown.err.splitlines().count(NOTE.format(former)) == 1
    summary = json.loads(shown.out)
    was = json.loads(Path("r.json").read_text())["options"]
    assert was["detail"] == former
    assert summary["options"] == was | {"detail": "layers"}
    assert len(frames_of("out.gif")) == was["frames"]
    # It is the film of that name, and its own recipe holds the new one.
    assert main(["morph", *given, "-o", "same.gif", "--detail", "layers"]) == 0
    capfd.readouterr()
    again = ["morph", "--config", "out.gif.json", "-o", "again.gif", "--backend", "numpy"]
    assert main(again) == 0
    assert "works until" not in capfd.readouterr().err
    assert Path("out.gif").read_bytes() == Path("again.gif").read_bytes()
    np.testing.assert_equal(frames_of("out.gif"), frames_of("same.gif"))


def test_settings_and_python(former, capfd):
    Path("mine.toml").write_text(f'detail = "{former}"\n')
    assert main(["morph", "--config", "mine.toml", "--dump-config"]) == 0
    shown = capfd.readouterr()
    assert tomllib.loads(shown.out)["detail"] == "layers"
    assert shown.err.splitlines().count(NOTE.format(former)) == 1
    with pytest.warns(clmorph.OptionWarning):
        assert clmorph.MorphOptions(detail=former) == clmorph.MorphOptions(detail="layers")
    images = [clmorph.read_image(name) for name in ("a.png", "b.png")]
    options = clmorph.load_options("r.json")
    with pytest.warns(clmorph.OptionWarning, match=f"^detail='{former}' means detail='layers' now"):
        morph = clmorph.morph(*images, backend="numpy", **options)
    assert morph.detail == morph.options.detail == "layers"
    assert len(morph) == 3
