"""Tables of colors in three dimensions: read from ``.cube`` files and HALD pictures."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.printable import printable, reason_of
from clmorph._shared.typing import Array
from clmorph._shared.validation import is_path, shown
from clmorph.backends.arrays import as_floats
from clmorph.errors import FileError, InputError
from clmorph.images.pixels import MAX_PIXELS, read_visible
from clmorph.images.resizing import as_unit

#: Fewest and most nodes along an axis, as in the specification of ``.cube``.
LEAST, MOST = 2, 256
#: Most bytes of a file: 40 characters for each line.
MOST_BYTES = 40 * MOST**3
#: The ending of tables as text.
CUBE = ".cube"


@dataclass(frozen=True, eq=False, init=False)
class Lut:
    """A table of colors in three dimensions, as grading programs have them.

    Parameters
    ----------
    table : (n, n, n, 3) array
        What becomes of the colors at even distances from `low` to `high`, by red, green and blue
        in this order; n from 2 to 256. Colors are sRGB; values outside [0, 1] are allowed.
    low, high : float or (3,) array
        The first and the last color of the table. Colors outside take the values of its border.

    Raises
    ------
    InputError
        If the table has another shape, or an entry that is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> levels = np.linspace(0.0, 1.0, 17)
    >>> table = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    >>> lut = clmorph.Lut(1.0 - table)
    >>> clmorph.apply_lut([[0.0, 0.25]], lut, backend="numpy")[0, :, 0].tolist()
    [1.0, 0.75]
    """

    table: Array
    low: Array
    high: Array

    def __init__(self, table: Any, low: Any = 0.0, high: Any = 1.0) -> None:
        values = as_floats("table", table, "an array (n, n, n, 3)")
        n = len(values) if values.ndim else 0
        if values.shape != (n, n, n, 3) or not LEAST <= n <= MOST:
            raise InputError(
                f"table has shape {values.shape}: expected (n, n, n, 3), with n from {LEAST} to "
                f"{MOST}"
            )
        if not np.isfinite(values).all():
            raise InputError("table holds NaN or infinity: expected finite numbers")
        ends = []
        for name, value in (("low", low), ("high", high)):
            end = as_floats(name, value, "a number or three")
            if end.shape not in ((), (3,)) or not np.isfinite(end).all():
                raise InputError(f"{name}={shown(value)}: expected a finite number, or three")
            ends.append(np.broadcast_to(end, 3).astype(float))
        if not np.all(ends[0] < ends[1]):
            raise InputError(f"low={shown(low)}, high={shown(high)}: expected low below high")
        for name, given in (("table", values), ("low", ends[0]), ("high", ends[1])):
            object.__setattr__(self, name, given)

    def __repr__(self) -> str:
        return f"<Lut of {len(self.table)} nodes>"


def read_lut(path: str | PathLike[str], max_pixels: int = MAX_PIXELS) -> Lut:
    """Read a table of colors from a file.

    Parameters
    ----------
    path : path
        ``.cube`` with a table in three dimensions, or a HALD picture of any format that
        `clmorph.read_image` reads.
    max_pixels : int
        Larger pictures are refused.

    Returns
    -------
    Lut
        The table.

    Raises
    ------
    FileError
        If the file cannot be read, or holds no table in three dimensions.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "look.cube")
    ...     clmorph.write_lut(file, clmorph.Lut(np.zeros((2, 2, 2, 3))))
    ...     clmorph.read_lut(file)
    <Lut of 2 nodes>
    """
    if not is_path(path):
        raise InputError(f"path={shown(path)}: expected the path of a table, such as 'look.cube'")
    file = Path(path)
    if file.suffix.lower() != CUBE:
        return _from_hald(file, max_pixels)
    try:
        with file.open("rb") as stream:
            content = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise FileError(f"{file}: it cannot be read ({reason_of(error)})") from None
    try:
        if len(content) > MOST_BYTES:
            raise ValueError("it has too many bytes")
        return _from_text(content.removeprefix(b"\xef\xbb\xbf").decode("latin-1"))
    except ValueError as error:
        raise FileError(f"{file}: {error}; expected a .cube table in three dimensions") from None


def _from_hald(file: Path, max_pixels: int) -> Lut:
    """Return the table in a picture, whose pixels follow one another with red fastest."""
    pixels = as_unit(read_visible(file, max_pixels))[..., :3]
    height, width = pixels.shape[:2]
    level = round(width ** (1 / 3))
    if height != width or level**3 != width or level < 2 or level**2 > MOST:
        raise FileError(
            f"{file} has {width} x {height} pixels: expected a .cube table, or a HALD picture, "
            "whose sides are equal and a cube, such as 512 x 512"
        )
    n = level**2
    return Lut(pixels.reshape(n, n, n, 3).transpose(2, 1, 0, 3))


def _from_text(text: str) -> Lut:
    """Return the table in the text of a ``.cube`` file, or raise ValueError."""
    if "\0" in text:
        raise ValueError("it is not a text")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    size, low, high, rows = 0, np.zeros(3), np.ones(3), 0
    for number, line in lines:
        word, *rest = line.split()
        if word[0] in "+-.0123456789" or word.lower() in ("nan", "inf", "infinity"):
            break
        rows += 1
        if word == "TITLE":
            continue
        if word.startswith("LUT_1D"):
            raise ValueError(f"line {number}: {word} belongs to a table in one dimension")
        counts = {"LUT_3D_SIZE": 1, "LUT_3D_INPUT_RANGE": 2, "DOMAIN_MIN": 3, "DOMAIN_MAX": 3}
        if len(rest) != counts.get(word, -1):
            raise ValueError(f"line {number}: {printable(line, 40)!r} is not understood")
        values = _numbers(" ".join(rest))
        if word == "LUT_3D_SIZE":
            if values[0] % 1 or not LEAST <= values[0] <= MOST:
                raise ValueError(f"its size is {rest[0]}, not a number from {LEAST} to {MOST}")
            size = int(values[0])
        elif word == "LUT_3D_INPUT_RANGE":
            low, high = np.full(3, values[0]), np.full(3, values[1])
        elif word == "DOMAIN_MIN":
            low = values
        else:
            high = values
    if not size:
        raise ValueError("LUT_3D_SIZE is missing in it")
    if len(lines) - rows != size**3:
        raise ValueError(f"it has {len(lines) - rows} colors where its size asks for {size**3}")
    values = _numbers("\n".join(line for _, line in lines[rows:]))
    if len(values) != 3 * size**3:
        raise ValueError(f"it has {len(values)} numbers where its size asks for {3 * size**3}")
    if not np.all(low < high):
        raise ValueError(f"its domain from {low.tolist()} to {high.tolist()} is empty")
    # In the file red changes fastest.
    return Lut(values.reshape(size, size, size, 3).transpose(2, 1, 0, 3), low, high)


def _numbers(text: str) -> Array:
    """Return the numbers of a text, or raise ValueError."""
    words = text.split()
    try:
        values = np.array(words, float)
    except ValueError:
        for word in words:
            try:
                float(word)
            except ValueError:
                raise ValueError(f"{printable(word, 40)!r} is not a number") from None
        raise
    if not np.isfinite(values).all():
        raise ValueError("it holds NaN or infinity")
    return values
