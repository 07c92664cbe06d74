"""Colors are converted from the space that a file names, wherever it names it.

The expected values follow from ITU-T H.273; those of PQ are what browsers show.
"""

import struct
import warnings
import zlib

import imagecodecs
import numpy as np
import pytest
from pictures import png
from PIL import Image
from test_reading import P3_PRIMARIES, converted, matrix_profile

from clmorph import ImageWarning
from clmorph.errors import FileError

#: Primaries, transfer, stored 8 bits, and sRGB of 8 bits.
CODED = [
    (12, 13, (200, 100, 100), (215, 93, 97)),
    (9, 16, (148, 148, 148), (187, 187, 187)),
    (1, 8, (55, 55, 55), (128, 128, 128)),
    (1, 13, (200, 100, 50), (200, 100, 50)),
    (2, 2, (200, 100, 50), (200, 100, 50)),
    (1, 1, (200, 100, 50), (200, 100, 50)),
    (9, 13, (120, 120, 120), (120, 120, 120)),
    (1, 4, (100, 100, 100), (100, 100, 100)),
    (9, 18, (0, 0, 0), (0, 0, 0)),
    (9, 18, (255, 255, 255), (255, 255, 255)),
    (9, 16, (255, 255, 255), (255, 255, 255)),
    (11, 17, (0, 0, 0), (0, 0, 0)),
]


def flat(color):
    return np.full((16, 16, 3), color, np.uint8)


def cicp(primaries, transfer, matrix=0, whole=1):
    return (b"cICP", bytes((primaries, transfer, matrix, whole)))


@pytest.mark.parametrize(("primaries", "transfer", "stored", "want"), CODED)
def test_codes(read, primaries, transfer, stored, want):
    chunks = (cicp(primaries, transfer),)
    files = [png(flat(stored), 2, 8, chunks), png(flat(stored).astype(int) * 257, 2, 16, chunks)]
    if len(set(stored)) == 1:  # gray too
        files.append(png(flat(stored)[..., 0], 0, 8, chunks))
    for data in files:
        assert np.abs(read(data) * 255 - want).max() < 1.01
    data = imagecodecs.avif_encode(
        flat(stored), level=100, primaries=primaries, transfer=transfer, matrix=6, speed=10
    )
    assert np.abs(read(data) * 255 - want).max() < 2.01


def test_ten_bits_of_pq(read):
    for bits, value in ((10, 593), (12, 2374)):
        array = np.full((16, 16, 3), value, np.uint16)
        data = imagecodecs.avif_encode(
            array, level=100, bitspersample=bits, primaries=9, transfer=16, matrix=9
        )
        assert np.abs(read(data) * 255 - 187).max() < 1.01


def test_codes_overrule_gamma_and_profiles(read):
    profile, _ = matrix_profile(P3_PRIMARIES, 1.0)
    others = (
        (b"gAMA", struct.pack(">I", 100000)), (b"sRGB", b"\0"),
        (b"iCCP", b"Wide\0\0" + zlib.compress(profile)),
    )  # fmt: skip
    array = flat((200, 100, 50))
    assert np.array_equal(read(png(array, 2, 8, (cicp(1, 13), *others))), array / 255)


@pytest.mark.parametrize("chunk", [cicp(1, 11), cicp(77, 13), cicp(1, 13, 0, 0)])
def test_codes_that_are_not_known_are_noted(read, chunk):
    array = flat((200, 100, 50))
    with pytest.warns(ImageWarning, match="color codes that are not known|narrow range"):
        assert np.array_equal(read(png(array, 2, 8, (chunk,))), array / 255)


def chromaticities(primaries):
    numbers = [0.3127, 0.329, *np.ravel(primaries)]
    return (b"cHRM", struct.pack(">8I", *(round(float(n) * 100000) for n in numbers)))


def test_primaries_of_pngs(read, rng):
    _, columns = matrix_profile(P3_PRIMARIES, 2.2)
    array = rng.integers(40, 256, (8, 8, 3), np.uint8)
    gamma = (b"gAMA", struct.pack(">I", 100000))
    wide = chromaticities(P3_PRIMARIES)
    got = read(png(array, 2, 8, (gamma, wide)))
    assert np.abs(got - converted(array / 255, columns, 1)).max() < 2e-3
    # Without a gamma the curve is that of sRGB, as with the code of Display P3.
    named, coded = (read(png(array, 2, 8, (chunk,))) for chunk in (wide, cicp(12, 13)))
    assert np.abs(named - coded).max() < 1e-4
    # Primaries among which white is not are nobody's.
    nobodys = chromaticities([(0.3, 0.3)] * 3)
    assert np.array_equal(read(png(array, 2, 8, (nobodys,))), array / 255)


def bitmap(array, kind, profile=b"", ends=(0,) * 9, gammas=(0,) * 3):
    """A BMP of version 5 with 24 bits a pixel."""
    rows = array[::-1, :, ::-1].tobytes()  # widths of the tests are multiples of 4
    header = struct.pack(
        "<IiiHHIIiiIIIIII4s9i3IIIII", 124, array.shape[1], array.shape[0], 1, 24, 0, len(rows),
        2835, 2835, 0, 0, 0, 0, 0, 0, kind[::-1], *ends, *gammas, 4, 124 + len(rows), len(profile),
        0,
    )  # fmt: skip
    start = 14 + len(header)
    head = b"BM" + struct.pack("<IHHI", start + len(rows) + len(profile), 0, 0, start)
    return head + header + rows + profile


def test_spaces_of_bitmaps(read, rng):
    profile, columns = matrix_profile(P3_PRIMARIES, 2.2)
    array = rng.integers(40, 256, (8, 8, 3), np.uint8)
    want = converted(array / 255, columns, 2.2)
    assert np.abs(read(bitmap(array, b"MBED", profile)) - want).max() < 0.02
    ends = [(x / y, 1, (1 - x - y) / y) for x, y in ((0.3127, 0.329), *P3_PRIMARIES)]
    mixed = np.linalg.solve(np.array(ends[1:]).T, ends[0])
    stored = np.rint(np.ravel(np.array(ends[1:]) * mixed[:, None] / 4) * (1 << 30)).astype(int)
    want = read(bitmap(array, bytes(4), b"", stored, (round(2.2 * 65536),) * 3))
    got = read(png(array, 2, 8, (chromaticities(P3_PRIMARIES),)))
    assert np.abs(got - want).max() < 1e-3
    for kind in (b"sRGB", b"Win "):
        assert np.array_equal(read(bitmap(array, kind)), array / 255)
    with pytest.warns(ImageWarning, match="profile in another file"):
        read(bitmap(array, b"LINK", b"C:\\a.icc\0"))


def test_profiles_of_jpeg_2000(tmp_path, read, rng):
    profile, columns = matrix_profile(P3_PRIMARIES, 2.2)
    array = rng.integers(40, 256, (16, 16, 3), np.uint8)
    Image.fromarray(array).save(tmp_path / "a.jp2")
    data = (tmp_path / "a.jp2").read_bytes()
    place = data.index(b"colr") - 4
    old = int.from_bytes(data[place : place + 4], "big")
    box = struct.pack(">I", 11 + len(profile)) + b"colr\2\0\0" + profile
    header = data.index(b"jp2h") - 4
    size = int.from_bytes(data[header : header + 4], "big") + len(box) - old
    data = data[:place] + box + data[place + old :]
    data = data[:header] + struct.pack(">I", size) + data[header + 4 :]
    want = converted(array / 255, columns, 2.2)
    assert np.abs(read(data) - want).max() < 0.02


def test_damaged_descriptions_do_not_matter(read):
    array = flat((200, 100, 50))
    for chunk in ((b"cICP", b"\1"), (b"cHRM", bytes(32)), (b"cHRM", b"\xff" * 32)):
        with warnings.catch_warnings(action="ignore", category=ImageWarning):
            assert np.array_equal(read(png(array, 2, 8, (chunk,))), array / 255)
    with pytest.raises(FileError):
        read(bitmap(array, b"MBED", b"")[:-3])
