"""The soft minimum between two grids, whose squared distances are sums over the axes.

    sum_j b_j exp((g_j - C_ij) / epsilon) = sum_l k_il sum_m k_jm ... b_lm.. exp(g_lm.. / epsilon)

with exp(-(x - y)^2 / (2 epsilon)) of each axis for k, so that one log-sum-exp along each axis sums
over all cells. Nothing is stored beside a few vectors.

Source of the idea: Solomon et al., "Convolutional Wasserstein distances" (2015).
"""

from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.backends.rounding import rounding_error
from clmorph.measures.grid import Grid
from clmorph.transport._solver.softmin import Softmin, check_finite

#: Relative error of a power, a sum of few terms or a coordinate in float64, with room to spare.
UNIT = 2.0**-50
#: Roundings of a squared distance, each relative to the square of the extent.
OF_COSTS = 8.0


class GridSoftmin(Softmin):
    """The operator T between two grids, which leaves out nothing."""

    def __init__(self, operations: Operations, rows: Grid, columns: Grid) -> None:
        super().__init__(operations, rows, columns, (rows.weights, columns.weights))
        self.n_columns = sum(columns.shape)
        with np.errstate(divide="ignore"):
            self._log_weights = np.log(columns.weights)

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential), (N,); flags as in `Softmin`, and `bounded` sums are `precise`."""
        exponents = potential / epsilon
        self.roundoff = self._roundoff(exponents, epsilon) if bounded else 0.0
        exponents += self._log_weights
        logarithms = self._sum(exponents, epsilon, precise or bounded)
        logarithms *= -epsilon
        return check_finite(logarithms)

    def means(self, potential: Array, epsilon: float) -> tuple[Array, Array]:
        """Return T(potential), (N,), and the mean of each row's destinations, (N, D)."""
        exponents = potential / epsilon + self._log_weights
        of_rows = self._sum(exponents, epsilon, True)
        means = np.empty((len(of_rows), self.rows.dimension))
        for k, axis in enumerate(self.columns.axes):
            # A mass is multiplied by its coordinate, shifted so that its logarithm exists.
            extent = float(np.ptp(axis))
            origin = axis.min() - (extent or 1.0)
            shape = [-1 if other == k else 1 for other in range(self.columns.dimension)]
            further = exponents.reshape(self.columns.shape) + np.log(axis - origin).reshape(shape)
            mean = origin + np.exp(self._sum(further.reshape(-1), epsilon, True) - of_rows)
            means[:, k] = np.clip(mean, axis.min(), axis.max())
        return check_finite(-epsilon * of_rows), means

    def _sum(self, exponents: Array, epsilon: float, precise: bool) -> Array:
        scale = (0.5 / epsilon) ** 0.5
        # Coordinates are counted from the first cell, so that far from the origin squared distances
        # are not rounded by more.
        axes = [
            (scale * (x - y[0]), scale * (y - y[0]))
            for x, y in zip(self.rows.axes, self.columns.axes, strict=True)
        ]
        found = self.operations.grid_log_sum_exp(
            exponents.reshape(self.columns.shape), axes, precise
        )
        return found.reshape(-1)

    def _roundoff(self, exponents: Array, epsilon: float) -> float:
        """Return a bound of the rounding of T(potential), given potential / epsilon, in nats.

        A pass rounds exponents relative to their range, which squared distances and numbers of
        terms enlarge, squared distances relative to the extent's, and its sums once a term.
        """
        given, logarithms = exponents[self._massive], self._log_weights[self._massive]
        size = float(np.abs(given).max() + np.abs(logarithms).max())
        total = 0.0
        for x, y in zip(self.rows.axes, self.columns.axes, strict=True):
            ends = np.array([x[0], x[-1], y[0], y[-1]])
            size += 0.5 * float(np.ptp(ends)) ** 2 / epsilon + np.log(len(y))
            total += UNIT * (OF_COSTS * size + len(y) + 32)
        return total

    def rounding(
        self, largest_cost: Any, epsilon: float, precise: bool, exact: bool = False
    ) -> Any:
        """Return the largest effect of rounding on a softmin; a pass rounds those before."""
        return rounding_error(
            self.operations, self.n_columns, 2 * largest_cost / epsilon, precise, exact or precise
        )
