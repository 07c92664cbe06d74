"""Tables of colors that the command writes, read by FFmpeg."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import clmorph
from clmorph.cli.main import main


def picture(path, seed):
    y, x = np.mgrid[:48, :48] / 47
    tint = np.random.default_rng(seed).uniform(0.4, 1.0, 3)
    values = np.stack([x, y, 0.5 * (x + 1 - y)], axis=2) * tint
    Image.fromarray(np.rint(255 * values).astype(np.uint8)).save(path)
    return str(path)


@pytest.fixture
def pair(tmp_path, monkeypatch):
    """The names of two pictures in the current folder."""
    monkeypatch.chdir(tmp_path)
    return picture("a.png", 0), picture("b.png", 1)


def by_ffmpeg(a, kind, look):
    """A picture after a table, by FFmpeg."""
    files = ["-i", a] if kind == "lut3d" else ["-i", a, "-i", str(look)]
    graph = f"format=rgb48,lut3d={look}" if kind == "lut3d" else "format=rgb48[a];[a][1]haldclut"
    command = ["ffmpeg", "-v", "error", *files, "-filter_complex", graph, "-frames:v", "1"]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    found = subprocess.run([*command, *raw], capture_output=True, check=True).stdout
    return np.frombuffer(found, np.uint8).reshape(48, 48, 3).astype(float)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("lut3d", 17), ("haldclut", None),
        *(pytest.param("lut3d", size, marks=pytest.mark.full) for size in (33, 65)),
    ],
)  # fmt: skip
def test_exported_tables_are_applied_by_us_and_by_others(pair, kind, size):
    a, b = pair
    look = "look.cube" if kind == "lut3d" else "look.png"
    plain = ["--backend", "numpy"]
    made = ["-o", "out.png", "--export-lut", look, *(["--lut-size", str(size)] if size else [])]
    assert main(["recolor", a, b, *made, *plain]) == 0
    assert main(["recolor", a, "--lut", look, "-o", "again.png", "--recipe", *plain]) == 0
    want, again = (np.asarray(Image.open(name)).astype(float) for name in ("out.png", "again.png"))
    assert np.abs(want - np.asarray(Image.open(a))).mean() > 5
    assert np.abs(again - want).mean() <= (1.0 if size == 17 else 0.5)
    # The same table, by the same kind of interpolation.
    assert np.abs(by_ffmpeg(a, kind, look) - again).mean() <= 0.5
    assert main(["recolor", "--config", "again.png", "-o", "third.png", *plain]) == 0
    assert Path("third.png").read_bytes() == Path("again.png").read_bytes()
    assert kind == "lut3d" or clmorph.read_image(look).shape == (512, 512, 3)


@pytest.mark.full
def test_a_table_is_fitted_in_python_as_by_the_command(pair):
    a, b = pair
    given = ["-o", "o.png", "--export-lut", "l.cube", "--backend", "numpy"]
    assert main(["recolor", a, b, *given]) == 0
    images = [clmorph.read_image(name) for name in (a, b)]
    lut = clmorph.fit_lut(*images, backend="numpy")
    np.testing.assert_allclose(clmorph.read_lut("l.cube").table, lut.table, atol=1e-6)
    mask = np.zeros((48, 48))
    mask[:20] = 1.0
    found = clmorph.apply_lut(images[0], lut, mask=mask, backend="numpy")
    whole = clmorph.apply_lut(images[0], lut, backend="numpy")
    np.testing.assert_array_equal(found[20:], images[0][20:])
    np.testing.assert_array_equal(found[:20], whole[:20])


def written(size=2, head="", rows=None):
    rows = [f"{i % 2} {i // 2 % 2} {i // 4}" for i in range(size**3)] if rows is None else rows
    return f"{head}LUT_3D_SIZE {size}\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        written(),
        written(head='# a comment\n\nTITLE "a b # c"\n'),
        written(head="\ufeffTITLE x\n").replace("\n", "\r\n"),
        written(head="LUT_3D_INPUT_RANGE 0.0 1.0\n"),
        written() + "\n# the end\n\n",
        written(head="DOMAIN_MIN 0 0 0\nDOMAIN_MAX 1.0 1 1e0\n").replace(" ", "\t  "),
    ],
)
def test_cubes_as_others_write_them(tmp_path, text):
    (tmp_path / "look.CUBE").write_text(text, encoding="utf-8", newline="")
    lut = clmorph.read_lut(tmp_path / "look.CUBE")
    image = np.random.default_rng(0).random((5, 6, 3))
    np.testing.assert_allclose(clmorph.apply_lut(image, lut, backend="numpy"), image, atol=1e-6)


def test_a_domain_is_obeyed_and_kept(tmp_path):
    """A table of its own colors over [-1, 3] x [0, 2] x [0, 1] changes nothing."""
    rows = [f"{-1 + 4 * (i % 2)} {2 * (i // 2 % 2)} {i // 4}" for i in range(8)]
    (tmp_path / "a.cube").write_text(
        "DOMAIN_MIN -1 0 0\nDOMAIN_MAX 3 2 1\n" + written(rows=rows), "ascii"
    )
    lut = clmorph.read_lut(tmp_path / "a.cube")
    clmorph.write_lut(tmp_path / "b.cube", lut)
    again = clmorph.read_lut(tmp_path / "b.cube")
    image = np.random.default_rng(0).random((5, 6, 3))
    for table in (lut, again):
        found = clmorph.apply_lut(image, table, backend="numpy")
        np.testing.assert_allclose(found, image, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (written(3), "does not exist"),
        ("", "LUT_3D_SIZE is missing"),
        ("0 0 0\n" * 8, "LUT_3D_SIZE is missing"),
        (written(2, rows=["0 0 0"] * 7), "7 colors where its size asks for 8"),
        (written(2, rows=["0 0 0"] * 9), "9 colors"),
        (written(2, rows=["0 0"] * 8), "16 numbers"),
        (written(2, rows=["0 0 nan"] * 8), "NaN"),
        (written(2, rows=["0 inf 0"] * 8), "infinity"),
        (written(2, rows=["0 x 0"] * 8), "'x' is not a number"),
        (written(1, rows=["0 0 0"]), "its size is 1"),
        (written(999, rows=["0 0 0"]), "its size is 999"),
        (written().replace("LUT_3D_SIZE 2", "LUT_3D_SIZE two"), "'two' is not a number"),
        ("LUT_1D_SIZE 2\n0 0 0\n1 1 1\n", "one dimension"),
        (written(head="DOMAIN_MIN 1 1 1\n"), "is empty"),
        (written(head="LUT_IN_VIDEO_RANGE\n"), "line 1: 'LUT_IN_VIDEO_RANGE' is not understood"),
        ("\0\1\2", "not a text"),
        ("<html>", "not understood"),
    ],
)
def test_wrong_tables_are_refused_in_a_line(pair, refused, text, words):
    Path("out.png").write_bytes(b"old")
    if words != "does not exist":
        Path("look.cube").write_text(text, "latin-1")
    else:
        words = "No such file"
    told = refused("recolor", pair[0], "--lut", "look.cube", "-o", "out.png", "--backend", "numpy")
    assert told.startswith("clmorph: error: look.cube")
    assert words in told
    assert Path("out.png").read_bytes() == b"old"


def test_pictures_that_are_no_hald_are_refused(pair, refused):
    told = refused("recolor", pair[0], "--lut", "a.png", "-o", "out.png", "--backend", "numpy")
    assert "a.png has 48 x 48 pixels: expected a .cube table, or a HALD" in told
    with pytest.raises(clmorph.InputError, match="expected 4, 9, 16"):
        clmorph.write_lut("hald.png", clmorph.Lut(np.zeros((5, 5, 5, 3))))
    for wrong in (np.zeros((2, 2, 3)), np.zeros((2, 2, 3, 3)), np.full((2, 2, 2, 3), np.nan)):
        with pytest.raises(clmorph.InputError, match="table"):
            clmorph.Lut(wrong)
    with pytest.raises(clmorph.InputError, match="low below high"):
        clmorph.Lut(np.zeros((2, 2, 2, 3)), 1.0, 0.5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--export-lut", "look.lut"], "expected .cube"),
        (["--lut-size", "17"], "expected --export-lut"),
        (["--export-lut", "look.cube", "--lut-size", "16"], "16"),
    ],
)
def test_mistakes_leave_an_old_output(pair, refused, given, words):
    Path("out.png").write_bytes(b"old")
    assert words in refused("recolor", *pair, "-o", "out.png", *given)
    assert Path("out.png").read_bytes() == b"old"
    assert {path.name for path in Path().iterdir()} == {"a.png", "b.png", "out.png"}
