"""Tables of colors in three dimensions as files: ``.cube``, and HALD pictures."""

from os import PathLike
from pathlib import Path

import numpy as np

from clmorph._shared.files import atomic_path, check_named_place
from clmorph._shared.validation import shown
from clmorph.errors import InputError
from clmorph.images.looks import CUBE, Lut

#: The ending of HALD pictures, and the nodes that a table needs for one: squares of whole numbers.
HALD = ".png"
HALD_SIZES = tuple(level**2 for level in range(2, 17))


def check_lut_place(path: str | PathLike[str]) -> Path:
    """Return the path of a table to be written, or raise OutputError if it cannot be written."""
    expected = ".cube for a table, or .png for a HALD picture of it"
    return check_named_place(path, (CUBE, HALD), "look.cube", expected)


def nodes_of(place: Path) -> int:
    """Return the usual number of nodes of a table in a file: 33, or 64 in a HALD picture."""
    return 64 if place.suffix.lower() == HALD else 33


def put_lut(lut: Lut, file: Path) -> None:
    """Write a table to a new file in the ending's format."""
    # In both red changes fastest.
    rows = lut.table.transpose(2, 1, 0, 3).reshape(-1, 3)
    if file.suffix.lower() == CUBE:
        lines = ['TITLE "clmorph"', f"LUT_3D_SIZE {len(lut.table)}"]
        for name, end, usual in (("MIN", lut.low, 0.0), ("MAX", lut.high, 1.0)):
            if np.any(end != usual):
                lines.append(f"DOMAIN_{name} " + " ".join(f"{value:.9g}" for value in end))
        lines += [f"{r:.6f} {g:.6f} {b:.6f}" for r, g, b in rows]
        file.write_text("\n".join(lines) + "\n", "ascii")
        return
    from imagecodecs import png_encode

    side = round(len(lut.table) ** 1.5)
    pixels = np.rint(65535.0 * np.clip(rows, 0.0, 1.0)).astype(np.uint16)
    file.write_bytes(png_encode(pixels.reshape(side, side, 3)))


def write_lut(path: str | PathLike[str], lut: Lut) -> None:
    """Write a table of colors to a file, the counterpart of `clmorph.read_lut`.

    Parameters
    ----------
    path : path
        ``.cube``, or ``.png`` for a HALD picture with 16 bits a channel, which needs a table of
        4, 9, 16, ..., 64, ... nodes over [0, 1]; its values are clipped. An existing file is
        replaced.
    lut : Lut
        The table.

    Raises
    ------
    InputError
        If an argument cannot be used.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "hald.png")
    ...     clmorph.write_lut(file, clmorph.Lut(np.zeros((4, 4, 4, 3))))
    ...     clmorph.read_image(file).shape
    (8, 8, 3)
    """
    place = check_lut_place(path)
    if not isinstance(lut, Lut):
        raise InputError(f"lut={shown(lut)}: expected a Lut, as clmorph.read_lut returns it")
    usual = not lut.low.any() and bool(np.all(lut.high == 1.0))
    if place.suffix.lower() == HALD and (len(lut.table) not in HALD_SIZES or not usual):
        raise InputError(
            f"lut has {len(lut.table)} nodes: expected 4, 9, 16, ..., 256 over [0, 1] for a HALD "
            "picture; write .cube"
        )
    with atomic_path(place) as file:
        put_lut(lut, file)
