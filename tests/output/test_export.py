"""Each written file is read by a library that did not write it, or by ffprobe."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
import weakref
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import plain
import pytest
from films import contents, frames_of, stills
from PIL import Image
from programs import program
from skimage.metrics import peak_signal_noise_ratio as psnr

import clmorph
from clmorph import InputError, OutputError
from clmorph._shared.threads import MOST_THREADS
from clmorph.images.pixels import to_bytes
from clmorph.output.formats.sheet import lengths
from clmorph.output.formats.video import CONTAINERS
from clmorph.output.framing import Framing
from clmorph.output.options import FrameStyle, PlaybackOptions
from clmorph.output.playback import Motion, held_frames, motion_of
from clmorph.output.provenance import read_parameters
from clmorph.output.recording import Recording, Spool
from clmorph.output.save import FORMATS, Output, save, write_all

#: The least peak signal-to-noise ratio of lossy files, in decibels, on small photographs: of
#: GIF and WebP at the frames' own size, where WebP halves the resolution of hues; of videos four
#: times enlarged.
LEAST_PSNR = {"webp": 30.0, "mp4": 35.0, "webm": 35.0, "gif": 30.0}


@pytest.fixture(scope="module")
def morph():
    """Two pieces of photographs, 24 x 32 and 24 x 32, twelve frames."""
    from skimage import data

    pair = [clmorph.fit(image[:384, :512] / 255, 32) for image in (data.astronaut(), data.coffee())]
    return plain.morph(*pair, 12, splatting="local", sigma_start="auto", sigma_end="auto")


@pytest.fixture(scope="module")
def growing():
    """A canvas that grows from 6 x 8 to 12 x 16."""
    rng = np.random.default_rng(3)
    return plain.morph(rng.random((6, 8, 3)), rng.random((12, 16, 3)), 5)


@pytest.fixture(scope="module")
def clear():
    """Frames with opacity."""
    rng = np.random.default_rng(4)
    images = rng.random((2, 10, 10, 4))
    images[..., 3] = images[..., 3] > 0.4
    return plain.morph(*images, 4)


def decoded(file, depth=3, *decoder):
    """The frames of a film as the system's ffmpeg decodes them, by the tags in the file."""
    width, height = size(file)
    raw = subprocess.run(
        [program("ffmpeg"), "-v", "error", *decoder, "-i", file, "-f", "rawvideo", "-sws_flags",
         "accurate_rnd+full_chroma_int+bicubic", "-pix_fmt", {3: "rgb24", 4: "rgba"}[depth], "-"],
        capture_output=True, check=True,
    ).stdout  # fmt: skip
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, depth)


def decoded_clear(file):
    """The frames of a WebM with their opacity, which FFmpeg's own decoder of VP9 leaves out."""
    return decoded(file, 4, "-c:v", "libvpx-vp9").astype(float)


def probe(file):
    told = subprocess.run(
        [program("ffprobe"), "-v", "error", "-count_frames", "-show_streams", "-show_format", "-of",
         "json", file],
        capture_output=True, check=True, text=True,
    ).stdout  # fmt: skip
    found = json.loads(told)
    assert len(found["streams"]) == 1
    return found["streams"][0] | {"format": found["format"]}


def size(file):
    return tuple(probe(file)[side] for side in ("width", "height"))


def film_of(frames, times=None, holds=None, motion=None, **more):
    """A film of frames; by default at equal times, without rests."""
    times = np.linspace(0, 1, len(frames)) if times is None else np.asarray(times, float)
    holds = np.zeros(len(frames), bool) if holds is None else np.asarray(holds)
    shapes = [frame.shape for frame in frames]
    return Recording(list(frames), shapes, times, holds, motion or Motion(), **more)


def write(path, film, **look):
    write_all([Output(path)], film, FrameStyle(**look))


def place(folder, name, stem="out"):
    """Where a file of a format is written, with its first ending."""
    return folder / f"{stem}{(FORMATS[name].endings or ('',))[0]}"


def wanted(morph):
    return [to_bytes(frame) for frame in morph.frames]


@pytest.mark.parametrize("name", ["out.apng", "out.webp"])
def test_lossless_animations_are_the_frames(tmp_path, morph, clear, name):
    save(morph, tmp_path / name, canvas="source", lossless=True, fps=25, hold=0.5)
    frames, durations = stills(tmp_path / name)
    assert np.array_equal(np.array(frames)[..., :3], wanted(morph))
    assert durations == [540, *[40] * 10, 540]
    with Image.open(tmp_path / name) as animation:
        assert animation.info["loop"] == 0
    # WebP forgets what color is under no opacity at all.
    save(clear, tmp_path / name, canvas="source", lossless=True)
    for frame, want in zip(frames_of(tmp_path / name), wanted(clear), strict=True):
        seen = want[..., 3:] > 0 if name == "out.webp" else True
        assert np.array_equal(frame * seen, want * seen)


@pytest.mark.parametrize("opacity", [False, True])
@pytest.mark.parametrize("name", ["out.gif", "out.apng", "out.webp"])
def test_equal_frames_last_as_long_as_others(tmp_path, name, opacity):
    """Libwebp writes a still, which lasts no time."""
    image = np.full((6, 8, 3 + opacity), 0.5)
    image[2, 3] = 1.0
    same = clmorph.morph(image, image, n_frames=5, backend="numpy")
    save(same, tmp_path / name, fps=10, hold=0.5, loop="once")
    frames, durations = stills(tmp_path / name)
    assert sum(durations) == 1500
    assert np.abs(frames[0][0, 0, :3].astype(int) - 128).max() <= 2
    if name != "out.gif":
        assert abs(int(frames[0][0, 0, 3]) - (128 if opacity else 255)) <= 1
    with Image.open(tmp_path / name) as opened:
        assert opened.info.get("loop", 1) == 1
    assert "blur" in read_parameters(tmp_path / name)["options"]


@pytest.mark.parametrize(
    ("name", "most", "others"),
    [
        ("out.gif", 50, ".webp, .apng, .mp4, .webm"), ("out.webp", 90, ".mp4, .webm"),
        ("out.apng", 90, ".mp4, .webm"),
    ],
)  # fmt: skip
def test_browsers_show_what_is_written_at_its_speed(tmp_path, growing, name, most, others):
    with pytest.raises(InputError, match=rf"at most {most}, .* or write {re.escape(others)}$"):
        save(growing, tmp_path / name, fps=most + 1)
    save(growing, tmp_path / name, fps=most)
    _, durations = stills(tmp_path / name)
    assert min(durations) > 10


@pytest.mark.parametrize("name", ["out.gif", "out.webp"])
def test_lossy_animations_are_close(tmp_path, morph, name):
    save(morph, tmp_path / name, canvas="source", scaling="nearest")
    frames, durations = stills(tmp_path / name)
    for frame, want in zip(frames, wanted(morph), strict=True):
        assert psnr(frame[..., :3], want) > LEAST_PSNR[name[4:]]
    assert sum(durations) == pytest.approx(1000 * (12 / 20 + 2 * 0.65))


@pytest.mark.parametrize(("name", "codec"), [("out.mp4", "h264"), ("out.webm", "vp9")])
def test_videos(tmp_path, morph, name, codec):
    """Codec, size, length, color tags, and colors as another decoder sees them."""
    save(morph, tmp_path / name, canvas="128x96", fps=30, hold=0.1)
    told = probe(tmp_path / name)
    tags = ("codec_name", "width", "height", "pix_fmt", "r_frame_rate", "color_range")
    tags += ("color_space", "color_primaries", "color_transfer", "nb_read_frames")
    assert [told[tag] for tag in tags] == [
        codec, 128, 96, "yuv420p", "30/1", "tv", "bt709", "bt709", "iec61966-2-1", "18",
    ]  # fmt: skip
    assert float(told["format"]["duration"]) == pytest.approx(18 / 30, abs=0.002)
    order = [0] * 3 + list(range(12)) + [11] * 3
    for frame, index in zip(decoded(tmp_path / name), order, strict=True):
        large = Image.fromarray(wanted(morph)[index]).resize((128, 96), Image.Resampling.BICUBIC)
        assert psnr(frame, np.asarray(large)) > LEAST_PSNR[name[4:]]


#: Pictures, frames of each morph, frames a second or seconds in all, rest at the pictures.
LENGTHS = [
    (2, 4, {"duration": 3.0}, 0.65), (2, 4, {"fps": 1.0}, 0.4), (2, 6, {"duration": 2.0}, 0.3),
    (2, 12, {"duration": 1.7}, 0.65), (3, 5, {"fps": 7.0}, 0.33), (3, 4, {"fps": 1.5}, 0.1),
    (3, 6, {"duration": 4.321}, 0.123), (2, 3, {"fps": 240.0}, 0.0), (2, 3, {"fps": 0.3}, 0.9),
]  # fmt: skip


@pytest.mark.in_turns
@pytest.mark.parametrize("name", ["out.mp4", "out.webm"])
@pytest.mark.parametrize(("n_images", "n_frames", "pace", "hold"), LENGTHS)
@pytest.mark.parametrize("loop", ["loop", "ping-pong"])
def test_videos_last_as_long_as_the_film(tmp_path, name, n_images, n_frames, pace, hold, loop):
    holds = held_frames(n_images, n_frames)
    motion = motion_of(PlaybackOptions(**pace, hold=hold, loop=loop), holds)
    frames = [np.full((16, 16, 3), 9 * n, np.uint8) for n in range(len(holds))]
    times = np.linspace(0, n_images - 1, len(holds))
    film = film_of(frames, times, holds, motion)
    write(tmp_path / name, film, canvas="source")
    told = probe(tmp_path / name)
    rate = Fraction(told["r_frame_rate"])
    assert rate == motion.rate_for([seconds for _, seconds in film.played()])
    assert abs(float(told["format"]["duration"]) - film.duration) < 1 / rate + 0.002
    assert abs(int(told["nb_read_frames"]) / rate - film.duration) < 1 / rate
    # Every picture begins when it should, in frames.
    grays = [-99.0, *(frame.mean() for frame in decoded(tmp_path / name))]
    begins = np.flatnonzero(np.abs(np.diff(grays)) > 4)
    ends = np.cumsum([seconds for _, seconds in film.played()])
    if loop == "loop":
        assert len(begins) == len(film)
        assert np.abs(begins[1:] - ends[:-1] * float(rate)).max() < 0.51


@pytest.mark.parametrize("name", ["out.mp4", "out.webm"])
def test_videos_have_true_colors(tmp_path, name):
    """Plain colors, which no codec has an excuse for: a wrong matrix would be off by 20."""
    colors = [(200, 30, 40), (20, 180, 60), (30, 60, 220), (128, 128, 128), (255, 255, 255)]
    frames = [np.full((32, 32, 3), color, np.uint8) for color in colors]
    write(tmp_path / name, film_of(frames), canvas="source")
    for frame, color in zip(decoded(tmp_path / name), colors, strict=True):
        assert np.abs(frame.astype(int) - color).max() <= 4


def test_odd_sizes_in_videos_are_made_even(tmp_path):
    rng = np.random.default_rng(0)
    odd = plain.morph(rng.random((7, 9, 3)), rng.random((9, 5, 3)), 3)
    for canvas, even in (("source", (10, 8)), ("33x21", (34, 22))):
        save(odd, tmp_path / "out.mp4", canvas=canvas)
        assert size(tmp_path / "out.mp4") == even


def test_webm_keeps_opacity(tmp_path, clear):
    save(clear, tmp_path / "out.webm", canvas="64x64", hold=0)
    opacities = set()
    for frame, want in zip(decoded_clear(tmp_path / "out.webm"), wanted(clear), strict=True):
        framing = Framing(FrameStyle(canvas=(64, 64)), [want.shape], False)
        large = np.asarray(framing(want)).astype(float)
        assert np.abs(frame[..., 3] - large[..., 3]).max() <= 12
        seen = large[..., 3] > 200
        assert np.abs(frame - large)[seen].mean() < 12
        opacities |= set(np.round(large[..., 3].ravel() / 16))
    assert opacities == set(range(17))  # nothing of all this is for want of opacity
    save(clear, tmp_path / "out.mp4", canvas="64x64", background="#00ff00")
    corner = decoded(tmp_path / "out.mp4")[0]
    green = (corner[..., 1] > 200) & (corner[..., 0] < 80) & (corner[..., 2] < 80)
    assert green.mean() > 0.2


@pytest.mark.parametrize("name", ["frames", "out.tif", "tiff-folder"])
def test_stills_are_the_frames_at_their_own_sizes(tmp_path, growing, name):
    save(growing, tmp_path / name, format=name if name == "tiff-folder" else None)
    if name == "out.tif":
        found = frames_of(tmp_path / name)
    else:
        ending = "png" if name == "frames" else "tif"
        files = sorted((tmp_path / name).iterdir())
        assert [file.name for file in files] == [f"frame-{i:04d}.{ending}" for i in range(5)]
        found = [np.asarray(Image.open(file)) for file in files]
    np.testing.assert_equal([frame[..., :3] for frame in found], wanted(growing))
    assert found[0].shape[:2] == (6, 8)
    assert found[-1].shape[:2] == (12, 16)


def test_npz_loads_again(tmp_path, morph, growing):
    for one in (morph, growing):
        save(one, tmp_path / "out.npz")
        loaded = clmorph.load(tmp_path / "out.npz")
        assert {frame.dtype for frame in loaded.frames} == {np.dtype(np.float32)}
        np.testing.assert_equal(list(loaded.frames), list(one.frames))
        assert np.array_equal(loaded.times, one.times)
        assert (loaded.plan.to_scipy() != one.plan.to_scipy()).nnz == 0
        assert np.array_equal(loaded.plan.whole_row_mass, one.plan.whole_row_mass)
        assert np.array_equal(loaded.potentials[0][0], one.potentials.f)
        assert loaded.parameters["options"]["blur"] == 0.05
    with np.load(tmp_path / "out.npz") as plain:  # without us
        assert plain["frame_0000"].shape == (6, 8, 3)
    save(morph, tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as plain:
        assert plain["frames"].shape == (12, 24, 32, 3)
    with pytest.raises(InputError, match=r"take [\d.]+ kB, expected at most 900 bytes; if you"):
        clmorph.load(tmp_path / "out.npz", max_bytes=900)


def test_npz_of_mean_destinations_and_of_chains(tmp_path, rng):
    images = rng.random((3, 6, 6, 3))
    chain = [plain.morph(*pair, 3, barycentric=True) for pair in (images[:2], images[1:])]
    save(chain, tmp_path / "out.npz")
    loaded = clmorph.load(tmp_path / "out.npz")
    assert loaded.times.tolist() == [0, 0.5, 1, 1.5, 2]
    covariances = [plan.covariance for plan in loaded.plans]
    np.testing.assert_equal(covariances, [one.plan.covariance for one in chain])


def test_what_is_no_archive_is_refused(tmp_path, rng):
    np.savez(tmp_path / "other.npz", a=rng.random(3))
    (tmp_path / "text.npz").write_text("not one")
    for name, words in (("other.npz", "other"), ("text.npz", "text"), ("", r"cannot be read \("),
                        ("missing.npz", r"missing\.npz: no such file$")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            clmorph.load(tmp_path / name)


def test_a_gif_has_one_palette(tmp_path, morph):
    """No local color tables: what does not move does not flicker."""
    save(morph, tmp_path / "out.gif")
    data = (tmp_path / "out.gif").read_bytes()
    # Image descriptors: a comma, four numbers, flags; the top bit announces a table, by which
    # a writer may repeat the one for all.
    table = data[13 : 13 + 255 * 3]
    descriptors = list(re.finditer(rb"\x21\xf9\x04.{5}\x2c.{8}(.)", data, re.DOTALL))
    assert len(descriptors) == 12
    for found in descriptors:
        if found[1][0] & 0x80:
            assert data[found.end() : found.end() + 255 * 3] == table
    with Image.open(tmp_path / "out.gif") as gif:
        assert gif.size == (384, 288)
        assert gif.info["loop"] == 0


@pytest.mark.parametrize("depth", [3, 4])
def test_a_chain_of_sprites_of_many_colors_is_exact(tmp_path, depth):
    """60 colors each, 180 in all, as squares; colors that are not seen take no entries."""
    rng = np.random.default_rng(8)
    sprites = rng.random((3, 60, depth))[np.arange(3)[:, None, None], rng.permuted(
        np.resize(np.arange(60), (3, 20, 20)), axis=1)]  # fmt: skip
    if depth == 4:
        sprites[..., 3] = rng.random((3, 20, 20)) > 0.2
        hidden = sprites[..., 3] == 0
        sprites[hidden, :3] = rng.random((hidden.sum(), 3))
    chain = [plain.morph(*pair, 4, splatting="none") for pair in (sprites[:2], sprites[1:])]
    assert all(morph.pixelated for morph in chain)
    save(chain, tmp_path / "out.gif")
    frames = np.array(frames_of(tmp_path / "out.gif"))
    small = frames[:, ::20, ::20]
    assert np.array_equal(frames, small.repeat(20, axis=1).repeat(20, axis=2))
    for frame, sprite in zip(small[::3], sprites, strict=True):
        want = to_bytes(sprite)
        seen = want[..., 3] > 0 if depth == 4 else np.ones((20, 20), bool)
        assert np.array_equal(frame[..., 3] > 0, seen)
        assert np.array_equal(frame[seen][:, :3], want[seen][:, :3])


@pytest.mark.parametrize("busy", [False, True])
def test_a_sprites_rarest_color_is_exact(tmp_path, busy):
    """One pixel of 270,000, whether the frames between have many colors or few."""
    rng = np.random.default_rng(9)
    frames = np.zeros((3, 300, 300, 3), np.uint8)
    frames[:, :150] = 90, 120, 30
    if busy:
        frames[1] = rng.integers(0, 255, (300, 300, 3))
    frames[0, 123, 257] = 255, 3, 9
    frames[2, 211, 77] = 7, 250, 40
    film = film_of(frames, holds=[True, False, True], pixelated=True)
    write(tmp_path / "out.gif", film, canvas="source")
    told = np.array(frames_of(tmp_path / "out.gif"))
    assert np.array_equal(told[[0, 2], ..., :3], frames[[0, 2]])


def test_a_gif_rounds_opacity(tmp_path, clear):
    save(clear, tmp_path / "out.gif", canvas="source")
    shown = np.array(frames_of(tmp_path / "out.gif"))
    assert np.array_equal(shown[..., 3] > 0, np.array(wanted(clear))[..., 3] >= 128)
    save(clear, tmp_path / "flat.gif", canvas="source", background="red")
    first = frames_of(tmp_path / "flat.gif")[0]
    assert first[..., 3].min() == 255
    hidden = wanted(clear)[0][..., 3] == 0
    assert np.all(first[hidden][:, 0] > 200)


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "npz"])
@pytest.mark.parametrize("reverse", [True, False])
def test_canvases_are_those_of_the_pictures_as_given(tmp_path, growing, name, reverse):
    """Also when the film is reversed."""
    path = place(tmp_path, name)
    for canvas, (width, height) in (("source", (8, 6)), ("target", (16, 12))):
        shutil.rmtree(path, ignore_errors=True)
        save(growing, path, format=name, canvas=canvas, reverse=reverse)
        if name in ("mp4", "webm"):
            assert size(path) == (width, height)
            continue
        if name == "html":
            assert f'"sizes":[[{width},{height}],' in path.read_text("ascii")
            continue
        first = frames_of(sorted(path.iterdir())[0] if path.is_dir() else path)[0]
        if name == "sheet":  # one row; cells are wider, for their captions
            assert len(first) == height + 34 + 12
        else:
            assert first.shape == (height, width, 4)


@pytest.mark.parametrize("pixelated", [False, pytest.param(True, marks=pytest.mark.full)])
def test_contact_sheets_of_large_frames_are_small(tmp_path, pixelated):
    """All of a frame comes in: stripes one pixel wide turn gray instead of one of their colors."""
    large = np.zeros((480, 720, 3), np.uint8)
    large[:, ::2] = 255
    film = film_of([large] * 12, pixelated=pixelated)
    for look, size in (
        (FrameStyle(), (192, 128)), (FrameStyle(canvas="30x20"), (30, 20)),
        (FrameStyle(canvas="300x100"), (300, 100)),
        (FrameStyle(canvas="source"), (720, 480)), (FrameStyle(scaling="nearest"), (192, 128)),
    ):  # fmt: skip
        write_all([Output(tmp_path / "sheet.PNG")], film, look)
        with Image.open(tmp_path / "sheet.PNG") as sheet:
            assert sheet.n_frames == 1
            width, height = sheet.size
            gap, label, *_ = lengths(*size)
            first = np.asarray(sheet)[gap : gap + size[1], gap : gap + size[0]]
        assert height == 2 * (size[1] + label + gap) + gap
        if look.canvas == (30, 20):
            assert 5 * (30 + 12) + 12 < width <= 5 * (60 + 12) + 12
        else:
            assert width == 5 * (size[0] + gap) + gap
        if look == FrameStyle():
            assert np.abs(first[4:-4, 4:-4].astype(int) - 128).max() < 20
        if look.scaling == "nearest":
            assert set(np.unique(first)) <= {0, 255}


@pytest.mark.parametrize("side", ["8x8", "192x192", "1280x720", "16x400"])
def test_captions_of_a_contact_sheet_can_be_read(tmp_path, side):
    """Seen as a whole, or at its own size if that is small; none is cut off."""
    frames = [np.full((8, 8, 3), 128, np.uint8)] * 3
    write(tmp_path / "sheet.png", film_of(frames), canvas=side)
    width, height = map(int, side.split("x"))
    gap, label, *_ = lengths(width, height)
    dark = np.asarray(Image.open(tmp_path / "sheet.png").convert("L")) < 99
    rows = np.flatnonzero(dark[-gap - label : -gap].any(axis=1))
    assert np.ptp(rows) >= max(9, 0.04 * min(width, height))
    assert rows[-1] < label - 2


def test_captions_of_a_contact_sheet_do_not_touch(tmp_path):
    """Below pictures of one column: with white between, and whole."""
    frames = np.zeros((5, 40, 1, 3), np.uint8)
    write(tmp_path / "sheet.png", film_of(frames, np.linspace(0, 12, 5)), canvas="1x40")
    gray = np.asarray(Image.open(tmp_path / "sheet.png").convert("L"))
    ink = np.flatnonzero((gray[12 + 40 + 1 : -8] < 128).any(axis=0))
    gaps = np.diff(ink)
    assert np.count_nonzero(gaps >= 9) == 4
    assert ink[0] >= 9
    assert ink[-1] < gray.shape[1] - 9
    pictures = np.flatnonzero(gray[20] < 128)
    centers = np.split(ink, np.flatnonzero(gaps >= 9) + 1)
    for column, letters in zip(pictures, centers, strict=True):
        assert abs(column - letters.mean()) < 6


def test_reverse_and_chains(tmp_path, growing):
    save(growing, tmp_path / "frames", reverse=True)
    first = np.asarray(Image.open(tmp_path / "frames" / "frame-0000.png"))
    assert np.array_equal(first, wanted(growing)[-1])
    rng = np.random.default_rng(3)
    images = rng.random((6, 8, 3)), rng.random((12, 16, 3)), rng.random((5, 5, 3))
    chain = [plain.morph(*pair, 4) for pair in (images[:2], images[1:])]
    save(chain, tmp_path / "tour.apng", canvas="source", hold=1)
    _, durations = stills(tmp_path / "tour.apng")
    assert durations == [1050, 50, 50, 1050, 50, 50, 1050]


@pytest.mark.in_turns
@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_tells_what_made_it(tmp_path, growing, name):
    path = place(tmp_path, name)
    told = {"clmorph": "9", "options": {"blur": 0.03, "name": 'ü "quoted" </script> \\ \n'}}
    save(growing, path, format=name, parameters=told)
    assert read_parameters(path) == told
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_the_same_film_gives_the_same_bytes(tmp_path, growing):
    """In every format, also two seconds later, which is ZIP's unit."""

    def written(folder):
        folder.mkdir()
        paths = {name: place(folder, name, f"out-{name}") for name in FORMATS}
        for name, path in paths.items():
            save(growing, path, format=name)
        return {name: contents(path) for name, path in paths.items()}

    before = written(tmp_path / "one")
    time.sleep(2.1)
    after = written(tmp_path / "other")
    assert [name for name in FORMATS if before[name] != after[name]] == []


#: What programs of a process of its own begin with.
WRITING = """
import pathlib, sys
import numpy as np
from clmorph.output.save import Output, write_all
from clmorph.output.recording import Recording
from clmorph.output.options import FrameStyle
from clmorph.output.playback import Motion
"""

#: Writes a film of noise in large squares, some of which change.
SQUARES = f"""{WRITING}
squares = np.random.default_rng(0).integers(0, 255, (8, 17, 22, 3), np.uint8)
frames = list(np.kron(squares, np.ones((1, 16, 16, 1), np.uint8)))
film = Recording(frames, [frames[0].shape] * 8, np.linspace(0, 1, 8), np.ones(8, bool),
                 Motion(20, 0.1))
write_all([Output(sys.argv[1])], film, FrameStyle(canvas="source"))
"""


@pytest.mark.full
@pytest.mark.parametrize(
    "name", [name for name in FORMATS if FORMATS[name].endings and not FORMATS[name].keep]
)
def test_bytes_do_not_depend_on_what_was_in_memory(tmp_path, name):
    """With MALLOC_PERTURB_, glibc fills allocated memory with a given byte."""
    found = []
    for filling in ("1", "77"):
        (tmp_path / filling).mkdir()
        path = tmp_path / filling / f"out{FORMATS[name].endings[0]}"
        environment = os.environ | {"MALLOC_PERTURB_": filling}
        subprocess.run([sys.executable, "-c", SQUARES, path], check=True, env=environment)
        found.append(contents(path))
    assert found[0] == found[1]


@pytest.fixture(scope="module", params=[0, 1, 2])
def partly_clear(request):
    """A chain of which one picture has a hole; frames between two opaque ones have no opacity."""
    rng = np.random.default_rng(11)
    images = [rng.choice([0.1, 0.5, 0.9], (8, 8, 3)) for _ in range(3)]
    alpha = np.ones((8, 8))
    alpha[2:6, 2:6] = 0
    images[request.param] = np.dstack((images[request.param], alpha))
    chain = [plain.morph(*pair, 4, splatting="none") for pair in pairwise(images)]
    depths = {frame.shape[2] for morph in chain for frame in morph.frames}
    assert depths == ({4} if request.param == 1 else {3, 4})
    return chain, images


@pytest.mark.parametrize("name", list(FORMATS))
def test_chains_with_opacity_in_one_picture(tmp_path, partly_clear, name):
    """It is there in that one's frame, and in the others' all is seen; or it lies on white."""
    chain, images = partly_clear
    path = place(tmp_path, name)
    enlarged = name in ("webm", "mp4", "sheet")
    # What codecs blur at the edges of 4 x 4 squares of one color, they do not in the middle.
    canvas = {"sheet": "64x64", "webm": "128x128", "mp4": "128x128"}.get(name, "source")
    look = {"canvas": canvas, "scaling": "nearest", "lossless": True, "hold": 0}
    save(chain, path, format=name, **look)
    if name == "html":
        assert read_parameters(path)["clmorph"]
        return
    if name == "npz":
        frames = [to_bytes(frame) for frame in clmorph.load(path).frames]
    elif name == "webm":
        frames = decoded_clear(path)
    elif name == "mp4":
        frames = decoded(path)
    elif name == "sheet":
        pixels = np.asarray(Image.open(path))
        assert pixels.shape == (2 * (64 + 34) + 12, 5 * (64 + 12) + 12, 3)
        frames = [
            pixels[top : top + 64, left : left + 64]
            for top in (12, 12 + 98) for left in range(12, 12 + 5 * 76, 76)
        ][:7]  # fmt: skip
    elif path.is_dir():
        frames = [np.asarray(Image.open(file)) for file in sorted(path.iterdir())]
    else:
        frames = frames_of(path)
    assert len(frames) == 7
    for frame, image in zip(frames[::3], images, strict=True):
        if enlarged:
            unit = len(frame) // 8
            frame = frame[unit // 2 :: unit, unit // 2 :: unit]
        want = to_bytes(image)
        seen = want[..., 3] > 0 if want.shape[2] == 4 else np.ones((8, 8), bool)
        within = 12 if name in ("webm", "mp4") else 1
        if name == "mp4" or name == "sheet":
            assert frame.shape == (8, 8, 3)
            assert frame[~seen].min(initial=255) >= 255 - within
        elif frame.shape[2] == 4:
            assert np.abs(frame[..., 3] - 255.0 * seen).max() <= within
        else:
            assert name == "npz"
            assert seen.all()
        # Hues have half the resolution in videos, so only gray is compared there.
        error = frame[..., :3].astype(float) - want[..., :3]
        error = error @ [0.2126, 0.7152, 0.0722] if name in ("webm", "mp4") else error
        assert np.abs(error[seen]).max() <= within


@pytest.mark.in_turns
@pytest.mark.parametrize(
    "name", ["out.gif", "out.apng", "out.webp", "out.tif", "out.npz", "out.html", "frames"]
)
def test_frames_are_not_held(tmp_path, monkeypatch, name):
    """They are rendered one by one, wait on disk, and are read again, a few ahead."""
    rng = np.random.default_rng(6)
    result = plain.morph(*rng.random((2, 8, 8, 3)), 20)
    (tmp_path / "before").mkdir()
    save(result, tmp_path / "before" / name, loop="ping-pong")
    alive, most = [], []

    def watched(frame):
        frame = frame.copy()  # of its own memory, which every view of it keeps
        alive.append(1)
        most.append(len(alive))
        weakref.finalize(frame, alive.pop)
        return frame

    render, read = clmorph.Morph.frame, Spool.__getitem__
    monkeypatch.setattr(clmorph.Morph, "frame", lambda self, t: watched(render(self, t)))
    monkeypatch.setattr(Spool, "__getitem__", lambda self, index: watched(read(self, index)))
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 1000)
    save(result, tmp_path / name, loop="ping-pong")
    assert len(most) >= 40
    # A thread that the system lets wait keeps what it has done, while the next are read.
    assert max(most) <= 3 + 2 * MOST_THREADS
    assert contents(tmp_path / name) == contents(tmp_path / "before" / name)


#: Writes a film of smooth frames that move, made when they are read, and tells by how many MB
#: more memory was ever taken for many than for some.
GROWTH = (
    WRITING
    + """
def most():
    status = pathlib.Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3

class Frames:
    def __init__(self, side):
        self.waves = np.linspace(0, 7, side)[:, None] + np.linspace(0, 5, side)

    def __getitem__(self, index):
        waves = np.sin(self.waves + 0.2 * index)[..., None] + [0.1, 0.3, 0.7]
        return (127.5 + 70 * waves).clip(0, 255).astype(np.uint8)

name, folder, side, *counts = sys.argv[1:]
peaks = []
for count in map(int, counts):
    film = Recording(Frames(int(side)), [(int(side), int(side), 3)] * count,
                     np.linspace(0, 1, count), np.zeros(count, bool), Motion())
    write_all([Output(f"{folder}/{count}{name}")], film, FrameStyle(canvas="source"))
    peaks.append(most())
print(peaks[1] - peaks[0])
"""
)


@pytest.mark.full
@pytest.mark.parametrize("name", [".gif", ".webp", ".apng", ".tif", "", ".mp4", ".webm"])
def test_memory_does_not_grow_with_the_number_of_frames(tmp_path, name):
    """By the system's account: what image libraries take is not Python's."""
    if not Path("/proc/self/status").exists():
        pytest.skip("memory is told elsewhere on this system")
    # Encoders of videos look ahead by some dozens of frames.
    side, some, many = (300, 80, 160) if name in (".mp4", ".webm") else (600, 10, 60)
    run = [sys.executable, "-c", GROWTH, name, tmp_path, str(side), str(some), str(many)]
    told = subprocess.run(run, capture_output=True, check=True, text=True).stdout
    one = side**2 * 3 / 1e6
    held = 0.5 if name in (".mp4", ".webm") else 0.1  # of a frame
    # How many frames threads hold at once depends on their turns, on a busy machine above all.
    assert float(told) < held * one * (many - some) + 4 * one


@pytest.mark.in_turns
@pytest.mark.parametrize("name", list(FORMATS))
def test_progress_is_that_of_the_writing(tmp_path, growing, monkeypatch, name):
    """Once for each frame, when it has been read and before the next is, up to the whole."""
    events = []
    read = Recording.picture
    monkeypatch.setattr(
        Recording, "picture", lambda self, n: (events.append("read"), read(self, n))[1]
    )

    def progress(stage, share):
        if stage.startswith("write "):
            events.append(float(share))

    save(growing, place(tmp_path, name), format=name, loop="ping-pong", progress=progress)
    shares = [event for event in events if event != "read"]
    count = 8 if FORMATS[name].animated else 5
    assert shares == pytest.approx(np.arange(1, count + 1) / count)
    if name not in ("npz", "html"):
        assert events[-2 * count :] == [part for share in shares for part in ("read", share)]


@pytest.mark.parametrize("name", ["out.gif", "out.apng", "out.webp"])
@pytest.mark.parametrize("depth", [3, 4])
def test_frames_that_repeat_or_stay_for_minutes_last_as_long(tmp_path, name, depth):
    """Longer than a frame's duration has digits for; one that is all clear is one, too."""
    frames = np.zeros((5, 6, 7, depth), np.uint8)
    frames[3:, 2:4, 3:5] = [200, 200, 200, 255][:depth]
    frames[[0, 1, 3], 1:3, 1:4, -1] = 255
    holds = [True, False, False, False, True]
    film = film_of(frames, None, holds, Motion(10, 700.0, "ping-pong"))
    write(tmp_path / name, film, canvas="source", lossless=True)
    told, durations = stills(tmp_path / name)
    assert sum(durations) == pytest.approx(1000 * film.duration)
    ends, shown = np.cumsum(durations), np.cumsum([seconds for _, seconds in film.played()]) * 1000
    for (index, _), end in zip(film.played(), shown, strict=True):
        seen = told[np.searchsorted(ends, end - 50)]
        if depth == 3:
            assert np.array_equal(seen[..., :3], frames[index])
        else:
            assert np.array_equal(seen[..., 3], frames[index][..., 3])
            there = frames[index][..., 3:] > 0
            assert np.array_equal(seen * there, frames[index] * there)


@pytest.mark.parametrize("name", ["out.gif", "out.apng"])
@pytest.mark.parametrize("clear", [False, True])
def test_ffmpeg_sees_the_same_frames(tmp_path, rng, name, clear):
    """Another decoder of what is put together here, part by part."""
    frames = np.zeros((6, 20, 24, 4), np.uint8)
    for number, frame in enumerate(frames):
        frame[2:9, 2 * number : 2 * number + 9, :3] = rng.choice([40, 90, 200], (7, 9, 1))
        frame[2:9, 2 * number : 2 * number + 9, 3] = 255
    frames = frames if clear else frames[..., :3]
    write(tmp_path / name, film_of(frames, motion=Motion(10)), canvas="source")
    seen = decoded(tmp_path / name, 4)
    if not clear:
        assert np.array_equal(seen[..., :3], frames)
    else:
        assert np.array_equal(seen * (seen[..., 3:] > 0), frames)


@pytest.mark.parametrize(
    ("name", "most"), [("out.webp", 16383), ("out.gif", 65535), ("out.mp4", 16384),
                       pytest.param("out.webm", 65536, marks=pytest.mark.full)]
)  # fmt: skip
def test_pictures_that_a_file_cannot_hold_are_refused_at_once(tmp_path, monkeypatch, name, most):
    """And the largest that it can hold are written."""
    wide = np.zeros((2, most + 2, 3), np.uint8)
    film = film_of([wide[:, : most + 2 - most % 2]] * 2)
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "picture", lambda *args: pytest.fail("encoding has begun"))
        with pytest.raises(InputError, match=f"at most {most}: set a smaller"):
            write_all([Output(tmp_path / name)], film)
    assert not list(tmp_path.iterdir())
    write_all([Output(tmp_path / name)], film_of([wide[:, :most]] * 2))
    if name in ("out.gif", "out.webp"):
        assert frames_of(tmp_path / name)[0].shape == (2, most, 4)
    else:
        assert size(tmp_path / name) == (most, 2)


@pytest.mark.parametrize(
    "name", ["out.webp", "out.gif", "out.apng", "out.mp4", "out.webm", "out.tif", "", "out.png"]
)
def test_what_encoders_raise_is_told_in_one_line(tmp_path, monkeypatch, growing, name):
    def broken(*args, **options):
        raise RuntimeError("ERROR adding frame\nof two lines")

    monkeypatch.setattr("PIL.Image.Image.paste", broken)
    monkeypatch.setattr("PIL.Image.Image.save", broken)
    monkeypatch.setattr("tifffile.TiffWriter.write", broken)
    if name in ("out.mp4", "out.webm"):
        broken_one = CONTAINERS[name[4:]]._replace(settings={"crf": "nothing"})
        monkeypatch.setitem(CONTAINERS, name[4:], broken_one)
    with pytest.raises(OutputError, match=r"the encoder of .* failed .*another format"):
        save(growing, tmp_path / (name or "frames"), canvas="source")
    assert not list(tmp_path.iterdir())


def test_refusals(tmp_path, growing, monkeypatch):
    for options, words in (
        ({"format": "mov"}, "format='mov'"),
        ({"canvas": "big"}, "canvas='big'"),
        ({"canvas": "0x10"}, "canvas='0x10'"),
        ({"canvas": (10, 99999)}, "canvas="),
        ({"background": "reddish"}, "background='reddish'"),
    ):
        with pytest.raises(InputError, match=re.escape(words)):
            save(growing, tmp_path / "out.gif", **options)
    for nothing in ([], None, [1]):
        with pytest.raises(InputError, match="expected a Morph"):
            save(nothing, tmp_path / "out.gif")
    monkeypatch.setattr("clmorph.output.formats.video.find_spec", lambda name: None)
    for name in ("out.mp4", "out.webm"):
        with pytest.raises(OutputError, match=r"pip install \"clmorph\[video\]\""):
            save(growing, tmp_path / name)
    assert not list(tmp_path.glob("out*"))


def test_a_folder_that_cannot_be_listed_is_told(tmp_path, monkeypatch):
    """Its rights let files be made in it, not be seen."""
    place = tmp_path / "frames"
    place.mkdir()

    def refuse(folder):
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(OutputError, match=r"frames cannot be written \(Permission denied\)"):
        Output(place)
