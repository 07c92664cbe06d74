"""Conversion of a file's colors to sRGB, by its ICC profile."""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from clmorph._shared.printable import printable

#: Color spaces of ICC profiles, and Pillow's modes for them.
_SPACES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK", "Lab": "LAB"}
#: Flags of Little CMS, whose names differ between versions of Pillow.
_BLACK_POINT_COMPENSATION, _NO_TABLES = 0x2000, 0x0100
#: Largest difference between sRGB profiles of different makers, in levels of 255.
_PROFILE_TOLERANCE = 2
#: What Pillow raises if it cannot use a profile.
_FAULTS = (ImageCms.PyCMSError, ImportError, OSError, ValueError, TypeError)


def to_srgb(picture: Any, profile: bytes | None) -> tuple[NDArray[np.uint8], str]:
    """Convert an image of mode L, RGB, CMYK or LAB to sRGB, (H, W) or (H, W, 3), with a note."""
    try:
        if picture.mode == "LAB" and not profile:
            return _converted(picture, ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB"))), ""
        if not profile:
            return _plain(picture), ""
        source, mode = _source(profile)
        if mode == "RGB" and picture.mode == "L":
            picture = picture.convert("RGB")
        if picture.mode == mode:
            return _converted(picture, source), ""
        profile_fault = f"is for other colors than its {picture.mode}"
    except _FAULTS as error:
        if picture.mode == "LAB":
            raise ValueError(f"its CIELAB colors cannot be converted: {error}") from error
        profile_fault = "cannot be used"
    return _plain(picture), (
        f"a color profile, {_name(profile or b'')}, that {profile_fault}: the colors are taken as "
        "sRGB; convert the image to sRGB first for exact ones"
    )


def _plain(picture: Any) -> NDArray[np.uint8]:
    return np.asarray(picture if picture.mode in ("L", "RGB") else picture.convert("RGB"))


def _converted(picture: Any, source: Any) -> NDArray[np.uint8]:
    target = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    flags: Any = _BLACK_POINT_COMPENSATION
    levels = None
    if picture.mode == "L":  # 256 levels are few enough for the exact but slow conversion
        levels = Image.fromarray(np.arange(256, dtype=np.uint8)[None])
        flags |= _NO_TABLES
    made = ImageCms.profileToProfile(
        levels or picture, source, target, ImageCms.Intent.RELATIVE_COLORIMETRIC, "RGB",
        flags=flags,
    )  # fmt: skip
    return np.asarray(made)[0][np.asarray(picture)] if levels else np.asarray(made)


def _name(profile: bytes) -> str:
    """Return the description in a profile, quoted."""
    try:
        name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(profile)))
    except _FAULTS:
        return "unreadable"
    return repr(printable(" ".join(name.split()), 60))


def is_srgb(profile: bytes) -> bool:
    """Return whether a profile converts as sRGB does; its name is not reliable."""
    try:
        source, mode = _source(profile)
        levels = np.arange(256, dtype=np.uint8)
        if mode == "L":
            ramp = levels[None]
        elif mode == "RGB":  # gray, red, green and blue
            ramp = levels[None, :, None] * np.array([(1, 1, 1), *np.eye(3)], np.uint8)[:, None]
        else:
            return False
        made = _converted(Image.fromarray(ramp), source).astype(int)
    except _FAULTS:
        return False
    return bool(np.all(np.abs(made - ramp.reshape(len(ramp), 256, -1)) <= _PROFILE_TOLERANCE))


def _source(profile: bytes) -> tuple[Any, str]:
    """Return the opened profile, and the mode of Pillow to which it applies, or ""."""
    source = ImageCms.ImageCmsProfile(BytesIO(profile))
    return source, _SPACES.get(source.profile.xcolor_space.strip(), "")
