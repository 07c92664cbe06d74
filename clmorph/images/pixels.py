"""Images as arrays of sRGB values in [0, 1], with opacity if some pixels are transparent."""

from __future__ import annotations

import warnings
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import reason_of
from clmorph._shared.typing import AnyArray, Array, ArrayLike, IntArray
from clmorph._shared.validation import check_integer, check_max_pixels, is_path, shown
from clmorph.backends.arrays import as_array
from clmorph.errors import FileError, ImageWarning, InputError
from clmorph.images.resizing import as_unit, resized

#: Largest number of pixels of a file that is decoded, unless the caller sets another limit.
MAX_PIXELS = 64_000_000
#: Distance of the pixels of a line that are compared first with those of the next one.
SPARSE = 61


def as_pixels(image: ArrayLike, name: str = "image", *, max_pixels: int | None = None) -> Array:
    """Return an image as (H, W, 3) or (H, W, 4) float64 sRGB in [0, 1], or raise InputError.

    It is given as (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), of uint8, uint16, bool, or float in
    [0, 1]. If any pixel is not opaque there is a fourth channel, opacity; colors are not multiplied
    by it.
    """
    return as_unit(as_samples(image, name, max_pixels=max_pixels))


def as_samples(image: ArrayLike, name: str = "image", *, max_pixels: int | None = None) -> AnyArray:
    """Return an image as `as_pixels` does, but integers as they are, which takes less memory."""
    if isinstance(image, str | PathLike):
        raise InputError(
            f"{name} is a path: expected an array; use clmorph.read_image({shown(image)})"
        )
    expected = "shape (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) with H, W >= 1"
    array = as_array(name, image, f"an image of {expected}")
    shape = array.shape
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or 0 in array.shape:
        raise InputError(f"{name} has shape {shape}: expected {expected}")
    if max_pixels is not None and array.shape[0] * array.shape[1] > max_pixels:
        raise InputError(
            f"{name} has shape {shape}: expected at most {max_pixels} pixels in all; reduce it "
            "with clmorph.fit"
        )
    pixels: AnyArray = array
    if array.dtype == np.bool_:
        pixels = array.astype(float)
    elif array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        pass
    elif np.issubdtype(array.dtype, np.floating):
        with np.errstate(over="ignore"):  # numbers beyond the range of float64 are refused below
            pixels = _checked_floats(array.astype(float), name)
    else:
        raise InputError(
            f"{name} has dtype {array.dtype}: expected uint8, uint16, bool, or float in [0, 1]"
        )
    if pixels.shape[2] == 4:
        full = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
        return np.ascontiguousarray(pixels if pixels[..., 3].min() < full else pixels[..., :3])
    return np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))


def _checked_floats(pixels: Array, name: str) -> Array:
    """Clip floats in place to [0, 1]; refuse values that differ from it by more than rounding."""
    if not np.all(np.isfinite(pixels)):
        raise InputError(f"{name} holds NaN or infinity: expected finite values in [0, 1]")
    low, high = float(pixels.min()), float(pixels.max())
    if low < -1e-6 or high > 1 + 1e-6:
        raise InputError(
            f"{name} holds values from {low:g} to {high:g}: expected [0, 1] for floats; "
            "divide by the largest possible value"
        )
    return np.clip(pixels, 0.0, 1.0, out=pixels)


def as_rgb(image: ArrayLike, name: str = "image") -> Array:
    """Return an image as (H, W, 3) float64 in [0, 1], composited on white where transparent."""
    colors, alpha = split_alpha(as_pixels(image, name))
    return colors if alpha is None else colors * alpha[..., None] + (1.0 - alpha[..., None])


def to_bytes(frame: AnyArray) -> NDArray[np.uint8]:
    """Round a frame in [0, 1] to 8 bits; a frame of 8 bits is returned unchanged."""
    if frame.dtype == np.uint8:
        return frame
    return np.round(np.clip(frame, 0.0, 1.0) * 255.0).astype(np.uint8)


def split_alpha(pixels: Array) -> tuple[Array, Array | None]:
    """Return (H, W, 3) colors, and (H, W) opacity or None if all pixels are opaque."""
    if pixels.shape[2] == 3:
        return pixels, None
    return np.ascontiguousarray(pixels[..., :3]), pixels[..., 3]


def block_size(image: AnyArray) -> int:
    """Return the largest k if visible pixels are k x k blocks of several colors, otherwise 1."""
    places = [*_changes(image, 0), *_changes(image, 1)]
    return int(np.gcd.reduce([*image.shape[:2], *places])) if places else 1


def _changes(image: AnyArray, axis: int) -> IntArray:
    """Return the rows, or columns, that differ from the ones before, or 1 alone if many do."""
    lines = np.moveaxis(image, axis, 0)
    # Almost any image is told from blocks by a few of its pixels.
    for part in (lines[:, ::SPARSE], lines):
        seen = part if part.shape[2] == 3 else part * (part[..., 3:] > 0)
        found = 1 + np.flatnonzero(np.any(np.diff(seen, axis=0) != 0, axis=(1, 2)))
        if len(found) and np.gcd.reduce(found) == 1:
            return np.array([1])
    return found


def fit(image: ArrayLike, size: int) -> Array:
    """Downscale an image so that its longer side has at most `size` pixels.

    Parameters
    ----------
    image : array_like
        (H, W), (H, W, 1), (H, W, 3) or (H, W, 4); uint8, uint16, bool, or float in [0, 1].
    size : int
        Largest length of the longer side, in pixels; a smaller image keeps its size.

    Returns
    -------
    (H', W', 3) or (H', W', 4) float64 array
        sRGB in [0, 1], with a fourth channel (opacity) if parts are transparent. The aspect ratio
        is kept. Downscaling averages pixels, so the result is anti-aliased. A sprite that consists
        of blocks of k x k pixels of one color keeps such blocks, with the largest whole number of
        pixels along a block that fits.

    Raises
    ------
    InputError
        If `image` is no image, or `size` is not from 2 to 65536.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> clmorph.fit(np.zeros((40, 20)), 10).shape
    (10, 5, 3)
    """
    size = check_integer("size", size, 2, 1 << 16)
    samples = as_samples(image)
    height, width = samples.shape[:2]
    longer = max(height, width)
    if longer <= size:
        return as_unit(samples)
    block = block_size(samples)
    if longer // block <= size:
        zoom = size // (longer // block)
        blocks = as_unit(samples[::block, ::block])
        return np.asarray(np.kron(blocks, np.ones((zoom, zoom, 1))), float)
    shape = reduced_shape((height, width), size)
    if samples.shape[2] == 3:
        return np.clip(resized(samples, shape, "mirror"), 0, 1)
    # Averages are weighted by opacity, so that invisible colors do not affect visible ones.
    seen = np.clip(resized(samples, shape, "mirror", weighted=True), 0, 1)
    opacity = seen[..., 3:]
    colors = np.divide(seen[..., :3], opacity, out=np.zeros_like(seen[..., :3]), where=opacity > 0)
    return np.dstack((np.clip(colors, 0, 1), opacity))


def reduced_shape(shape: tuple[int, int], size: int) -> tuple[int, int]:
    """Return height and width of an image whose longer side has at most `size` pixels."""
    shrink = min(1.0, size / max(shape))
    return max(1, round(shape[0] * shrink)), max(1, round(shape[1] * shrink))


def read_image(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Array:
    """Read an image file.

    Parameters
    ----------
    path : path
        PNG, JPEG, WebP, AVIF, GIF, TIFF, BMP, JPEG 2000 or another format of
        `clmorph.images.reading.opening.FORMATS`. Of an animation, or of several pages, the first
        picture is read. The picture is rotated by the orientation in its Exif data. PNG, TIFF,
        AVIF and JPEG 2000 keep up to 16 bits, and TIFF keeps floats.
    max_pixels : int
        Largest number of pixels; a larger image raises an error before it is decoded.

    Returns
    -------
    (H, W, 3) float64 array, or (H, W, 4) if parts are transparent
        sRGB in [0, 1], and opacity. The colors are converted from the space that the file names: by
        an ICC profile, or by codes, primaries or a gamma (`clmorph.images.reading.spaces`). If it
        names none they are taken as sRGB.

    Raises
    ------
    InputError
        If an argument is no path, or no number of pixels.
    FileError
        If the file is missing, unreadable, too large or not an image. It is an InputError.

    Warns
    -----
    ImageWarning
        If only the first of several pictures is read, a color profile or code cannot be used, or
        bits are lost.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from PIL import Image
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "red.png"
    ...     Image.new("RGB", (3, 2), "red").save(file)
    ...     image = clmorph.read_image(file)
    >>> image.shape, image[0, 0].tolist()
    ((2, 3, 3), [1.0, 0.0, 0.0])
    """
    return as_unit(_read(path, max_pixels))


def read_visible(path: str | PathLike[str], max_pixels: int = MAX_PIXELS) -> AnyArray:
    """Read an image file as `as_samples` has it; if every pixel is transparent raise FileError."""
    samples = _read(path, max_pixels)
    if samples.shape[2] == 4 and not samples[..., 3].any():
        raise FileError(f"{path}: every pixel is transparent; expected visible pixels")
    return samples


def _read(path: str | PathLike[str], max_pixels: int) -> AnyArray:
    """Return the samples of an image file, and warn the caller's caller of what is odd in it."""
    max_pixels = check_max_pixels(max_pixels)
    if not is_path(path):
        raise InputError(f"path={shown(path)}: expected the path of an image, such as 'photo.png'")
    from clmorph.images.reading.decoding import decode
    from clmorph.images.reading.opening import REASON_LENGTH, UnsupportedError, unsupported_reason

    file = Path(path)
    name = str(file)
    try:
        if not file.exists():
            raise FileError(f"{name}: no such file; expected an image such as a PNG or a JPEG")
        if not file.is_file():
            raise FileError(f"{name} is not a file; expected an image such as a PNG or a JPEG")
        decoded, notes = decode(file, max_pixels)
        samples = as_samples(decoded, name)
    except FileError:
        raise
    except InputError as error:
        raise FileError(str(error)) from error
    except UnsupportedError as error:
        raise FileError(f"{name} {error}; convert it to PNG") from error
    except PermissionError as error:
        raise FileError(f"{name} may not be read; change its permissions") from error
    except MemoryError as error:
        raise FileError(f"{name} does not fit into memory; reduce it first") from error
    except Exception as error:
        # Only decoders run in this block, and they raise errors of any kind for damaged files.
        if reason := unsupported_reason(error):
            raise FileError(
                f"{name} is of an unsupported kind ({reason}); convert it to PNG"
            ) from error
        raise FileError(
            f"{name} cannot be decoded ({reason_of(error, REASON_LENGTH)}); is it complete?"
        ) from error
    for note in notes:
        warnings.warn(f"{name} has {note}", ImageWarning, stacklevel=3)
    return samples
