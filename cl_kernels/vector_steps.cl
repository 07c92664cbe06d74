// Vectors of float64, for half_steps.cl and stored_steps.cl: sums and maxima over what the items of a
// work-group have, and the normal equations of Anderson's acceleration, which one work-group solves.
//
// Launch: work-groups of GROUP; item l takes the entries l * LANES + k * GROUP * LANES, k = 0, 1, ...,
// of those of its group. In a launch each item reads only entries of vectors that it wrote itself, so that
// barriers are needed by sums alone.
//
// Shapes: n points of the rows, m of the columns; `rows` and `columns` have one vector after the other.
//
// -D LANES   float64 lanes of a work-item: 1 on GPUs; divides TILE
// -D GROUP   work-items of the group, a power of two
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

// A vector of the rows or of the columns, and those of the acceleration.
#define ROW(slot) (rows + (size_t)(slot) * n)
#define COLUMN(slot) (columns + (size_t)(slot) * m)
#define AHEAD(j) COLUMN(COLUMN_AHEAD + (j))
#define DIFFERENCES(j) COLUMN(COLUMN_DIFFERENCES + (j))

// `control` has g's place, the parity of the iterate, whether an iterate is stored, the place of its
// difference, and the number of differences.
#define G_AT (control & 63u)
#define PARITY (control >> 6 & 1u)
#define BEGUN (control >> 7 & 1u)
#define PLACE (control >> 8 & 15u)
#define COUNT (control >> 12)

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

// The sum of x over the group, or the largest, the same number in every item.
INLINE double group_reduced(const double x, const bool largest, __local double* shared)
{
#if GROUP > 1
    const uint item = get_local_id(0);
    STEP_BARRIER();
    shared[item] = x;
    for (uint half_size = GROUP / 2; half_size > 0; half_size /= 2) {
        STEP_BARRIER();
        if (item < half_size) {
            const double other = shared[item + half_size];
            shared[item] = largest ? fmax(shared[item], other) : shared[item] + other;
        }
    }
    STEP_BARRIER();
    return shared[0];
#else
    return x;
#endif
}

#define group_sum(x, shared) group_reduced(x, false, shared)
#define group_largest(x, shared) group_reduced(x, true, shared)

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
