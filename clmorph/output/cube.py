"""Tables of colors in three dimensions as ``.cube`` files, which grading programs read."""

from os import PathLike
from pathlib import Path

from clmorph._shared.files import check_file_place
from clmorph._shared.printable import printable
from clmorph._shared.typing import Array
from clmorph.errors import OutputError


def check_cube_place(path: str | PathLike[str]) -> Path:
    """Return the path of a table to be written, or raise OutputError if it cannot be written."""
    ending = Path(path).suffix.lower()
    if ending != ".cube":
        raise OutputError(
            f"{path}: unknown ending {printable(repr(ending), 40)}; expected .cube for a table"
        )
    return check_file_place(path)


def write_cube(table: Array, file: Path) -> None:
    """Write a table (n, n, n, 3), indexed by red, green and blue, to a new file."""
    # In the file red changes fastest.
    rows = table.transpose(2, 1, 0, 3).reshape(-1, 3)
    lines = [f"LUT_3D_SIZE {len(table)}", *(f"{r:.6f} {g:.6f} {b:.6f}" for r, g, b in rows)]
    file.write_text("\n".join(lines) + "\n", "ascii")
