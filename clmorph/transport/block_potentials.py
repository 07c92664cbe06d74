"""Potentials and mean destinations of pixels, from a balanced solve between blocks of pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from clmorph._shared.progress import Report
from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.measures.pixel_blocks import PixelBlocks
from clmorph.transport._solver.softmin import Softmin
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import regularization
from clmorph.transport.sinkhorn import solve


class PixelTransport(NamedTuple):
    """Balanced entropic transport between the pixels of two images."""

    potentials: Potentials  #: (N,) and (M,) potentials of the pixels
    destinations: Array  #: (N, D) mean destinations of the source's pixels, as lifted points


def transport_pixels(
    source: PixelBlocks,
    target: PixelBlocks,
    blur: float,
    tol: float,
    operations: Operations,
    report: Report,
) -> PixelTransport:
    """Solve between blocks, and extend the potentials to the pixels by one softmin each."""
    pair = source.coarse, target.coarse
    found = solve(operations, pair, regularization(blur, tol=tol), report)
    epsilon = found.epsilon

    def extended(own: PixelBlocks, other: PixelBlocks, f: Array, g: Array) -> tuple[Softmin, Array]:
        rows, columns = (operations.upload(m.points, m.weights) for m in (own.fine, other.coarse))
        weights = own.fine.weights, other.coarse.weights
        softmin = Softmin(operations, rows, columns, weights, found.truncation)
        softmin.guess = f[own.owners]
        return softmin, softmin(g, epsilon)

    to_rows, f = extended(source, target, found.f, found.g)
    _, means = operations.barycentric_projection(
        to_rows.rows, to_rows.columns, found.g, epsilon, False, to_rows.near
    )
    _, g = extended(target, source, found.g, found.f)
    return PixelTransport(replace(found, f=f, g=g), means)
