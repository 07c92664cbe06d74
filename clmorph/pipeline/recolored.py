"""The result `Recolored`: an array that a notebook shows as a picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from clmorph._shared.notebook import picture
from clmorph.images.pixels import to_bytes


class Recolored(np.ndarray):
    """A recolored picture: an array like any other, which a notebook shows as a picture.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> found = clmorph.recolor(np.zeros((2, 2, 3)), np.ones((2, 2, 3)), backend="numpy")
    >>> isinstance(found, np.ndarray), found.shape
    (True, (2, 2, 3))
    >>> found._repr_html_().startswith("<figure")
    True
    """

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Results of calculations are plain arrays and numbers."""
        return np.asarray(array) if array.ndim else array[()]

    def _repr_html_(self) -> str | None:
        """Show the picture in a notebook; None, for the numbers, if this is none."""
        if self.ndim != 3 or self.shape[2] not in (3, 4) or not self.size:
            return None
        if self.dtype != np.float64 or not ((self >= 0) & (self <= 1)).all():
            return None
        height, width = self.shape[:2]
        return picture(to_bytes(np.asarray(self)), f"Recolored picture, {width} × {height} pixels")
