"""Clips that are recolored: frames, flicker, sound, tags, mistakes, and ends before the end."""

import base64
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from programs import ffmpeg
from skimage import data

import clmorph
from clmorph.cli.main import main
from clmorph.clips.reading import Clip
from clmorph.clips.writing import ClipWriter
from clmorph.errors import InputError
from clmorph.pipeline import clips as module

SINE = ["-f", "lavfi", "-i", "sine=d=2"]
TAGS = ["-vf", "scale=out_color_matrix=bt709", "-colorspace", "bt709", "-color_trc", "bt709"]
TAGS += ["-color_primaries", "bt709", "-pix_fmt", "yuv420p"]
QUICK = ["-c:v", "libx264", "-preset", "ultrafast"]


def zoom(count=20):
    """A slow zoom into a noisy photograph, a fifth of which is dark: (n, 96, 160, 3) uint8."""
    photograph, rng = Image.fromarray(data.chelsea()), np.random.default_rng(0)
    frames = []
    for k in range(count):
        width = 400 - 3 * k
        height = width * 96 / 160
        corner = (photograph.width - width) / 2, (photograph.height - height) / 2
        box = (*corner, corner[0] + width, corner[1] + height)
        frame = np.asarray(photograph.resize((160, 96), Image.Resampling.LANCZOS, box=box), float)
        frame[:, :32] *= 0.02
        frames.append(np.clip(frame + rng.normal(0, 2.0, frame.shape), 0, 255))
    return np.rint(frames).astype(np.uint8)


def made(path, frames, *more):
    """Write frames as a clip, without loss for .mkv."""
    size = f"{frames.shape[2]}x{frames.shape[1]}"
    coder = ["-c:v", "ffv1"] if path.suffix == ".mkv" else ["-c:v", "libx264", "-crf", "8"]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", "10", "-i", "-"]
    ffmpeg(*raw, *more, *TAGS, *coder, path, input=frames.tobytes())
    return path


def pixels_of(path):
    with Clip(path) as clip:
        return np.stack([frame.pixels for frame in clip.frames()])


@pytest.fixture
def few_nodes(monkeypatch):
    """A table that is made quickly, where the colors do not matter."""
    monkeypatch.setattr(module, "NODES", 9)


@pytest.fixture
def palette(tmp_path):
    Image.fromarray(data.coffee()[::8, ::8]).save(tmp_path / "palette.png")
    return tmp_path / "palette.png"


@pytest.mark.full
def test_frames_are_recolored_as_a_picture_of_all_of_them(device, tmp_path):
    clip, like = made(tmp_path / "in.mp4", zoom(16)), data.coffee()[::8, ::8]
    clmorph.recolor_clip(clip, like, tmp_path / "out.mp4", backend=device)
    before, after = pixels_of(clip), pixels_of(tmp_path / "out.mp4")
    all_frames = before.reshape(1, -1, 3)
    want = clmorph.recolor(all_frames, like, backend=device).reshape(before.shape)
    # What H.264 loses, of the frames and of their colors.
    assert np.abs(after - 255 * want).mean() < 4
    assert np.abs(after.astype(int) - before).mean() > 20


def test_a_clip_does_not_flicker(tmp_path):
    clip = made(tmp_path / "in.mp4", zoom())
    clmorph.recolor_clip(clip, data.coffee()[::8, ::8], tmp_path / "out.mp4", backend="numpy")
    before, after = (pixels_of(path).astype(float) for path in (clip, tmp_path / "out.mp4"))

    def change(frames, axis):
        return np.abs(np.diff(frames, axis=axis)).mean()

    # The map's own gain in contrast is that of neighbors in a frame.
    gain = change(after, 2) / change(before, 2)
    assert gain > 1.1
    assert change(after, 0) <= 1.1 * gain * change(before, 0)
    dark = before[1:].max(axis=3) < 12
    change_of_dark = [np.abs(np.diff(each, axis=0))[dark].mean() for each in (after, before)]
    assert change_of_dark[0] <= 1.1 * change_of_dark[1]


def test_frames_of_a_still_clip_are_equal_to_the_bit(tmp_path, monkeypatch):
    still = np.repeat(zoom(1), 12, axis=0)
    clip, written = made(tmp_path / "in.mkv", still), []
    write = ClipWriter.write

    def seen(self, pixels, times):
        written.append(pixels.copy())
        write(self, pixels, times)

    monkeypatch.setattr(ClipWriter, "write", seen)
    clmorph.recolor_clip(clip, data.coffee()[::8, ::8], tmp_path / "out.mp4", backend="numpy")
    assert len(written) == 12
    np.testing.assert_array_equal(written, [written[0]] * 12)


def test_sound_times_and_tags_are_kept(tmp_path, few_nodes):
    clip = made(tmp_path / "in.mp4", zoom(), *SINE)
    out = tmp_path / "out.mp4"
    clmorph.recolor_clip(clip, np.full((4, 4, 3), 0.6), out, backend="numpy", reference_frame=3)
    entries = "stream=codec_name,width,height,nb_frames,color_space,color_transfer,color_primaries"
    probe = ["ffprobe", "-v", "error", "-show_entries", f"{entries}:frame=pts_time", "-of", "csv"]
    told = [
        subprocess.run([*probe, str(path)], capture_output=True, check=True).stdout
        for path in (clip, out)
    ]
    assert told[0] == told[1]
    assert b"bt709" in told[0]


def test_a_reference_frame_decides(tmp_path, few_nodes):
    frames = np.concatenate((np.full((5, 48, 64, 3), 60), np.full((5, 48, 64, 3), 200)))
    clip = made(tmp_path / "in.mkv", frames.astype(np.uint8))
    found = []
    for number in (0, 9):
        like, out = np.full((4, 4, 3), 0.5), tmp_path / f"{number}.mp4"
        clmorph.recolor_clip(
            clip, like, out, reference_frame=number, reach=None, blur=0.05, color_space="srgb",
            backend="numpy",
        )  # fmt: skip
        found.append(pixels_of(out).mean(axis=(1, 2, 3)))
    assert abs(found[0][0] - 127) < 4
    assert abs(found[1][-1] - 127) < 4
    assert abs(found[0][-1] - 127) > 20
    with pytest.raises(InputError, match=r"reference_frame=10: .* fewer frames"):
        clmorph.recolor_clip(clip, np.ones((2, 2, 3)), out, reference_frame=10, backend="numpy")


def test_a_table_recolors_a_clip(tmp_path, palette, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made(tmp_path / "in.mp4", zoom(6))
    levels = np.linspace(1, 0, 17)
    table = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    clmorph.write_lut("negative.cube", clmorph.Lut(table))
    assert main(["recolor", "in.mp4", "--lut", "negative.cube", "-o", "a.mp4"]) == 0
    want = 255 - pixels_of("in.mp4").astype(int)
    assert np.abs(pixels_of("a.mp4") - want).mean() < 3
    both = ["--lut", "negative.cube", "--strength", "0", "-o", "b.mp4"]
    assert main(["recolor", "in.mp4", *both, "--backend", "numpy"]) == 0
    assert np.abs(pixels_of("b.mp4") - (255 - want)).mean() < 3


@pytest.mark.full
def test_the_command_is_repeated_from_its_file(tmp_path, palette, monkeypatch, capsys, few_nodes):
    monkeypatch.chdir(tmp_path)
    made(tmp_path / "in.mp4", zoom(8), *SINE)
    plain = ["--backend", "numpy"]
    given = ["in.mp4", "palette.png", "--strength", "0.5", *plain, "--json"]
    assert main(["recolor", *given, "-o", "out.mp4", "--recipe"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["size"], summary["frames"]) == ([160, 96], 8)
    for file in ("out.mp4", "out.mp4.json"):
        assert main(["recolor", "--config", file, "-o", "again.mp4", *plain]) == 0
        assert Path("again.mp4").read_bytes() == Path("out.mp4").read_bytes()
    assert "8 frames of 160 x 96 pixels" in capsys.readouterr().out


@pytest.mark.full
def test_mistakes_leave_an_old_output(tmp_path, palette, monkeypatch, refused, few_nodes):
    monkeypatch.chdir(tmp_path)
    clip = made(tmp_path / "in.mp4", zoom(), *SINE, "-movflags", "+faststart")
    Path("broken.mp4").write_bytes(clip.read_bytes()[: clip.stat().st_size * 6 // 10])
    ffmpeg(*SINE, "sound.mp4")
    ffmpeg("-i", clip, "-an", "-color_trc", "smpte2084", "-pix_fmt", "yuv420p10le", "hdr.mp4")
    Path("out.mp4").write_bytes(b"old")
    Path("nan.cube").write_text("LUT_3D_SIZE 2\n" + "nan 0 0\n" * 8)
    before = {path.name for path in tmp_path.iterdir()}
    for given, words in (
        (["broken.mp4", "palette.png"], "damaged after"),
        (["sound.mp4", "palette.png"], "sound without a picture"),
        (["hdr.mp4", "palette.png"], "high dynamic range"),
        (["none.mp4", "palette.png"], "none.mp4"),
        (["palette.png", "palette.png"], "palette.png: this is not a readable clip"),
        (["in.mp4", "in.mp4"], "not an image"),
        (["in.mp4"], "expected two"),
        (["in.mp4", "palette.png", "--lut", "nan.cube"], "expected one"),
        (["in.mp4", "--lut", "nan.cube"], "NaN"),
        (["in.mp4", "--lut", "nan.cube", "--blur", "0.2"], "contradict"),
        (["in.mp4", "palette.png", "--mask", "palette.png"], "--mask is for pictures"),
        (["in.mp4", "palette.png", "--reference-frame", "20"], "--reference-frame 20"),
        (["in.mp4", "palette.png", "--max-pixels", "1000"], "expected at most 1000"),
        (["in.mp4", "palette.png", "-o", "new.png"], "expected .mp4 or .webm for a clip"),
        (["in.mp4", "palette.png", "-o", "new.webm"], "aac cannot be copied"),
    ):
        assert words in refused("recolor", *given, "-o", "out.mp4", "--backend", "numpy")
        assert Path("out.mp4").read_bytes() == b"old"
        assert {path.name for path in tmp_path.iterdir()} == before
    for given, words in (
        (["in.mp4", "palette.png", "-o", "in.mp4"], "would overwrite an input"),
        (["palette.png"] * 2 + ["-o", "x.png", "--reference-frame", "1"], "belongs to a clip"),
    ):
        assert words in refused("recolor", *given)


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_run_that_is_ended_leaves_an_old_output(tmp_path, name):
    number = getattr(signal, name)
    ffmpeg("-f", "lavfi", "-i", "testsrc2=s=320x180:r=25:d=20", *TAGS, *QUICK, tmp_path / "in.mp4")
    clmorph.write_lut(tmp_path / "gray.cube", clmorph.Lut(np.full((2, 2, 2, 3), 0.5)))
    (tmp_path / "out.mp4").write_bytes(b"old")
    command = [sys.executable, "-m", "clmorph", "recolor", "in.mp4", "--lut", "gray.cube"]
    run = subprocess.Popen(
        [*command, "-o", "out.mp4", "--backend", "numpy"], cwd=tmp_path, stderr=subprocess.PIPE
    )
    until = time.monotonic() + 300
    while not list(tmp_path.glob(".clmorph-*/new.mp4")) and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(run.pid, number)
    error = run.communicate(timeout=300)[1]
    assert run.returncode == (-number if name == "SIGKILL" else 128 + number)
    assert (tmp_path / "out.mp4").read_bytes() == b"old"
    if name != "SIGKILL":
        assert b"nothing was written" in error
        assert not list(tmp_path.glob(".clmorph-*"))


@pytest.mark.parametrize("name", ["out.mp4", pytest.param("out.webm", marks=pytest.mark.full)])
def test_a_browser_plays_it(browser, tmp_path, name):
    """It shows the colors of a frame in the middle, and the sound is there."""
    clip = made(tmp_path / "in.mkv", zoom(), *SINE, "-c:a", "libopus")
    if name == "out.mp4":
        ffmpeg("-i", clip, "-c:v", "libx264", "-crf", "8", "-c:a", "aac", tmp_path / "in.mp4")
        clip = tmp_path / "in.mp4"
    ramp = np.stack(np.meshgrid(*3 * [[0.2, 0.7]], indexing="ij"), axis=-1)
    clmorph.recolor_clip(clip, clmorph.Lut(ramp), tmp_path / name, backend="numpy")
    wanted = pixels_of(tmp_path / name)[10].mean(axis=(0, 1))
    page = browser.new_page()
    text = base64.b64encode((tmp_path / name).read_bytes()).decode()
    page.set_content(f'<video muted src="data:video/{name[4:]};base64,{text}"></video>')
    found = page.evaluate(
        """async () => {
        const video = document.querySelector("video");
        const once = (name) => new Promise((done, failed) => {
            video.addEventListener(name, done, { once: true });
            video.addEventListener("error", () => failed(video.error.message)); });
        if (video.readyState < 2) await once("loadeddata");
        const sought = once("seeked");
        video.currentTime = 1.05;
        await sought;
        await video.play();
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
        const context = canvas.getContext("2d");
        context.drawImage(video, 0, 0);
        const levels = context.getImageData(0, 0, canvas.width, canvas.height).data;
        const sums = [0, 0, 0, 0];
        levels.forEach((level, place) => { sums[place % 4] += level; });
        return [video.duration, canvas.width, canvas.height,
                ...sums.slice(0, 3).map((sum) => sum / levels.length * 4)];
        }"""
    )
    page.close()
    assert found[0] == pytest.approx(2.0, abs=0.1)
    assert found[1:3] == [160, 96]
    assert np.abs(np.array(found[3:]) - wanted).max() < 4


@pytest.mark.full
def test_memory_does_not_grow_with_the_length(tmp_path):
    clmorph.write_lut(tmp_path / "gray.cube", clmorph.Lut(np.full((2, 2, 2, 3), 0.5)))
    code = (
        "import resource, sys, clmorph\n"
        "lut = clmorph.read_lut('gray.cube')\n"
        "clmorph.recolor_clip(sys.argv[1], lut, 'out.mp4', backend='numpy')\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    used = []
    for seconds in (4, 40):
        source = f"testsrc2=s=192x108:r=10:d={seconds}"
        ffmpeg("-f", "lavfi", "-i", source, *TAGS, *QUICK, tmp_path / "in.mp4")
        run = subprocess.run(
            [sys.executable, "-c", code, "in.mp4"], cwd=tmp_path, capture_output=True, check=True
        )
        used.append(int(run.stdout) / 1024)
    # A frame takes 0.24 MB as float32: 360 more of them would take 85 MB.
    assert used[1] - used[0] < 20
