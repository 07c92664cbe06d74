"""Fit frames of any sizes onto one canvas, for files whose frames all have one size."""

import math
from collections.abc import Iterable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from clmorph._shared.typing import AnyArray
from clmorph.output.options import FrameStyle

#: The enlargement from which frames look soft.
ENLARGED = 1.25


def in_time(shapes: Iterable[tuple[int, ...]], times: AnyArray) -> list[tuple[int, ...]]:
    """Return frames' shapes in the order of the morph's time, even if it is shown in reverse."""
    shapes = list(shapes)
    return [shapes[index] for index in np.argsort(times, kind="stable")]


def enlargement_note(
    style: FrameStyle, shapes: Iterable[tuple[int, ...]], pixelated: bool, size: int | None
) -> str | None:
    """Return a note if a canvas enlarges smooth frames much; `size` is the option ``--size``."""
    if isinstance(style.canvas, str) or style.is_nearest(pixelated):
        return None
    shapes, (right, down) = list(shapes), style.canvas
    factor = min(min(right / shape[1], down / shape[0]) for shape in shapes)
    if factor < ENLARGED:
        return None
    height, width, _ = max(shapes, key=lambda shape: (max(shape[:2]), shape[0] * shape[1]))
    note = (
        f"frames of up to {width}x{height} pixels are enlarged {factor:.2g} times to fit the "
        f"canvas of {right}x{down}"
    )
    if size is None or max(height, width) < size:
        return f"{note}: the pictures themselves have no more pixels"
    return f"{note}; for sharper frames, which take longer, add --size {round(size * factor)}"


class Framing:
    """Bring frames of `shapes` (H, W, C), in the order of the morph's time, to one size.

    `side` is the least length in pixels of the longer side where the style leaves the size open.
    With `even` the size is rounded up to even numbers, for video; `opacity` tells whether the file
    can hold it. The attribute `size` is (width, height), and `clear` whether pictures have opacity.
    """

    def __init__(
        self,
        style: FrameStyle,
        shapes: Iterable[tuple[int, ...]],
        pixelated: bool,
        side: int = 1,
        even: bool = False,
        opacity: bool = True,
    ) -> None:
        shapes = list(shapes)
        self.nearest = style.is_nearest(pixelated)
        transparent = any(shape[2] == 4 for shape in shapes)
        self.clear = transparent and opacity and style.background is None
        self._background = style.background or ("white" if transparent else "black")
        if style.canvas == "dynamic":
            self.size = self._size_for_all(shapes, side)
        elif style.canvas == "source":
            self.size = shapes[0][1], shapes[0][0]
        elif style.canvas == "target":
            self.size = shapes[-1][1], shapes[-1][0]
        else:
            self.size = cast(tuple[int, int], style.canvas)
        self._inner = self.size
        if even:
            self.size = self.size[0] + self.size[0] % 2, self.size[1] + self.size[1] % 2

    def _size_for_all(self, shapes: list[tuple[int, ...]], side: int) -> tuple[int, int]:
        height, width = (max(shape[axis] for shape in shapes) for axis in (0, 1))
        factor = max(1.0, side / max(height, width))
        if self.nearest:
            factor = np.ceil(factor)  # pixels of one size
        return max(1, round(width * factor)), max(1, round(height * factor))

    @property
    def ground(self) -> tuple[int, ...] | None:
        """Color of bars and behind transparent pixels, as RGB; None if these stay transparent."""
        if self.clear:
            return None
        color = ImageColor.getcolor(self._background, "RGB")
        return color if isinstance(color, tuple) else (color,) * 3

    def __call__(self, frame: NDArray[np.uint8]) -> Image.Image:
        """Return a frame (H, W, 3 or 4) centered on the canvas; pixel art by whole factors."""
        picture = self._grounded(self._scaled(Image.fromarray(frame)))
        if picture.size == self.size:
            return picture
        margins = [whole - part for whole, part in zip(self.size, picture.size, strict=True)]
        if picture.size == self._inner:
            # Video may need one more row or column, which repeats the border of the frame.
            edges = (0, margins[1]), (0, margins[0]), (0, 0)
            return Image.fromarray(np.pad(np.asarray(picture), edges, mode="edge"))
        ground: Any = (0, 0, 0, 0) if self.clear else self._background
        page = Image.new(picture.mode, self.size, ground)
        page.paste(picture, (margins[0] // 2, margins[1] // 2))
        return page

    def unscaled(self, frame: NDArray[np.uint8]) -> Image.Image:
        """Return a frame at its own size, with opacity or on the background like the others."""
        return self._grounded(Image.fromarray(frame))

    def _grounded(self, picture: Image.Image) -> Image.Image:
        if self.clear:
            return picture.convert("RGBA")
        if picture.mode == "RGB":
            return picture
        page = Image.new("RGB", picture.size, self._background)
        page.paste(picture, mask=picture)
        return page

    def _scaled(self, picture: Image.Image) -> Image.Image:
        factor = min(whole / part for whole, part in zip(self._inner, picture.size, strict=True))
        if self.nearest and factor > 1:
            factor = math.floor(factor)
        width, height = (max(1, round(side * factor)) for side in picture.size)
        size = width, height
        if size == picture.size:
            return picture
        if self.nearest:
            return picture.resize(size, Image.Resampling.NEAREST)
        how = Image.Resampling.BICUBIC if factor > 1 else Image.Resampling.LANCZOS
        return (
            _resampled(picture, size, how) if picture.mode == "RGBA" else picture.resize(size, how)
        )


def _resampled(picture: Image.Image, size: tuple[int, int], how: Image.Resampling) -> Image.Image:
    """Return an RGBA picture at another size, with colors weighted by opacity."""
    pixels = np.asarray(picture, np.float32)
    weighted = [pixels[..., channel] * pixels[..., 3] for channel in range(3)]
    *weighted, alpha = (
        np.asarray(Image.fromarray(plane).resize(size, how))
        for plane in (*weighted, np.ascontiguousarray(pixels[..., 3]))
    )
    seen = alpha >= 0.5
    colors = [np.divide(plane, alpha, out=np.zeros_like(plane), where=seen) for plane in weighted]
    # Opacity is clipped only after the division by it, or a light rim would remain.
    made = np.clip(np.rint(np.dstack((*colors, alpha))), 0, 255).astype(np.uint8)
    return Image.fromarray(made)
