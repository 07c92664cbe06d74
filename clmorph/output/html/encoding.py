"""Encode frames as text inside a page: without loss, unless the page would become too large."""

import base64
import io
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.threads import in_order
from clmorph.errors import OutputError

if TYPE_CHECKING:
    from PIL.Image import Image

#: The formats of frames, as Pillow calls them.
WEBP, PNG = "WEBP", "PNG"

#: Options of lossless WebP. With this effort files are a quarter smaller than PNG, at about 0.4
#: microseconds a pixel; the highest effort takes forty times as long and saves another 4 %.
LOSSLESS: dict[str, Any] = {"lossless": True, "quality": 80, "method": 4}
OPTIMAL: dict[str, Any] = {"optimize": True}
#: Qualities that are tried in turn where frames without loss would take too many bytes.
QUALITIES = (99, 95, 90, 80, 60)
#: Bytes that a frame without loss may take, as a multiple of its share: the first frames are often
#: the sharpest.
ADVANCE = 1.25
#: The longest side that WebP can have.
WEBP_SIDE = 16383


class Encoder:
    """Encodes `count` frames within `max_bytes` of text; from the first too large one with loss."""

    def __init__(self, count: int, max_bytes: float) -> None:
        from PIL import features

        self._count = count
        self._bytes_left = max_bytes
        self._max_bytes = max_bytes
        self._webp = bool(features.check("webp"))
        #: (height, width) of the frames so far, their qualities, and whether one has opacity.
        self.sizes: list[tuple[int, int]] = []
        self.qualities: list[int] = []
        self.alpha = False

    def encode(self, frames: Iterable[NDArray[np.uint8]]) -> Iterator[tuple[str, str]]:
        """Yield the media type and the Base64 of frames (H, W, 3 or 4); threads work ahead."""
        from PIL import Image

        pictures = (Image.fromarray(np.ascontiguousarray(frame)) for frame in frames)
        for picture, without_loss in in_order(self._first_try, pictures):
            yield self._within_share(picture, without_loss)

    def _is_webp(self, picture: "Image") -> bool:
        return self._webp and max(picture.size) <= WEBP_SIDE

    def _first_try(self, picture: "Image") -> str | None:
        """Return a frame without loss, unless an earlier one was encoded with loss."""
        if min(self.qualities, default=100) < 100:
            return None
        return _text(picture, *((WEBP, LOSSLESS) if self._is_webp(picture) else (PNG, OPTIMAL)))

    def _within_share(self, picture: "Image", without_loss: str | None) -> tuple[str, str]:
        webp = self._is_webp(picture)
        share = self._bytes_left / (self._count - len(self.sizes))
        qualities: list[int] = [100] if min(self.qualities, default=100) == 100 else []
        for quality in (*qualities, *(QUALITIES if webp else ())):
            if quality == 100:
                text, most = without_loss or "", min(self._bytes_left, ADVANCE * share)
            else:
                text, most = _text(picture, WEBP, {"quality": quality}), share
            if len(text) <= most:
                self._bytes_left -= len(text)
                self.sizes.append((picture.height, picture.width))
                self.qualities.append(quality)
                self.alpha = self.alpha or picture.mode == "RGBA"
                return f"image/{(WEBP if webp else PNG).lower()}", text
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


def _text(picture: "Image", form: str, options: dict[str, Any]) -> str:
    """Return a frame, encoded, in Base64."""
    file = io.BytesIO()
    picture.save(file, form, **options)
    return base64.b64encode(file.getbuffer()).decode("ascii")
