"""Least-squares fits of values that are close to linear over the points of a tile."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SLICED_FROM
from clmorph.backends.records import Float64

#: Added to the normal equations, relative to their trace: points of a tile may lie in a plane.
RIDGE = 1e-6


class TileFits:
    """Fits values over the points of each tile, less its center, by linear functions."""

    def __init__(self, shifts: NDArray[np.float32]) -> None:
        self._shifts = shifts

    @cached_property
    def half_squares(self) -> Float64:
        """Half the squared distances of the points from their tile's center: (tiles, tile)."""
        return 0.5 * np.einsum("ntd,ntd->nt", self._shifts, self._shifts, dtype=float)

    @cached_property
    def _of_values(self) -> NDArray[np.float32]:
        """The matrices that turn values of all points into slopes: (tiles, D, tile) array."""
        u = self._shifts - self._shifts.mean(axis=1, dtype=float)[:, None]
        across = np.swapaxes(u, 1, 2)
        # `solve` takes many times as long for so many right sides of small matrices.
        found: NDArray[np.float64] = np.linalg.inv(_with_ridge(across @ u)) @ across
        return found.astype(np.float32)

    def slopes(self, values: Float64, present: NDArray[np.bool_]) -> Float64:
        """Return least-squares slopes of values over present points, (tiles, D), as float32."""
        if self._shifts.shape[2] >= SLICED_FROM:
            # A tile has hardly more points than slopes.
            return np.zeros((len(values), self._shifts.shape[2]))
        centered = (values - values.mean(axis=1, keepdims=True)).astype(np.float32)
        slopes = (self._of_values @ centered[..., None])[..., 0]
        some = np.flatnonzero(~present.all(axis=1))
        if len(some):
            slopes[some] = _slopes_of_some(self._shifts[some], values[some], present[some])
        return slopes.astype(float)


def _slopes_of_some(
    shifts: NDArray[np.float32], values: Float64, present: NDArray[np.bool_]
) -> Float64:
    """Return the slopes of values of the points that are present: (tiles, D) array."""
    weights = present.astype(float)
    count = np.maximum(weights.sum(axis=1), 1.0)
    means = np.einsum("ntd,nt->nd", shifts, weights) / count[:, None]
    u = (shifts - means[:, None]) * weights[..., None]
    v = values - (np.einsum("nt,nt->n", values, weights) / count)[:, None]
    right = np.einsum("ntd,nt->nd", u, v * weights)
    normal = _with_ridge(np.einsum("ntd,nte->nde", u, u))
    slopes: Float64 = np.linalg.solve(normal, right[..., None])[..., 0]
    return slopes


def _with_ridge(normal: Float64) -> Float64:
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2) + 1e-30
    result: Float64 = normal + ridge[:, None, None] * np.eye(normal.shape[1])
    return result
