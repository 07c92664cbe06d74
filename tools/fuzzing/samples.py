"""Small valid image files of every kind that Pillow and tifffile write here."""

from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np
import tifffile
from PIL import Image, ImageCms

MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr", "LAB", "I;16", "I", "F")
#: Formats of Pillow, with ways to write each.
WRITERS: dict[str, list[dict[str, Any]]] = {
    "PNG": [{}, {"optimize": True}],
    "JPEG": [
        {}, {"progressive": True, "quality": 95}, {"subsampling": 0, "restart_marker_rows": 1},
    ],
    "WEBP": [{}, {"lossless": True}],
    "GIF": [{}, {"interlace": 0}],
    "BMP": [{}],
    "DIB": [{}],
    "TIFF": [
        {"compression": compression}
        for compression in (
            None, "tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg", "group3", "group4", "lzma",
            "zstd",
        )
    ],
    "AVIF": [{"speed": 10}],
    "JPEG2000": [{}, {"irreversible": True, "no_jp2": True}],
    "ICO": [{}, {"bitmap_format": "bmp"}],
    "TGA": [{}, {"compression": "tga_rle"}],
    "PPM": [{}],
    "QOI": [{}],
    "PCX": [{}],
    "SGI": [{}],
    "DDS": [{}, {"pixel_format": "DXT5"}],
    "MPO": [{}],
}  # fmt: skip
ANIMATED = ("PNG", "WEBP", "GIF", "AVIF", "TIFF", "MPO")


def _pictures() -> dict[str, Image.Image]:
    """One small picture of each mode."""
    y, x = np.mgrid[:13, :17]
    rgba = np.stack((x * 15, y * 19, (x ^ y) * 8, 255 - x * 9), axis=2).astype(np.uint8)
    whole = Image.fromarray(rgba)
    made = {}
    for mode in MODES:
        if mode == "I;16":
            made[mode] = Image.fromarray(rgba[..., 0].astype(np.uint16) * 257)
        elif mode == "LAB":
            made[mode] = Image.frombytes("LAB", whole.size, rgba[..., :3].tobytes())
        elif mode == "F":
            made[mode] = Image.fromarray(rgba[..., 0].astype(np.float32) / 255)
        elif mode == "PA":
            made[mode] = whole.convert("P").convert("PA")
        elif mode in ("LA", "RGBA"):
            made[mode] = whole.convert(mode)
        else:
            made[mode] = whole.convert("RGB").convert("L" if mode == "I" else mode).convert(mode)
    return made


def _saved(picture: Image.Image, kind: str, **options: Any) -> bytes | None:
    stream = BytesIO()
    try:
        picture.save(stream, kind, **options)
    except Exception:  # not every format takes every mode
        return None
    return stream.getvalue()


def _metadata() -> dict[str, Any]:
    exif = Image.Exif()
    exif[0x0112], exif[0x010E] = 6, "described"
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    return {"exif": exif, "icc_profile": profile}


def samples() -> Iterator[tuple[str, bytes]]:
    """Yield files: what each is, and its bytes."""
    pictures, metadata = _pictures(), _metadata()
    # The name says sRGB's, so that another one is what is converted by.
    foreign = (
        metadata["icc_profile"]
        .replace(b"sRGB", b"mine")
        .replace("sRGB".encode("utf-16-be"), "mine".encode("utf-16-be"))
    )
    for kind, ways in WRITERS.items():
        for index, options in enumerate(ways):
            for mode, picture in pictures.items():
                data = _saved(picture, kind, **options)
                if data is not None:
                    yield f"{kind} {mode} {index}", data
        for mode in ("L", "RGB", "RGBA", "CMYK"):
            for name, more in (
                ("metadata", metadata), ("profile", metadata | {"icc_profile": foreign}),
            ):  # fmt: skip
                data = _saved(pictures[mode], kind, **more)
                if data is not None:
                    yield f"{kind} {mode} {name}", data
        if kind in ANIMATED:
            others = [pictures[mode].convert("RGBA") for mode in ("L", "RGB")]
            first = pictures["RGBA"].convert("RGB" if kind == "MPO" else "RGBA")
            data = _saved(first, kind, save_all=True, append_images=others, duration=50)
            if data is not None:
                yield f"{kind} animated", data
    yield from _tiffs()


def _tiffs() -> Iterator[tuple[str, bytes]]:
    """Yield TIFFs that Pillow does not write."""
    y, x = np.mgrid[:13, :17]
    share = np.stack((x / 17, y / 13, (x + y) / 30, 1 - x / 40), axis=2)
    for dtype in (np.uint8, np.uint16, np.uint32, np.float16, np.float32, np.float64):
        scale = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
        for channels, photometric in (
            (1, "minisblack"), (1, "miniswhite"), (2, "minisblack"), (3, "rgb"), (4, "rgb"),
            (4, "separated"),
        ):  # fmt: skip
            array = (share[..., :channels] * scale).astype(dtype)
            array = array[..., 0] if channels == 1 else array
            for options in (
                {}, {"byteorder": ">", "compression": "zlib"},
                {"tile": (16, 16), "bigtiff": True},
                {"compression": "zlib", "predictor": scale > 1, "rowsperstrip": 4},
            ):  # fmt: skip
                stream = BytesIO()
                tifffile.imwrite(
                    stream, array, photometric=photometric, metadata=None,
                    planarconfig=None if channels == 1 else "contig", **options,
                )  # fmt: skip
                yield f"TIFF {np.dtype(dtype)} {photometric} {channels}", stream.getvalue()
