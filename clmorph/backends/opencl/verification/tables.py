"""The check of tables of colors."""

import numpy as np

from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Findings, check
from clmorph.backends.opencl.verification.findings import UNIT, Finding, largest
from clmorph.backends.records import Float32


def table_of(nodes: int) -> Float32:
    """Return a table of random values, which is as steep as any."""
    rng = np.random.default_rng((9, nodes))
    return rng.uniform(-1, 2, (nodes, nodes, nodes, 3)).astype(np.float32)


def colors_of(count: int, nodes: int) -> Float32:
    """Return colors inside and outside of the cube, at nodes, between two, and with equal rests."""
    rng = np.random.default_rng(10)
    inside = rng.uniform(-0.2, 1.2, (count, 3))
    at_nodes = rng.integers(0, nodes, (count // 4, 3)) / (nodes - 1)
    halves = rng.integers(0, 2 * nodes - 1, (count // 4, 3)) / (2 * nodes - 2)
    grays = np.repeat(rng.uniform(0, 1, (count // 4, 1)), 3, axis=1)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return np.concatenate((inside, at_nodes, halves, grays, corners)).astype(np.float32)


@check("color_table.cl")
def tables(bench: Bench, variant: Variant) -> Findings:
    """Compare colors after tables."""
    # A place is rounded twice, relative to the number of nodes; a sum has four terms.
    count, sizes = (300_000, (17, 65)) if bench.pictures else (5003, (2, 3, 33))
    for nodes in sizes:
        table, colors = table_of(nodes), colors_of(count, nodes)
        got, want = (
            backend.apply_table(backend.upload_table(table), colors) for backend in bench.both
        )
        tolerance = UNIT * (6 * nodes + 16) * float(np.abs(table).max())
        yield Finding(f"apply_table, {nodes} nodes", largest(got - want) / tolerance)
