"""Pictures of results in notebooks, as HTML that loads nothing."""

from base64 import b64encode
from html import escape
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

#: CSS pixels to which a small picture is enlarged, along its longer side.
SHOWN = 360
#: Pixels along the longer side to which a large picture is reduced, so that notebooks stay small.
LARGEST = 1024
#: Cells of a table that is drawn, along a side.
CELLS = 128
#: The darkest shade of a table, in sRGB of 8 bits.
DARKEST = np.array([0, 68, 119])


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return a picture (H, W, 3 or 4) as the bytes of a PNG file; large ones are reduced."""
    from PIL import Image

    file, image = BytesIO(), Image.fromarray(pixels)
    image.thumbnail((LARGEST, LARGEST), Image.Resampling.LANCZOS)
    image.save(file, format="PNG")
    return file.getvalue()


def figure(image: bytes, caption: str, *, width: int | None = None, sharp: bool = False) -> str:
    """Return a PNG with a line below it; `sharp` shows its pixels as squares."""
    text = escape(caption)
    style = "max-width:100%;height:auto;" + ("image-rendering:pixelated;" if sharp else "")
    style += f"width:{width}px;" if width else ""
    return (
        '<figure style="margin:0">'
        f'<img src="data:image/png;base64,{b64encode(image).decode()}" alt="{text}" '
        f'style="{style}"><figcaption>{text}</figcaption></figure>'
    )


def picture(pixels: NDArray[np.uint8], caption: str) -> str:
    """Return a picture (H, W, 3 or 4) with a line below it; small ones are enlarged."""
    height, width = pixels.shape[:2]
    factor = max(1, SHOWN // max(height, width))
    enlarged = factor * width if factor > 1 else None
    return figure(png(pixels), caption, width=enlarged, sharp=factor > 1)


def table(
    rows: NDArray[np.integer], columns: NDArray[np.integer], values: NDArray[np.floating],
    shape: tuple[int, int], caption: str,
) -> str:  # fmt: skip
    """Return a sparse table as a picture, darker where values are larger, neighbors summed."""
    cells = tuple(max(1, min(CELLS, side)) for side in shape)
    drawn = np.zeros(cells)
    if len(values):
        places = tuple(
            np.asarray(index, np.int64) * many // side
            for index, many, side in zip((rows, columns), cells, shape, strict=True)
        )
        np.add.at(drawn, places, values)
    # Square roots show small masses beside large ones.
    share = np.sqrt(drawn / drawn.max()) if drawn.max() > 0 else drawn
    shades = np.rint(255 - share[..., None] * (255 - DARKEST)).astype(np.uint8)
    return picture(shades, caption)


def interval(value: float, low: float, high: float, caption: str) -> str:
    """Return a value between its bounds, on a line that begins at 0, with a line below it."""
    ends = [end for end in (value, low, high) if np.isfinite(end)]
    scale = 300.0 / max((abs(end) for end in ends if end), default=1.0)
    zero = 20.0 - scale * min(0.0, *ends) if ends else 20.0

    def at(place: float, otherwise: float) -> float:
        return zero + scale * place if np.isfinite(place) else otherwise

    left, middle, right = at(low, 0.0), at(value, zero), at(high, zero + 340.0)
    whole = round(max(right, zero + 300.0) + 60)
    text = escape(caption)
    return (
        f'<figure style="margin:0"><svg role="img" aria-label="{text}" viewBox="0 0 {whole} 64" '
        f'width="{whole}" style="max-width:100%;height:auto" fill="currentColor" '
        'font-size="12" font-family="sans-serif">'
        f'<path d="M{zero - 8:.1f} 32H{whole - 8}M{zero:.1f} 26v12" stroke="currentColor" '
        'opacity="0.5"/>'
        f'<rect x="{left:.1f}" y="22" width="{max(right - left, 2.0):.1f}" height="20" rx="3" '
        'fill="#56B4E9" opacity="0.7"/>'
        f'<circle cx="{middle:.1f}" cy="32" r="5" fill="#D55E00"/>'
        f'<text x="{zero:.1f}" y="58" text-anchor="middle">0</text>'
        f'<text x="{middle:.1f}" y="14" text-anchor="middle">{value:.5g}</text>'
        f"</svg><figcaption>{text}</figcaption></figure>"
    )
