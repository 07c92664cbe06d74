"""Recoloring by tables of colors: fitting them, and applying them on a device."""

from __future__ import annotations

from typing import Unpack

import numpy as np

from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_integer, check_number, check_progress, shown
from clmorph.backends.interface import Operations
from clmorph.backends.records import Float32
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.images.looks import LEAST, MOST, Lut
from clmorph.images.pixels import as_pixels
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import RecolorKeywords
from clmorph.pipeline.recolor import Look, Recolored, as_mask, check_for_picture, lattice, look_of
from clmorph.pipeline.recolor_options import RecolorOptions


class LutOnDevice:
    """A table on a device."""

    def __init__(self, lut: Lut, operations: Operations) -> None:
        self._operations, self._low = operations, lut.low.astype(np.float32)
        self._scale = (1.0 / (lut.high - lut.low)).astype(np.float32)
        self._table = operations.upload_table(lut.table.astype(np.float32))
        self._is_usual = not lut.low.any() and bool(np.all(lut.high == 1.0))

    def __call__(self, colors: Array | Float32) -> Float32:
        """Return sRGB colors (..., 3) in [0, 1] after the table, in [0, 1], as float32."""
        flat = np.ascontiguousarray(colors, np.float32).reshape(-1, 3)
        if not self._is_usual:
            flat = (flat - self._low) * self._scale
        found = self._operations.apply_table(self._table, flat)
        shape: tuple[int, ...] = colors.shape
        return np.clip(found, 0.0, 1.0, out=found).reshape(shape)


def apply_lut(
    image: ArrayLike,
    lut: Lut,
    *,
    mask: ArrayLike | None = None,
    strength: float = 1.0,
    backend: Backend = "auto",
) -> Recolored:
    """Recolor a picture by a table of colors, by tetrahedral interpolation between its nodes.

    Parameters
    ----------
    image : array
        The picture, see `clmorph.images.pixels.as_pixels`.
    lut : Lut
        The table, such as `clmorph.read_lut` or `clmorph.fit_lut` returns.
    mask : (H, W) array, optional
        Where the picture is recolored, as in `clmorph.recolor`.
    strength : float
        Share of the way that colors go, from 0 to 1.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Recolored
        As `clmorph.recolor` returns it.

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> dark = clmorph.Lut(np.full((2, 2, 2, 3), 0.25))
    >>> clmorph.apply_lut(np.ones((1, 1, 3)), dark, strength=0.5, backend="numpy").tolist()
    [[[0.625, 0.625, 0.625]]]
    """
    if not isinstance(lut, Lut):
        raise InputError(f"lut={shown(lut)}: expected a Lut, as clmorph.read_lut returns it")
    check_number("strength", strength, 0.0, 1.0)
    pixels = as_pixels(image, "image")
    amount = as_mask(mask, (pixels.shape[0], pixels.shape[1]))
    return graded(pixels, lut, amount, strength, get_backend(backend)).view(Recolored)


def graded(
    pixels: Array, lut: Lut, mask: Array | None, strength: float, operations: Operations
) -> Array:
    """Apply a table to a picture, (H, W, 3 or 4); the parameters are checked ones."""
    found = pixels.copy()
    shares = strength if mask is None else strength * mask[..., None]
    colors = pixels[..., :3]
    found[..., :3] = colors + shares * (LutOnDevice(lut, operations)(colors) - colors)
    if mask is not None:
        found[mask == 0] = pixels[mask == 0]
    return found


@documented(RecolorOptions)
def fit_lut(
    image: ArrayLike,
    like: ArrayLike,
    options: RecolorOptions | None = None,
    *,
    size: int = 33,
    mask: ArrayLike | None = None,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[RecolorKeywords],
) -> Lut:
    """Return the change of colors of `clmorph.recolor` as a table, for other pictures.

    Parameters
    ----------
    image, like, options, mask, backend, progress
        As in `clmorph.recolor`. A mask says which colors count.
    size : int
        Nodes of the table along each axis, from 2 to 256.
    {options}

    Returns
    -------
    Lut
        The table, for `clmorph.apply_lut` and `clmorph.write_lut`.

    Raises
    ------
    InputError
        If an argument cannot be used.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> gray = np.linspace(0.0, 1.0, 5)[None]
    >>> blue = gray[..., None] * [0.2, 0.4, 1.0]
    >>> lut = clmorph.fit_lut(gray, blue, reach=None, size=9, backend="numpy")
    >>> lut.table[-1, -1, -1].round(2).tolist()
    [0.2, 0.4, 1.0]
    """
    chosen = RecolorOptions.of_call(options, given, "strength=0.5")
    check_for_picture(chosen)
    nodes = check_integer("size", size, LEAST, MOST)
    report = check_progress(progress)
    pixels, other = as_pixels(image, "image"), as_pixels(like, "like")
    amount = as_mask(mask, (pixels.shape[0], pixels.shape[1]))
    look = look_of(pixels, other, chosen, amount, get_backend(backend), report)
    return lut_of(look, nodes, report)


def lut_of(look: Look | None, size: int, report: StageProgress) -> Lut:
    """Return a look as a table; without one, that of colors that do not change."""
    colors = lattice(size)
    if look is not None:
        colors = look.moved(colors, report)
    return Lut(colors.reshape(size, size, size, 3))
