"""Each kind of image file is read as it was assembled by hand or written by another library."""

import struct
import subprocess
import sys
import threading
import time
import warnings
import zlib
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import imagecodecs
import numpy as np
import PIL
import pytest
import tifffile
from pictures import png, png_chunk, tiff
from PIL import Image, ImageCms, ImageOps

from clmorph import ImageWarning, read_image
from clmorph.errors import FileError

WIDTH, HEIGHT = 7, 5


def values(rng, samples, dtype):
    shape = (HEIGHT, WIDTH, samples) if samples > 1 else (HEIGHT, WIDTH)
    return rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True, dtype=dtype)


def as_float(array):
    return array / float(np.iinfo(array.dtype).max)


def as_color(array):
    array = as_float(array).reshape(HEIGHT, WIDTH, -1)
    return np.broadcast_to(array, (HEIGHT, WIDTH, 3)) if array.shape[2] == 1 else array


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32])
def test_signed_samples_are_refused(tmp_path, dtype, samples):
    array = np.zeros((HEIGHT, WIDTH, samples), dtype)
    tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb" if samples == 3 else "minisblack")
    with pytest.raises(FileError, match="signed samples"):
        read_image(tmp_path / "a.tif")


def test_lab_tiffs(read):
    """CIELAB of pure colors: L in 0 .. 255, a and b signed."""
    lab = np.array([[(255, 0, 0), (0, 0, 0), (136, 81, 70), (224, -79, 81)]])
    data = (lab % 256).astype(np.uint8).tobytes()
    got = read(tiff(data, 4, 1, {258: (8, 8, 8), 262: 8, 277: 3}))
    want = [(1, 1, 1), (0, 0, 0), (1, 0, 0), (0, 1, 0)]
    assert np.abs(got[0] - want).max() < 0.06
    with pytest.raises(FileError, match="photometric 8"):
        read(tiff(bytes(48), 4, 1, {258: (16,) * 3, 262: 8, 277: 3}))


def test_ycbcr_tiffs(tmp_path, read, rng):
    picture = Image.fromarray(values(rng, 3, np.uint8)).resize((32, 32), Image.Resampling.BICUBIC)
    if int(PIL.__version__.split(".")[0]) > 10:  # older ones do not read what they write
        picture.convert("YCbCr").save(tmp_path / "a.tif")
        assert np.abs(read_image(tmp_path / "a.tif") - np.asarray(picture) / 255).max() < 0.15
    with pytest.raises(FileError, match="uncompressed YCbCr"):
        read(tiff(bytes(96), 8, 8, {258: (8, 8, 8), 262: 6, 277: 3, 530: (2, 2)}))


def oriented(array, orientation):
    """What is seen of stored rows and columns, by the text of the standard."""
    upside_down = array[::-1]
    return {
        1: array, 2: array[:, ::-1], 3: upside_down[:, ::-1], 4: upside_down,
        5: array.T, 6: upside_down.T, 7: upside_down[:, ::-1].T, 8: array[:, ::-1].T,
    }[orientation]  # fmt: skip


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(tmp_path, read, rng, orientation):
    array = values(rng, 1, np.uint8)
    want = as_float(oriented(array, orientation))
    exif = Image.Exif()
    exif[0x0112] = orientation
    for name in ("a.png", "a.webp"):
        Image.fromarray(array).save(tmp_path / name, exif=exif, lossless=True)
        assert np.array_equal(read_image(tmp_path / name)[..., 0], want), name
    for stored, bits in ((array, 8), (array.astype("<u2") * 257, 16)):
        tags = {258: bits, 262: 1, 274: orientation}
        got = read(tiff(stored.tobytes(), WIDTH, HEIGHT, tags))
        assert np.allclose(got[..., 0], want, atol=1e-9)


def test_reduced_first_pages_are_passed_over(tmp_path, rng):
    array = values(rng, 3, np.uint8)
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        writer.write(np.zeros((2, 2, 3), np.uint8), photometric="rgb", subfiletype=1)
        writer.write(array, photometric="rgb")
    assert np.array_equal(read_image(tmp_path / "a.tif"), as_float(array))


# PNG


@pytest.mark.parametrize(("color", "samples"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_16_bits_of_pngs_are_kept(read, rng, color, samples):
    array = values(rng, samples, np.uint16)
    want = as_color(array if samples != 2 else array[..., (0, 0, 0, 1)])
    for interlaced in (False, True):
        got = read(png(array, color, 16, interlaced=interlaced))
        assert np.abs(got - want).max() < 1e-9


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("color", [0, 2])
def test_transparent_colors_of_pngs(read, rng, bits, color):
    if color == 2 and bits < 8:
        bits = 8
    array = rng.integers(0, 1 << bits, (HEIGHT, WIDTH, 3)[: 2 + color // 2])
    key = array[2, 3]
    got = read(png(array, color, bits, ((b"tRNS", np.asarray(key, ">u2").tobytes()),)))
    same = array == key if color == 0 else np.all(array == key, axis=2)
    assert np.array_equal(got[..., 3], 1.0 - same)
    if color == 0:
        array = np.stack((array,) * 3, axis=2)
    assert np.abs(got[..., :3] - array / ((1 << bits) - 1)).max() < 1e-9


def encoded(light):
    """The values of sRGB for linear light."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("gamma", [100000, 55556, 44000, 45000, 45455, 46000, round(1e5 / 2.3)])
def test_gamma_of_pngs(read, gamma):
    """One near that of sRGB is sRGB, as programs mean it."""
    array = np.arange(0, 256, dtype=np.uint8)[None]
    chunk = (b"gAMA", struct.pack(">I", gamma))
    got, want = read(png(array, 0, 8, (chunk,)))[0, :, 0], array[0] / 255
    if gamma > 50000:
        assert np.abs(got - encoded(want ** (100000 / gamma))).max() < 1e-4
    else:
        assert np.array_equal(got, want)
    assert np.array_equal(read(png(array, 0, 8, ((b"sRGB", b"\0"), chunk)))[0, :, 0], want)


# Profiles


def matrix_profile(primaries, gamma):
    """A profile of an RGB display with these primaries and the white D65; its colors as XYZ."""

    def xyz(x, y):
        return np.array([x / y, 1, (1 - x - y) / y])

    columns = np.array([xyz(*primary) for primary in primaries]).T
    columns = columns * np.linalg.solve(columns, xyz(*D65))
    ends = np.column_stack((primaries, np.ones(3))).ravel()
    profile = imagecodecs.cms_profile("rgb", whitepoint=(*D65, 1), primaries=ends, gamma=gamma)
    return profile, columns


D65 = 0.3127, 0.329
SRGB_PRIMARIES = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
P3_PRIMARIES = ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06))


def converted(stored, columns, gamma):
    _, srgb = matrix_profile(SRGB_PRIMARIES, 2.2)
    return encoded(np.clip(stored**gamma @ columns.T @ np.linalg.inv(srgb).T, 0, 1))


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "lzw.tif"])
def test_profiles_are_applied(tmp_path, rng, name):
    profile, columns = matrix_profile(P3_PRIMARIES, 2.2)
    array = rng.integers(40, 256, (2, 2, 3), np.uint8).repeat(16, 0).repeat(16, 1)
    options = {"compression": "tiff_lzw"} if name == "lzw.tif" else {}
    options |= {"quality": 100, "subsampling": 0} if name == "a.jpg" else {}
    Image.fromarray(array).save(tmp_path / name, icc_profile=profile, **options)
    want = converted(array / 255, columns, 2.2)
    assert np.abs(want - array / 255).max() > 0.02
    assert np.abs(read_image(tmp_path / name) - want).max() < 0.02


def test_profiles_keep_opacity_and_gray(tmp_path, rng):
    profile, columns = matrix_profile(P3_PRIMARIES, 1.0)
    array = rng.integers(0, 256, (8, 8, 4), np.uint8)
    Image.fromarray(array).save(tmp_path / "a.png", icc_profile=profile)
    got = read_image(tmp_path / "a.png")
    assert np.array_equal(got[..., 3], array[..., 3] / 255)
    assert np.abs(got[..., :3] - converted(array[..., :3] / 255, columns, 1)).max() < 0.02
    Image.fromarray(array[..., 0]).save(tmp_path / "b.png", icc_profile=profile)
    gray = np.broadcast_to(array[..., :1] / 255, (8, 8, 3))
    assert np.abs(read_image(tmp_path / "b.png") - converted(gray, columns, 1)).max() < 0.02


def test_16_bits_with_a_profile_are_converted_and_noted(read, rng):
    profile, columns = matrix_profile(P3_PRIMARIES, 2.2)
    array = values(rng, 3, np.uint16)
    data = png(array, 2, 16, ((b"iCCP", b"Wide\0\0" + zlib.compress(profile)),))
    with pytest.warns(ImageWarning, match="8 bits"):
        got = read(data)
    assert np.abs(got - converted(as_float(array), columns, 2.2)).max() < 0.02


# Other formats


def test_around_the_first_picture_of_a_gif_is_nothing(read, tmp_path):
    Image.new("P", (4, 4), 1).save(tmp_path / "a.gif")
    data = bytearray((tmp_path / "a.gif").read_bytes())
    assert data[6:10] == b"\4\0\4\0"
    data[6:10] = b"\6\0\7\0"
    place = data.index(b"\x2c\0\0\0\0\4\0\4\0")
    data[place + 1 : place + 5] = b"\1\0\2\0"
    alpha = np.zeros((7, 6))
    alpha[2:6, 1:5] = 1
    assert np.array_equal(read(bytes(data))[..., 3], alpha)


def test_largest_picture_of_an_icon(tmp_path):
    picture = Image.linear_gradient("L").convert("RGB")
    picture.save(tmp_path / "a.ico", sizes=[(16, 16), (256, 256), (48, 48)])
    assert np.array_equal(read_image(tmp_path / "a.ico"), np.asarray(picture) / 255)


def test_names_alone_make_no_image(read):
    for name in ("a.tga", "a.xpm", "a.eps"):
        with pytest.raises(FileError, match=r"unsupported kind|not read"):
            read(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", name)


def test_16_bits_of_other_formats(read, tmp_path, rng):
    """Gray keeps them; what is lost of colors is noted."""
    gray = values(rng, 1, np.uint16)
    head = f"{WIDTH} {HEIGHT}\n65535\n".encode()
    assert np.abs(read(b"P5\n" + head + gray.astype(">u2").tobytes()) - as_color(gray)).max() < 1e-9
    colors = values(rng, 3, np.uint16)
    with pytest.warns(ImageWarning, match="reduced to 8"):
        got = read(b"P6\n" + head + colors.astype(">u2").tobytes())
    assert np.abs(got - as_color(colors)).max() < 1 / 255


@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize("samples", [1, 2, 3, 4])
def test_bits_of_jpeg_2000_and_avif_are_kept(read, rng, bits, samples):
    shape = (HEIGHT, WIDTH, samples)[: 2 + (samples > 1)]
    array = rng.integers(0, 1 << bits, shape, np.uint16)
    kinds = [imagecodecs.jpeg2k_encode(array, bitspersample=bits, level=0, codecformat="jp2")]
    if bits < 16 and samples > 2:
        kinds.append(imagecodecs.avif_encode(array, bitspersample=bits, level=100))
    want = array.reshape(HEIGHT, WIDTH, -1) / ((1 << bits) - 1)
    want = want if samples > 2 else want[..., [0, 0, 0, 1][: 3 + (samples == 2)]]
    for data in kinds:
        assert np.abs(read(data) - want).max() < 1e-5


def test_sizes_within_jpeg_2000_are_checked(read, rng):
    """The box says 7 x 5 pixels, and the data would take 10 GB."""
    array = rng.integers(0, 4096, (HEIGHT, WIDTH, 3), np.uint16)
    data = imagecodecs.jpeg2k_encode(array, bitspersample=12, level=0, codecformat="jp2")
    place = data.index(b"\xff\x4f\xff\x51") + 8
    with pytest.raises(FileError, match="contradict"):
        read(data[:place] + struct.pack(">II", 30000, 30000) + data[place + 8 :])


def test_16_bits_for_three_colors_are_no_reduction(read):
    """A bitmap of 5, 6 and 5 bits a pixel holds fewer than 8 of a sample."""
    rows = np.full((4, 4), 0xF800, "<u2").tobytes()
    header = struct.pack("<IiiHHIIiiII3I", 40, 4, 4, 1, 16, 3, 32, 0, 0, 0, 0, 0xF800, 0x7E0, 0x1F)
    head = b"BM" + struct.pack("<IHHI", 66 + 32, 0, 0, 66)
    assert np.array_equal(read(head + header + rows)[0, 0], [1, 0, 0])


def test_valid_files_that_are_not_read_are_not_called_damaged(read):
    """A bitmap of 10, 10 and 10 bits, a PNG with a long text or profile, a TGA of 15 bits."""
    masks = 0x3FF00000, 0xFFC00, 0x3FF
    header = struct.pack("<IiiHHIIiiII3I", 40, 4, 4, 1, 32, 3, 64, 0, 0, 0, 0, *masks)
    bitmap = b"BM" + struct.pack("<IHHI", 66 + 64, 0, 0, 66) + header + bytes(64)
    long = zlib.compress(bytes(3 << 20))
    array = np.zeros((4, 4), np.uint8)
    targa = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 4, 4, 15, 0) + bytes(64)
    for data, name, words in (
        (bitmap, "a.bmp", "bitfields"), (targa, "a.tga", "TGA"),
        (png(array, 0, 8, ((b"zTXt", b"a\0\0" + long),)), "a.png", "more than 1 MB"),
        (png(array, 0, 8, ((b"iCCP", b"a\0\0" + long),)), "b.png", "more than 1 MB"),
    ):  # fmt: skip
        with pytest.raises(FileError, match=rf"is of an unsupported kind \(.*{words}"):
            read(data, name)


@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
@pytest.mark.parametrize("kind", ["QOI", "DDS"])
@pytest.mark.full
def test_large_files_of_rare_kinds_are_read_soon(tmp_path, rng, kind, mode):
    """Pillow decodes them in Python: 4 megapixels took 8 s."""
    array = rng.integers(0, 256, (2000, 2000, len(mode)), np.uint8)
    Image.fromarray(array).save(tmp_path / "a", kind)
    began = time.process_time()
    got = read_image(tmp_path / "a")
    assert time.process_time() - began < 2
    assert np.array_equal(got, array / 255)


@pytest.mark.parametrize(
    ("bits", "masks"),
    [
        (16, (0xF800, 0x7E0, 0x1F)), (16, (0x7C00, 0x3E0, 0x1F, 0x8000)),
        (24, (0xFF0000, 0xFF00, 0xFF)), (32, (0x3FF, 0xFFC00, 0x3FF00000, 0xC0000000)),
    ],
)  # fmt: skip
def test_channels_of_dds(read, rng, bits, masks):
    values = [rng.integers(0, mask // (mask & -mask), 20, endpoint=True) for mask in masks]
    numbers = sum(each * (mask & -mask) for each, mask in zip(values, masks, strict=True))
    rows = numbers.astype("<u4").view(np.uint8).reshape(20, 4)[:, : bits // 8].tobytes()
    every = (*masks, 0)[:4]
    flags = 0x40 | (len(masks) == 4)
    header = struct.pack("<7I44x", 124, 0x1007, 4, 5, 0, 0, 0)
    header += struct.pack("<13I", 32, flags, 0, bits, *every, 0x1000, 0, 0, 0, 0)
    got = read(b"DDS " + header + rows).reshape(20, -1)
    want = np.transpose(values) / [mask // (mask & -mask) for mask in masks]
    assert np.abs(got - want).max() < 0.51 / 255


@pytest.mark.parametrize("suffix", ["gif", "png", "webp", "avif"])
def test_animations_are_noted_and_stills_are_not(tmp_path, suffix):
    frames = [Image.new("RGB", (8, 8), color) for color in ("red", "blue")]
    file = tmp_path / f"a.{suffix}"
    if file.suffix not in Image.registered_extensions():
        pytest.skip("this Pillow has no AVIF")
    frames[0].save(file)
    assert np.abs(read_image(file) - [1, 0, 0]).max() < 0.02
    frames[0].save(file, save_all=True, append_images=frames[1:])
    with pytest.warns(ImageWarning, match="several pictures: its first is taken"):
        assert np.abs(read_image(file) - [1, 0, 0]).max() < 0.02


def test_several_pages_are_noted(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((3, 8, 8, 3), np.uint8), photometric="rgb")
    with pytest.warns(ImageWarning, match="several pages"):
        read_image(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((8, 8, 3), np.uint8), photometric="rgb")
    read_image(tmp_path / "a.tif")


# Damage


def test_messages_are_one_printable_line(tmp_path):
    file = tmp_path / ("a\n\x1b[31m\udcff" + "x" * 150 + ".png")
    for data in (b"", b"\x89PNG\r\n\x1a\n", b"II*\0"):
        file.write_bytes(data)
        with pytest.raises(FileError):
            read_image(file)
    with pytest.raises(FileError, match="too long") as caught:
        read_image(tmp_path / ("\n" * 3000))
    assert len(str(caught.value)) <= 1000


def test_whatever_a_decoder_raises_is_told_as_ours(tmp_path, monkeypatch):
    file = tmp_path / "a.png"
    Image.new("L", (4, 4)).save(file)
    errors = zlib.error("x\ny"), KeyError("a"), RecursionError(), struct.error(""), Warning()
    for error in (*errors, KeyboardInterrupt()):
        fail = Mock(side_effect=error)
        monkeypatch.setattr("clmorph.images.reading.decoding.open_picture", fail)
        with pytest.raises(FileError if error in errors else KeyboardInterrupt) as caught:
            read_image(file)
        assert error in (caught.value, caught.value.__cause__)


def test_bombs_are_refused(read):
    """Files of a few KB that say, or hold, much more than they are."""
    bombs = {
        "samples": tiff(bytes(64), 100, 100, {258: 8, 262: 2, 277: 60000}),
        "missing": tiff(bytes(64), 7900, 7900, {258: (16,) * 3, 262: 2, 277: 3, 279: 375 << 20}),
        "strips": tiff(bytes(64), 1, 600000, {258: 8, 262: 1, 278: 1, 273: (8,) * 600000}),
        "side": png(np.zeros((1, 1)), 0, 8)[:16] + struct.pack(">II", 1 << 30, 1 << 30),
    }  # fmt: skip
    inner = png(np.zeros((1, 1), int), 0, 1)
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 12000, 12000, 1, 0, 0, 0, 0))
    inner = inner[:8] + header + inner[33:]
    bombs["icon"] = (
        struct.pack("<HHH", 0, 1, 1) + struct.pack("<BBBBHHII", 0, 0, 0, 0, 1, 32, len(inner), 22)
        + inner
    )  # fmt: skip
    for name, data in bombs.items():
        with pytest.raises(FileError):
            read(data, name)


# Global state


def test_threads_leave_no_trace(tmp_path):
    """Many reads at once: filters of warnings and Pillow's guard are never other ones."""
    files = []
    for name in ("a.png", "a.jpg", "a.gif", "a.webp", "a.tif", "cut.png"):
        Image.linear_gradient("L").convert("RGB").save(tmp_path / name)
        files.append(tmp_path / name)
    files[-1].write_bytes(files[-1].read_bytes()[:100])
    read_image(files[0])

    def state():
        return (
            Image.MAX_IMAGE_PIXELS, warnings.filters, list(warnings.filters),
            warnings.showwarning, warnings._showwarning_orig,
        )  # fmt: skip

    before, failed, done = state(), [], threading.Event()

    def work(start):
        for index in range(24):
            try:
                read_image(files[(start + index) % len(files)])
            except FileError:
                continue
            except BaseException as error:
                failed.append(error)

    def watch():
        while not done.is_set():
            now = state()
            if now != before or now[1] is not before[1]:
                failed.append(now)
                return

    watcher = threading.Thread(target=watch)
    watcher.start()
    with ThreadPoolExecutor(8) as threads:
        threads.map(work, range(8))
    done.set()
    watcher.join()
    assert not failed
    assert state() == before


# The command line


def test_the_command_prints_notes_and_no_remarks_of_libraries(
    tmp_path, capfd, monkeypatch, refused
):
    """Our warnings are notes; what Pillow remarks on damaged metadata is not printed."""
    from clmorph.cli.main import main

    monkeypatch.chdir(tmp_path)
    frames = [Image.new("RGB", (5, 4), color) for color in ("red", "blue")]
    frames[0].save("a.gif", save_all=True, append_images=frames[1:])
    exif = tiff(b"", 1, 1, {274: 1})
    frames[1].save("b.jpg", exif=b"Exif\0\0" + exif[:-9])  # cut off
    monkeypatch.setattr(warnings, "filters", [("default", None, Warning, None, 0)])
    options = ["--size", "4", "--frames", "3", "--backend", "numpy", "--max-iter", "20"]
    assert main(["morph", "a.gif", "b.jpg", "-o", "out.png", *options]) == 0
    lines = capfd.readouterr().err.splitlines()
    assert "note: a.gif has several pictures: its first is taken" in lines
    assert all(line.startswith(("device:", "preset:", "memory:", "note:")) for line in lines), lines
    frames[1].save("c.tif", compression="tiff_lzw")
    data = (tmp_path / "c.tif").read_bytes()
    (tmp_path / "c.tif").write_bytes(data[:9] + b"\xff" * 20 + data[29:])  # libtiff prints itself
    told = refused("morph", "a.gif", "c.tif", "-o", "out.png", *options)
    assert "c.tif cannot be decoded" in told
    tags = {258: 8, 262: 1, 277: (11,) * 300, 270: b"clmorph" * 3}
    (tmp_path / "in.tif").write_bytes(tiff(bytes(1), 1, 1, tags)[:-9])
    refused("morph", "--config", "in.tif", "-o", "out.png")


# What ordinary programs write


def xmp_of(orientation):
    return f'<x:xmpmeta><rdf:Description tiff:Orientation="{orientation}"/>'.encode()


@pytest.mark.parametrize("own", [None, 1, 3, 9])
def test_xmp_is_asked_only_if_exif_does_not_tell(tmp_path, rng, own):
    """As `PIL.ImageOps.exif_transpose` does."""
    exif = Image.Exif()
    exif[0x010E] = "a picture"
    if own is not None:
        exif[0x0112] = own
    picture = Image.fromarray(values(rng, 3, np.uint8))
    for name in ("a.webp", "a.jpg"):
        if name == "a.webp":
            picture.save(tmp_path / name, exif=exif, xmp=xmp_of(6), lossless=True)
        else:
            picture.save(tmp_path / name, exif=exif, quality=100, subsampling=0)
            data = (tmp_path / name).read_bytes()
            packet = b"http://ns.adobe.com/xap/1.0/\0" + xmp_of(6)
            marker = b"\xff\xe1" + struct.pack(">H", len(packet) + 2) + packet
            (tmp_path / name).write_bytes(data[:2] + marker + data[2:])
        with Image.open(tmp_path / name) as opened:
            want = np.asarray(ImageOps.exif_transpose(opened)) / 255
        assert want.shape[0] == (WIDTH if own is None else HEIGHT)
        assert np.array_equal(read_image(tmp_path / name), want)


@pytest.mark.parametrize("own", [None, 1])
@pytest.mark.parametrize("bits", [8, 16])
def test_xmp_of_tiffs(read, rng, own, bits):
    array = values(rng, 1, np.uint8)
    stored = array if bits == 8 else array.astype("<u2") * 257
    got = read(tiff(stored.tobytes(), WIDTH, HEIGHT, {258: bits, 262: 1, 274: own, 700: xmp_of(6)}))
    want = array if own else oriented(array, 6)
    assert np.allclose(got[..., 0], want / 255, atol=1e-9)


def test_damaged_exif_in_text_does_not_matter(read):
    chunk = (b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(b"\nexif\n  4\nzzzz\n"))
    assert read(png(np.zeros((2, 2)), 0, 8, (chunk,))).shape == (2, 2, 3)


def test_profiles_are_known_by_what_they_do(tmp_path, rng):
    """Names do not tell: not that of a linear profile, nor that of sRGB itself."""
    array = rng.integers(0, 256, (8, 8, 3), np.uint8)
    picture = Image.fromarray(array)
    profile, columns = matrix_profile(SRGB_PRIMARIES, 1.0)
    names = (name.encode("utf-16-be") for name in ("RGB built-in", "sRGB, linear"))
    named = profile.replace(*names)
    assert named != profile
    picture.save(tmp_path / "a.png", icc_profile=named)
    want = converted(array / 255, columns, 1)
    assert np.abs(want - array / 255).max() > 0.1
    assert np.abs(read_image(tmp_path / "a.png") - want).max() < 0.01
    own = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for data in (own, own.replace("sRGB".encode("utf-16-be"), "mine".encode("utf-16-be"))):
        picture.save(tmp_path / "b.png", icc_profile=data)
        assert np.array_equal(read_image(tmp_path / "b.png"), array / 255)


GRAY_PROFILE = imagecodecs.cms_profile("gray", whitepoint=(*D65, 1), gamma=1.0)


@pytest.mark.parametrize("mode", ["L", "LA"])
def test_profiles_of_gray_are_applied(tmp_path, rng, mode):
    array = rng.integers(0, 256, (8, 8, 2), np.uint8)
    stored = array if mode == "LA" else array[..., 0]
    Image.fromarray(stored).save(tmp_path / "a.png", icc_profile=GRAY_PROFILE)
    got = read_image(tmp_path / "a.png")
    assert np.abs(got[..., :3] - encoded(array[..., :1] / 255)).max() < 0.01
    if mode == "LA":
        assert np.array_equal(got[..., 3], array[..., 1] / 255)


def test_notes_about_profiles_are_sentences(tmp_path):
    Image.new("RGB", (4, 4), "red").save(tmp_path / "a.png", icc_profile=GRAY_PROFILE)
    with pytest.warns(ImageWarning) as caught:
        assert read_image(tmp_path / "a.png")[0, 0].tolist() == [1, 0, 0]
    assert str(caught[0].message) == (
        f"{tmp_path / 'a.png'} has a color profile, 'gray built-in', that is for other colors "
        "than its RGB: the colors are taken as sRGB; convert the image to sRGB first for exact ones"
    )
    Image.new("RGB", (4, 4), "red").save(tmp_path / "a.png", icc_profile=b"nothing")
    with pytest.warns(ImageWarning, match="has a color profile, unreadable, that cannot be used: "):
        assert read_image(tmp_path / "a.png")[0, 0].tolist() == [1, 0, 0]


def test_large_tiffs_are_told_the_limit(read):
    with pytest.raises(FileError, match=r"20000 x 20000 pixels.*max-pixels"):
        read(tiff(bytes(8), 20000, 20000, {258: 8, 262: 1}))
    tags = {258: 8, 262: 1, 273: None, 279: None, 278: None, 322: 65536, 323: 65536, 324: 8, 325: 8}
    with pytest.raises(FileError, match="in 1 piece of 65536 x 65536 pixels"):
        read(tiff(bytes(8), 8, 8, tags))


def test_sparse_tiffs_are_refused_by_name(read):
    tags = {258: 8, 262: 1, 278: 4, 273: (8, 0), 279: (32, 0)}
    with pytest.raises(FileError, match=r"sparse files.*SPARSE_OK=FALSE"):
        read(tiff(bytes(32), 8, 8, tags))


def test_pieces_that_hold_too_much_are_refused(read, tmp_path):
    """No decoder makes more of a strip than its tags say."""
    packed = zlib.compress(bytes(40 << 20))
    with pytest.raises(FileError, match="INSUFFICIENT_SPACE"):
        read(tiff(packed, 8, 8, {258: 8, 259: 8, 262: 1}))
    for name, number in (("JPEG", 7), ("WebP", 50001)):
        Image.new("RGB", (64, 64)).save(tmp_path / "a", name)
        data = (tmp_path / "a").read_bytes()
        with pytest.raises(FileError, match="more than its tags say"):
            read(tiff(data, 8, 8, {258: (8,) * 3, 259: number, 262: 2, 277: 3}))


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "a HEIC picture"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "a HEIC picture"),
        (b"icns\0\0\1\0", "kind ICNS"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n", "kind EPS"),
        (b"#define a_width 8\n#define a_height 8\nstatic char a_bits[] = {", "kind XBM"),
        (b"<svg xmlns=''>", "an SVG drawing"),
    ],
)
def test_kinds_that_are_not_read_are_told(read, start, kind):
    with pytest.raises(FileError, match=f"is .*{kind}, which is not read; .*convert it to PNG"):
        read(start.ljust(100, b"\0"))
    with pytest.raises(FileError, match=r"is not an image that is read; .*convert it to PNG"):
        read(b"nothing in particular")


def test_scans_are_counted_by_what_is_allowed(tmp_path, read, monkeypatch):
    """Ten scans are ordinary: of any picture that is not too large, they are read."""
    Image.linear_gradient("L").convert("RGB").save(tmp_path / "a.jpg", progressive=True)
    data = (tmp_path / "a.jpg").read_bytes()
    assert data.count(b"\xff\xda") > 5
    scan = data[data.rindex(b"\xff\xda") : -2]
    with pytest.raises(FileError, match="scans"):
        read(data[:-2] + scan * 100 + data[-2:])
    monkeypatch.setattr("clmorph.images.reading.opening.MAX_SCANNED", 1000)
    assert read(data, max_pixels=65536).shape == (256, 256, 3)
    with pytest.raises(FileError, match=r"scans: expected at most 16 .*as a plain JPEG"):
        read(data[:-2] + scan * 20 + data[-2:], max_pixels=65536)


def test_common_files_do_not_load_every_plugin(tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    code = (
        "import sys; from clmorph import read_image; read_image(sys.argv[1]); "
        "sys.exit('PIL.FpxImagePlugin' in sys.modules or 'PIL.SgiImagePlugin' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.png")]).returncode == 0


def ordinary_files(folder):
    """Write what programs write every day: name, and how near Pillow's own reading is."""
    y, x = np.mgrid[:24, :32]
    array = np.stack((x * 8, y * 10, (x + y) * 4), axis=2).astype(np.uint8)
    picture = Image.fromarray(array)
    alpha = Image.fromarray((x * 8).astype(np.uint8))
    clear = picture.copy()
    clear.putalpha(alpha)
    palette = picture.quantize(16)
    gray = picture.convert("L")
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = Image.Exif()
    exif[0x0112] = 8
    second = picture.rotate(180)
    written = {
        "plain.jpg": (picture, {}), "progressive.jpg": (picture, {"progressive": True}),
        "profile.jpg": (picture, {"icc_profile": srgb}), "turned.jpg": (picture, {"exif": exif}),
        "gray.jpg": (gray, {}), "ink.jpg": (picture.convert("CMYK"), {}),
        "rgb.jpg": (picture, {"keep_rgb": True}), "444.jpg": (picture, {"subsampling": 0}),
        "phone.mpo": (picture, {"save_all": True, "append_images": [second]}),
        "plain.png": (picture, {}), "gray.png": (gray, {}), "clear.png": (clear, {}),
        "gray_clear.png": (clear.convert("LA"), {}), "palette.png": (palette, {}),
        "palette_clear.png": (palette, {"transparency": 3}), "bits.png": (gray.convert("1"), {}),
        "key.png": (picture, {"transparency": (0, 0, 0)}),
        "profile.png": (clear, {"icc_profile": srgb}),
        "lossless.webp": (clear, {"lossless": True, "exact": True}), "lossy.webp": (picture, {}),
        "turned.webp": (picture, {"exif": exif}), "clear.gif": (palette, {"transparency": 3}),
        "plain.gif": (palette, {}), "gray.gif": (gray, {}), "plain.bmp": (picture, {}),
        "palette.bmp": (palette, {}), "gray.bmp": (gray, {}), "clear.bmp": (clear, {}),
        "bits.bmp": (gray.convert("1"), {}), "plain.tif": (picture, {}), "clear.tif": (clear, {}),
        "lzw.tif": (picture, {"compression": "tiff_lzw"}),
        "fax.tif": (gray.convert("1"), {"compression": "group4"}),
        "jpeg.tif": (picture, {"compression": "jpeg"}), "palette.tif": (palette, {}),
        "ink.tif": (picture.convert("CMYK"), {}), "profile.tif": (picture, {"icc_profile": srgb}),
        "plain.jp2": (picture, {}), "clear.jp2": (clear, {}), "plain.tga": (picture, {}),
        "clear.tga": (clear, {}), "plain.ppm": (picture, {}), "gray.pgm": (gray, {}),
        "plain.pcx": (picture, {}), "plain.sgi": (picture, {}), "clear.dds": (clear, {}),
        "bitmap.ico": (clear, {"bitmap_format": "bmp", "sizes": [(24, 24)]}),
        "plain.ico": (clear, {"sizes": [(24, 24)]}),
        "solid.ico": (picture, {"bitmap_format": "bmp", "sizes": [(24, 24)]}),
        "palette.ico": (palette, {"bitmap_format": "bmp", "sizes": [(16, 16)]}),
    }  # fmt: skip
    for name, (saved, options) in written.items():
        saved.save(folder / name, **options)
        yield folder / name
    stuff = ((b"gAMA", struct.pack(">I", 45455)), (b"cHRM", struct.pack(
        ">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)),
        (b"pHYs", struct.pack(">IIB", 2835, 2835, 1)))  # fmt: skip
    profile = (b"iCCP", b"sRGB\0\0" + zlib.compress(srgb))
    for name, chunks in (
        ("gamma.png", stuff), ("both.png", ((b"sRGB", b"\0"), *stuff)),
        ("profile_gamma.png", (profile, *stuff)),
        ("all.png", (profile, (b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 100000)))),
    ):  # fmt: skip
        (folder / name).write_bytes(png(array, 2, 8, chunks))
        yield folder / name


def test_ordinary_files_are_read_as_pillow_reads_them(tmp_path):
    for file in ordinary_files(tmp_path):
        with Image.open(file) as opened:
            turned = ImageOps.exif_transpose(opened)
            want = np.asarray(turned.convert("RGBA")) / 255
        got = read_image(file)
        if got.shape[2] == 3:
            got = np.dstack((got, np.ones(got.shape[:2])))
        assert got.shape == want.shape, file.name
        assert np.abs(got - want).max() < (0.02 if "ink" in file.name else 1e-9), file.name
