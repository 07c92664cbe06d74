"""Soft minima and mean destinations in one pass, by ``cl_kernels/barycentric_projection.cl``."""

import numpy as np

from clmorph.backends.opencl.kernels.clouds import Cloud, unsort
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import Float64, NearPairs


class BarycentricProjection:
    """The log-sum-exp over the columns of every row, with the mean of the columns."""

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
        exponents = loop.exponents(rows, columns, g, epsilon, pairs, precise=precise)
        shares = loop.column_shares(rows, columns, pairs)
        dimension, n = rows.centers.shape[1], len(rows)
        softmin, mean = np.empty(rows.stride), np.empty((rows.stride, dimension))
        for part in loop.parts(kernel, rows, columns, pairs=pairs, shares=shares):
            n_rows = len(part) * tile
            found = np.empty((shares, n_rows), np.float32)
            sums = np.empty((1 + dimension, shares, n_rows), np.float32)
            buffers = loop.work.empty(found.nbytes), loop.work.empty(sums.nbytes)
            loop.launch(
                kernel, rows, columns, exponents, part, np.uint32(n_rows), *buffers,
                shares=shares, precise=precise, pairs=pairs,
                results=tuple(zip((found, sums), buffers, strict=True)),
            )  # fmt: skip
            maxima = found.max(axis=0).astype(float)
            total = np.sum(sums * np.exp2(found - maxima), axis=1)
            section = slice(part.start * tile, part.stop * tile)
            # Overflow gives NaN if float32 cannot hold the numbers; the caller checks the results.
            with np.errstate(invalid="ignore", divide="ignore"):
                softmin[section] = maxima + np.log2(total[0])
                mean[section] = (total[1:] / total[0]).T / exponents.k
        softmin[:n] += loop.row_offsets(rows, exponents)
        mean[:n] += np.repeat(rows.centers, tile, axis=0)[:n]
        return unsort(rows, -epsilon / LOG2_E * softmin[:n]), unsort(rows, mean[:n])
