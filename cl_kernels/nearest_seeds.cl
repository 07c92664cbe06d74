// The nearest of many seeds for each pixel: the index k, the lowest one of equals, that minimizes
//
//     d_k = dx dx + dy dy,   dx = x - x_k,   dy = y - y_k,
//
// in float32 with a rounding after each operation, as NumPy computes it. Seeds come in the leaves of a
// tree, LEAF to a leaf and WAYS nodes to a node of the next level, each with the box of its seeds and with
// their lowest index. Rounding is monotone, so no seed is nearer than the d of the nearest point of its box,
// and what the search leaves out is farther, or as far and of a higher index: the result does not depend
// on the tree.
//
// A work-item has a block of BLOCK_X x BLOCK_Y = WIDTH pixels. It begins at the leaf that the nearest boxes
// lead to, and then goes through all nodes in their order, without those that are too far. After a number of
// rounds, one for each node and each seed, it keeps its place in memory for the next launch, so that launches
// are bounded.
//
// Launch: one work-item for each block of a list, in groups of GROUP; those beyond its end do nothing.
//
// -D GROUP      work-items of a group
// -D LEAF       seeds of a leaf
// -D WAYS       nodes below a node

#include "common.cl"

#pragma OPENCL FP_CONTRACT OFF // seeds and boxes must be rounded alike

#if !defined(GROUP) || !defined(LEAF) || !defined(WAYS)
#error "GROUP, LEAF and WAYS must be given, see above"
#endif

#define BLOCK_X (WIDTH > 4 ? 4 : WIDTH > 1 ? 2 : 1)
#define BLOCK_Y (WIDTH / BLOCK_X)

// Where d is less than the best one, or as small and of a lower index.
INLINE vint is_better(const vreal d, const int index, const vreal best, const vint found)
{
    return (d < best) | ((d == best) & ((vint)(index) < found));
}

// The same for the seeds of a leaf, which may become the best ones.
INLINE void try_leaf(
    const __global float2* seeds, const __global int* order, const vreal x, const vreal y,
    vreal* best, vint* found)
{
    for (int i = 0; i < LEAF; ++i) {
        const float2 seed = seeds[i];
        const int index = order[i];
        const vreal dx = x - seed.x;
        const vreal dy = y - seed.y;
        const vreal d = dx * dx + dy * dy;
        const vint better = is_better(d, index, *best, *found);
        *best = select(*best, d, better);
        *found = select(*found, (vint)(index), better);
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void nearest_seeds(
    const uint n_blocks, const uint blocks_x, const int begins, const int rounds,
    const int top, // level of the root; leaves have level 0
    const __global uint* restrict blocks,   // (n_blocks,): the blocks of this launch
    const __global uint* restrict starts,   // (top + 1,): the first node of each level
    const __global float4* restrict boxes,  // (nodes,): lowest x and y, highest x and y
    const __global int* restrict lowest,    // (nodes,): lowest index of a seed
    const __global float2* restrict seeds,  // (leaves, LEAF): x, y
    const __global int* restrict order,     // (leaves, LEAF): index
    __global int* restrict places,          // (all blocks, 2): level and number of the next node
    __global float* restrict distances,     // (all blocks, WIDTH): d
    __global int* restrict nearest,         // (all blocks, WIDTH): index
    __global int* restrict made)            // (n_blocks,): rounds, below 0 if the search has ended
{
    const uint item = get_global_id(0);
    if (item >= n_blocks)
        return;
    const uint block = blocks[item];
    const uint block_y = block / blocks_x;
    const float left = (float)((block - block_y * blocks_x) * BLOCK_X);
    const float upper = (float)(block_y * BLOCK_Y);
    float along[WIDTH], down[WIDTH]; // the pixels of a block, row by row
    for (int lane = 0; lane < WIDTH; ++lane) {
        along[lane] = left + lane % BLOCK_X;
        down[lane] = upper + lane / BLOCK_X;
    }
    const vreal x = VLOAD(0, along), y = VLOAD(0, down);
    vreal best = (vreal)(MAXFLOAT);
    vint found = (vint)(INT_MAX);
    int level = top;
    int number = 0;
    if (begins) {
        const float middle_x = left + 0.5f * (BLOCK_X - 1);
        const float middle_y = upper + 0.5f * (BLOCK_Y - 1);
        int leaf = 0;
        for (int below = top - 1; below >= 0; --below) {
            float least = MAXFLOAT;
            int least_index = INT_MAX;
            int chosen = 0;
            for (int way = 0; way < WAYS; ++way) {
                const uint node = starts[below] + WAYS * leaf + way;
                const float4 box = boxes[node];
                const float dx = max(max(box.x - middle_x, middle_x - box.z), 0.0f);
                const float dy = max(max(box.y - middle_y, middle_y - box.w), 0.0f);
                const float d = dx * dx + dy * dy;
                if (d < least || (d == least && lowest[node] < least_index)) {
                    least = d;
                    least_index = lowest[node];
                    chosen = way;
                }
            }
            leaf = WAYS * leaf + chosen;
        }
        try_leaf(seeds + (size_t)LEAF * leaf, order + (size_t)LEAF * leaf, x, y, &best, &found);
    } else {
        level = places[2 * block];
        number = places[2 * block + 1];
        best = VLOAD((size_t)WIDTH * block, distances);
        found = VLOAD((size_t)WIDTH * block, nearest);
    }
    int round = 0;
    while (round < rounds && level <= top) {
        const uint node = starts[level] + number;
        const float4 box = boxes[node];
        const vreal zero = (vreal)(0.0f);
        const vreal dx = max(max(box.x - x, x - box.z), zero);
        const vreal dy = max(max(box.y - y, y - box.w), zero);
        const vreal d = dx * dx + dy * dy;
        const int enters = ANY(is_better(d, lowest[node], best, found));
        if (enters && level > 0) {
            --level;
            number *= WAYS;
        } else {
            if (enters) {
                try_leaf(seeds + (size_t)LEAF * number, order + (size_t)LEAF * number, x, y,
                         &best, &found);
                round += LEAF;
            }
            ++number;
            while (level < top && number % WAYS == 0) {
                ++level;
                number /= WAYS;
            }
            if (level == top)
                ++level; // through
        }
        ++round;
    }
    VSTORE(best, (size_t)WIDTH * block, distances);
    VSTORE(found, (size_t)WIDTH * block, nearest);
    places[2 * block] = level;
    places[2 * block + 1] = number;
    made[item] = level > top ? -round : round;
}
