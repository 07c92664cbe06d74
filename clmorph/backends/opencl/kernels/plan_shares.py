"""Means, moments and draws of plan rows: ``barycentric_projection.cl``, ``plan_shares.cl``."""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import Float64, NearPairs

#: The largest threshold of a draw, below row sums that rounding has made slightly less than 1.
LARGEST_THRESHOLD = 1.0 - 1e-5


class PlanShares:
    """Reductions over the shares pi_ij / (pi 1)_i of each plan row, which sum to 1."""

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop

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
        pairs = None if near is None else near.pairs.without_masks()
        loop, tile = self._loop, self._loop.constants.tile
        kernel = loop.kernel(
            "barycentric_projection.cl", "barycentric_projection", rows, precise, pairs is not None
        )
        exponents = loop.exponents(rows, columns, g, epsilon, precise, pairs)
        shares = loop.column_shares(rows, columns, pairs)
        dimension, n = rows.centers.shape[1], len(rows)
        softmin, mean = np.empty(rows.stride), np.empty((rows.stride, dimension))
        for part in loop.parts(kernel, exponents, shares=shares):
            n_rows = len(part) * tile
            found = np.empty((shares, n_rows), np.float32)
            sums = np.empty((1 + dimension, shares, n_rows), np.float32)
            buffers = loop.work.empty(found.nbytes), loop.work.empty(sums.nbytes)
            loop.launch(
                kernel, exponents, part, np.uint32(n_rows), *buffers, shares=shares,
                results=tuple(zip((found, sums), buffers, strict=True)),
            )  # fmt: skip
            maxima = found.max(axis=0).astype(float)
            total = np.sum(sums * np.exp2(found - maxima), axis=1)
            section = slice(part.start * tile, part.stop * tile)
            # Overflow gives NaN if float32 cannot hold the numbers; the caller checks the results.
            with np.errstate(invalid="ignore", divide="ignore"):
                softmin[section] = maxima + np.log2(total[0])
                mean[section] = (total[1:] / total[0]).T / exponents.k
        softmin[:n] += loop.row_offsets(exponents)
        mean[:n] += np.repeat(rows.centers, tile, axis=0)[:n]
        return unsort(rows, -epsilon / LOG2_E * softmin[:n]), unsort(rows, mean[:n])

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
        loop = self._loop
        dimension, n = rows.centers.shape[1], len(rows)
        moments = np.empty((1 + dimension + dimension * (dimension + 1) // 2, rows.stride))
        for section, launch in self._launches(
            "plan_moments", rows, columns, g, softmin, epsilon, precise, near
        ):
            out = np.empty((len(moments), section.stop - section.start), np.float32)
            buffer = loop.work.empty(out.nbytes)
            launch(out.shape[1], buffer)
            cl.enqueue_copy(loop.work.queue, out, buffer)
            moments[:, section] = out
        moments = moments[1:, :n] / moments[0, :n]
        k = LOG2_E / epsilon
        mean, covariance = np.empty((n, dimension)), np.empty((n, dimension, dimension))
        first, number = np.empty((dimension, n)), 0
        for d in range(dimension):
            first[d] = moments[number]
            mean[:, d] = np.repeat(rows.centers[:, d], loop.constants.tile)[:n] + first[d] / k
            for e in range(d + 1):
                second = moments[number + 1 + e] - first[d] * first[e]
                covariance[:, d, e] = covariance[:, e, d] = second / k**2
            number += d + 2
        return unsort(rows, mean), unsort(rows, covariance)

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
        n, n_draws = thresholds.shape
        ordered = np.zeros((rows.stride, n_draws), np.float32)
        ordered[:n] = np.minimum(thresholds[rows.order], LARGEST_THRESHOLD)
        draws = np.empty((rows.stride, n_draws), np.int32)
        loop, most = self._loop, loop_limits.draws(self._loop.constants)
        for section, launch in self._launches(
            "sample_plan_rows", rows, columns, g, softmin, epsilon, precise, near
        ):
            for first in range(0, n_draws, most):
                own = ordered[section, first : first + most]
                found = np.full(own.shape, -1, np.int32)
                so_far = np.zeros(len(own))
                buffer = loop.work.buffer(found, np.int32)
                launch(
                    own.shape[1], loop.work.buffer(own), buffer,
                    loop.work.buffer(so_far, np.uint32), loop.work.buffer(so_far, np.float32),
                )  # fmt: skip
                cl.enqueue_copy(loop.work.queue, found, buffer)
                draws[section, first : first + most] = found
        # If rounding keeps a row's sum below its last thresholds, the draw before is repeated.
        for number in range(1, n_draws):
            missing = draws[:n, number] < 0
            draws[:n][missing, number] = draws[:n][missing, number - 1]
        return unsort(rows, columns.order[np.maximum(draws[:n], 0)].astype(np.int32))

    def _launches(
        self, name: str, rows: Cloud, columns: Cloud, g: Float64, softmin: Float64, epsilon: float,
        precise: bool, near: NearPairs | None,
    ) -> Iterator[tuple[slice, Callable[..., None]]]:  # fmt: skip
        """Yield sorted rows, and what launches a kernel over them, from its number of items on."""
        loop, listed, pairs = self._loop, near is not None, None if near is None else near.pairs
        kernel = loop.kernel("plan_shares.cl", name, rows, precise, listed, masked=listed)
        exponents = loop.exponents(rows, columns, g, epsilon, precise, pairs)
        # Their sum with e_ij is log2 of pi_ij / (pi 1)_i.
        offsets = loop.row_offsets(exponents)
        offsets += exponents.k * softmin[rows.order]
        on_device = loop.work.buffer(split(pad(offsets, rows.stride, SENTINEL)))

        def launch(part: range, masks: list[Any], count: int, *arguments: Any) -> None:
            loop.launch(kernel, exponents, part, *masks, np.uint32(count), on_device, *arguments)

        tile = loop.constants.tile
        for part, masks in loop.masked_parts(kernel, exponents):
            section = slice(part.start * tile, part.stop * tile)
            yield section, functools.partial(launch, part, masks)
