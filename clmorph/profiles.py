"""Colors of a file, whatever they are stored as, to sRGB."""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.colors import encode
from clmorph.printable import printable

#: What ICC calls the colors of a profile, and which of Pillow's modes hold such.
_SPACES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK", "Lab": "LAB"}
#: Of Little CMS; Pillow names it by another name in each version.
_BLACK_POINT_COMPENSATION: Any = 0x2000
#: PNG's exponent of sRGB, and its primaries: white, red, green, blue.
_SRGB_GAMMA = 0.45455
_SRGB_CHROMATICITY = (0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)


def to_srgb(picture: Any, profile: bytes | None) -> tuple[NDArray[np.uint8], str]:
    """Convert the colors of a Pillow image by its profile.

    Parameters
    ----------
    picture : PIL.Image.Image
        Of mode L, RGB, CMYK or LAB.
    profile : bytes, optional
        ICC; without one, RGB and gray are sRGB and CMYK is plain ink on white.

    Returns
    -------
    (H, W) or (H, W, 3) array
        sRGB.
    str
        What is to be noted, "" if nothing.
    """
    from PIL import ImageCms

    try:
        if picture.mode == "LAB" and not profile:
            return _converted(picture, ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB"))), ""
        if profile and not is_srgb(profile):
            source = ImageCms.ImageCmsProfile(BytesIO(profile))
            mode = _SPACES.get(source.profile.xcolor_space.strip(), "")
            if mode == "RGB" and picture.mode == "L":
                picture = picture.convert("RGB")
            if picture.mode == mode:
                return _converted(picture, source), ""
            profile_fault = f"is for other colors than its {picture.mode}"
        else:
            return _plain(picture), ""
    except (ImageCms.PyCMSError, ImportError, OSError, ValueError, TypeError) as error:
        if picture.mode == "LAB":
            raise ValueError(f"its CIELAB colors cannot be converted: {error}") from error
        profile_fault = "cannot be used"
    return _plain(picture), (
        f"the color profile {_name(profile or b'')} {profile_fault}: its colors are taken as sRGB; "
        "convert it first for exact ones"
    )


def _plain(picture: Any) -> NDArray[np.uint8]:
    return np.asarray(picture if picture.mode in ("L", "RGB") else picture.convert("RGB"))


def _converted(picture: Any, source: Any) -> NDArray[np.uint8]:
    from PIL import ImageCms

    target = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    made = ImageCms.profileToProfile(
        picture, source, target, ImageCms.Intent.RELATIVE_COLORIMETRIC, "RGB",
        flags=_BLACK_POINT_COMPENSATION,
    )  # fmt: skip
    return np.asarray(made)


def _name(profile: bytes) -> str:
    """Return what a profile calls itself, quoted."""
    from PIL import ImageCms

    try:
        name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(profile)))
    except (ImageCms.PyCMSError, ImportError, OSError, ValueError, TypeError):
        return "(unreadable)"
    return repr(printable(" ".join(name.split()), 60))


def is_srgb(profile: bytes) -> bool:
    """Return whether a profile is sRGB's, by its name."""
    return "sRGB" in _name(profile)


def from_gamma(
    pixels: NDArray[Any], gamma: float | None, chromaticity: tuple[float, ...] | None
) -> tuple[NDArray[Any], str]:
    """Convert the colors of a PNG whose chunk gAMA says how they are stored.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3) array
        uint8 or uint16.
    gamma : float, optional
        A value is light to the power of this.
    chromaticity : 8 floats, optional
        The chunk cHRM: x and y of white, red, green and blue.

    Returns
    -------
    array
        sRGB; the same if there is nothing to do.
    str
        What is to be noted, "" if nothing.
    """
    note = ""
    if chromaticity and not np.allclose(chromaticity, _SRGB_CHROMATICITY, atol=0.005):
        note = "primaries of its own (cHRM): they are taken as those of sRGB"
    if gamma is None or abs(gamma / _SRGB_GAMMA - 1) < 0.01 or not 0.05 <= gamma <= 20:
        return pixels, note
    largest = np.iinfo(pixels.dtype).max
    light = (np.arange(largest + 1) / largest) ** (1 / gamma)
    stored = encode(light)
    # 8 bits of light are too few for the shadows of sRGB to be told apart once more.
    return np.round(stored * 65535).astype(np.uint16)[pixels], note
