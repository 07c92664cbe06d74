"""What the numbers of a clip mean: code points of ITU-T H.273, and ways from and to sRGB."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.images.color import decode, encode
from clmorph.images.reading.spaces import PRIMARIES

#: Code points that tell nothing.
UNKNOWN = (0, 2)
#: Matrix and primaries of BT.709, the matrix of BT.601, the transfer curve of sRGB, limited range.
BT709, BT601, SRGB_CURVE, LIMITED, FULL = 1, 5, 13, 1, 2
#: Rows from which on a clip that names no matrix is taken for BT.709, as players do.
HIGH_DEFINITION = 720
#: Code points of primaries that clips may have.
KNOWN_PRIMARIES = (1, 5, 6, 7, 9, 12)
#: Transfer curves that screens show as they show sRGB's: those of BT.709, BT.601 and BT.2020.
LIKE_SRGB = (1, 6, 13, 14, 15)
#: Exponents of the curves that are powers, and linear light.
POWERS = {4: 2.2, 5: 2.8, 8: 1.0}
#: Curves of high dynamic range.
HDR = {16: "PQ", 18: "HLG"}
#: Matrices that FFmpeg's scaler knows, by their code points.
MATRICES = {1: 1, 4: 4, 5: 5, 6: 5, 7: 7, 9: 9}


class ColorTags(NamedTuple):
    """Code points of a clip's colors, as its file has them."""

    matrix: int = 2
    range: int = 0
    primaries: int = 2
    transfer: int = 2

    def unreadable(self) -> str:
        """Return what of the tags cannot be read, in words; '' if all can."""
        if self.transfer in HDR:
            return f"it has a high dynamic range ({HDR[self.transfer]})"
        known = (
            ("matrix", self.matrix, (*MATRICES, 0, 8)),
            ("transfer curve", self.transfer, (*LIKE_SRGB, *POWERS)),
            ("primaries", self.primaries, KNOWN_PRIMARIES),
        )
        for name, value, values in known:
            if value not in (*values, *UNKNOWN):
                return f"its colors have the {name} {value} of ITU-T H.273"
        return ""

    def scaler_matrix(self, height: int) -> int:
        """Return the matrix of frames of a height, as FFmpeg's scaler names it."""
        if self.matrix in MATRICES:
            return MATRICES[self.matrix]
        return BT709 if height >= HIGH_DEFINITION else BT601

    def to_srgb(self, colors: Array) -> Array:
        """Return colors (..., 3) of the clip in sRGB; those that sRGB has not are clipped."""
        if self.is_srgb:
            return colors
        power = POWERS.get(self.transfer)
        light = decode(colors) if power is None else np.asarray(colors) ** power
        return np.clip(encode(light @ _between(self._primaries(), BT709).T), 0.0, 1.0)

    def from_srgb(self, colors: Array) -> Array:
        """Return colors (..., 3) of sRGB as the clip has them, the inverse of `to_srgb`."""
        if self.is_srgb:
            return colors
        light = np.maximum(decode(colors) @ _between(BT709, self._primaries()).T, 0.0)
        power = POWERS.get(self.transfer)
        return np.clip(encode(light) if power is None else light ** (1 / power), 0.0, 1.0)

    @property
    def is_srgb(self) -> bool:
        """Whether the numbers of the clip are those of sRGB."""
        return self.transfer not in POWERS and self._primaries() == BT709

    def _primaries(self) -> int:
        return BT709 if self.primaries in UNKNOWN else self.primaries


def _between(source: int, target: int) -> Array:
    """Return the matrix that turns linear light of some primaries into that of others."""
    return np.asarray(np.linalg.inv(_to_xyz(target)) @ _to_xyz(source))


def _to_xyz(primaries: int) -> Array:
    ends = np.reshape(PRIMARIES[primaries], (4, 2)).tolist()
    white, *three = [np.array((x / y, 1.0, (1.0 - x - y) / y)) for x, y in ends]
    colors = np.array(three).T
    return np.asarray(colors * np.linalg.solve(colors, white))
