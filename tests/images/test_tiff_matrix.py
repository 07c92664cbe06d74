"""TIFFs of all kinds are read as they were written, and as libvips reads them.

The matrix: samples x photometric x opacity x planes x compression x byte order x tiles x predictor.
The stored numbers are known, and libvips, which shares no code with tifffile, confirms what the
file says wherever it reads such a file at all.
"""

import itertools
import subprocess
import sys

import numpy as np
import pytest
import pyvips
import tifffile
from pictures import tiff
from PIL import Image

from clmorph import read_image
from clmorph.errors import FileError

HEIGHT, WIDTH = 19, 24
SAMPLES = ("u1", "u2", "u4", "f2", "f4", "f8")
COLORS = {"palette": 1, "minisblack": 1, "miniswhite": 1, "rgb": 3, "separated": 4}
COMPRESSIONS = ("none", "lzw", "packbits", "zlib", "lzma", "zstd")
ALPHAS = (None, "unassalpha", "assocalpha", "unspecified")

pyvips.cache_set_max(0)


def stored_samples(rng, samples, count, alpha):
    """Random samples, with colors up to the opacity where they are multiplied by it."""
    dtype = np.dtype(samples)
    shape = (HEIGHT, WIDTH, count + (alpha is not None))
    if dtype.kind == "f":
        array = rng.random(shape).astype(dtype)
    else:
        array = rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    if alpha == "assocalpha":
        array[..., :count] = np.minimum(array[..., :count], array[..., count:])
        array[0, 0] = 0
    return array


def seen(array, photometric, alpha, palette):
    """What an image of these samples shows: colors, and opacity or None."""
    count = COLORS[photometric]
    if photometric == "palette":
        return np.moveaxis(palette, 0, -1)[array[..., 0]] / 65535, None
    largest = 1 if array.dtype.kind == "f" else np.iinfo(array.dtype).max
    values = array.astype(float) / largest
    colors, opacity = values[..., :count], None
    if alpha in ("unassalpha", "assocalpha"):
        opacity = values[..., count]
        if alpha == "assocalpha":
            weight = opacity[..., None]
            colors = np.divide(colors, weight, out=np.zeros_like(colors), where=weight > 0)
    if photometric == "miniswhite":
        colors = 1 - colors
    if photometric == "separated":
        colors = (1 - colors[..., :3]) * (1 - colors[..., 3:])
    return np.broadcast_to(colors, (HEIGHT, WIDTH, 3)), opacity


def by_vips(file, samples, photometric, alpha, planar, tiled):
    """What libvips reads, as `seen`; None where it refuses the file, or reads it as nobody does."""
    gray_planes = planar == "separate" and not tiled and COLORS[photometric] == 1
    if gray_planes or (samples == "f2" and planar == "separate"):
        return None  # it takes the rows of one plane for the other's
    if alpha == "assocalpha" and samples not in ("u1", "u2"):
        return None  # it divides by opacities of 255
    if photometric == "miniswhite" and samples.startswith("f"):
        return None  # it does not invert floats
    try:
        picture = pyvips.Image.new_from_file(str(file), fail_on="warning")
        values = picture.numpy().reshape(picture.height, picture.width, -1)
    except pyvips.Error:
        return None
    largest = {"uchar": 255, "ushort": 65535, "uint": 2**32 - 1}.get(picture.format, 1)
    values = values / largest
    count = picture.bands - (alpha is not None)
    if count not in {"rgb": (3,), "palette": (1, 3), "separated": (4,)}.get(photometric, (1,)):
        return None
    colors, opacity = values[..., :count], None
    if alpha in ("unassalpha", "assocalpha"):
        opacity = values[..., count]
    if photometric == "separated":
        colors = (1 - colors[..., :3]) * (1 - colors[..., 3:])
    return np.broadcast_to(colors, (*values.shape[:2], 3)), opacity


def difference(got, want):
    """The largest difference of two pictures, of colors only where they are seen."""
    colors, opacity = want
    alpha = got[..., 3] if got.shape[2] == 4 else np.ones(got.shape[:2])
    opacity = np.ones(got.shape[:2]) if opacity is None else opacity
    shown = (alpha > 0) & (opacity > 0)
    return max(np.abs(alpha - opacity).max(), np.abs(got[..., :3] - colors)[shown].max())


def variants(samples, photometric, compression):
    """The rest of the matrix, as far as such files exist."""
    predictors = [None]
    if compression not in ("none", "packbits"):
        predictors.append("floatingpoint" if samples.startswith("f") else "horizontal")
    alphas = ALPHAS
    if photometric in ("separated", "miniswhite"):
        alphas = [alpha for alpha in alphas if alpha != "assocalpha"]
    if photometric == "palette":
        alphas = (None,)
    for alpha, planar, order, tiled, predictor in itertools.product(
        alphas, ("contig", "separate"), "<>", (False, True), predictors
    ):
        if planar == "contig" or COLORS[photometric] + (alpha is not None) > 1:
            yield alpha, planar, order, tiled, predictor


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("photometric", COLORS)
@pytest.mark.parametrize("samples", SAMPLES)
def test_matrix(tmp_path, rng, samples, photometric, compression):
    if photometric == "palette" and samples != "u1":
        pytest.skip("no palette has so many colors")
    palette = rng.integers(0, 256, (3, 256)).astype(np.uint16) * np.uint16(257)
    confirmed = 0
    for number, (alpha, planar, order, tiled, predictor) in enumerate(
        variants(samples, photometric, compression)
    ):
        array = stored_samples(rng, samples, COLORS[photometric], alpha)
        file = tmp_path / f"{number}.tif"
        kept = array if planar == "contig" else np.moveaxis(array, -1, 0)
        tifffile.imwrite(
            file, np.ascontiguousarray(kept[..., 0] if array.shape[2] == 1 else kept),
            photometric=photometric, planarconfig=planar if array.shape[2] > 1 else None,
            compression=None if compression == "none" else compression, byteorder=order,
            extrasamples=None if alpha is None else [alpha], tile=(16, 16) if tiled else None,
            rowsperstrip=None if tiled else 7, predictor=predictor or False, metadata=None,
            bigtiff=number % 3 == 1,
            colormap=palette if photometric == "palette" else None,
        )  # fmt: skip
        case = (alpha, planar, order, tiled, predictor)
        got = read_image(file)
        want = seen(array, photometric, alpha, palette)
        assert difference(got, want) < 1e-6, case
        judge = by_vips(file, samples, photometric, alpha, planar, tiled)
        if judge is not None:
            # Integer levels are rounded where libvips divides by opacity.
            tolerance = 2e-6 if samples[1] > "2" else 1.01 / 255
            assert difference(got, judge) < tolerance, case
            confirmed += 1
    if samples in ("u1", "u2", "u4") and compression not in ("lzma", "zstd"):
        assert confirmed >= number / 4


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("bits", [1, 2, 4, 10, 12])
@pytest.mark.parametrize("photometric", [0, 1, 2, 3])
def test_packed_samples(read, rng, bits, photometric, order):
    """Samples that share bytes; tifffile itself does not write all of them as the standard says."""
    count = 3 if photometric == 2 else 1
    array = rng.integers(0, 1 << bits, (HEIGHT, WIDTH, count))
    planes = (array[..., None] >> np.arange(bits)[::-1]) & 1
    data = np.packbits(planes.reshape(HEIGHT, -1).astype(np.uint8), axis=1).tobytes()
    palette = rng.integers(0, 256, (1 << bits, 3))
    tags = {258: (bits,) * count, 262: photometric, 277: count}
    if photometric == 3:
        tags[320] = tuple(int(value) * 257 for value in palette.T.ravel())
    want = palette[array[..., 0]] / 255 if photometric == 3 else array / ((1 << bits) - 1)
    want = 1 - want if photometric == 0 else want
    assert np.abs(read(tiff(data, WIDTH, HEIGHT, tags, order)) - want).max() < 1e-9


@pytest.mark.parametrize("mode", ["RGB", "L", "CMYK", "YCbCr", "WebP"])
def test_pieces_that_are_pictures(tmp_path, mode):
    """JPEG and WebP in TIFFs."""
    y, x = np.mgrid[:40, :56]
    picture = Image.fromarray(np.stack((x * 4, y * 6, x + y), axis=2).astype(np.uint8))
    file = tmp_path / "a.tif"
    if mode == "WebP":
        tifffile.imwrite(file, np.asarray(picture), compression="webp", photometric="rgb")
        want = picture
    else:
        picture.convert(mode).save(file, compression="jpeg", quality=95)
        want = pyvips.Image.new_from_file(str(file)).numpy()
        want = picture.convert(mode) if mode == "CMYK" else Image.fromarray(want)
    got = read_image(file)
    assert np.abs(got - np.asarray(want.convert("RGB")) / 255).max() < 0.08


@pytest.mark.parametrize("value", [2.0, -0.5, np.nan, np.inf])
def test_floats_that_are_no_colors_are_refused_by_name(tmp_path, value):
    tifffile.imwrite(tmp_path / "a.tif", np.full((4, 4), value, np.float32))
    with pytest.raises(FileError, match=r"a\.tif holds (values|NaN)"):
        read_image(tmp_path / "a.tif")


def test_kinds_that_are_not_read_are_not_called_damaged(read):
    for tags in ({258: 8, 259: 32809}, {258: 8, 262: 32845}, {258: (5, 6, 5), 262: 2, 277: 3}):
        with pytest.raises(FileError) as caught:
            read(tiff(bytes(64), 4, 4, {262: 1, **tags}))
        assert "complete" not in str(caught.value)


def test_decoders_write_nothing_to_the_terminal(tmp_path):
    odd = tiff(bytes(64), 8, 8, {258: 8, 262: 1, 296: 77, 338: 99})  # tifffile logs such numbers
    code = "import sys, clmorph; print(clmorph.read_image(sys.argv[1]).shape)"
    (tmp_path / "a.tif").write_bytes(odd)
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "a.tif"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("(8, 8, 3)\n", "")
