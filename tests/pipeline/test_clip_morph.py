"""Films in which a still or a clip becomes another one while both play."""

import json
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from clouds import smooth
from PIL import Image
from programs import COMMAND, ffmpeg, program

import clmorph
from clmorph import InputError
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.cli.main import main
from clmorph.clips.reading import is_clip

RATE = 20


def moving(seed, count):
    """Frames of a camera that moves along a smooth colored pattern."""
    whole = np.round(255 * smooth(np.random.default_rng(seed), (48, 90), 4)).astype(np.uint8)
    return [whole[:, k : k + 48] for k in range(count)]


def test_frames_before_and_after_are_the_clips_own(device):
    one, two = moving(1, 18), moving(2, 16)
    film = list(clmorph.morph_clip(one, two, duration=0.5, fps=RATE, backend=device))
    assert len(film) == 18 + 16 - 10
    assert all(frame.dtype == np.float32 and frame.shape == (48, 48, 3) for frame in film)
    for found, given in [*zip(film, one[:8], strict=False), *zip(film[18:], two[10:], strict=True)]:
        assert np.array_equal(found, (given / 255).astype(np.float32))
    # In the transition the first ones are near the source, and the last ones near the target.
    assert np.abs(film[8] - one[8] / 255).mean() < 0.04
    assert np.abs(film[17] - two[9] / 255).mean() < 0.04


@pytest.mark.full
@pytest.mark.parametrize("kinds", ["clip clip", "still clip", "clip still"])
def test_nothing_jumps_where_a_pair_is_solved(device, kinds):
    """Changes at key pairs are at most 1.3 times those elsewhere, also at both ends."""
    count, step = 24, 6
    ends = [
        moving(number, count + 4) if kind == "clip" else moving(number, 1)[0]
        for number, kind in enumerate(kinds.split(), 1)
    ]
    options = {"duration": count / RATE, "fps": RATE, "every": step / RATE, "backend": device}
    film = list(clmorph.morph_clip(*ends, **options))
    begin = 4 if kinds.startswith("clip") else 1
    found = np.abs(np.diff(film, axis=0)).mean(axis=(1, 2, 3))  # from each frame to the next
    inside = found[begin : begin + count - 1]  # between frames of the transition
    keys = np.zeros(count - 1, bool)
    for key in range(step, count - 1, step):
        keys[key - 1 : key + 1] = True
    assert inside[keys].max() <= 1.3 * inside[~keys].max()
    assert inside[keys].mean() <= 1.3 * inside[~keys].mean()
    # Into the transition and out of it, too.
    assert max(found[begin - 1], found[begin + count - 1]) <= 1.3 * inside.max()


def test_stills_that_play_are_a_morph(device):
    """Of clips without motion the film is that of the stills."""
    one, two = moving(1, 1)[0], moving(2, 1)[0]
    film = list(clmorph.morph_clip([one] * 9, two, duration=0.45, fps=RATE, backend=device))
    options = {"size": None, "landmarks": None, "preset": "photo", "backend": device}
    morph = clmorph.morph(one, two, n_frames=11, **options)
    assert len(film) == 10
    np.testing.assert_allclose(film, morph[1:], rtol=0, atol=1e-4)


@pytest.mark.full
def test_other_sizes_and_opacity(device):
    """The film has the size of the first clip, and what differs gets bars."""
    wide = np.full((10, 40, 4), 255, np.uint8)
    wide[:, :20, 3] = 0
    options = {"duration": 0.2, "fps": RATE, "backend": device}
    film = list(clmorph.morph_clip(wide, moving(1, 6), **options))
    assert {frame.shape for frame in film} == {(48, 48, 3)}
    assert not film[0][:10].any()
    assert np.allclose(film[0][24], 1.0)
    small = list(clmorph.morph_clip(wide, moving(1, 6), size=24, **options))
    assert {frame.shape for frame in small} == {(24, 24, 3)}


def test_frames_are_read_as_they_are_asked_for(device):
    """Of a long clip no more are held than the transition has."""
    read = 0

    def endless():
        nonlocal read
        while True:
            read += 1
            yield moving(1, 1)[0]

    film = clmorph.morph_clip(endless(), moving(2, 9), duration=0.4, fps=RATE, backend=device)
    for _ in range(30):
        next(film)
    assert read == 30 + 8


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with two films with a tone each, a silent one, and a picture."""
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("films")
    for name, seed, tone, how in (
        ("one.mp4", 1, 440, ["-c:v", "libx264", "-c:a", "aac"]),
        ("two.webm", 2, 1500, ["-c:v", "libvpx-vp9", "-c:a", "libopus"]),
        ("silent.mkv", 2, 0, ["-c:v", "libx264"]),
    ):
        frames = np.stack(moving(seed, 30)).tobytes()
        sound = ["-f", "lavfi", "-i", f"sine=frequency={tone}:duration=1.5"] if tone else []
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "48x48", "-r", "20", "-i", "-"]
        ffmpeg(*raw, *sound, "-pix_fmt", "yuv420p", *how, folder / name, input=frames)
    Image.fromarray(moving(3, 1)[0]).save(folder / "still.png")
    return folder


@pytest.fixture
def films(recorded, tmp_path, monkeypatch):
    """The current folder, with copies of the films and of the picture."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    return tmp_path


def probed(name):
    """What ffprobe says of a film: its pictures, the kinds of its streams, and its sound."""
    run = subprocess.run(
        [program("ffprobe"), "-v", "error", "-count_frames", "-show_entries",
         "stream=codec_name,nb_read_frames,r_frame_rate", "-of", "json", name],
        capture_output=True, check=True,
    )  # fmt: skip
    return json.loads(run.stdout)["streams"]


def heard(name):
    """The sound of a film, 48,000 samples a second."""
    sound = ffmpeg("-i", name, "-f", "f32le", "-ac", "1", "-ar", "48000", "-")
    return np.frombuffer(sound, np.float32)


def loudness(sound, tone, begin, end):
    """How strong a tone is in a part of a sound, by its times in seconds."""
    part = sound[round(48000 * begin) : round(48000 * end)]
    waves = np.exp(2j * np.pi * tone * np.arange(len(part)) / 48000)
    return 2 * abs(np.mean(part * waves))


def test_films_and_their_sounds(device, films, capfd):
    """Rates and lengths are kept, and one tone fades into the other."""
    index = next(each.index for each in find_devices() if each.handle == device.device)
    arguments = ["--duration", "0.5", "--size", "16", "--device", index]
    line = ["morph", "one.mp4", "two.webm", "-o", "a.mp4", "-o", "b.webm", *arguments]
    assert main(line) == 0
    assert "50 frames, 2.5 s" in capfd.readouterr().out
    for name, kinds in (("a.mp4", ["h264", "aac"]), ("b.webm", ["vp9", "opus"])):
        streams = probed(name)
        assert [each["codec_name"] for each in streams] == kinds
        assert streams[0]["nb_read_frames"] == "50"
        assert Fraction(streams[0]["r_frame_rate"]) == 20
        sound = heard(name)
        assert len(sound) / 48000 == pytest.approx(2.5, abs=0.05)
        parts = (0.2, 0.8), (1.2, 1.3), (1.7, 2.4)
        first, second = ([loudness(sound, tone, *part) for part in parts] for tone in (440, 1500))
        assert first[0] > 0.1
        assert second[2] > 0.1
        assert 0.3 < first[1] / first[0] < 0.7
        assert 0.3 < second[1] / second[2] < 0.7
        assert max(first[2], second[0]) < 0.005

    assert main(["morph", "still.png", "silent.mkv", "-o", "c.mp4", *arguments]) == 0
    assert [each["codec_name"] for each in probed("c.mp4")] == ["h264"]
    assert probed("c.mp4")[0]["nb_read_frames"] == "31"
    assert main(["morph", "one.mp4", "still.png", "-o", "d.mp4", *arguments]) == 0
    sound = heard("d.mp4")
    assert loudness(sound, 440, 0.2, 0.8) > 0.1
    assert loudness(sound, 440, 1.45, 1.5) < 0.03


@pytest.mark.full
def test_a_film_is_made_again_from_its_recipe(device, films):
    """Also through pipes, and of a clip from standard input."""
    index = next(each.index for each in find_devices() if each.handle == device.device)
    usual = ["--device", index, "--size", "16"]
    assert main(["morph", "still.png", "silent.mkv", "-o", "a.mp4", *usual]) == 0
    assert main(["morph", "--config", "a.mp4", "-o", "b.mp4", *usual[:2]]) == 0
    assert Path("a.mp4").read_bytes() == Path("b.mp4").read_bytes()
    assert Fraction(probed("b.mp4")[0]["r_frame_rate"]) == 20
    command = [COMMAND, "morph", "still.png", "-"]
    done = subprocess.run(
        [*command, "-o", "-", "--format", "mp4", *usual], input=Path("silent.mkv").read_bytes(),
        capture_output=True, check=True,
    )  # fmt: skip
    Path("c.mp4").write_bytes(done.stdout)
    assert probed("c.mp4") == probed("a.mp4")


@pytest.mark.full
def test_unusual_clips(films):
    """Odd sides, ten bits, and a rate that varies: the film is as long as the clip."""
    for name, how in (
        ("odd.mkv", ["-vf", "crop=47:45", "-c:v", "ffv1"]),
        ("deep.mkv", ["-pix_fmt", "yuv420p10le", "-c:v", "ffv1"]),
        ("uneven.mkv", ["-vf", "select='not(eq(mod(n,3),1))'", "-fps_mode", "vfr"]),
    ):
        ffmpeg("-i", "silent.mkv", *how, name)
        line = ["morph", name, "still.png", "-o", f"{name}.mp4", "--duration", "0.3"]
        assert main([*line, "--backend", "numpy", "--size", "16"]) == 0, name
        picture = probed(f"{name}.mp4")[0]
        frames = int(picture["nb_read_frames"]) / float(Fraction(picture["r_frame_rate"]))
        assert frames == pytest.approx(1.5, abs=0.12), name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("one.mp4 two.webm -o x.gif", "expected .mp4 or .webm"),
        ("one.mp4 two.webm still.png -o x.mp4", "expected two"),
        ("one.mp4 two.webm -o x.mp4 --duration 9", "lasts 1.50 s, and the transition 9.00 s"),
        pytest.param(
            "still.png two.webm -o x.mp4 --duration 9",
            "two.webm lasts 1.50 s",
            marks=pytest.mark.full,
        ),
        ("one.mp4 two.webm -o x.mp4 --duration 99", "expected at most 60 s"),
        ("one.mp4 two.webm -o x.mp4 --preset mosaic", "expected 'layers' for a clip"),
        ("one.mp4 two.webm -o x.mp4 --labels still.png still.png", "--labels is for stills"),
        ("one.mp4 two.webm -o one.mp4", "would overwrite an input"),
        ("cut.mp4 two.webm -o x.mp4", "cut.mp4"),
        ("sound.m4a two.webm -o x.mp4", "sound without a picture"),
        ("one.mp4 text.png -o x.mp4", "not an image"),
    ],
)
def test_mistakes(films, refused, arguments, words):
    """One line each, and an old output stays."""
    Path("x.mp4").write_bytes(b"old")
    Path("cut.mp4").write_bytes(Path("one.mp4").read_bytes()[:4000])
    Path("text.png").write_text("no picture")
    ffmpeg("-i", "one.mp4", "-vn", "-c", "copy", "sound.m4a")
    before = sorted(films.iterdir())
    assert words in refused("morph", *arguments.split(), "--backend", "numpy", "--size", "16")
    assert sorted(films.iterdir()) == before
    assert Path("x.mp4").read_bytes() == b"old"


def test_mistakes_in_python():
    clip, still = moving(1, 6), moving(2, 1)[0]
    for call, words in (
        (lambda: clmorph.morph_clip(still, still), "are stills"),
        (lambda: clmorph.morph_clip([], still), "no frames"),
        (lambda: clmorph.morph_clip(7, still), "expected a picture, the path of a clip"),
        (lambda: clmorph.morph_clip(np.ma.masked, still), "source=masked: expected a picture"),
        (lambda: clmorph.morph_clip(clip, still, every=0), "every"),
        (lambda: clmorph.morph_clip(clip, still, fps=-1), "fps"),
        (lambda: clmorph.morph_clip(clip, still, detail="cells"), "detail='cells'"),
        (lambda: clmorph.morph_clip("missing.mp4", still), "missing.mp4"),
        (lambda: list(clmorph.morph_clip(clip, still, backend="numpy")), "source lasts"),
        (
            lambda: list(clmorph.morph_clip([*clip, still[:9]], still, backend="numpy")),
            "source, frame 6 has 48 x 9 pixels",
        ),
    ):
        with pytest.raises(InputError, match=words) as raised:
            call()
        assert "\n" not in str(raised.value)


def test_pictures_are_no_clips(films):
    picture = Image.open("still.png")
    for ending in ("gif", "webp", "avif", "jpg", "bmp", "tif", "jp2"):
        picture.convert("RGB").save(f"p.{ending}")
        assert not is_clip(Path(f"p.{ending}")), ending
    assert not is_clip(Path("missing"))
    assert all(is_clip(Path(name)) for name in ("one.mp4", "two.webm", "silent.mkv"))
    for ending in ("avi", "ts", "flv", "mov", "mpg"):
        ffmpeg("-i", "silent.mkv", "-r", "25", f"q.{ending}")
        assert is_clip(Path(f"q.{ending}")), ending
