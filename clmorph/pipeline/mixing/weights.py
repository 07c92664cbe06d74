"""Weights of mixes: checked, on grids between the images, and along paths."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.printable import printable
from clmorph._shared.typing import Array
from clmorph._shared.validation import check_integer, shown
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError

#: Number of mixes along a side, unless the user says it, and the largest number.
USUAL, MOST = 5, 64
#: Letter of the even mix of all images in a path; images are a, b, c and so forth.
EVEN = "+"
#: Largest number of images: each pair of them is solved.
MOST_IMAGES = 8


class Layout(NamedTuple):
    """Weights of mixes and their places on a sheet."""

    #: Weights of each mix, with the sum 1: (n, K) array.
    weights: Array
    #: Left and top of each mix on the sheet, in units of its cells: (n, 2) array.
    places: Array
    #: Columns and rows of the sheet.
    size: tuple[int, int]


def check_mix_weights(weights: Any, n_images: int) -> Array:
    """Return the weights of one or several mixes, scaled to the sum 1: (n, K) array."""
    found = np.atleast_2d(as_floats("weights", weights, "a weight for each image"))
    if found.ndim != 2 or found.shape[1] != n_images or not len(found):
        raise InputError(
            f"weights have shape {found.shape}: expected {n_images} weights, one for each "
            f"image, or an array (n, {n_images}) for n mixes"
        )
    largest = found.max(axis=1, keepdims=True)
    if not np.all(np.isfinite(found)) or found.min() < 0 or largest.min() <= 0:
        raise InputError(
            "weights: expected finite numbers of at least 0, not all 0 in a mix; 0 leaves an image "
            "out"
        )
    found = found / largest  # the sum of large numbers would overflow
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def row_layout(weights: Array) -> Layout:
    """Return the layout of mixes in one row."""
    n = len(weights)
    return Layout(weights, np.column_stack((np.arange(n), np.zeros(n))), (n, 1))


def grid_layout(n_images: int, grid: Any = None) -> Layout:
    """Return weights and layout of a row, a triangle or a rectangle between 2, 3 or 4 images."""
    if n_images not in (2, 3, 4):
        raise InputError(
            f"{n_images} images have no grid: expected two, three or four; with others give weights"
        )
    sides = [USUAL] if grid is None else list(grid) if isinstance(grid, tuple | list) else [grid]
    if not 1 <= len(sides) <= 2:
        raise InputError(f"grid={shown(grid)}: expected a number, or (rows, columns)")
    sides = [check_integer("grid", side, 1, MOST) for side in sides]
    if n_images == 4:
        rows, columns = sides if len(sides) == 2 else sides * 2
        if min(rows, columns) < 2:
            raise InputError(
                f"grid={shown(grid)}: expected at least 2 rows and 2 columns between four images"
            )
        down, along = np.mgrid[:rows, :columns].reshape(2, -1)
        v, u = down / (rows - 1), along / (columns - 1)
        weights = np.stack(((1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v), axis=1)
        return Layout(weights, np.stack((along, down), axis=1).astype(float), (columns, rows))
    if n_images == 2:
        upright = len(sides) == 2 and sides[1] == 1
        n = max(sides)
        if n < 2 or min(sides) != (1 if len(sides) == 2 else n):
            raise InputError(
                f"grid={shown(grid)}: two images have one row between them; expected a number of "
                "mixes, at least 2"
            )
        t = np.arange(n) / (n - 1)
        found = row_layout(np.stack((1 - t, t), axis=1))
        return found._replace(places=found.places[:, ::-1], size=(1, n)) if upright else found
    if len(set(sides)) != 1 or sides[0] < 2:
        raise InputError(
            f"grid={shown(grid)}: three images have a triangle between them; expected the number "
            "of mixes along its side, at least 2"
        )
    n = sides[0]
    down, along = np.array([(row, k) for row in range(n) for k in range(row + 1)]).T
    weights = np.stack((n - 1 - down, down - along, along), axis=1) / (n - 1)
    return Layout(weights, np.stack((along + 0.5 * (n - 1 - down), down), axis=1), (n, n))


def grid_sides(name: str, text: Any) -> int | tuple[int, int]:
    """Return the sides of a grid from a text such as 5x5 or 7, which errors call `name`."""
    try:
        sides = tuple(int(part) for part in str(text).lower().split("x"))
    except ValueError:
        sides = ()
    if not 1 <= len(sides) <= 2:
        raise InputError(f"{name} {printable(str(text), 40)}: expected rows x columns, such as 5x5")
    return (sides[0], sides[1]) if len(sides) == 2 else sides[0]


def path_weights(path: Any, n_images: int) -> Array:
    """Return the weights (n, K) at a path's stops: letters of images, + for all; or weights."""
    if isinstance(path, str):
        last = chr(ord("a") + n_images - 1)
        corners = np.vstack((np.eye(n_images), np.full(n_images, 1.0 / n_images)))
        letters = {chr(ord("a") + k): k for k in range(n_images)} | {EVEN: n_images}
        if len(path) < 2 or any(letter not in letters for letter in path.lower()):
            raise InputError(
                f"path={shown(path)}: expected two or more letters from a to {last}, one for each "
                "stop, or + for the even mix of all images, such as ab+a"
            )
        return corners[[letters[letter] for letter in path.lower()]]
    stops = check_mix_weights(path, n_images)
    if len(stops) < 2:
        raise InputError("path: expected at least two stops")
    return stops
