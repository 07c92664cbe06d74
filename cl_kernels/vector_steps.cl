// Vectors of float64 that one work-group holds, for half_steps.cl: sums and maxima over them, the
// softmin that log_sum_exp.cl has left in parts, what the next softmin needs of a potential, and the
// normal equations of Anderson's acceleration.
//
// Launch: one work-group of GROUP; item l takes the entries l * LANES + k * GROUP * LANES. Each item
// reads only entries that it wrote itself, so that barriers are needed by sums alone.
//
// Units: costs and potentials in coordinates squared, k = log2(e) / epsilon in its inverse; levels, logits
// and maxima in powers of two (log2).
//
// -D LANES   float64 lanes of a work-item: 1 on GPUs; divides TILE
// -D GROUP   work-items of the group, a power of two
// -D TILE    points of one tile
// -D MEMORY  differences of iterates that the acceleration stores
// -D RIDGE_PPT  regularization of its normal equations, in units of 10^-12

#include "common.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#ifndef LANES
#error "LANES (float64 lanes per work-item) must be given"
#endif
#ifndef GROUP
#error "GROUP (work-items of a group) must be given"
#endif
#ifndef TILE
#error "TILE (points of one tile) must be given"
#endif
#ifndef MEMORY
#error "MEMORY (stored differences) must be given"
#endif
#ifndef RIDGE_PPT
#error "RIDGE_PPT (regularization of the normal equations) must be given"
#endif

#if LANES == 1
typedef double vdouble;
typedef float vsingle;
#define DLOAD(i, p) ((p)[i])
#define DSTORE(v, i, p) ((p)[i] = (v))
#define SLOAD(i, p) ((p)[i])
#define SSTORE(v, i, p) ((p)[i] = (v))
#define TO_VDOUBLE(v) ((double)(v))
#define TO_VSINGLE(v) ((float)(v))
#else
typedef CONCAT(double, LANES) vdouble;
typedef CONCAT(float, LANES) vsingle;
#define DLOAD(i, p) CONCAT(vload, LANES)(0, (p) + (i))
#define DSTORE(v, i, p) CONCAT(vstore, LANES)((v), 0, (p) + (i))
#define SLOAD(i, p) CONCAT(vload, LANES)(0, (p) + (i))
#define SSTORE(v, i, p) CONCAT(vstore, LANES)((v), 0, (p) + (i))
#define TO_VDOUBLE(v) CONCAT(convert_double, LANES)(v)
#define TO_VSINGLE(v) CONCAT(convert_float, LANES)(v)
#endif

#define FIRST (get_local_id(0) * LANES)
#define STEP (GROUP * LANES)

// A work-group of one needs no barrier. Long functions without one are not inlined, as Intel's compiler
// takes twice as long otherwise.
#if GROUP > 1
#define STEP_BARRIER() barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE)
#define LONG_FUNCTION static inline
#else
#define STEP_BARRIER()
#define LONG_FUNCTION static __attribute__((noinline))
#endif

INLINE double sum_of_lanes(const vdouble v)
{
    double lanes[LANES];
    DSTORE(v, 0, lanes);
    double sum = 0.0;
    for (int l = 0; l < LANES; ++l)
        sum += lanes[l];
    return sum;
}

INLINE double largest_lane(const vdouble v)
{
    double lanes[LANES];
    DSTORE(v, 0, lanes);
    double largest = lanes[0];
    for (int l = 1; l < LANES; ++l)
        largest = fmax(largest, lanes[l]);
    return largest;
}

// The sum of x over the group, the same number in every item.
INLINE double group_sum(const double x, __local double* shared)
{
#if GROUP > 1
    STEP_BARRIER();
    shared[get_local_id(0)] = x;
    for (uint half_size = GROUP / 2; half_size > 0; half_size /= 2) {
        STEP_BARRIER();
        if (get_local_id(0) < half_size)
            shared[get_local_id(0)] += shared[get_local_id(0) + half_size];
    }
    STEP_BARRIER();
    return shared[0];
#else
    return x;
#endif
}

// The largest x of the group, the same number in every item.
INLINE double group_largest(const double x, __local double* shared)
{
#if GROUP > 1
    STEP_BARRIER();
    shared[get_local_id(0)] = x;
    for (uint half_size = GROUP / 2; half_size > 0; half_size /= 2) {
        STEP_BARRIER();
        if (get_local_id(0) < half_size)
            shared[get_local_id(0)] = fmax(shared[get_local_id(0)], shared[get_local_id(0) + half_size]);
    }
    STEP_BARRIER();
    return shared[0];
#else
    return x;
#endif
}

// The softmin -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) of LANES rows from i on, from the maxima
// and sums of log_sum_exp.cl.
INLINE vdouble softmin_of(
    const __global float* maxima,      // (shares, n)
    const __global float* sums,        // (shares, n)
    const __global double* row_level,  // (n / TILE,): see prepare_softmin
    const __global double* own_costs,  // (n,): |u|^2 / 2 and the row's offset
    const uint shares, const uint n, const double k, const uint i)
{
    vdouble m = TO_VDOUBLE(SLOAD(i, maxima));
    vdouble s = TO_VDOUBLE(SLOAD(i, sums));
    for (uint share = 1; share < shares; ++share) {
        const vdouble other = TO_VDOUBLE(SLOAD(i, maxima + (size_t)share * n));
        const vdouble largest = fmax(m, other);
        s = s * exp2(m - largest)
            + TO_VDOUBLE(SLOAD(i, sums + (size_t)share * n)) * exp2(other - largest);
        m = largest;
    }
    return ((vdouble)(-1.0 / k)) * (m + ((vdouble)(row_level[i / TILE]) - k * DLOAD(i, own_costs)) + log2(s));
}

INLINE vdouble logit_of(
    const __global double* potential, const __global double* offsets,
    const __global double* log2_weights, const double k, const uint j)
{
    const vdouble logit = (DLOAD(j, potential) - DLOAD(j, offsets)) * k + DLOAD(j, log2_weights);
    return logit < (vdouble)(0.5 * (double)SENTINEL) ? (vdouble)((double)SENTINEL) : logit;
}

// What row_loop.cl needs of the potential of the columns: logits below the largest of their tile, and the
// levels of pairs of tiles below the largest of their row, both in float32 with its rounding errors.
LONG_FUNCTION void prepare_softmin(
    const __global double* potential,    // (m,)
    const __global double* offsets,      // (m,)
    const __global double* log2_weights, // (m,)
    const __global double* tile_costs,   // (row_tiles, m / TILE): |p - q|^2 / 2 of the tiles' centers
    const uint m, const uint row_tiles, const uint planes, const double k,
    __global double* tile_max,           // (m / TILE,)
    __global double* row_level,          // (row_tiles,)
    __global float* logits,              // (2, m)
    __global float* levels)              // (row_tiles, planes, m / TILE)
{
    const uint tiles = m / TILE;
    STEP_BARRIER();
    for (uint q = get_local_id(0); q < tiles; q += GROUP) {
        vdouble largest = logit_of(potential, offsets, log2_weights, k, q * TILE);
        for (uint j = q * TILE + LANES; j < (q + 1) * TILE; j += LANES)
            largest = fmax(largest, logit_of(potential, offsets, log2_weights, k, j));
        const double top = largest_lane(largest);
        tile_max[q] = top;
        for (uint j = q * TILE; j < (q + 1) * TILE; j += LANES) {
            const vdouble logit = logit_of(potential, offsets, log2_weights, k, j);
            const vdouble h = logit == (vdouble)((double)SENTINEL) ? logit : logit - top;
            const vsingle high = TO_VSINGLE(h);
            SSTORE(high, j, logits);
            SSTORE(TO_VSINGLE(h - TO_VDOUBLE(high)), j, logits + m);
        }
    }
    STEP_BARRIER();
    for (uint p = get_local_id(0); p < row_tiles; p += GROUP) {
        const __global double* costs = tile_costs + (size_t)p * tiles;
        double top = tile_max[0] - k * costs[0];
        for (uint q = 1; q < tiles; ++q)
            top = fmax(top, tile_max[q] - k * costs[q]);
        row_level[p] = top;
        __global float* own_levels = levels + (size_t)p * planes * tiles;
        for (uint q = 0; q < tiles; ++q) {
            const double level = fmax(tile_max[q] - k * costs[q] - top, (double)SENTINEL);
            own_levels[q] = (float)level;
            if (planes == 2)
                own_levels[tiles + q] = (float)(level - (double)(float)level);
        }
    }
}

#define SYSTEM_ROW (2 * MEMORY) // a power of two

// Solve the normal equations of the stored differences after the one at `place` has got new inner products:
// coefficients of the residual, and whether they are determined. The first `count` are stored.
LONG_FUNCTION bool solve_normal(
    __global double* products,      // (MEMORY, MEMORY): inner products of the differences
    const double* row,              // (MEMORY,): those of the new one
    const double* right,            // (MEMORY,): inner products with the residual
    const uint place, const uint count, __local double* system, double* coefficients)
{
    STEP_BARRIER();
    for (uint j = get_local_id(0); j < count; j += GROUP)
        products[place * MEMORY + j] = products[j * MEMORY + place] = row[j];
    STEP_BARRIER();
    bool determined = count > 0;
    double scale[MEMORY];
    for (uint i = 0; i < count; ++i) {
        const double square = products[i * MEMORY + i];
        determined = determined && square > 0.0;
        scale[i] = square > 0.0 ? sqrt(square) : 1.0;
    }
    // Entries (i, j) of the system stand at SYSTEM_ROW i + j, the right-hand side in column MEMORY.
    for (uint entry = get_local_id(0); entry < count * SYSTEM_ROW; entry += GROUP) {
        const uint i = entry / SYSTEM_ROW, j = entry % SYSTEM_ROW;
        if (j < count)
            system[entry] = i == j ? 1.0 + 1e-12 * (double)RIDGE_PPT
                                   : products[i * MEMORY + j] / (scale[i] * scale[j]);
    }
    for (uint i = get_local_id(0); i < count; i += GROUP)
        system[i * SYSTEM_ROW + MEMORY] = right[i] / scale[i];
    // The matrix is positive definite, so that elimination needs no exchange of rows.
    for (uint p = 0; p < count; ++p) {
        STEP_BARRIER();
        const __local double* pivot = system + p * SYSTEM_ROW;
        for (uint entry = get_local_id(0); entry < count * SYSTEM_ROW; entry += GROUP) {
            const uint i = entry / SYSTEM_ROW, j = entry % SYSTEM_ROW;
            if (i != p && ((p < j && j < count) || j == MEMORY))
                system[entry] -= system[i * SYSTEM_ROW + p] / pivot[p] * pivot[j];
        }
    }
    STEP_BARRIER();
    for (uint i = 0; i < MEMORY; ++i)
        coefficients[i] = 0.0;
    for (uint i = 0; i < count; ++i)
        coefficients[i] = system[i * SYSTEM_ROW + MEMORY] / system[i * SYSTEM_ROW + i] / scale[i];
    return determined;
}
