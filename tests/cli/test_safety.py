"""Files from unknown sources can affect a picture, and nothing else."""

import io
import json
import os
import struct
import sys
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from pictures import png, png_chunk
from PIL import Image

import clmorph
from clmorph._shared import files
from clmorph._shared.printable import printable
from clmorph.cli.config import is_bare
from clmorph.cli.main import main
from clmorph.errors import ClmorphWarning, InputError, OutputError
from clmorph.output.bounded import MAX_TEXT, from_text
from clmorph.output.formats.webp import as_exif
from clmorph.output.metadata import as_text
from clmorph.output.playback import Motion
from clmorph.output.provenance import read_parameters
from clmorph.output.recording import recorded
from clmorph.output.save import Output, write_all

#: What a name out of a foreign file may hold: a terminal's commands, a line's end, a reversal.
HOSTILE = "a\x1b]0;owned\x07\n\u202e.png"
FEW = ["--frames", "2", "--backend", "numpy", "--solve-size", "4"]


@pytest.fixture(autouse=True)
def pictures(tmp_path, monkeypatch, rng):
    """Two small pictures in the current folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("a.png", "b.png"):
        Image.fromarray(rng.integers(0, 255, (5, 6, 3), np.uint8)).save(name)
    return tmp_path


@pytest.fixture
def morph(rng):
    return clmorph.morph(*rng.random((2, 5, 6, 3)), n_frames=3, backend="numpy")


def run(*arguments):
    return main(["morph", *map(str, arguments), *FEW])


@pytest.fixture
def told(refused):
    """Return the one line that a mistake of a morph is told in."""
    return lambda *arguments: refused("morph", *arguments, *FEW)


def recipe(images=("a.png", "b.png"), **options):
    return {"clmorph": "1", "options": options, "images": list(images)}


def as_movie(text):
    av = pytest.importorskip("av")
    with av.open("foreign.webm", "w") as movie:
        movie.metadata["comment"] = text
        stream = movie.add_stream("libvpx-vp9", rate=1)
        stream.width = stream.height = 16
        movie.mux(stream.encode(av.VideoFrame(16, 16, "yuv420p")))
        movie.mux(stream.encode(None))


BLANK = Image.new("RGB", (2, 2))
#: How a file of each ending carries parameters, which are JSON.
CARRIERS = {
    "gif": lambda text: BLANK.save("foreign.gif", comment=text.encode()),
    "html": lambda text: Path("foreign.html").write_text(
        '<!DOCTYPE html><script type="application/json" id="clmorph-parameters">'
        + text.replace("<", "\\u003c")
        + "</script>"
    ),
    "json": Path("foreign.json").write_text,
    "png": lambda text: Path("foreign.png").write_bytes(
        png(np.zeros((2, 2)), 0, chunks=((b"tEXt", b"clmorph\0" + text.encode()),))
    ),
    "npz": lambda text: np.savez("foreign.npz", parameters=np.array(text)),
    "webp": lambda text: BLANK.save("foreign.webp", exif=as_exif(json.loads(text))),
    "tif": lambda text: BLANK.save("foreign.tif", description=text),
    "webm": as_movie,
}


def foreign(ending, parameters):
    """Write a file that carries parameters, and return its name."""
    CARRIERS[ending](json.dumps(parameters))
    return f"foreign.{ending}"


@pytest.mark.parametrize("ending", CARRIERS)
def test_a_foreign_file_decides_about_the_picture_alone(ending, told, capfd):
    Path("profile").write_text("mine")
    file = foreign(ending, recipe(
        output=[str(Path("profile").absolute())], format="gif", recipe=True, max_pixels=1 << 40,
        blur=0.125,
    ))  # fmt: skip
    assert "no output given: expected -o" in told("--config", file)
    assert main(["morph", "--config", file, "--dump-config"]) == 0
    dump, err = capfd.readouterr()
    assert "blur = 0.125" in dump
    assert 'images = [\n    "a.png",\n    "b.png",\n]' in dump
    assert "max_pixels = 64000000" in dump
    assert not {"output", "format", "recipe"} & {line.split(" ")[0] for line in dump.splitlines()}
    assert err.count("note: ") == 2
    for name in ("output", "format"):
        assert f"names its own {name}, which a recipe does not choose" in err
    assert Path("profile").read_text() == "mine"


def test_toml_is_the_users_own(capfd, tmp_path):
    (tmp_path / "deep").mkdir()
    Path("own.toml").write_text(
        f'output = "deep/o.gif"\nimages = ["{tmp_path}/a.png", "./b.png"]\nmax_pixels = 90\n'
    )
    assert run("--config", "own.toml") == 0
    assert Path("deep/o.gif").exists()
    capfd.readouterr()
    assert main(["morph", "--config", "own.toml", "--dump-config"]) == 0
    assert "max_pixels = 90" in capfd.readouterr().out


@pytest.mark.parametrize(
    "name", ["../a.png", "/etc/passwd", "deep/a.png", "..\\a.png", "C:a.png", "..", "", "nul",
             "COM1.png", "\\\\host\\share\\a.png", "a.png\0", "lpt1 .txt", "a.png ", "x" * 400]
)  # fmt: skip
def test_a_recipe_names_pictures_without_folders(name, told):
    assert not is_bare(name, windows=True)
    if is_bare(name):
        return  # a name like others, here
    line = told("--config", foreign("json", recipe([name, "b.png"])), "-o", "o.gif")
    assert "foreign.json names the picture " in line
    assert line.endswith("name the pictures in the command line")
    assert run("a.png", "b.png", "--config", "foreign.json", "-o", "o.gif") == 0


def test_a_recipes_pictures_are_beside_it_or_here(tmp_path, capfd):
    there = tmp_path / "there"
    there.mkdir()
    Path("b.png").rename(there / "b.png")
    for name in ("COMMON.png", ".a é.png"):
        assert is_bare(name)
        assert is_bare(name, windows=True)
    Path(foreign("json", recipe())).rename(there / "foreign.json")
    assert run("--config", "there/foreign.json", "-o", "o.gif") == 0


@pytest.mark.parametrize("key", ["device", "backend", "config", "as_json"])
def test_nothing_chooses_the_device(key, told):
    file = foreign("json", recipe(**{key: "numpy"}))
    assert "unknown option" in told("--config", file, "-o", "o.gif")


def test_a_recipe_may_lower_the_limit_of_memory_but_not_raise_it(capfd, monkeypatch):
    seen = []

    def spy(problem, *more):
        seen.append(problem.options.max_memory)
        raise InputError("seen")

    monkeypatch.setattr("clmorph.pipeline.morph.ImagePair.morph", spy)
    monkeypatch.setattr("clmorph.cli.morph.default_memory", lambda operations: 2e9)
    for file, amount, want in (
        ("x.json", 1.5, 1.5e9), ("x.json", 900, None), ("x.toml", 900, 9e11),
    ):  # fmt: skip
        if file == "x.json":
            Path(file).write_text(json.dumps(recipe(max_memory=amount)))
        else:
            Path(file).write_text(f'images = ["a.png", "b.png"]\nmax_memory = {amount}\n')
        assert run("--config", file, "-o", "o.gif") == 2
        assert seen.pop() == want
        assert ("above the device's own" in capfd.readouterr().err) == (want is None)
    assert run("--config", "x.json", "-o", "o.gif", "--max-memory", "900") == 2
    assert seen.pop() == 9e11


# Nothing written replaces anything read.


def overwritten(told, *arguments):
    before = {path: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    line = told(*arguments)
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before
    return line


def test_no_recipe_takes_an_inputs_place(told):
    Path("b.png").rename("y.gif.json")  # pictures are known by what is in them
    assert "would overwrite an input" in overwritten(
        told, "a.png", "y.gif.json", "-o", "y.gif", "--recipe"
    )
    Path(foreign("json", recipe())).rename("z.gif.json")
    assert "would overwrite an input, z.gif.json" in overwritten(
        told, "a.png", "y.gif.json", "--config", "z.gif.json", "-o", "z.gif", "--recipe"
    )


def test_links_and_other_names_of_an_input_are_known(told):
    Path("link.gif").symlink_to("a.png")
    os.link("b.png", "hard.gif")
    foreign("gif", recipe())
    for output in ("link.gif", "hard.gif", "foreign.gif"):
        assert "would overwrite an input" in overwritten(
            told, "a.png", "b.png", "--config", "foreign.gif", "-o", output
        )


def test_outputs_are_kept_apart(told, tmp_path):
    (tmp_path / "frames").mkdir()
    Path("twin.gif").symlink_to("o.gif")
    for arguments, words in (
        (["-o", "o.gif", "-o", "twin.gif"], "two outputs have one name"),
        (["-o", "frames", "-o", "frames/o.gif"], "lies in the other"),
        (["-o", "frames/o.gif", "-o", "frames"], "lies in the other"),
    ):
        assert words in overwritten(told, "a.png", "b.png", *arguments)


def test_capitals_make_one_name_where_the_disk_says_so(monkeypatch):
    files.check_apart(["o.gif", "O.GIF"])
    with pytest.raises(InputError, match="overwrite an input"):
        files.check_apart(["frames"], ["frames/mine"])
    monkeypatch.setattr(files, "ignores_case", lambda folder: True)
    with pytest.raises(InputError, match="one name"):
        files.check_apart(["o.gif", "O.GIF"])
    with pytest.raises(InputError, match="overwrite an input"):
        files.check_apart(["NEW.png"], ["new.PNG"])
    files.check_apart(["o.gif"], ["o.png"])


def test_disks_that_ignore_capitals_are_known(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    folder.mkdir()
    assert not files.ignores_case(folder)
    (tmp_path / "FOLDER").symlink_to(folder)  # as such a disk would answer
    assert files.ignores_case(folder)


def test_python_and_the_other_commands_check_too(morph, capfd):
    output = Output("o.gif")
    with recorded([morph], Motion()) as film, pytest.raises(InputError, match="one name"):
        write_all([output], film, texts={output.place: "{}"})
    assert not Path("o.gif").exists()
    pytest.importorskip("matplotlib")
    assert main(["inspect", "a.png", "b.png", "-o", "b.png", "--backend", "numpy"]) == 2
    assert "would overwrite an input" in capfd.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="devices of POSIX")
def test_a_report_replaces_no_device(capfd, monkeypatch):
    from clmorph.cli.devices import check_devices

    monkeypatch.setattr("clmorph.cli.devices._choose", lambda *choice, **options: [])
    for place, words in ((os.devnull, "neither a file nor a folder"), (".", "is a folder")):
        with pytest.raises(OutputError, match=words):
            check_devices(None, False, Path(place))
    Path("link.json").symlink_to("real.json")
    assert check_devices(None, False, Path("link.json")) == 0
    assert Path("link.json").is_symlink()
    assert Path("real.json").read_text() == "[]\n"
    assert Path("real.json").stat().st_mode == Path("a.png").stat().st_mode


# Messages.


def test_printable():
    assert printable("plain é 猫.png") == "plain é 猫.png"
    assert printable(HOSTILE) == "a\\x1b]0;owned\\x07\\n\\u202e.png"
    assert printable("o\udcff.gif") == "o\ufffd.gif"
    for text in ("x" * 10**6, "\x1b" * 10**6, "\U000e0001" * 400):
        short = printable(text, 90)
        assert len(short) <= 90
        assert short.isprintable()
        assert "…" in short
    assert printable("begin" + "x" * 1000 + "end").startswith("begin")
    assert printable("begin" + "x" * 1000 + "end").endswith("end")
    assert printable(Path("x" * 300)) == "x" * 300


def test_spaces_and_joiners_are_no_escapes():
    """Names of screenshots on macOS, Persian words, emoji of several parts."""
    assert printable("at 9.41.00\u202fAM\u00a0(1).png") == "at 9.41.00 AM (1).png"
    assert printable("a\u3000b") == "a b"
    for text in ("\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645", "\U0001f469\u200d\U0001f52c"):
        assert printable(text) == text
    # Lines end by these, and direction turns by those.
    assert printable("\u2028\u2029\u0085\u200e\u2066") == "\\u2028\\u2029\\x85\\u200e\\u2066"


def test_every_error_and_warning_is_printable():
    for kind in (InputError, OutputError, clmorph.ConvergenceWarning, ClmorphWarning):
        text = str(kind(f"{HOSTILE}{'y' * 10**6}: expected another"))
        assert text.isprintable()
        assert len(text) <= 1000
        assert text.endswith(": expected another")


def test_names_reach_the_terminal_without_commands(told, capfd, recwarn):
    Path("a.png").rename(HOSTILE)
    assert run(HOSTILE, "b.png", "-o", f"{HOSTILE}.html", "--lossless") == 0
    out, err = capfd.readouterr()
    assert err.count("note: ") == 1
    for line in [*out.splitlines(), *err.splitlines()]:
        assert line.isprintable()
    page = Path(f"{HOSTILE}.html").read_text()
    assert "\x1b" not in page
    assert "&#8238;" not in page
    title = page[page.index("<title>") : page.index("</title>")]
    assert title == "<title>a\\x1b]0;owned\\x07\\n\\u202e &#8594; b"
    assert run("--config", f"{HOSTILE}.html", "-o", "again.gif") == 0
    for parameters, words in (
        (recipe(["b.png", f"{HOSTILE}gone"]), "no such file"), (recipe(**{HOSTILE: 1}), "\\x1b"),
        (recipe(**{"k" * 900_000: 1}), "unknown option"),
        (recipe(splatting=HOSTILE * 1000), "splatting"),
        (recipe(blur=[[[[HOSTILE]]]] * 1000), "blur = ["),
    ):  # fmt: skip
        assert words in told("--config", foreign("json", parameters), "-o", "o.gif")


# Bombs.

ROOM = 48e6


def within_room(told, file, limit=ROOM):
    """Read a file as settings within little memory; return the line in which it is refused."""
    tracemalloc.start()
    try:
        line = told("a.png", "b.png", "--config", file, "-o", "o.gif")
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()
    assert not Path("o.gif").exists()
    assert "foreign" in line
    return line


JSONS = {
    "nested": '{"clmorph":' + "[" * 500_000,
    "deep enough to be parsed": '{"clmorph":"1","options":{"blur":' + "[" * 900 + "]" * 900 + "}}",
    "twice": '{"clmorph":"1","options":{},"options":{"blur":1}}',
    "NaN": '{"clmorph":"1","options":{"blur":NaN}}',
    "huge int": '{"clmorph":"1","options":{"frames":' + "9" * 5000 + "}}",
    "huge float": '{"clmorph":"1","options":{"blur":1e999}}',
    "keys": '{"clmorph":"1","options":{' + ",".join(f'"k{i}":1' for i in range(90_000)) + "}}",
    "long": '{"clmorph":"1","options":{"' + "k" * (2 * MAX_TEXT) + '":1}}',
    "gigabytes": None,
}


@pytest.mark.parametrize("name", JSONS)
def test_json(name, told):
    text = JSONS[name]
    with Path("foreign.json").open("wb") as file:
        file.write((text or '{"clmorph"').encode())
        if text is None:
            file.truncate(1 << 32)  # zeros that take no room
    within_room(told, "foreign.json")


@pytest.mark.parametrize("text", [
    "blur = " + "[" * 200_000, "a." * 2000 + "b = 1", f"{'k' * 10**6} = 1", "x = 1\n" * 300_000,
    "splatting = 0x" + "f" * 20_000, "blur = " + "{a=" * 3000,
    'images = ["\\u0000"]\nblur = "\\u001b"',
])  # fmt: skip
def test_toml(text, told):
    Path("foreign.toml").write_text(text)
    within_room(told, "foreign.toml")


def test_a_page_of_gigabytes(told):
    with Path(foreign("html", recipe())).open("r+b") as file:
        file.truncate(1 << 33)
    assert read_parameters(Path("foreign.html"))["clmorph"] == "1"
    with Path("foreign.html").open("wb") as file:
        file.write(b"<!DOCTYPE html>")
        file.truncate(1 << 33)
    assert "holds no parameters of clmorph" in within_room(told, "foreign.html")
    within_room(told, foreign("html", recipe(**{"k" * (2 * MAX_TEXT): 1})))


def test_png_texts(told):
    head = png(np.zeros((1, 1)), 0)[:33]
    bomb = zlib.compress(b" " * (160 << 20), 1)
    for body in (
        png_chunk(b"zTXt", b"clmorph\0\0" + bomb),
        png_chunk(b"iTXt", b"clmorph\0\1\0\0\0" + bomb),
        png_chunk(b"zTXt", b"clmorph\0\0" + zlib.compress(b" " * 10**6, 9)) * 200,
        struct.pack(">I", 1 << 30) + b"tEXtclmorph\0",
    ):
        with Path("foreign.png").open("wb") as file:
            file.write(head + body)
            if body.startswith(b"\x40"):
                file.truncate(1 << 31)
        within_room(told, "foreign.png", 120e6)


def test_a_gif_of_comments(told):
    """Pillow joins them one by one; a hundred megabytes would take it hours."""
    block = b"\xff" + b" " * 255
    with Path("foreign.gif").open("wb") as file:
        file.write(b"GIF89a" + struct.pack("<HHBBB", 1, 1, 0, 0, 0) + b"!\xfe")
        for _ in range(40):
            file.write(block * 10_000)
        file.write(b"\0;")
    within_room(told, "foreign.gif")


def test_a_webp_of_pieces(told):
    for pieces in (
        b"EXIF\xff\xff\xff\x7f", b"ABCD\xff\xff\xff\xff", b"EXIF\x08\0\0\0nonsense", b"",
    ):  # fmt: skip
        Path("foreign.webp").write_bytes(b"RIFF\0\0\0\0WEBP" + pieces)
        within_room(told, "foreign.webp")


def test_a_movie_opens_nothing_else(told):
    pytest.importorskip("av")
    Path("foreign.mp4").write_bytes(b"\0\0\0\x10ftypmp42\n#EXTM3U\n#EXTINF:1\n/etc/passwd\n")
    within_room(told, "foreign.mp4")
    within_room(told, foreign("webm", {"clmorph": "k" * (2 * MAX_TEXT)}))


def test_pipes_and_devices_are_not_waited_for(told):
    if not hasattr(os, "mkfifo"):
        pytest.skip("no pipes here")
    os.mkfifo("foreign.gif")
    assert "not a file" in within_room(told, "foreign.gif")
    Path("foreign").symlink_to("/dev/zero")
    assert "not a file" in within_room(told, "foreign")


def npy(shape="(2,)", descr="'<f4'", data=b"", version=(1, 0)):
    """Return an array as a file holds it, with a given header."""
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    length = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + length + text + data


def with_changed(source, name, content, method=zipfile.ZIP_DEFLATED):
    """Write an archive as another is, with one array changed."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile("foreign.npz", "w") as new:
        for entry in old.namelist():
            if entry != f"{name}.npy":
                new.writestr(entry, old.read(entry))
        if content is not None:
            new.writestr(f"{name}.npy", content, method)


@pytest.fixture
def saved(morph):
    morph.save("whole.npz")
    return "whole.npz"


def as_bytes(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


HEADS = {
    "unclosed": npy(shape="(2,"),
    "not Python": npy(shape="(2 2)"),
    "tokens": npy(shape='"""'),
    "negative": npy(shape="(-1,)"),
    "huge": npy(shape="(99999999999999999999,)"),
    "more than there is": npy(shape="(99999,)"),
    "less than there is": npy(data=b"\0" * 99),
    "nested record": npy(descr="[('a', [('b', '<f4')])]", shape="(1,)", data=b"\0" * 4),
    "deep": npy(descr="[('a', " * 90 + "'<f4'" + ")]" * 90),
    "minus": npy(shape="(" + "-" * 9000 + "1,)"),
    "objects": npy(descr="'|O'", data=b"cos\nsystem\n"),
    "texts": npy(descr="'<U9'", data=b"\0" * 72),
    "no dtype": npy(descr="'what'"),
    "subarray": npy(descr="('<f4', (2,))", shape="()", data=b"\0" * 8),
    "version 2": npy(version=(2, 0), data=b"\0" * 8),
    "version 9": npy(version=(9, 0)),
    "empty": b"",
    "missing": None,
}


@pytest.mark.in_turns
@pytest.mark.parametrize("name", HEADS)
@pytest.mark.parametrize("array", ["frames", "times", "parameters", "plan_0_indptr"])
def test_heads_of_arrays(saved, array, name):
    with_changed(saved, array, HEADS[name])
    with pytest.raises(InputError, match=r"foreign\.npz") as caught:
        clmorph.load("foreign.npz")
    assert len(str(caught.value)) < 500
    if array == "parameters":
        with pytest.raises(InputError, match=r"foreign\.npz"):
            read_parameters(Path("foreign.npz"))


@pytest.mark.parametrize(
    "change",
    [
        {"plan_0_indices": np.array([7000], np.int32)},
        {"plan_0_shape": np.array([3, 3])},
        {"plan_0_shape": np.array([3])},
        {"times": np.zeros(7)},
        {"frames": np.zeros((3, 5, 6, 2), np.float32)},
        {"parameters": np.array("[1]")},
        {"parameters": np.array("[" * 100_000)},
        {"parameters": np.array('{"a":1,"a":2}')},
    ],
)
def test_what_does_not_fit_together(saved, change):
    ((name, array),) = change.items()
    with_changed(saved, name, as_bytes(array))
    with pytest.raises(InputError, match=r"foreign\.npz"):
        clmorph.load("foreign.npz")


@pytest.mark.skipif(sys.platform == "win32", reason="tracemalloc is slow there")
def test_a_small_archive_that_unpacks_to_gigabytes(saved):
    zeros = npy(shape="(3, 10000, 12000, 3)")
    with zipfile.ZipFile("foreign.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        with file.open("frames.npy", "w", force_zip64=True) as stream:
            stream.write(zeros)
            for _ in range(5):
                stream.write(bytes(1 << 20))
        entry = file.getinfo("frames.npy")
        entry.file_size = len(zeros) + 3 * 10000 * 12000 * 3 * 4  # so the directory tells
    tracemalloc.start()
    with pytest.raises(InputError, match=r"take 4\.32 GB, expected at most 2\.15 GB.*max_bytes="):
        clmorph.load("foreign.npz")
    assert tracemalloc.get_traced_memory()[1] < ROOM
    with pytest.raises(InputError, match=r"foreign\.npz"):
        read_parameters(Path("foreign.npz"))
    tracemalloc.stop()
    assert len(clmorph.load(saved).frames) == 3
    size = sum(entry.file_size for entry in zipfile.ZipFile(saved).infolist())
    assert len(clmorph.load(saved, max_bytes=size).frames) == 3
    with pytest.raises(InputError, match=f"max_bytes={size}"):
        clmorph.load(saved, max_bytes=size - 1)
    with pytest.raises(InputError, match="max_bytes"):
        clmorph.load(saved, max_bytes=0)


def test_texts_and_directories_of_archives(saved):
    with_changed(saved, "parameters", npy(descr="'<U99999999'", shape="()", data=b"\0" * 64))
    for read in (clmorph.load, lambda path: read_parameters(Path(path))):
        with pytest.raises(InputError, match=r"foreign\.npz"):
            read("foreign.npz")
    with_changed(saved, "times", as_bytes(np.zeros(3)), zipfile.ZIP_LZMA)
    with pytest.raises(InputError, match="packed"):
        clmorph.load("foreign.npz")
    with zipfile.ZipFile("foreign.npz", "w") as file:
        file.writestr("times.npy", b"")
        with pytest.warns(UserWarning, match="Duplicate"):
            file.writestr("times.npy", b"")
    with pytest.raises(InputError, match="one name"):
        clmorph.load("foreign.npz")


def test_what_we_write_we_can_read(morph):
    """The same limit holds in both directions."""
    long = {"clmorph": "1", "k": "v" * (MAX_TEXT - 30)}
    assert from_text(as_text(long)) == long
    for name in ("o.gif", "o.png", "o.webp", "o.npz", "o.html", "o.tif"):
        morph.save(name, parameters=long)
        assert read_parameters(Path(name)) == long
    with pytest.raises(InputError, match="too many"):
        morph.save("long.gif", parameters={"k": "v" * MAX_TEXT})
    deep: list = []
    for _ in range(10_000):
        deep = [deep]
    with pytest.raises(InputError, match="what JSON takes"):
        morph.save("long.gif", parameters={"k": deep})
    assert not Path("long.gif").exists()


def test_a_picture_that_says_it_is_vast_is_told_in_one_line(capfd):
    """Pillow's limit of sizes raises errors of a separate class."""
    frame = b"," + struct.pack("<HHHHB", 0, 0, 65535, 65535, 0) + b"\2\2D\1\0"
    head = b"GIF89a" + struct.pack("<HHBBB", 1, 1, 0x80, 0, 0) + bytes(6)
    Path("vast.gif").write_bytes(head + frame + b";")
    assert main(["morph", "--config", "vast.gif", "-o", "x.gif"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert "vast.gif: cannot be read" in line
