"""The operations in NumPy and float64, with which other backends are compared."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import MAX_SPREAD
from clmorph.backends.numpy.blocks import BLOCK_ENTRIES, costs, exponent_blocks, plan_blocks
from clmorph.backends.numpy.fields import apply_table, grid_log_sum_exp, nearest_seeds
from clmorph.backends.numpy.handles import Cloud, ParticleSet, Splats
from clmorph.backends.numpy.layers import draw_layers, edge_preserving_mean, follow_paths
from clmorph.backends.records import (
    WIDTH_LEVELS,
    Bins,
    Float32,
    Float64,
    NearPairs,
    PlanRows,
    PlanTerms,
    StoredPairs,
    StoredVectors,
    bin_grid,
)

#: The clouds of many problems.
Batch = list[Cloud]


def _problems(
    rows: Batch, columns: Batch, potential: Float64
) -> Iterator[tuple[Cloud, Cloud, Float64]]:
    """Return the two clouds of each problem, and its part of the potential."""
    ends = np.cumsum([len(cloud.points) for cloud in columns])
    return zip(rows, columns, np.split(potential, ends[:-1]), strict=True)


class NumPyOperations:
    """The operations of `clmorph.backends.interface.Operations`, simple rather than fast."""

    description = "NumPy float64"
    bin_size = 8
    sum_roundoff = exponent_roundoff = precise_roundoff = 2.0**-53
    has_float64 = True
    max_spread = MAX_SPREAD
    memory_bytes: int | None = None
    shares_host_memory = on_processor = True
    pairs_per_second = 0.0

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Cloud:
        """Upload a weighted cloud."""
        with np.errstate(divide="ignore"):
            log_weights = np.log(np.asarray(weights, float))
        added = np.zeros(len(points)) if offsets is None else np.asarray(offsets, float)
        return Cloud(np.asarray(points, float), log_weights, added)

    def softmin(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) (paper, 3.1; math: softmin)."""
        if isinstance(rows, list):
            problems = _problems(rows, columns, potential)
            return np.concatenate([self.softmin(*problem, epsilon) for problem in problems])
        result = np.empty(len(rows.points))
        for block, exponents in exponent_blocks(rows, columns, potential, epsilon, near):
            largest = exponents.max(axis=1)
            total = np.exp(exponents - largest[:, None]).sum(axis=1)
            result[block] = -epsilon * (largest + np.log(total))
        return result

    def grid_log_sum_exp(
        self, exponents: Float64, axes: Sequence[tuple[Float64, Float64]], precise: bool = False
    ) -> Float64:
        """Return log sum_j exp(e_j - |x_i - y_j|^2) over the cells of a grid."""
        return grid_log_sum_exp(exponents, axes)

    def start_iteration(
        self,
        rows: Cloud,
        columns: Cloud,
        weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
        corrections: tuple[Float64 | float, Float64 | float] = (0.0, 0.0),
    ) -> None:
        """Return None: all arithmetic is on the host."""

    def bounded_softmin(
        self,
        rows: Any,
        columns: Any,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
        enough: float = 0.0,
    ) -> tuple[Float64, Any]:
        """Return T(g) and a bound of its rounding error in nats."""
        if isinstance(rows, list):
            problems = _problems(rows, columns, potential)
            found = [self.bounded_softmin(*problem, epsilon) for problem in problems]
            softmins, errors = zip(*found, strict=True)
            return np.concatenate(softmins), np.array(errors)
        softmin = self.softmin(rows, columns, potential, epsilon, near=near)
        points = np.concatenate((rows.points, columns.points))
        size = 0.5 * float(np.sum(np.ptp(points, axis=0) ** 2))
        massive = columns.log_weights > -np.inf
        size += float(np.abs(potential[massive]).max() + np.abs(columns.offsets).max())
        size = (size + float(np.abs(rows.offsets).max())) / epsilon
        size += float(np.abs(columns.log_weights[massive]).max())
        operations = (points.shape[1] + 12) * size + len(columns.points) + 8
        return softmin, operations * 2.0**-52

    def upload_batch(
        self,
        points: Float64,
        weights: Float64,
        counts: NDArray[np.int64],
        offsets: Float64 | None = None,
    ) -> Batch:
        """Upload the clouds of many problems."""
        ends = np.cumsum(counts)[:-1]
        parts = zip(
            *(np.split(each, ends) for each in self.upload(points, weights, offsets)), strict=True
        )
        return [Cloud(*part) for part in parts]

    def take_batch(self, batch: Batch, problems: NDArray[np.int64]) -> Batch:
        """Return a batch of some clouds of a batch."""
        return [batch[number] for number in problems]

    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that contribute to the rows' sums, one by one, and ignore the estimate."""
        keep = np.ones((len(rows.points), len(columns.points)), bool)
        found, skipped = np.empty(len(keep)), np.empty(len(keep))
        largest = 0.0
        for block, exponents in exponent_blocks(rows, columns, potential, epsilon):
            top = exponents.max(axis=1, keepdims=True)
            share = np.exp(exponents - top)
            share /= share.sum(axis=1, keepdims=True)
            order = np.argsort(share, axis=1)
            below = np.cumsum(np.take_along_axis(share, order, axis=1), axis=1)
            np.put_along_axis(keep[block], order, below > budget, axis=1)
            left = np.where(keep[block], 0.0, share).sum(axis=1)
            total = np.exp(exponents - top).sum(axis=1)
            found[block] = -epsilon * (top[:, 0] + np.log(total) + np.log1p(-left))
            # Shares that underflow may grow when potentials change.
            left[~keep[block].all(axis=1)] += np.finfo(float).tiny
            skipped[block] = left / (1.0 - left)
            cost = np.where(keep[block], costs(rows.points[block], columns.points), 0.0)
            largest = max(largest, float(cost.max()))
        counts = keep.sum(axis=1)
        return NearPairs(keep, found, skipped, int(counts.sum()), int(counts.max()), largest)

    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        result = np.empty(len(rows.points))
        for block, exponents in exponent_blocks(rows, columns, potential, epsilon, near):
            result[block] = exponents.max(axis=1)
        return result

    def count_plan_rows(self, plan: PlanTerms, precise: bool = False) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps."""
        counts = np.zeros(len(plan.rows.points), np.int64)
        for block, _, keep in plan_blocks(plan):
            counts[block] = keep.sum(axis=1)
        return counts

    def plan_rows(
        self, plan: PlanTerms, precise: bool = False, counts: NDArray[np.int64] | None = None
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold."""
        lengths, indices, mass = [np.zeros(1, np.int64)], [], []
        for _, log_plan, keep in plan_blocks(plan):
            lengths.append(keep.sum(axis=1))
            indices.append(np.nonzero(keep)[1].astype(np.int32))
            mass.append(np.exp(log_plan[keep]))
        indptr = np.cumsum(np.concatenate(lengths))
        return PlanRows(indptr, np.concatenate(indices), np.concatenate(mass))

    def store_pairs(
        self,
        plan: PlanTerms,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Store log pi_ij of pairs, as a dense matrix with -inf elsewhere."""
        whole = np.full((len(plan.rows.points), len(plan.columns.points)), -np.inf)
        for block, log_plan, keep in plan_blocks(plan):
            whole[block] = np.where(keep, log_plan, -np.inf)
        if near[0] is not None and near[1] is not None:
            whole[~(near[0].pairs | near[1].pairs.T)] = -np.inf
        n_pairs = int(np.isfinite(whole).sum())
        orders = np.arange(whole.shape[0]), np.arange(whole.shape[1])
        return StoredPairs(whole, n_pairs, orders) if n_pairs <= max_pairs else None

    def sum_stored(
        self, stored: StoredPairs, changes: Float64, by_column: bool, ordered: bool = False
    ) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the stored pairs of every row, or column."""
        exponents = (stored.pairs.T if by_column else stored.pairs) + changes
        largest = np.maximum(exponents.max(axis=1), np.finfo(float).min)
        with np.errstate(divide="ignore"):
            return largest + np.log(np.exp(exponents - largest[:, None]).sum(axis=1))

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
        over: Any = None,
    ) -> None:
        """Return None: all arithmetic is on the host."""

    def barycentric_projection(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return T(g), and the mean of each row's destinations."""
        softmin, mean = np.empty(len(rows.points)), np.empty(rows.points.shape)
        for block, exponents in exponent_blocks(rows, columns, g, epsilon, near):
            largest = exponents.max(axis=1, keepdims=True)
            share = np.exp(exponents - largest)
            sums = share.sum(axis=1)
            softmin[block] = -epsilon * (np.log(sums) + largest[:, 0])
            mean[block] = (share @ columns.points) / sums[:, None]
        return softmin, mean

    def plan_moments(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return mean and covariance of each row's destinations."""
        n, dimension = rows.points.shape
        mean, covariance = np.empty((n, dimension)), np.empty((n, dimension, dimension))
        for block, exponents in exponent_blocks(rows, columns, g, epsilon, near):
            share = np.exp(exponents + softmin[block, None] / epsilon)
            share /= share.sum(axis=1, keepdims=True)
            mean[block] = share @ columns.points
            middle = columns.points.mean(axis=0)
            for d in range(dimension):
                off = share * (columns.points[:, d] - mean[block, d, None])
                covariance[block, d] = off @ (columns.points - middle)
                covariance[block, d] -= off.sum(axis=1)[:, None] * (mean[block] - middle)
        return mean, covariance

    def sample_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        thresholds: Float64,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> NDArray[np.int32]:
        """Return columns drawn from each plan row."""
        draws = np.empty(thresholds.shape, np.int32)
        for block, exponents in exponent_blocks(rows, columns, g, epsilon, near):
            sums = np.cumsum(np.exp(exponents + softmin[block, None] / epsilon), axis=1)
            sums /= sums[:, -1:]
            for row, (own, wanted) in enumerate(zip(sums, thresholds[block], strict=True)):
                draws[block][row] = np.searchsorted(own, wanted, side="right")
        return draws

    def upload_particles(
        self, table: Float64, links: NDArray[np.uint32], weights: Float64
    ) -> ParticleSet:
        """Upload particles that move in straight lines."""
        return ParticleSet(table, links, weights)

    def advect(
        self,
        particles: ParticleSet,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Splats:
        """Move particles to time t, and transform them to pixel coordinates of a canvas."""
        start, end = particles.table[particles.links[:, 0]], particles.table[particles.links[:, 1]]
        moved = (1 - t) * start + t * end
        weights = (1 - t) * particles.weights[:, 0] + t * particles.weights[:, 1]
        positions = (moved[:, :2] - 0.5) * np.asarray(scale) + np.asarray(center)
        spacings = moved[:, 5] * 0.5 * (scale[0] + scale[1])
        return Splats(positions, moved[:, 2:5], weights, spacings)

    edge_preserving_mean = staticmethod(edge_preserving_mean)

    follow_paths = staticmethod(follow_paths)

    def upload_spline(self, coefficients: Float32) -> Float32:
        """Upload a picture, as the coefficients of a cubic spline."""
        return coefficients

    def upload_layer(self, paths: Float32, change: Float32) -> tuple[Float32, Float32]:
        """Upload what moves and recolors a picture."""
        return paths, change

    draw_layers = staticmethod(draw_layers)

    def upload_splats(
        self, positions: Float32, colors: Float32, weights: Float32, spacings: Float32 | None = None
    ) -> Splats:
        """Upload particles at rest."""
        given = np.ones(len(weights)) if spacings is None else spacings
        return Splats(*(array.astype(float) for array in (positions, colors, weights, given)))

    def deposit(self, splats: Splats, shape: tuple[int, int]) -> tuple[Float64, Float64]:
        """Give each splat to its nearest pixel, and return sums of masses and of their squares."""
        column, row = np.ceil(splats.positions - 0.5).T.astype(np.int64)
        inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        pixel = (row * shape[1] + column)[inside]
        sums = [
            np.bincount(pixel, splats.weights[inside] ** power, shape[0] * shape[1]).astype(float)
            for power in (1, 2)
        ]
        return sums[0].reshape(shape), sums[1].reshape(shape)

    def adapt_widths(self, splats: Splats, distances: Float64, sigma: float) -> Splats:
        """Give every splat an individual width."""
        from scipy.ndimage import map_coordinates

        gap = 0.5 * map_coordinates(
            np.minimum(distances, 1e30), splats.positions[:, ::-1].T, order=1, mode="nearest"
        )
        width = np.maximum(sigma * splats.spacings, gap) / sigma
        octaves = np.log2(np.maximum(width, 1e-30))
        levels = np.rint(WIDTH_LEVELS.per_octave * octaves) + WIDTH_LEVELS.base
        levels = np.clip(levels, 0, WIDTH_LEVELS.count - 1).astype(np.int64)
        weights = splats.weights / WIDTH_LEVELS.factor(levels) ** 2
        return splats._replace(weights=weights, width_levels=levels)

    def width_levels(self, splats: Splats) -> NDArray[np.int64]:
        """Return the width level of each splat."""
        if splats.width_levels is None:
            return np.full(len(splats.weights), WIDTH_LEVELS.base)
        return splats.width_levels

    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins."""
        grid = bin_grid(shape, margin, self.bin_size)
        last = np.array([grid[1] - 1, grid[0] - 1])
        xy = np.clip(np.floor(splats.positions / self.bin_size) + margin, 0, last).astype(np.int64)
        bins = xy[:, 1] * grid[1] + xy[:, 0]
        starts = np.concatenate(([0], np.cumsum(np.bincount(bins, minlength=grid[0] * grid[1]))))
        return Bins(grid, starts, np.argsort(bins, kind="stable"))

    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a Nadaraya-Watson frame."""
        height, width = shape
        sums = np.zeros((4, height, width))
        chunk = max(1, BLOCK_ENTRIES // (4 * (height + width)))
        for first in range(0, len(splats.weights), chunk):
            check_cancelled()
            part = slice(first, first + chunk)
            x = np.arange(width) - splats.positions[part, 0, None]
            y = np.arange(height) - splats.positions[part, 1, None]
            factor = WIDTH_LEVELS.factor(self.width_levels(splats)[part, None])
            along_x = kernel_1d(x / factor, sigma, radius)
            # The kernel is a product, so the sum over particles is a matrix product.
            along_y = kernel_1d(y / factor, sigma, radius) * splats.weights[part, None]
            sums[0] += along_y.T @ along_x
            for channel in range(3):
                sums[channel + 1] += (along_y * splats.colors[part, channel, None]).T @ along_x
        return np.moveaxis(sums[1:], 0, -1), sums[0]

    nearest_seeds = staticmethod(nearest_seeds)

    def upload_table(self, table: Float32) -> Float32:
        """Upload a table of colors."""
        return table

    apply_table = staticmethod(apply_table)


def kernel_1d(d: Float64, sigma: float, radius: float) -> Float64:
    """Return the 1D kernel at distances d in pixels: the cut Gaussian, or the box of a pixel."""
    if sigma == 0:
        return ((d >= -0.5) & (d < 0.5)).astype(float)
    return np.where(np.abs(d) <= radius, np.exp(-0.5 * (d / sigma) ** 2), 0.0)
