"""Pictures through pipes: ``-`` for standard input and standard output, with real programs."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from films import frames_of
from marks import full
from PIL import Image
from programs import COMMAND, program

import clmorph
from clmorph.cli.main import main
from clmorph.output.save import FORMATS

QUICK = ["--frames", "3", "--backend", "numpy", "--size", "8", "--blur", "0.2"]
MORPH = ["morph", "a.png", "b.jpg", *QUICK]
FILES = [name for name, kind in FORMATS.items() if not kind.folder]

pytestmark = pytest.mark.skipif(os.name == "nt", reason="shells of POSIX")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, rng):
    """Two small pictures in the current folder, and a temporary folder of the test's own."""
    (tmp_path / "work").mkdir()
    (tmp_path / "temporary").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    for name, shape in (("a.png", (12, 20, 3)), ("b.jpg", (15, 9, 3))):
        Image.fromarray(rng.integers(0, 255, shape, np.uint8)).save(name)
    yield tmp_path
    assert list((tmp_path / "temporary").iterdir()) == []


def run(*command, given=b"", code=0):
    """Run a program with pipes as its streams; it must end with a code."""
    done = subprocess.run(command, input=given, capture_output=True, check=False)
    assert done.returncode == code, done.stderr
    return done


def command(*arguments, **options):
    return run(COMMAND, *arguments, **options)


def shell(line, **options):
    """Run a line of a shell; `clmorph` is the command."""
    return run("bash", "-o", "pipefail", "-c", line.replace("clmorph", f"'{COMMAND}'"), **options)


#: Formats that are piped by default, too; their writers differ most.
PIPED = ["gif", "mp4"]


@pytest.mark.parametrize("name", PIPED + full(*(name for name in FILES if name not in PIPED)))
def test_the_bytes_of_a_file(name):
    """What a pipe gets is what a file of this format holds."""
    if name in ("mp4", "webm"):
        pytest.importorskip("av")
    done = command(*MORPH, "-o", "-", "--format", name)
    assert b"/dev/stdout: 3 frames" in done.stderr
    assert main([*MORPH, "-o", "file", "--format", name]) == 0
    assert done.stdout == Path("file").read_bytes()


@pytest.mark.full
def test_a_closed_standard_output_takes_no_film():
    done = shell(f"clmorph {' '.join(MORPH)} -o - --format gif >&-", code=2)
    assert b"standard output is closed" in done.stderr.splitlines()[-1]


@pytest.mark.full
def test_programs_read_films():
    pytest.importorskip("av")
    ffprobe = program("ffprobe")
    probe = f"{ffprobe} -v error -count_frames -show_entries stream=codec_name,nb_read_frames"
    for name, codec in (("mp4", "h264"), ("webm", "vp9")):
        for place in ("-", "/dev/stdout"):
            line = f"clmorph {' '.join(MORPH)} -o {place} --format {name} | {probe} -of json -"
            (stream,) = json.loads(shell(line).stdout)["streams"]
            assert stream["codec_name"] == codec
            assert int(stream["nb_read_frames"]) >= 3


@pytest.mark.full
def test_every_command_pipes():
    pictures = "a.png b.jpg --backend numpy"
    for line, kind in (
        (f"rearrange {pictures} --size 8 --frames 3 -o - --format webp", "WEBP"),
        (f"mix {pictures} --size 8 --grid 3 -o - --format sheet", "PNG"),
        (f"recolor {pictures} -o - --format tif", "TIFF"),
        (f"recolor {pictures} -o - --format jpg", "JPEG"),
    ):
        with Image.open(io.BytesIO(command(*line.split()).stdout)) as picture:
            assert picture.format == kind
            picture.load()
    shell(
        "clmorph recolor a.png b.jpg --backend numpy -o - --format png"
        f" | clmorph morph - b.jpg -o - --format gif {' '.join(QUICK)} | clmorph inspect"
        " - b.jpg --backend numpy --size 8"
    )


@pytest.mark.parametrize("name", ["-", *full("/dev/stdin")])
def test_standard_input_is_read_like_a_file(name):
    assert main([*MORPH, "-o", "file.npz"]) == 0
    data = Path("a.png").read_bytes()
    command("morph", name, "b.jpg", *QUICK, "-o", "x.npz", given=data)
    both = clmorph.load("x.npz").frames, clmorph.load("file.npz").frames
    assert all(map(np.array_equal, *both))


@pytest.mark.full
def test_files_of_a_shell_and_masks_are_read_like_a_file():
    with Path("a.png").open("rb") as file:  # of a file, too, in place of a pipe
        done = subprocess.run([COMMAND, "morph", "-", "b.jpg", *QUICK, "-o", "x.gif"], stdin=file)
    assert done.returncode == 0
    shell(f"clmorph morph <(cat a.png) <(cat b.jpg) {' '.join(QUICK)} -o y.gif")
    Image.new("L", (20, 12), 255).save("mask.png")
    mask = Path("mask.png").read_bytes()
    arguments = ["recolor", "a.png", "b.jpg", "--backend", "numpy", "--mask"]
    command(*arguments, "-", "-o", "m.png", given=mask)
    assert main([*arguments, "mask.png", "-o", "n.png"]) == 0
    assert np.array_equal(clmorph.read_image("m.png"), clmorph.read_image("n.png"))


def test_settings_from_standard_input():
    assert main([*MORPH, "-o", "x.gif"]) == 0
    given = Path("x.gif").read_bytes()
    command("morph", "--config", "-", "-o", "y.gif", "--backend", "numpy", given=given)
    assert Path("x.gif").read_bytes() == Path("y.gif").read_bytes()


@pytest.mark.full
def test_a_file_beside_it():
    """The format is that of standard output; a file that is named has its ending's."""
    done = command(*MORPH, "-o", "-", "-o", "x.webp", "--format", "gif", "--json")
    assert done.stdout.startswith(b"GIF89a")
    assert Path("x.webp").read_bytes()[8:12] == b"WEBP"
    told = json.loads(done.stderr.splitlines()[-1])
    assert [each["path"] for each in told["outputs"]] == ["/dev/stdout", "x.webp"]


@pytest.mark.parametrize("place", ["-", *full("/dev/stdout", "/dev/fd/1")])
def test_into_a_file_of_the_shell(place):
    """The file that the shell has opened is filled, and not replaced behind its back."""
    shell(f"( echo begin; clmorph {' '.join(MORPH)} -o {place} --format gif; echo end ) > all")
    data = Path("all").read_bytes()
    assert data.startswith(b"begin\nGIF89a")
    assert data.endswith(b";end\n")


def test_a_reader_that_stops():
    """`head` has what it wants, nobody complains, and a file beside it is written."""
    big = [*MORPH, "--canvas", "900x900"]
    done = shell(
        f"set +o pipefail; clmorph {' '.join(big)} -o - -o x.gif --format apng | head -c 8;"
        ' echo "${PIPESTATUS[0]}" >&2'
    )
    assert done.stdout == b"\x89PNG\r\n\x1a\n"
    assert done.stderr.splitlines()[-1] == b"0"
    assert b"error" not in done.stderr.lower()
    assert b"Traceback" not in done.stderr
    assert len(frames_of("x.gif")) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_leaves_no_file():
    done = shell(f"clmorph {' '.join(MORPH)} -o - -o x.gif --format webp > /dev/full", code=2)
    assert b"standard output cannot be written (No space left on device)" in done.stderr
    assert b"Traceback" not in done.stderr
    assert b"Exception" not in done.stderr
    assert not Path("x.gif").exists()


@pytest.mark.full
def test_ctrl_c_while_nobody_reads():
    """The pipe is full; the last line says that a part was written."""
    big = [*MORPH, "--canvas", "900x900", "-o", "-", "-o", "x.gif", "--format", "tiff"]
    with subprocess.Popen(
        [COMMAND, *big], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout.read(4) == b"II*\0"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        told = process.stderr.read().splitlines()
    assert told[-1] == b"clmorph: interrupted, a part was written to standard output"
    assert not Path("x.gif").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("morph a.png b.jpg -o -", "expected --format"),
        ("recolor a.png b.jpg -o -", "expected --format"),
        ("morph a.png b.jpg -o - --format png-folder", "is a folder, which standard output"),
        ("morph a.png b.jpg -o - --format gif --recipe", "--recipe writes a file beside"),
        ("morph a.png b.jpg -o - -o /dev/stdout --format gif", "two outputs have one name"),
        ("morph a.png b.jpg -o x.gif -o y.gif --format gif", "--format is for one output"),
        ("recolor a.png b.jpg -o x.png --export-lut -", "expected .cube"),
        ("mix a.png b.jpg -o - --format gif", "mixes side by side are one picture"),
        ("check --report /dev/stdout", "--report needs the name"),
    ],
)
def test_mistakes(arguments, words, refused):
    before = sorted(Path().iterdir())
    assert words in refused(*arguments.split())
    assert sorted(Path().iterdir()) == before


def test_what_is_no_picture_or_empty_or_read_twice():
    for pictures, given, words in (
        ("- b.jpg", b"", b"- is empty, or was read already"),
        ("- b.jpg", b"no picture", b"standard-input is not an image"),
        ("- -", Path("a.png").read_bytes(), b"was read already"),
    ):
        done = command("morph", *pictures.split(), "-o", "x.gif", given=given, code=2)
        assert words in done.stderr
    assert not Path("x.gif").exists()


def test_a_file_called_minus():
    assert main([*MORPH, "-o", "./-", "--format", "gif"]) == 0
    assert Path("./-").absolute().read_bytes().startswith(b"GIF89a")


def test_terminals():
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    try:
        for arguments, streams, words in (
            (["morph", "-", "b.jpg", "-o", "x.gif"], {"stdin": theirs}, b"- is a terminal"),
            ([*MORPH, "-o", "-", "--format", "gif"], {"stdout": theirs}, b"is a terminal"),
        ):
            done = subprocess.run(
                [COMMAND, *arguments], stderr=subprocess.PIPE, check=False, **streams
            )
            assert done.returncode == 2
            assert words in done.stderr
            assert done.stderr.count(b"\n") == 1
    finally:
        os.close(ours)
        os.close(theirs)


def test_from_python():
    code = (
        "import numpy as np, clmorph; one, other = np.zeros((2, 6, 6, 3)); one[:3] = 1;"
        "clmorph.morph(one, other, n_frames=3, backend='numpy').save('/dev/stdout', format='gif')"
    )
    assert len(frames_of(io.BytesIO(run(sys.executable, "-c", code).stdout))) == 3
