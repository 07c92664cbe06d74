"""The work of one launch on devices that end long loops (``short_loops``), none unrolled."""

# Such a device counts the rounds of all loops of a work-item, and a loop of n rounds takes n + 1.
# Work-items may run in step: each waits for the others.

from clmorph.backends.opencl.build.constants import (
    SEED_LEAF,
    SEED_WAYS,
    SLICED_FROM,
    STORED_UNROLL,
    BuildConstants,
)

#: The number of work-items in step, which can make their draws one after the other.
STEPS = 16


def column_tiles(constants: BuildConstants, dimension: int) -> int:
    """Return the number of column tiles of a row in one launch of a kernel of ``row_loop.cl``."""
    width, items, tile = constants.width, constants.group, constants.tile
    if dimension >= SLICED_FROM:
        # The loops over the coordinates of moments, the longest ones, and the staging of slices.
        in_tile = tile * (dimension + 2) * (dimension + 4 + width // items)
        return max(1, constants.loop_rounds // (2 * in_tile))
    moments = 1 + dimension + dimension * (dimension + 1) // 2
    staging = tile // (items * width) * (dimension + 2) + dimension + 3
    column = 3 * dimension + 6 + moments + 2 * width
    in_tile = staging + tile * column + width + items + 2 * moments + 4
    # The other half is for draws.
    return max(1, constants.loop_rounds // (2 * in_tile))


def mean_rows(constants: BuildConstants, window: int) -> int:
    """Return the rows of `window` cells that one launch of ``edge_preserving_mean`` takes."""
    # For each vector of cells there are two loops over eight channels; lanes are added up at last.
    around = 4 * 9 + 9 * (constants.width + 1)
    return max(1, (constants.loop_rounds - around) // (19 * (window // constants.width + 1)))


def draws(constants: BuildConstants) -> int:
    """Return the number of draws of a row in one launch of ``sample_plan_rows``."""
    return max(1, constants.loop_rounds // (2 * STEPS))


def gathered_particles(constants: BuildConstants, bin_rows: int) -> int:
    """Return the number of particles that a block of pixels may visit in a launch of ``splat``."""
    width = constants.width
    around = 10 * width + bin_rows * (8 * width + 6)
    # Work-items in step may visit the particles of one bin in different rounds.
    return max(1, (constants.loop_rounds - around) // (2 * (width + 3)))


def sorted_particles(constants: BuildConstants) -> int:
    """Return the number of particles of a slice of the list that is sorted."""
    return constants.loop_rounds // 2


def stored_pairs(constants: BuildConstants) -> int:
    """Return the number of stored pairs that a row may have."""
    rounds = 1 + 2 * (STORED_UNROLL + 1) + STORED_UNROLL * (constants.width + 1)
    return constants.loop_rounds // rounds * STORED_UNROLL


def tree_rounds(constants: BuildConstants, most: int) -> int:
    """Return how many nodes and seeds a work-item may look at in one launch: at most `most`."""
    # A tree has at most 16 levels.
    before = 16 * (SEED_WAYS + 2) + SEED_LEAF + 1
    return max(1, min(most, (constants.loop_rounds - before) // (SEED_LEAF + 2 + 17)))
