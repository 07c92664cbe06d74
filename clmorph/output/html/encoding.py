"""Encode frames as text inside a page: without loss, unless the page would become too large."""

import base64
import io
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.errors import InputError, OutputError

#: Options of lossless WebP. With this effort files are a quarter smaller than PNG, at about 0.4
#: microseconds a pixel; the highest effort takes forty times as long and saves another 4 %.
LOSSLESS: dict[str, Any] = {"lossless": True, "quality": 80, "method": 4}
#: Qualities that are tried in turn where frames without loss would take too many bytes.
QUALITIES = (99, 95, 90, 80, 60)
#: Bytes that a frame without loss may take, as a multiple of its share: the first frames are often
#: the sharpest.
ADVANCE = 1.25
#: The longest side that WebP can have.
WEBP_SIDE = 16383


class Encoded(NamedTuple):
    """A frame as text.

    Attributes
    ----------
    text : str
        The encoded frame in Base64.
    kind : str
        The media type.
    size : (height, width)
    quality : int
        Quality of lossy WebP; 100 stands for no loss.
    """

    text: str
    kind: str
    size: tuple[int, int]
    quality: int


class Encoder:
    """Encodes frames one by one within a budget of bytes, without knowledge of later frames.

    Each frame may take an equal share of the remaining bytes, or a quarter more if it is encoded
    without loss; unused bytes are left for the next frames. From the first frame that needs more,
    all frames are compressed with loss, because a change between both would flicker.

    Parameters
    ----------
    count : int
        Number of frames.
    max_bytes : float
        The limit of the bytes that all frames may take, as text.
    """

    def __init__(self, count: int, max_bytes: float) -> None:
        from PIL import features

        self._frames_left = count
        self._bytes_left = max_bytes
        self._max_bytes = max_bytes
        self._webp = bool(features.check("webp"))
        #: (height, width) of the frames so far, and their qualities.
        self.sizes: list[tuple[int, int]] = []
        self.qualities: list[int] = []

    def encode(self, frame: NDArray[np.uint8]) -> Encoded:
        """Return a frame as text.

        Raises
        ------
        InputError
            If the frame is not an (H, W, 3) or (H, W, 4) array of uint8.
        OutputError
            If the frame needs more than its share of the bytes.
        """
        from PIL import Image

        number = len(self.sizes)
        if (
            getattr(frame, "dtype", None) != np.uint8
            or frame.ndim != 3
            or frame.shape[2] not in (3, 4)
            or 0 in frame.shape
        ):
            raise InputError(
                f"frame {number} is {_kind(frame)}: expected (H, W, 3) or (H, W, 4) uint8"
            )
        if not self._frames_left:
            raise InputError("there are more frames than times: expected one each")
        size = (int(frame.shape[0]), int(frame.shape[1]))
        picture = Image.fromarray(np.ascontiguousarray(frame))
        webp = self._webp and max(size) <= WEBP_SIDE
        share = self._bytes_left / self._frames_left
        forms: list[tuple[int, str, dict[str, Any]]] = []
        if min(self.qualities, default=100) == 100:
            forms = [(100, "WEBP", LOSSLESS) if webp else (100, "PNG", {"optimize": True})]
        if webp:
            forms += [(quality, "WEBP", {"quality": quality}) for quality in QUALITIES]
        for quality, form, options in forms:
            file = io.BytesIO()
            picture.save(file, form, **options)
            text = base64.b64encode(file.getbuffer()).decode("ascii")
            most = min(self._bytes_left, ADVANCE * share) if quality == 100 else share
            if len(text) <= most:
                self._frames_left -= 1
                self._bytes_left -= len(text)
                self.sizes.append(size)
                self.qualities.append(quality)
                return Encoded(text, f"image/{form.lower()}", size, quality)
        raise OutputError(
            f"the page would take more than {self._max_bytes / 1e6:.3g} MB: use fewer or smaller "
            "frames, or write a .gif or a folder of frames"
        )

    @property
    def note(self) -> str | None:
        """A note for the reader if frames are compressed with loss; None otherwise."""
        lossy = [quality for quality in self.qualities if quality < 100]
        if not lossy:
            return None
        return (
            f"{len(lossy)} of {len(self.qualities)} frames are compressed with loss "
            f"(WebP, quality {min(lossy)} or better), so that this page stays within "
            f"{self._max_bytes / 1e6:.3g} MB."
        )


def _kind(frame: object) -> str:
    shape, dtype = getattr(frame, "shape", None), getattr(frame, "dtype", None)
    return type(frame).__name__ if shape is None else f"{shape} {dtype}"
