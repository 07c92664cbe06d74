"""Checks of tables of colors."""

from collections.abc import Iterator

import numpy as np

from clmorph.backends.comparison import UNIT, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.records import Float32
from clmorph.backends.verification.layers import largest


def tables(sizes: tuple[int, ...]) -> dict[str, Float32]:
    """Return tables of random values, which are as steep as any."""
    rng = np.random.default_rng(9)
    return {f"{n} nodes": rng.uniform(-1, 2, (n, n, n, 3)).astype(np.float32) for n in sizes}


def colors_of(count: int, nodes: int) -> Float32:
    """Return colors inside and outside of the cube, at nodes, between two, and with equal rests."""
    rng = np.random.default_rng(10)
    inside = rng.uniform(-0.2, 1.2, (count, 3))
    at_nodes = rng.integers(0, nodes, (count // 4, 3)) / (nodes - 1)
    halves = rng.integers(0, 2 * nodes - 1, (count // 4, 3)) / (2 * nodes - 2)
    grays = np.repeat(rng.uniform(0, 1, (count // 4, 1)), 3, axis=1)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return np.concatenate((inside, at_nodes, halves, grays, corners)).astype(np.float32)


def check_tables(
    operations: Operations,
    exact: Operations,
    count: int = 5003,
    sizes: tuple[int, ...] = (2, 3, 33),
) -> Iterator[Finding]:
    """Compare colors after tables.

    A place is rounded twice, relative to the number of nodes, and values change from node to node
    by as much as the table holds; a sum has four terms.
    """
    for name, table in tables(sizes).items():
        colors = colors_of(count, len(table))
        got, want = (
            backend.apply_table(backend.upload_table(table), colors)
            for backend in (operations, exact)
        )
        error = largest(got - want)
        tolerance = float(UNIT * (6 * len(table) + 16) * np.abs(table).max())
        yield Finding(f"apply_table, {name}", error / tolerance, 1.0, "of the tolerance")
