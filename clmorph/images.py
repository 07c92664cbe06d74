"""Images in, as arrays of sRGB values in [0, 1], with opacity where there is some."""

import warnings
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph.checks import check_integer, check_max_pixels
from clmorph.errors import ImageWarning, InputError

#: Pixels above which a file is refused before it is decoded, unless told otherwise.
MAX_PIXELS = 64_000_000


def as_pixels(image: ArrayLike, name: str = "image") -> NDArray[np.float64]:
    """Return an image as (H, W, 3) or (H, W, 4) float64 in [0, 1].

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) array
        uint8, uint16, bool, or float in [0, 1].
    name : str
        What messages call it.

    Returns
    -------
    (H, W, 3) or (H, W, 4) array
        With a fourth channel, opacity, if any pixel is not opaque; colors are not multiplied
        by it.

    Raises
    ------
    InputError
        If the shape, dtype or values are not those of an image.
    """
    if isinstance(image, str | PathLike):
        raise InputError(f"{name} is a path: expected an array; use clmorph.read_image({image!r})")
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: not an array of pixels ({error})") from None
    expected = "expected (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) with H, W >= 1"
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or 0 in array.shape:
        raise InputError(f"{name} has shape {np.shape(image)}: {expected}")
    if array.dtype == np.bool_:
        pixels = array.astype(float)
    elif array.dtype in (np.uint8, np.uint16):
        pixels = array / float(np.iinfo(array.dtype).max)
    elif np.issubdtype(array.dtype, np.floating):
        pixels = array.astype(float)
    else:
        raise InputError(
            f"{name} has dtype {array.dtype}: expected uint8, uint16, bool, or float in [0, 1]"
        )
    if not np.all(np.isfinite(pixels)):
        raise InputError(f"{name} holds NaN or infinity: expected finite values in [0, 1]")
    low, high = float(pixels.min()), float(pixels.max())
    if low < -1e-6 or high > 1 + 1e-6:
        raise InputError(
            f"{name} holds values from {low:g} to {high:g}: expected [0, 1] for floats; "
            "divide by the largest possible value"
        )
    pixels = np.clip(pixels, 0.0, 1.0)
    if pixels.shape[2] == 4:
        return np.ascontiguousarray(pixels if np.any(pixels[..., 3] < 1) else pixels[..., :3])
    return np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))


def as_rgb(image: ArrayLike, name: str = "image") -> NDArray[np.float64]:
    """Return an image as (H, W, 3) float64 in [0, 1], transparent parts laid on white.

    Parameters and errors as `as_pixels`.
    """
    colors, alpha = split_alpha(as_pixels(image, name))
    return colors if alpha is None else colors * alpha[..., None] + (1.0 - alpha[..., None])


def to_bytes(frame: NDArray[Any]) -> NDArray[np.uint8]:
    """Round a frame in [0, 1] to 8 bits; one that is, is returned as it is."""
    if frame.dtype == np.uint8:
        return frame
    return np.round(np.clip(frame, 0.0, 1.0) * 255.0).astype(np.uint8)


def split_alpha(
    pixels: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return (H, W, 3) colors and (H, W) opacity, None if all is opaque."""
    if pixels.shape[2] == 3:
        return pixels, None
    return np.ascontiguousarray(pixels[..., :3]), pixels[..., 3]


def block_size(image: NDArray[np.float64]) -> int:
    """Return k if an image is made of k x k blocks of one color each, as enlarged sprites are.

    Parameters
    ----------
    image : (H, W, C) array

    Returns
    -------
    int
        The largest such k; 1 for anything else, images of a single color included.
    """
    sides = list(image.shape[:2])
    for axis in (0, 1):
        changes = np.any(np.diff(image, axis=axis) != 0, axis=(1 - axis, 2))
        sides += [int(place) + 1 for place in np.flatnonzero(changes)]
    return 1 if len(sides) == 2 else int(np.gcd.reduce(sides))


def fit(image: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Reduce an image so that its longer side has at most `size` pixels.

    Parameters
    ----------
    image : (H, W, 3) or (H, W, 4) array
    size : int
        Pixels; a smaller image is returned as it is.

    Returns
    -------
    (H', W', 3) or (H', W', 4) array
        The aspect ratio kept. Anti-aliased; but a sprite, made of blocks of k x k pixels,
        keeps its blocks at the largest whole number of pixels that fits.
    """
    size = check_integer("size", size, 2, 1 << 16)
    image = as_pixels(image)
    height, width = image.shape[:2]
    longer = max(height, width)
    if longer <= size:
        return image
    block = block_size(image)
    if longer // block <= size:
        zoom = size // (longer // block)
        return np.kron(image[::block, ::block], np.ones((zoom, zoom, 1))).astype(float)
    from skimage.transform import resize

    shape = [max(1, round(side * size / longer)) for side in (height, width)]
    colors, alpha = split_alpha(image)
    if alpha is None:
        return np.clip(np.asarray(resize(image, (*shape, 3), order=1, anti_aliasing=True)), 0, 1)
    # What cannot be seen must not bleed into what can: averages are weighted by opacity.
    seen = np.dstack((colors * alpha[..., None], alpha))
    seen = np.clip(np.asarray(resize(seen, (*shape, 4), order=1, anti_aliasing=True)), 0, 1)
    opacity = seen[..., 3:]
    colors = np.divide(seen[..., :3], opacity, out=np.zeros_like(seen[..., :3]), where=opacity > 0)
    return np.dstack((np.clip(colors, 0, 1), opacity))


def resized(image: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image (H, W, C) at another size (height, width), interpolated linearly."""
    if image.shape[:2] == shape:
        return image
    from skimage.transform import resize

    return np.asarray(resize(image, (*shape, image.shape[2]), order=1, mode="edge"))


def read_image(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> NDArray[np.float64]:
    """Read an image file.

    Parameters
    ----------
    path : path
        PNG, JPEG, WebP, GIF, BMP, TIFF or what else Pillow reads; the first picture of an
        animation. EXIF orientation is applied, colors are taken as sRGB.
    max_pixels : int
        A larger image is refused before it is decoded.

    Returns
    -------
    (H, W, 3) array, or (H, W, 4) if parts are transparent
        sRGB in [0, 1], and opacity.

    Raises
    ------
    InputError
        If the file is missing, unreadable, too large or not an image.

    Warns
    -----
    ImageWarning
        If the file has a color profile other than sRGB.
    """
    from PIL import Image, UnidentifiedImageError

    max_pixels = check_max_pixels(max_pixels)
    if not isinstance(path, str | PathLike) or not str(path):
        raise InputError(f"{path!r} is not the path of an image")
    file = Path(path)
    try:
        if not file.exists():
            raise InputError(f"{file}: no such file; expected an image such as a PNG or a JPEG")
        if not file.is_file():
            raise InputError(f"{file} is not a file; expected an image such as a PNG or a JPEG")
        return as_pixels(_decode(file, max_pixels), str(file))
    except UnidentifiedImageError:
        raise InputError(
            f"{file} is not an image that can be read; expected a PNG, JPEG or similar"
        ) from None
    except PermissionError:
        raise InputError(f"{file} may not be read; change its permissions") from None
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file} cannot be decoded ({reason}); is it complete?") from None
    except MemoryError:
        raise InputError(f"{file} does not fit into memory; reduce it first") from None


def _decode(file: Path, max_pixels: int) -> NDArray[Any]:
    """Decode a file to an array that `as_pixels` takes."""
    from PIL import Image, ImageOps

    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # ours comes below
    try:
        with warnings.catch_warnings():
            # Pillow's remarks on odd metadata; the pixels are judged by themselves.
            warnings.simplefilter("ignore")
            deep = _decode_deep_tiff(file, max_pixels)
            if deep is not None:
                return deep
            with Image.open(file) as opened:
                _check_size(file, opened.size, max_pixels)
                profile = _foreign_profile(opened.info.get("icc_profile"))
                pixels = _to_array(ImageOps.exif_transpose(opened))
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    if profile:
        warnings.warn(
            f"{file} has the color profile {profile!r}: its colors are taken as sRGB; "
            "convert it first for exact ones",
            ImageWarning,
            stacklevel=3,
        )
    return pixels


def _foreign_profile(profile: bytes | None) -> str:
    """Return the name of a color profile, '' if there is none or it is sRGB."""
    if not profile:
        return ""
    from io import BytesIO

    from PIL import ImageCms

    try:
        name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(profile)))
    except (ImageCms.PyCMSError, OSError):
        return "unreadable"
    return "" if "sRGB" in name else " ".join(name.split())


def _check_size(file: Path, size: tuple[int, int], max_pixels: int) -> None:
    width, height = size
    if width * height > max_pixels:
        raise InputError(
            f"{file} has {width} x {height} pixels: expected at most {max_pixels} in all; "
            "reduce it, or raise the limit (--max-pixels, max_pixels)"
        )


def _decode_deep_tiff(file: Path, max_pixels: int) -> NDArray[Any] | None:
    """Decode the first page of a TIFF of more than 8 bits, which Pillow mostly cannot."""
    with file.open("rb") as stream:
        if stream.read(4) not in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return None
    from tifffile import TiffFile, TiffFileError

    try:
        with TiffFile(file) as tiff:
            page = tiff.pages[0]
            if page.dtype not in (np.uint16, np.float16, np.float32, np.float64):
                return None
            _check_size(file, (page.shape[1], page.shape[0]), max_pixels)
            return np.asarray(page.asarray())
    except (TiffFileError, IndexError) as error:
        raise ValueError(str(error)) from None


def _to_array(picture: Any) -> NDArray[Any]:
    """Turn a Pillow image into an array that `as_pixels` takes."""
    if picture.mode.startswith("I;16"):
        return np.asarray(picture).astype(np.uint16)
    if picture.mode == "I":  # 16-bit gray PNGs in older versions of Pillow
        return np.clip(np.asarray(picture), 0, 65535).astype(np.uint16)
    if picture.mode == "F":
        return np.asarray(picture)
    transparent = "A" in picture.mode or "transparency" in picture.info
    return np.asarray(picture.convert("RGBA" if transparent else "RGB"))
