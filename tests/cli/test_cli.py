"""The command line through its real entry point."""

import builtins
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from films import frames_of
from marks import full
from PIL import Image
from programs import COMMAND
from refusals import REMARKS

import clmorph
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.cli.main import main

QUICK = ["--frames", "2", "--backend", "numpy", "--size", "6", "--blur", "0.2"]


@pytest.fixture
def pictures(tmp_path, monkeypatch, rng):
    """Two small pictures in the current folder: a.png, 20 x 12, and b.jpg, 9 x 15."""
    monkeypatch.chdir(tmp_path)
    for name, shape in (("a.png", (12, 20, 3)), ("b.jpg", (15, 9, 3))):
        Image.fromarray(rng.integers(0, 255, shape, np.uint8)).save(name)
    return tmp_path


def run(*arguments, **options):
    options = {"capture_output": True, "text": True, "check": False} | options
    return subprocess.run([COMMAND, *map(str, arguments)], **options)


def test_a_gif(device, pictures):
    index = next(d.index for d in find_devices() if d.handle == device.device)
    done = run("morph", "a.png", "b.jpg", "-o", "out.gif", "--frames", 5, "--device", index)
    assert done.returncode == 0, done.stderr
    assert device.description in done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("out.gif: 5 frames, 1.55 s a round, made in ")
    assert "converged" in lines[0]
    assert len(frames_of("out.gif")) == 5
    assert sorted(path.name for path in pictures.iterdir()) == ["a.png", "b.jpg", "out.gif"]


@pytest.mark.full
def test_motion_and_color_options(pictures):
    """What no preset asks for, through to the file."""
    for number, options in enumerate(
        (
            "--color-space lab --path-space linear --mass luminance --splatting fixed",
            "--sigma optimal --endpoints paper --unmatched drop --extent unit",
            "--sample 3 --seed 4 --sigma-start auto --sigma-end 1.5 --splatting local",
            "--barycentric --splatting none",
        )
    ):
        name = f"{number}.gif"
        arguments = ["morph", "a.png", "b.jpg", "-o", name, "--frames", "3", "--size", "10"]
        assert main([*arguments, *options.split()]) == 0
        assert Path(name).exists()


def test_options_reach_the_morph(pictures, monkeypatch):
    seen = {}

    def spy(problem, *more):
        seen.update(problem.options.as_dict(), shapes=tuple(p.shape for p in problem.images))
        raise clmorph.InputError("seen")

    monkeypatch.setattr("clmorph.pipeline.morph.ImagePair.morph", spy)
    arguments = "morph a.png b.jpg -o x.gif --backend numpy --frames 7 --size 6 --blur 0.1"
    arguments += " --reach balanced --color-weight 3 --sigma-start 2 --sigma-end 1 --gamma 0.1"
    assert main(arguments.split()) == 2
    assert seen["n_frames"] == 7
    assert seen["shapes"] == ((4, 6, 3), (6, 4, 3))
    wanted = {
        "blur": 0.1, "reach": None, "color_weight": 3, "sigma_start": 2, "sigma_end": 1,
        "gamma": 0.1, "extent": "true", "unmatched": "fade", "splatting": "adaptive",
        "endpoints": "exact", "path_space": "oklab",
    }  # fmt: skip
    assert {name: seen[name] for name in wanted} == wanted


def test_unconverged_is_said(pictures, capfd):
    assert main(["morph", "a.png", "b.jpg", "-o", "x.gif", "--frames", "3", "--max-iter", "9"]) == 0
    assert "not converged after 9 iterations" in capfd.readouterr().out


def test_what_cannot_be_written_is_said_before_anything_is_solved(pictures, monkeypatch, refused):
    monkeypatch.setattr("clmorph.pipeline.morph.ImagePair.morph", None)
    Path("r.gif.json").mkdir()
    Image.new("RGBA", (5, 5)).save("void.png")
    Path("full").mkdir()
    Path("full/mine").touch()
    for arguments, words in (
        ("a.png b.jpg -o full", "full exists already"),
        ("a.png b.jpg -o x.webp -o x.gif --fps 60", "--fps 60 is too fast for x.gif"),
        ("a.png b.jpg -o r.gif --recipe", "r.gif.json is a folder"),
        ("a.png b.jpg void.png -o x.gif", "void.png: every pixel is transparent"),
        ("size=3.png b.jpg -o x.gif", "error: size=3.png: no such file"),
    ):
        assert words in refused("morph", *arguments.split())


@pytest.mark.full
def test_names_that_cannot_be_printed(pictures):
    done = subprocess.run(
        [COMMAND, "morph", "a.png", "b.jpg", "-o", b"o\xff.gif", "--frames", "3"],
        capture_output=True, check=False, env=os.environ | {"PYTHONIOENCODING": "utf-8:strict"},
    )  # fmt: skip
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert done.stdout.startswith("o\ufffd.gif: 3 frames".encode())


def test_ctrl_c_while_loading(monkeypatch, capfd):
    """Before the command line is there to catch it."""
    from clmorph.__main__ import main as command

    usual = builtins.__import__

    def interrupt(name, *arguments, **options):
        if name == "clmorph.cli.main":
            raise KeyboardInterrupt
        return usual(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", interrupt)
    assert command() == 130
    assert capfd.readouterr().err == "clmorph: interrupted, nothing was written\n"


def test_importing_is_light():
    """Names are there without what they stand for; a function wins over its module's name."""
    told = subprocess.run(
        [sys.executable, "-c", "import sys, clmorph; print('numpy' in sys.modules, dir(clmorph));"
         "import clmorph.pipeline.morph, clmorph.transport.sinkhorn;"
         "print(callable(clmorph.morph), callable(clmorph.sinkhorn), clmorph.__version__);"
         "import clmorph.cli.main; print([name for name in sys.modules if name[:6] == 'scipy.'])"],
        capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    assert told[0].startswith("False")
    for name in ("morph", "sinkhorn", "save", "load", "inspect", "reference"):
        assert repr(name) in told[0]
    assert told[1:] == [f"True True {clmorph.__version__}", "[]"]


def test_demo(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clmorph.cli.demo.PHOTO_SIDE", 24)
    monkeypatch.setattr("clmorph.cli.demo.SPRITE_ZOOM", 1)
    assert main(["demo"]) == 0
    out, err = capfd.readouterr()
    for words in ("options: the defaults of clmorph morph", "transport ", "frames ", "wrote "):
        assert words in out
    assert err.startswith("device: ")
    assert len(frames_of("clmorph-demo.gif")) == 30
    assert "<canvas" in Path("clmorph-demo.html").read_text()
    assert frames_of("clmorph-demo.png")[0].shape[1] > 1000


def test_version_and_help(capfd):
    lines = run("--version").stdout.splitlines()
    assert lines[0] == f"clmorph {clmorph.__version__}"
    assert "pyopencl" in lines[1]
    for device in find_devices():
        assert any(device.index in line and device.driver in line for line in lines[2:])
    assert main(["--help"]) == 0
    told = capfd.readouterr().out
    assert told.index("clmorph demo") < told.index("Options")
    assert "130: interrupted" in told
    assert main(["morph", "--help"]) == 0
    told = capfd.readouterr().out
    assert told.index("clmorph morph a.png b.jpg -o out.gif") < told.index("--color-weight")
    assert told.index("─ File") < told.index("─ Motion") < told.index("─ Transport")


def test_options_are_checked_before_devices_are_sought(pictures, refused, monkeypatch):
    monkeypatch.setattr("clmorph.cli.request.open_backend", None)
    told = refused("morph", "a.png", "b.jpg", "-o", "x.gif", "--frames", "0")
    assert told.startswith("clmorph: error: --frames 0: expected")


@pytest.mark.needs_device
def test_no_transport_at_all_fades(pictures, capfd):
    """A reach so small that every pair's mass underflows: the images cross-fade."""
    for backend in ("opencl", "numpy"):
        assert main(
            f"morph a.png b.jpg -o {backend} --frames 3 --size 9 --blur 0.001 --reach 0.0001 "
            f"--backend {backend}".split()
        ) == 0  # fmt: skip
        assert frames_of(f"{backend}/frame-0001.png")[0][..., :3].std() > 5
    assert "Warning" not in capfd.readouterr().err


def test_a_chain(pictures, capfd):
    arguments = ["a.png", "b.jpg", "a.png", "-o", "tour.apng", "--frames", "4", "--loop", "once"]
    assert main(["morph", *arguments, "--canvas", "40x40", "--hold", "0"]) == 0
    assert "tour.apng: 7 frames, 0.35 s a round" in capfd.readouterr().out
    frames = frames_of("tour.apng")
    assert len(frames) == 7
    assert np.array_equal(frames[0], frames[6])


def test_several_files_of_one_run(pictures, capfd):
    outputs = [word for name in ("x.gif", "x.npz", "x.html") for word in ("-o", name)]
    assert main(["morph", "a.png", "b.jpg", *outputs, "--frames", "3"]) == 0
    assert capfd.readouterr().out.startswith("x.gif, x.npz, x.html: 3 frames, ")
    assert len(clmorph.load("x.npz").frames) == 3


def test_a_summary_for_programs(pictures, capfd):
    options = ["-o", "x.gif", "--frames", "5", "--duration", "3", "--json"]
    assert main(["morph", "a.png", "b.jpg", *options]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["outputs"] == [{"path": "x.gif", "format": "gif"}]
    assert summary["frames"] == 5
    assert summary["duration"] == pytest.approx(3)
    assert summary["sizes"][0] == [20, 12]
    assert summary["solver"][0]["status"] == "converged"
    assert summary["options"]["duration"] == 3
    assert summary["seconds"]["total"] > summary["seconds"]["transport"] > 0


def test_progress_is_shown_to_people_only(pictures):
    """Each stage with its time left and the solver's residual, on a terminal; else nothing."""
    arguments = ["morph", "a.png", "b.jpg", "-o", "x.gif", "--frames", "4"]
    pty = pytest.importorskip("pty", reason="no terminals of POSIX", exc_type=ImportError)
    leader, follower = pty.openpty()
    with subprocess.Popen(
        [COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=follower,
        env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "120"},
    ) as process:  # fmt: skip
        os.close(follower)
        told = b""
        while True:
            try:
                part = os.read(leader, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            told += part
    os.close(leader)
    assert process.returncode == 0
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", told.decode())
    for words in ("transport", "frames", "write x.gif", "left", "100 %", "4 of 4"):
        assert words in shown
    assert re.search(r"residual \de-0\d of 1e-03", shown)
    quiet = run(*arguments)
    device, preset, memory = quiet.stderr.splitlines()
    assert preset.startswith("preset: ")
    assert device.startswith("device: ")
    assert re.fullmatch(r"memory: about [\d.]+ [MG]B", memory)


@pytest.mark.full
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell, capfd):
    assert main(["completion", shell]) == 0
    assert "_CLMORPH_COMPLETE" in capfd.readouterr().out
    if shell == "bash":
        told = {"_CLMORPH_COMPLETE": "bash_complete", "COMP_CWORD": "2"}
        done = run(env=os.environ | told | {"COMP_WORDS": "clmorph morph --pre"})
        assert "--preset" in done.stdout


def closed(redirections, *arguments):
    """Run the command from a shell that closes or redirects its streams."""
    command = " ".join(map(shlex.quote, [str(COMMAND), *map(str, arguments)]))
    return subprocess.run(
        ["/bin/sh", "-c", f"{command} {redirections}"],
        capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.full
def test_streams_that_are_closed(pictures):
    """What is printed is lost, and gets into no file; the file is made."""
    done = closed(">&- 2>&- <&-", "morph", "a.png", "b.jpg", "-o", "x.npz", *QUICK)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(clmorph.load("x.npz").frames) == 2
    for redirections in (">&-", "2>&-"):
        for command in (["--version"], ["morph", "--dump-config"]):
            done = closed(redirections, *command)
            assert done.returncode == 0
            assert "Traceback" not in done.stderr
    done = closed("2>&-", "morph", "missing.png", "b.jpg", "-o", "x.gif")
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.full
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_streams_that_are_full(pictures):
    """Lost results are an error; lost notes are none."""
    morph = ["morph", "a.png", "b.jpg", "-o", "x.png", *QUICK]
    for command in ([], ["devices", "--json"], ["--help"], ["completion", "bash"], morph):
        done = closed(">/dev/full", *command)
        assert done.returncode == 2
        (line,) = [line for line in done.stderr.splitlines() if not line.startswith(REMARKS)]
        assert line.startswith("clmorph: error: ")
        assert "No space left" in line
    arguments = ["morph", "a.png", "b.jpg", "-o", "x.gif", *QUICK]
    done = closed("2>/dev/full", *arguments)
    assert done.returncode == 0
    assert done.stdout.startswith("x.gif: 2 frames")
    assert closed(">/dev/full 2>&1", *arguments, "--size", 0).returncode == 2


def test_frames_into_the_folder_where_one_stands(pictures, monkeypatch, capfd):
    Path("here").mkdir()
    monkeypatch.chdir("here")
    where = Path().stat()
    assert main(["morph", "../a.png", "../b.jpg", "-o", ".", "--recipe", *QUICK]) == 0
    assert os.path.samestat(Path().stat(), where)
    assert [path.name for path in sorted(Path().iterdir())] == ["frame-0000.png", "frame-0001.png"]
    recipe = json.loads(Path("../here.json").read_text())
    assert [image["file"] for image in recipe["images"]] == ["a.png", "b.jpg"]
    assert main(["morph", "../a.png", "../b.jpg", "-o", "new/", *QUICK]) == 0
    assert len(list(Path("new").iterdir())) == 2


@pytest.mark.parametrize(
    ("output", "words"),
    [
        (".", ". exists already"),
        ("..", ".. exists already"),
        ("/", "/ exists already"),
        ("", "'' is an invalid file name"),
        ("a\0b", r"'a\x00b' is an invalid file name"),
        ("x.gif/", "leave out the '/' or the ending"),
    ],
)
def test_outputs_that_are_none(pictures, refused, output, words):
    before = sorted(pictures.rglob("*"))
    assert words in refused("morph", "a.png", "b.jpg", "-o", output, *QUICK)
    assert sorted(pictures.rglob("*")) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["morph", "", "b.jpg", "-o", "x.gif"],
        ["morph", "a.png", "b.jpg", "-o", "x.gif", "--config", ""],
        ["inspect", "a.png", ""],
        ["inspect", "a.png", "b.jpg", "-o", ""],
        ["check", "--report", ""],
    ],
)
def test_names_that_are_empty(pictures, refused, arguments):
    assert "'' is an invalid file name" in refused(*arguments)


def test_names_of_any_characters(pictures, capfd, refused):
    """Neither markup nor emoji nor line ends nor escapes: nothing but names."""
    odd = "[red]:cat:\n\x1b[2J é.png"
    Path("a.png").rename(odd)
    assert main(["morph", odd, odd, "-o", "[b]\n.gif", "--lossless", *QUICK]) == 0
    out, err = capfd.readouterr()
    assert out.startswith("[b]\\n.gif: 2 frames")
    assert "note: --lossless makes no difference to [b]\\n.gif\n" in err
    told = refused("morph", odd, "[/red]\n:cat:", "-o", "x.gif", *QUICK)
    assert told.startswith("clmorph: error: [/red]\\n:cat:: no such file; ")


@pytest.mark.parametrize("digits", [400, 5000])
def test_numbers_of_any_length(pictures, refused, digits):
    """Python reads whole numbers of at most 4300 digits, and floats end at 308."""
    number = "9" * digits
    for option in ("frames", "size", "blur", "reach", "sigma-start", "seed", "max-pixels", "fps",
                   "max-memory", "sample", "solve-size", "max-iter", "canvas"):  # fmt: skip
        line = "morph", "a.png", "b.jpg", "-o", "x.gif", "--backend", "numpy"
        assert len(refused(*line, f"--{option}", number)) < 400


@pytest.mark.full
@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_streams_that_lack_characters(pictures, encoding):
    """Help and tables are printed all the same; files of settings are always UTF-8."""
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    for arguments in (["morph", "--help"], ["devices"]):
        done = run(*arguments, text=False, env=environment)
        assert (done.returncode, done.stderr) == (0, b"")
        assert len(done.stdout) > 200
    done = run("morph", "ł.png", "b.jpg", "--dump-config", text=False, env=environment)
    assert done.returncode == 0
    assert '"ł.png"'.encode() in done.stdout


@pytest.mark.full
def test_nobody_reads_what_is_printed_at_once(pictures):
    """The same whether the pipe closes before or after."""
    made = ["a.png", "b.jpg", "-o", "x.gif", *QUICK]
    read, write = os.pipe()
    os.close(read)
    try:
        for arguments in (["--version"], ["completion", "zsh"], ["morph", *made]):
            done = run(*arguments, capture_output=False, stdout=write, stderr=subprocess.PIPE)
            assert done.returncode == 0
            assert all(line.startswith(REMARKS) for line in done.stderr.splitlines())
    finally:
        os.close(write)
    assert Path("x.gif").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no folder goes while somebody is in it")
@pytest.mark.needs_device
def test_a_folder_that_is_gone(pictures, monkeypatch, refused):
    Path("gone").mkdir()
    monkeypatch.chdir("gone")
    Path("../gone").rmdir()
    a, b = pictures / "a.png", pictures / "b.jpg"
    for arguments, words in (
        (["morph", str(a), str(b), "-o", "x.gif", *QUICK], "x.gif: this place does not exist"),
        (["morph", str(a), str(b), "-o", ".", *QUICK], "this place does not exist"),
        (["demo", "--backend", "numpy"], "the current folder is gone"),
        (["check", "--report", "x.json"], "x.json: this place does not exist"),
    ):
        assert words in refused(*arguments)
    assert main(["morph", str(a), str(b), "-o", str(pictures / "x.gif"), *QUICK]) == 0


def test_mistakes_of_inspect_are_those_of_morph(pictures, refused):
    Image.new("RGBA", (5, 5)).save("void.png")
    for arguments, words in (
        (["void.png", "b.jpg"], "void.png: every pixel is transparent"),
        (["a.png", "b.jpg", "--max-pixels", "0"], "--max-pixels 0: expected a whole number"),
        (["a.png", "b.jpg", "--max-pixels", "5"], "a.png has 20 x 12 pixels: expected at most 5"),
        (["a.png", "b.jpg", "--frames", "1"], "--frames 1: expected a whole number"),
        (["a.png"], "1 picture given: expected two, as in clmorph inspect"),
        (["a.png", "b.jpg", "a.png"], "3 pictures given: expected two"),
    ):
        assert words in refused("inspect", *arguments, "--backend", "numpy")


@pytest.mark.parametrize("command", ["morph", *full("rearrange", "mix", "inspect")])
def test_pictures_of_which_little_is_left_are_noted(tmp_path, monkeypatch, capfd, command):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (20, 2000, 3), np.uint8)).save("wide.png")
    Image.fromarray(rng.integers(0, 256, (20, 40, 3), np.uint8)).save("whole.png")
    name = "x.png" if command in ("mix", "inspect") else "x.gif"
    options = ["--backend", "numpy", "-o", name]
    options += ["--frames", "3"] if command in ("morph", "rearrange") else []
    assert main([command, "wide.png", "whole.png", "--size", "64", *options]) == 0
    told = [line for line in capfd.readouterr().err.splitlines() if "shorter side" in line]
    assert told == [
        "note: wide.png of 2000 x 20 pixels is reduced to 64 x 1 (--size), which leaves little of "
        "its shorter side; give a larger --size, or cut it"
    ]
    assert main([command, "whole.png", "whole.png", "--size", "32", *options]) == 0
    assert "shorter side" not in capfd.readouterr().err
