"""The nearest of many seeds for each pixel, by a tree of boxes: ``cl_kernels/nearest_seeds.cl``."""

import functools
import time
from typing import NamedTuple, TypeVar

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SEED_LEAF, SEED_WAYS, BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.records import Float32

_Real = TypeVar("_Real", bound=np.number)

#: Pixels of a work-item along x, by the width of its vectors; the same as in the kernel.
BLOCK_X = {1: 1, 2: 2, 4: 2, 8: 4, 16: 4}
#: The largest number of nodes and seeds that a work-item looks at in one launch, some times what
#: most need.
ROUNDS = 512
#: Nodes and seeds that the first launch looks at.
FIRST_ROUNDS = 1 << 18
#: The lowest index of a node without seeds.
NONE = np.iinfo(np.int32).max


class SeedTree(NamedTuple):
    """Seeds in the leaves of a tree, and the boxes of its nodes, level by level from the leaves."""

    #: Positions, (leaves * SEED_LEAF, 2); the last one is repeated until the last leaf is complete.
    seeds: Float32
    #: Index of each seed: (leaves * SEED_LEAF,) array.
    order: NDArray[np.int32]
    #: The first node of each level: (levels,) array.
    starts: NDArray[np.uint32]
    #: (nodes, 4) Lowest and highest x and y; infinitely far for nodes that complete a level.
    boxes: Float32
    #: Lowest index of a seed: (nodes,) array.
    lowest: NDArray[np.int32]


class NearestSeeds:
    """Finds nearest seeds."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self._work, self._constants, self._programs = work, constants, programs
        self._budget = LaunchBudget(FIRST_ROUNDS)

    def nearest_seeds(self, seeds: Float32, shape: tuple[int, int]) -> NDArray[np.int32]:
        """Return the nearest seed of each pixel; see `clmorph.backends.interface.Operations`."""
        kernel = self._programs.kernel("nearest_seeds.cl", "nearest_seeds")
        work, tree = self._work, plant(seeds)
        width = self._constants.width
        sides = width // BLOCK_X[width], BLOCK_X[width]
        down, across = (-(-side // own) for side, own in zip(shape, sides, strict=True))
        n_blocks = down * across
        found = np.empty((n_blocks, width), np.int32)
        nearest = work.empty(found.nbytes)
        fixed = (
            work.buffer(tree.starts, np.uint32), work.buffer(tree.boxes),
            work.buffer(tree.lowest, np.int32), work.buffer(tree.seeds),
            work.buffer(tree.order, np.int32), work.empty(8 * n_blocks),
            work.empty(found.nbytes), nearest,
        )  # fmt: skip
        group, rounds = self._constants.group, loop_limits.tree_rounds(self._constants, ROUNDS)
        waiting, begins = np.arange(n_blocks, dtype=np.uint32), 1
        while len(waiting):
            left, first = [], 0
            while first < len(waiting):
                part = waiting[first : first + max(1, self._budget.pairs() // rounds)]
                made = np.empty(len(part), np.int32)
                buffer = work.empty(made.nbytes)
                began = time.perf_counter()
                work.launch(
                    kernel, (-(-len(part) // group) * group,), (group,),
                    np.uint32(len(part)), np.uint32(across), np.int32(begins), np.int32(rounds),
                    np.int32(len(tree.starts) - 1), work.buffer(part, np.uint32), *fixed, buffer,
                    results=((made, buffer),),
                )  # fmt: skip
                self._budget.learn(int(np.abs(made).sum()), time.perf_counter() - began)
                left.append(part[made > 0])
                first += len(part)
            waiting, begins = np.concatenate(left), 0
        cl.enqueue_copy(work.queue, found, nearest)
        rows = found.reshape(down, across, *sides).swapaxes(1, 2)
        return np.ascontiguousarray(
            rows.reshape(down * sides[0], across * sides[1])[: shape[0], : shape[1]]
        )


def plant(seeds: Float32) -> SeedTree:
    """Sort seeds, (K, 2), along a Hilbert curve through the ranks of x and of y, into a tree."""
    x, y = (np.ascontiguousarray(seeds[:, axis]) for axis in range(2))
    sorted_ = _in_order(_along_curve(_ranks(x), _ranks(y)))
    more = np.repeat(sorted_[-1:], -len(sorted_) % SEED_LEAF)
    order = np.concatenate((sorted_, more)).astype(np.int32)
    places = seeds.take(order, axis=0)
    low = high = [x.take(order), y.take(order)]
    first, ways = order, SEED_LEAF
    boxes, lowest, starts = [], [], [0]
    while True:
        low = [_reduced(np.minimum, side, ways, np.inf) for side in low]
        high = [_reduced(np.maximum, side, ways, -np.inf) for side in high]
        first = _reduced(np.minimum, first, ways, NONE)
        ways = SEED_WAYS
        boxes.append(np.column_stack(low + high))
        lowest.append(first)
        if len(first) == 1:
            break
        starts.append(starts[-1] + len(first))
    return SeedTree(
        places, order, np.array(starts, np.uint32), np.concatenate(boxes), np.concatenate(lowest)
    )


def _reduced(
    reduction: np.ufunc, values: NDArray[_Real], ways: int, missing: float
) -> NDArray[_Real]:
    """Reduce values of the nodes below each node, and complete the new level."""
    found = reduction.reduce(values.reshape(-1, ways), axis=1)
    more = -len(found) % SEED_WAYS if len(found) > 1 else 0
    return np.concatenate((found, np.full(more, missing, found.dtype)))


def _ranks(values: Float32) -> NDArray[np.uint32]:
    """Return the rank of each value, without the bits beyond 16."""
    bits = (values + np.float32(0.0)).view(np.uint32)  # without negative zero
    # As integers in this form, floats ascend.
    bits ^= np.where(bits >> np.uint32(31), np.uint32(0xFFFFFFFF), np.uint32(0x80000000))
    ranks = np.arange(len(values), dtype=np.uint32)
    ranks >>= np.uint32(max(0, len(values).bit_length() - 16))
    found = np.empty_like(ranks)
    found[_in_order(bits)] = ranks
    return found


def _in_order(keys: NDArray[np.uint32]) -> NDArray[np.intp]:
    """Sort keys of 32 bits: twice by 16 bits, which NumPy does in linear time."""
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    high = (keys >> np.uint32(16)).astype(np.uint16)
    return order.take(np.argsort(high.take(order), kind="stable"))


def _along_curve(x: NDArray[np.uint32], y: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return where points stand along a Hilbert curve: 32 bits of two times 16."""
    steps, states = _curve_steps()
    key, state = np.zeros(len(x), np.uint32), np.zeros(len(x), np.uint16)
    for shift in (12, 8, 4, 0):
        bits = (x >> np.uint32(shift) & np.uint32(15)) << np.uint32(4)
        bits |= y >> np.uint32(shift) & np.uint32(15)
        place = state | bits.astype(np.uint16)
        key = key << np.uint32(8) | steps.take(place)
        state = states.take(place)
    return key


@functools.cache
def _curve_steps() -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Return the curve through 16 x 16 squares: steps, and states inside, by state + 16 x + y."""
    place = np.arange(1024)  # a state is 256 times two bits: x and y exchanged, both turned round
    exchanged, turned = place >> 8 & 1, place >> 9 & 1
    x, y, steps = place >> 4 & 15, place & 15, np.zeros(1024, int)
    for shift in (3, 2, 1, 0):
        first, second = x >> shift & 1 ^ turned, y >> shift & 1 ^ turned
        first, second = np.where(exchanged, (second, first), (first, second))
        steps = 4 * steps + (3 * first ^ second)
        turned ^= first & (second ^ 1)
        exchanged ^= second ^ 1
    return steps.astype(np.uint32), (256 * (exchanged + 2 * turned)).astype(np.uint16)
