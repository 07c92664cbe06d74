"""The color space that a file describes by numbers: PNG, AVIF, JPEG 2000, and BMP.

Codes are those of ITU-T H.273.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import AnyArray, Array
from clmorph.images.color import decode, encode
from clmorph.images.reading.boxes import Reader, boxes, png_chunk

#: x and y of white, red, green and blue.
Primaries = tuple[float, ...]
SRGB: Primaries = (0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
_D65, _C = (0.3127, 0.329), (0.31, 0.316)
#: The same, by the code points of ITU-T H.273.
PRIMARIES: dict[int, Primaries] = {
    1: SRGB, 2: SRGB,
    4: (*_C, 0.67, 0.33, 0.21, 0.71, 0.14, 0.08),
    5: (*_D65, 0.64, 0.33, 0.29, 0.6, 0.15, 0.06),
    6: (*_D65, 0.63, 0.34, 0.31, 0.595, 0.155, 0.07),
    7: (*_D65, 0.63, 0.34, 0.31, 0.595, 0.155, 0.07),
    8: (*_C, 0.681, 0.319, 0.243, 0.692, 0.145, 0.049),
    9: (*_D65, 0.708, 0.292, 0.17, 0.797, 0.131, 0.046),
    10: (1 / 3, 1 / 3, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    11: (0.314, 0.351, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06),
    12: (*_D65, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06),
    22: (*_D65, 0.63, 0.34, 0.295, 0.605, 0.155, 0.077),
}  # fmt: skip
#: Distance of chromaticities up to which primaries count as those of sRGB.
_SAME_PRIMARIES = 0.005
#: The gamma by which PNG describes sRGB, and the relative difference up to which a gamma counts as
#: sRGB's, as in libpng: encoders write 0.45, 1 / 2.2 or 1 / 2.3 for sRGB.
_SRGB_GAMMA, _GAMMA_TOLERANCE = 0.45455, 0.05
#: Light of PQ and HLG in cd/m2: of white on paper (ITU-R BT.2408), and at most.
_WHITE, _PQ_PEAK, _HLG_PEAK = 203.0, 10000.0, 1000.0
#: Number of samples that are converted at a time.
_PART = 1 << 20
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


class Space(NamedTuple):
    """A color space."""

    primaries: Primaries = SRGB
    #: Linear light of stored values in [0, 1], where 1 is white; None for the curve of sRGB.
    to_light: Callable[[Array], Array] | None = None
    #: The largest light; if it exceeds 1 it is compressed to 1.
    peak: float = 1.0
    #: Whether the light is that of a scene, which a display reproduces with more contrast (HLG).
    scene: bool = False


class Description(NamedTuple):
    """What a file says about its colors: an ICC profile, a space or neither, and a note or ""."""

    profile: bytes | None = None
    space: Space | None = None
    note: str = ""


def described(picture: Any, file: Path) -> Description:
    """Return what a file says about its colors; it is opened a second time."""
    profile = picture.info.get("icc_profile") or None
    with Reader(file) as stream:
        if picture.format == "PNG":
            return _of_png(picture, profile, png_chunk(stream, b"cICP"))
        if picture.format in ("AVIF", "JPEG2000"):
            return _of_boxes(profile, stream.read())
        if picture.format in ("BMP", "DIB"):
            return _of_bitmap(stream.read())
    return Description(profile)


def _of_png(picture: Any, profile: bytes | None, cicp: bytes) -> Description:
    """Apply the first of cICP, iCCP, sRGB, and gAMA with cHRM, as the standard says."""
    note = ""
    if len(cicp) == 4:
        found = _coded(cicp[0], cicp[1])
        if found.space is not None and cicp[2:] == b"\0\1":
            return found
        note = found.note or "colors in a narrow range (cICP), which is not applied"
    if profile or "srgb" in picture.info:
        return Description(profile, None, note)
    gamma, primaries = (picture.info.get(name) for name in ("gamma", "chromaticity"))
    return Description(None, _measured(gamma, primaries), note)


def _of_boxes(profile: bytes | None, data: bytes) -> Description:
    """Apply an ICC profile, or the first code of colors."""
    note = ""
    for kind, content in boxes(data):
        if kind != b"colr" or profile:
            continue
        if content.startswith(b"nclx") and len(content) >= 8:
            return _coded(*struct.unpack(">HH", content[4:8]))
        if content[:1] in (b"\2", b"\3"):  # of JPEG 2000: a profile
            profile = content[3:]
        elif content[:1] == b"\1" and len(content) >= 7:
            code = int.from_bytes(content[3:7], "big")
            if code not in (0, 12, 15, 16, 17, 18):
                note = f"colors of the kind {code} of JPEG 2000, which is not known"
    return Description(profile, None, "" if profile else note and _taken(note))


def _of_bitmap(data: bytes) -> Description:
    """Apply the color space of a bitmap of version 4 or 5."""
    header = data[14:] if data.startswith(b"BM") else data
    size = int.from_bytes(header[:4], "little")
    kind = header[56:60][::-1]
    if size < 108 or len(header) < size:
        return Description()
    if kind == b"MBED" and size >= 124:
        start, length = struct.unpack_from("<II", header, 112)
        return Description(header[start : start + length])
    if kind == b"LINK":
        return Description(note=_taken("a color profile in another file, which is not read"))
    if kind != bytes(4):  # sRGB, or that of Windows, which is sRGB
        return Description()
    ends = np.array(struct.unpack_from("<9i", header, 60)).reshape(3, 3) / (1 << 30)
    gammas = np.array(struct.unpack_from("<3I", header, 96)) / (1 << 16)
    sums = ends.sum(axis=1)
    if not np.all(sums > 0) or np.ptp(gammas) > 0.01:
        return Description()
    white = ends.sum(axis=0) / ends.sum()
    primaries = (*white[:2], *(ends[:, :2] / sums[:, None]).ravel())
    return Description(None, _measured(1 / gammas[0] if gammas[0] > 0 else None, primaries))


def _taken(what: str) -> str:
    return f"{what}: the colors are taken as sRGB; convert the image to sRGB first for exact ones"


def _measured(gamma: float | None, primaries: Primaries | None) -> Space | None:
    """Return the space of a gamma and of primaries; sRGB's where they are missing or senseless."""
    to_light = None
    if gamma and abs(gamma / _SRGB_GAMMA - 1) >= _GAMMA_TOLERANCE and 0.05 <= gamma <= 20:
        to_light = _power(1 / gamma)
    if primaries is None or not _is_gamut(primaries):
        primaries = SRGB
    return Space(primaries, to_light)


def _is_gamut(primaries: Primaries) -> bool:
    """Return whether white lies between red, green and blue."""
    try:
        return primaries[1] > 0 and bool(np.all(_mixing(primaries)[1] > 1e-4))
    except np.linalg.LinAlgError:
        return False


def _coded(primaries: int, transfer: int) -> Description:
    """Return the space of two codes."""
    found = PRIMARIES.get(primaries)
    if found is None or transfer not in _TRANSFERS:
        return Description(note=_taken(f"color codes that are not known ({primaries}, {transfer})"))
    return Description(None, _TRANSFERS[transfer]._replace(primaries=found))


def _power(exponent: float) -> Callable[[Array], Array]:
    return lambda stored: stored**exponent


def _of_pq(stored: Array) -> Array:
    """Return the light of the perceptual quantizer (SMPTE ST 2084)."""
    root = stored ** (32 / 2523)
    least, span = 0.8359375, 18.8515625 - 18.6875 * root
    return (np.maximum(root - least, 0.0) / span) ** (8192 / 1305) * (_PQ_PEAK / _WHITE)


def _of_hlg(stored: Array) -> Array:
    """Return the light of a scene, by hybrid log-gamma (ITU-R BT.2100)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(stored <= 0.5, stored**2 / 3, (np.exp((stored - c) / a) + b) / 12)


#: The curves of displays. Those of television (1, 6, 14, 15) describe cameras; what such a picture
#: shows on a display is sRGB, as viewers assume.
_TRANSFERS = {
    **dict.fromkeys((1, 2, 6, 13, 14, 15), Space()),
    4: Space(to_light=_power(2.2)),
    5: Space(to_light=_power(2.8)),
    8: Space(to_light=lambda stored: stored),
    16: Space(to_light=_of_pq, peak=_PQ_PEAK / _WHITE),
    17: Space(to_light=lambda stored: stored**2.6 * (52.37 / 48)),
    18: Space(to_light=_of_hlg, peak=_HLG_PEAK / _WHITE, scene=True),
}


def from_space(colors: AnyArray, space: Space) -> AnyArray:
    """Convert uint8 or uint16 to sRGB; what changes is uint16, because shadows need the bits."""
    gray = colors.ndim == 2
    same = gray or np.allclose(space.primaries, SRGB, atol=_SAME_PRIMARIES)
    if space.to_light is None and same:
        return colors
    levels = np.arange(np.iinfo(colors.dtype).max + 1) / np.iinfo(colors.dtype).max
    light = decode(levels) if space.to_light is None else space.to_light(levels)
    if gray:
        rows = np.repeat(light[:, None], 3, axis=1)
        return _stored(rows, space._replace(primaries=SRGB))[:, 0][colors]
    found = np.empty(colors.shape, np.uint16)
    rows, made = colors.reshape(-1, 3), found.reshape(-1, 3)
    for start in range(0, len(rows), _PART):
        made[start : start + _PART] = _stored(light[rows[start : start + _PART]], space)
    return found


def _stored(light: Array, space: Space) -> NDArray[np.uint16]:
    """Return sRGB of linear light (N, 3) of a space."""
    to_xyz = _to_xyz(space.primaries)
    if space.scene:
        luminance = light @ to_xyz[1]
        light = light * (np.maximum(luminance, 0.0) ** 0.2 * space.peak)[:, None]
    if space.peak > 1:  # Reinhard's curve, by the largest channel, so that hues stay
        most = light.max(axis=1, keepdims=True)
        light = light * ((1 + most / space.peak**2) / (1 + most))
    if not np.allclose(space.primaries, SRGB, atol=_SAME_PRIMARIES):
        light = light @ np.linalg.solve(_to_xyz(SRGB), to_xyz).T
    return np.round(encode(np.clip(light, 0.0, 1.0)) * 65535).astype(np.uint16)


def _mixing(primaries: Primaries) -> tuple[Array, Array]:
    """Return XYZ of the primaries as columns, and how much of each makes white of luminance 1."""
    white, *ends = np.reshape(primaries, (4, 2))
    columns = np.array([(x, y, 1 - x - y) for x, y in ends]).T
    wanted = np.array([white[0] / white[1], 1.0, (1 - white[0] - white[1]) / white[1]])
    return columns, np.linalg.solve(columns, wanted)


def _to_xyz(primaries: Primaries) -> Array:
    """Return the matrix from linear light to XYZ, adapted (Bradford) to the white of sRGB."""
    columns, amounts = _mixing(primaries)
    matrix = columns * amounts
    cones = _BRADFORD @ matrix.sum(axis=1)
    srgb_columns, srgb_amounts = _mixing(SRGB)
    wanted = _BRADFORD @ (srgb_columns @ srgb_amounts)
    return np.asarray(np.linalg.solve(_BRADFORD, (wanted / cones)[:, None] * (_BRADFORD @ matrix)))
