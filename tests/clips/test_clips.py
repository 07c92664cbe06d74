"""Clips are read and written: pixels, times, sound, turns, tags, and files that cannot be read."""

import shutil
import subprocess
from fractions import Fraction

import numpy as np
import pytest
from marks import full

from clmorph.clips.reading import Clip, Frame, Sound
from clmorph.clips.tags import KNOWN_PRIMARIES, ColorTags
from clmorph.clips.writing import CONTAINERS, ClipWriter, even
from clmorph.errors import FileError, OutputError

pytestmark = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")

PICTURE = ["-f", "lavfi", "-i", "testsrc2=s=96x64:r=10:d=2,gblur=sigma=3"]
SINE = ["-f", "lavfi", "-i", "sine=d=2"]


def ffmpeg(*arguments):
    """Run FFmpeg; return what it writes to standard output."""
    command = ["ffmpeg", "-v", "error", "-y", *map(str, arguments)]
    return subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout


def asked(path, entries, stream="v"):
    """What ffprobe says of a file: a list of lines."""
    command = ["ffprobe", "-v", "error", "-select_streams", stream, "-show_entries", entries]
    done = subprocess.run(
        [*command, "-of", "csv=p=0", str(path)], capture_output=True, text=True, check=True
    )
    return [line.strip(",") for line in done.stdout.split()]


def sound_of(path):
    return ffmpeg("-i", path, "-map", "0:a", "-c", "copy", "-f", "md5", "-")


def copied(source, target, container="mp4", change=lambda pixels: pixels):
    with Clip(source) as clip:
        size = tuple(side + side % 2 for side in clip.size)
        with ClipWriter(
            target, container, size, clip.rate, clip.time_base, clip.tags, clip.matrix,
            aspect=clip.aspect, deep=clip.deep, sounds=clip.sounds,
            changes=CONTAINERS[container].fast,
        ) as writer:  # fmt: skip
            for part in clip.parts():
                if isinstance(part, Sound):
                    writer.copy(part.packet)
                else:
                    writer.write(change(even(part.pixels)), [round(part.time / clip.time_base)])
            writer.finish()


def decoded(path, size):
    """Frames as the system's ffmpeg decodes them: (n, H, W, 3) array."""
    raw = "-f", "rawvideo", "-pix_fmt", "rgb24", "-"
    found = ffmpeg("-i", path, "-vsync", "passthrough", *raw)
    return np.frombuffer(found, np.uint8).reshape(-1, size[1], size[0], 3)


def test_frames_times_and_sound_are_copied(tmp_path):
    source, target = tmp_path / "in.mp4", tmp_path / "out.mp4"
    held = "setpts=PTS+floor(N/5)*0.1/TB"
    ffmpeg(*PICTURE, *SINE, "-vf", held, "-vsync", "vfr", "-pix_fmt", "yuv420p", source)
    copied(source, target)
    times = asked(source, "frame=pts_time")
    assert asked(target, "frame=pts_time") == times
    assert len(set(np.diff(np.array(times, float)).round(3))) == 2
    assert sound_of(source) == sound_of(target)
    with Clip(target) as clip:
        frames = list(clip.frames())
        assert (clip.size, clip.deep, len(frames)) == ((96, 64), False, 20)
        assert [str(float(frame.time)) for frame in frames] == [str(float(t)) for t in times]
    before, after = (decoded(path, (96, 64)).astype(int) for path in (source, target))
    assert np.abs(before - after).mean() < 4
    assert np.abs(np.stack([frame.pixels for frame in frames]) - after).mean() < 3


@pytest.mark.parametrize("turn", [90, *full(180, 270)])
def test_turned_clips_stand_upright(tmp_path, turn):
    plain, source, target = (tmp_path / name for name in ("a.mp4", "b.mp4", "c.mp4"))
    ffmpeg(*PICTURE, "-pix_fmt", "yuv420p", plain)
    ffmpeg("-i", plain, "-c", "copy", "-metadata:s:v", f"rotate={turn}", source)
    copied(source, target)
    size = (64, 96) if turn % 180 else (96, 64)
    assert asked(target, "stream=width,height") == [f"{size[0]},{size[1]}"]
    # ffmpeg turns frames that it decodes.
    want, got = decoded(source, size).astype(int), decoded(target, size)
    assert np.abs(want - got).mean() < 4
    assert np.abs(want[:, ::-1, ::-1] - got).mean() > 30


@pytest.mark.parametrize("tags", [(1, 1, 1, 1), (1, 2, 1, 13), (9, 1, 9, 14), (6, 1, 6, 6)])
@pytest.mark.parametrize("depth", ["yuv420p", "yuv420p10le"])
def test_tags_are_obeyed_and_kept(tmp_path, tags, depth):
    """A color is read as it was before the encoder, by the matrix and the range of its tags."""
    matrix, width = {1: "bt709", 9: "bt2020", 6: "bt601"}[tags[0]], ("tv", "pc")[tags[1] - 1]
    source, target = tmp_path / "in.mkv", tmp_path / "out.mp4"
    ffmpeg(
        "-f", "lavfi", "-i", "color=c=0x3070C0:s=64x48:r=5:d=1", "-vf",
        f"format=gbrp16le,scale=out_color_matrix={matrix}:out_range={width},format={depth}",
        "-c:v", "ffv1", "-colorspace", tags[0], "-color_range", tags[1], "-color_primaries",
        tags[2], "-color_trc", tags[3], source,
    )  # fmt: skip
    copied(source, target)
    for path in (source, target):
        with Clip(path) as clip:
            assert clip.tags == tags
            assert clip.deep == (depth == "yuv420p10le")
            pixels = next(clip.frames()).pixels / (65535 if clip.deep else 255)
        np.testing.assert_allclose(pixels.mean(axis=(0, 1)) * 255, [0x30, 0x70, 0xC0], atol=2)


@pytest.mark.parametrize("primaries", KNOWN_PRIMARIES)
@pytest.mark.parametrize("transfer", [1, 4, 5, 8, 13])
def test_ways_from_and_to_srgb_are_inverses(primaries, transfer):
    tags, colors = ColorTags(1, 1, primaries, transfer), np.random.default_rng(0).random((50, 3))
    inside = 0.3 + 0.4 * colors
    np.testing.assert_allclose(tags.to_srgb(tags.from_srgb(inside)), inside, atol=1e-9)
    for gray in (0.0, 1.0):
        np.testing.assert_allclose(tags.to_srgb(np.full(3, gray)), gray, atol=2e-4)


def test_a_gamut_is_that_of_the_published_matrix():
    """ITU-R BT.2087: linear BT.709 in BT.2020."""
    tags = ColorTags(9, 1, 9, 8)
    found = tags.from_srgb(np.eye(3)).T
    want = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
    np.testing.assert_allclose(found, want, atol=2e-4)


def test_one_frame_is_found_by_number_and_by_time(tmp_path):
    source = tmp_path / "in.mp4"
    ffmpeg(*PICTURE, "-pix_fmt", "yuv420p", source)
    with Clip(source) as clip:
        frames = list(clip.frames())
    for number in (0, 7, 19):
        with Clip(source) as clip:
            np.testing.assert_array_equal(clip.numbered(number).pixels, frames[number].pixels)
        with Clip(source) as clip:
            found = clip.at(number / 10 + 0.01)
            assert isinstance(found, Frame)
            # The frame of this time, or the next one.
            assert found.time in (Fraction(number, 10), Fraction(number + 1, 10))
    with Clip(source) as clip:
        assert clip.numbered(20) is None


def test_a_recording_that_begins_late_is_written_from_zero_with_its_sound(tmp_path):
    source, target = tmp_path / "in.ts", tmp_path / "out.mp4"
    ffmpeg(*PICTURE, *SINE, "-pix_fmt", "yuv420p", "-c:v", "libx264", "-c:a", "mp2", source)
    copied(source, target)
    starts = {
        (path, stream): float(asked(path, "stream=start_time", stream)[0])
        for path in (source, target) for stream in "va"
    }  # fmt: skip
    assert starts[source, "v"] > 1
    assert min(starts[target, "v"], starts[target, "a"]) < 0.05
    apart = [starts[path, "v"] - starts[path, "a"] for path in (source, target)]
    assert abs(apart[0] - apart[1]) < 0.01


@pytest.mark.parametrize("ending", ["mp4", "mkv", "webm"])
def test_a_clip_that_ends_early_is_refused(tmp_path, ending):
    whole, broken = tmp_path / f"whole.{ending}", tmp_path / f"broken.{ending}"
    more = ["-movflags", "+faststart"] if ending == "mp4" else []
    more += ["-c:v", "libvpx"] if ending == "webm" else []
    ffmpeg(*PICTURE, "-pix_fmt", "yuv420p", *more, whole)
    data = whole.read_bytes()
    broken.write_bytes(data[: int(0.6 * len(data))])
    with Clip(whole) as clip:
        assert len(list(clip.frames())) == 20
    with Clip(broken) as clip, pytest.raises(FileError, match=r"damaged after [01]\.\d s"):
        list(clip.frames())


def test_files_that_are_no_clips_are_refused(tmp_path):
    ffmpeg(*PICTURE, "-pix_fmt", "yuv420p10le", "-color_trc", "smpte2084", tmp_path / "pq.mp4")
    ffmpeg(*SINE, tmp_path / "sound.mp4")
    ffmpeg(*PICTURE, "-frames:v", "0", "-pix_fmt", "yuv420p", tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("text")
    (tmp_path / "l.m3u8").write_text("#EXTM3U\n#EXTINF:1,\nsound.mp4\n#EXT-X-ENDLIST\n")
    words = {
        "pq.mp4": "high dynamic range", "sound.mp4": "sound without a picture",
        "none.mp4": "no ", "text.mp4": "not a readable clip", "l.m3u8": "not a readable clip",
        "missing.mp4": "No such file",
    }  # fmt: skip
    for name, what in words.items():
        with pytest.raises(FileError, match=what):
            Clip(tmp_path / name)
    ffmpeg(*PICTURE, "-pix_fmt", "yuv420p", tmp_path / "plain.mp4")
    with pytest.raises(FileError, match="expected at most 5000"):
        Clip(tmp_path / "plain.mp4", 5000)


def test_sound_that_a_container_cannot_hold_is_named(tmp_path):
    ffmpeg(*PICTURE, *SINE, "-pix_fmt", "yuv420p", tmp_path / "in.mp4")
    with pytest.raises(OutputError, match="aac"):
        copied(tmp_path / "in.mp4", tmp_path / "out.webm", "webm")


def test_odd_sides_are_made_even(tmp_path):
    ffmpeg(*PICTURE, "-vf", "crop=95:63:exact=1,format=yuv444p", tmp_path / "in.mkv")
    copied(tmp_path / "in.mkv", tmp_path / "out.mp4")
    assert asked(tmp_path / "out.mp4", "stream=width,height") == ["96,64"]
