// The levels of pairs of tiles, see row_loop.cl, in float64: for each row tile p of a launch, over all column tiles q
// or those that are listed for it,
//
//     level_pq = max_{j in q} [k g_j + log2 b_j] - k |p - q|^2 / 2,    row_level_p = max_q level_pq,
//
// and of level_pq - row_level_p the nearest float32, and where `planes` is 2 what that rounds off.
//
// Without lists `n_listed` is 0. Levels are (row tiles of the launch, planes, n_columns) then, else (planes, n_listed).
//
// Launch: a work-group of GROUP for each row tile.
//
// Units: centers in any unit, k in its inverse squared; levels in powers of two (log2).
//
// -D GROUP  work-items of a work-group

#include "common.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#ifndef GROUP
#error "GROUP (work-items of a work-group) must be given"
#endif

INLINE double level_of(
    const uint dimension, const double k, const __global float* p, const __global float* q, const double tile_max)
{
    double squares = 0.0;
    for (uint d = 0; d < dimension; ++d) {
        const double difference = (double)p[d] - (double)q[d];
        squares += difference * difference;
    }
    return tile_max - 0.5 * k * squares;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tile_levels(
    const uint first_tile, const uint n_columns, const uint n_listed, const uint dimension, const uint planes,
    const double k,
    const __global float* restrict row_centers,    // (row tiles, dimension): p
    const __global float* restrict column_centers, // (n_columns, dimension): q
    const __global double* restrict tile_max,      // (n_columns,)
    const __global uint* restrict list_starts,     // (row tiles + 1,), as `listed` read with lists only
    const __global uint* restrict listed,          // (n_listed,)
    __global double* restrict row_level,           // (row tiles of the launch,)
    __global float* restrict levels)               // see above
{
    const uint row_tile = first_tile + get_group_id(0);
    const __global float* p = row_centers + (size_t)row_tile * dimension;
    const uint begin = n_listed ? list_starts[row_tile] : 0;
    const uint end = n_listed ? list_starts[row_tile + 1] : n_columns;
    double largest = -INFINITY;
    for (uint n = begin + get_local_id(0); n < end; n += GROUP) {
        const uint q = n_listed ? listed[n] : n;
        largest = fmax(largest, level_of(dimension, k, p, column_centers + (size_t)q * dimension, tile_max[q]));
    }
#if GROUP > 1
    __local double largest_of[GROUP];
    largest_of[get_local_id(0)] = largest;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint item = 0; item < GROUP; ++item)
        largest = fmax(largest, largest_of[item]);
#endif
    if (get_local_id(0) == 0)
        row_level[get_group_id(0)] = largest;
    const size_t plane = n_listed ? n_listed : n_columns;
    if (!n_listed)
        levels += get_group_id(0) * planes * plane;
    for (uint n = begin + get_local_id(0); n < end; n += GROUP) {
        const uint q = n_listed ? listed[n] : n;
        const double level = level_of(dimension, k, p, column_centers + (size_t)q * dimension, tile_max[q]);
        const double own = fmax(level - largest, (double)SENTINEL);
        levels[n] = (float)own;
        if (planes == 2)
            levels[plane + n] = (float)(own - (double)(float)own);
    }
}
