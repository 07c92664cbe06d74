"""Images in, as arrays of sRGB values in [0, 1]."""

import warnings
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph.checks import check_integer
from clmorph.errors import InputError

#: Side in pixels above which an image is refused rather than lifted at full size.
MAX_SIDE = 16384


def as_rgb(image: ArrayLike, name: str = "image") -> NDArray[np.float64]:
    """Return an image as (H, W, 3) float64 in [0, 1].

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) array
        uint8, uint16, bool, or float in [0, 1]. Transparent parts are laid on white.
    name : str
        What messages call it.

    Raises
    ------
    InputError
        If the shape, dtype or values are not those of an image.
    """
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: not an array of pixels ({error})") from None
    expected = "expected (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) with H, W >= 1"
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or 0 in array.shape:
        raise InputError(f"{name} has shape {np.shape(image)}: {expected}")
    if max(array.shape[:2]) > MAX_SIDE:
        raise InputError(
            f"{name} is {array.shape[1]} x {array.shape[0]} pixels: expected at most {MAX_SIDE} "
            "along a side; reduce it first"
        )
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
        alpha = pixels[..., 3:]
        pixels = pixels[..., :3] * alpha + (1.0 - alpha)
    return np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))


def fit(image: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Reduce an image so that its longer side has at most `size` pixels.

    Parameters
    ----------
    image : (H, W, 3) array
    size : int
        Pixels; a smaller image is returned as it is.

    Returns
    -------
    (H', W', 3) array
        Anti-aliased, the aspect ratio kept.
    """
    size = check_integer("size", size, 2, MAX_SIDE)
    height, width = image.shape[:2]
    longer = max(height, width)
    if longer <= size:
        return image
    from skimage.transform import resize

    shape = [max(1, round(side * size / longer)) for side in (height, width)]
    return np.clip(np.asarray(resize(image, (*shape, 3), order=1, anti_aliasing=True)), 0, 1)


def read_image(path: str | PathLike[str]) -> NDArray[np.float64]:
    """Read an image file.

    Parameters
    ----------
    path : path
        Any format Pillow reads; the first picture of an animation. EXIF orientation is
        applied, transparent parts are laid on white.

    Returns
    -------
    (H, W, 3) array
        sRGB in [0, 1].

    Raises
    ------
    InputError
        If the file is missing, unreadable or not an image.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: no such file; expected an image such as a PNG or a JPEG")
    if not file.is_file():
        raise InputError(f"{file} is not a file; expected an image such as a PNG or a JPEG")
    try:
        with warnings.catch_warnings():
            # Past its first limit Pillow warns, past twice that it refuses; the size is
            # judged below, in our words.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            warnings.simplefilter("ignore", UserWarning)
            with Image.open(file) as opened:
                if max(opened.size) > MAX_SIDE:
                    raise InputError(
                        f"{file} is {opened.size[0]} x {opened.size[1]} pixels: expected at "
                        f"most {MAX_SIDE} along a side; reduce it first"
                    )
                picture: Any = ImageOps.exif_transpose(opened)
                return as_rgb(_to_array(picture), str(file))
    except UnidentifiedImageError:
        raise InputError(
            f"{file} is not an image that can be read; expected a PNG, JPEG or similar"
        ) from None
    except PermissionError:
        raise InputError(f"{file} may not be read; change its permissions") from None
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file} cannot be decoded ({reason}); is it complete?") from None


def _to_array(picture: Any) -> NDArray[Any]:
    """Decode a Pillow image to an array that `as_rgb` takes."""
    if picture.mode.startswith("I;16"):
        return np.asarray(picture).astype(np.uint16)
    if picture.mode == "I":  # 16-bit grey PNGs in older versions of Pillow
        return np.clip(np.asarray(picture), 0, 65535).astype(np.uint16)
    transparent = "A" in picture.mode or "transparency" in picture.info
    return np.asarray(picture.convert("RGBA" if transparent else "RGB"))
