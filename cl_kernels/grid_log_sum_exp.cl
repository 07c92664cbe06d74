// A log-sum-exp along the last axis of a grid, which becomes the first axis of the result.
//
// For each line l of the grid and each place i of the result,
//
//     found[i, l] = log2 sum_j 2^(e[l, j] - (x_i - y_j)^2).
//
// Squared distances are sums over axes, so that such a pass for each axis sums over the whole grid.
//
// With the largest exponent e* of the line, the sum is 2^e* sum_j 2^(e_j - e*) 2^(-(x_i - y_j)^2): grid_powers
// computes the first powers once for each line, and the host the second ones, so that each term is one product. Powers
// under the least normal number count as 0. Where the sum is so small that they could matter (LEAST), it is computed
// anew from exponents: CHUNK columns j together, first the chunk that is nearest to the block, then those above and
// those below. Coordinates y ascend, so that terms fall along each way but for e, which e* bounds: once no term of the
// rest of a way can be above 2^-cut of the largest term, the way ends. All that is left out is less than m 2^-cut of
// the sum.
//
// Launch: of grid_powers a work-item for each line from `first` on. Of grid_log_sum_exp dimension 0 covers blocks of
// LANES places i, `span` of them a work-item, and dimension 1 lines from `first` on.
//
// Units: exponents in powers of two; coordinates in the square root of that. An empty cell has SENTINEL.
// Lines of powers are filled with 0 to `stride` numbers, a multiple of UNROLL.
//
// -D PRECISE  0: float32; 2: float64
// -D LANES    lanes of one work-item: WIDTH, or as many bytes of float64

#include "common.cl"

#if !defined(PRECISE) || !defined(LANES)
#error "PRECISE and LANES must be given, see above"
#endif
#define CHUNK 8
#define UNROLL 4

#if PRECISE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef OF_LANES(double, LANES) reals;
#if LANES == 1
#define LOAD(offset, p) ((p)[offset])
#define SOME(v) (v)
#else
#define LOAD(offset, p) CONCAT(vload, LANES)(0, (p) + (offset))
#define SOME(v) any(v)
#endif
#define POWER(v) exp2(v)
#define LEAST 0x1p-900
#define FAINTEST -1022.0
#else
typedef float real;
typedef vreal reals;
#define LOAD(offset, p) VLOAD(offset, p)
#define SOME(v) ANY(v)
#define POWER(v) exp2_nonpositive(v)
#define LEAST 0x1p-60f
#define FAINTEST -126.0f
#endif

// Add the terms of columns j to j + CHUNK - 1 to the sum, which is *sum 2^*top.
INLINE void add_chunk(
    const __global real* own, const __global real* y, const uint j, const uint m, const reals u, reals* top, reals* sum)
{
    reals t[CHUNK];
    reals largest = *top;
#pragma unroll
    for (uint c = 0; c < CHUNK; ++c) {
        const real e = j + c < m ? own[j + c] : (real)SENTINEL;
        const reals d = u - (reals)(y[j + c]);
        t[c] = (reals)(e) - d * d;
        largest = fmax(largest, t[c]);
    }
    reals s = *sum * POWER(*top - largest);
#pragma unroll
    for (uint c = 0; c < CHUNK; ++c)
        s += POWER(t[c] - largest);
    *top = largest;
    *sum = s;
}

// Whether a term at the coordinate v or beyond can matter.
#define MATTERS(v) SOME((reals)(most + cut) - (u - (reals)(v)) * (u - (reals)(v)) > top)

__kernel
void grid_powers(
    const uint first, const uint lines, const uint m, const uint stride,
    const __global real* restrict exponents, // (lines, m): e
    __global real* restrict largest,         // (lines,): e*
    __global real* restrict powers)          // (lines, stride): 2^(e - e*)
{
    const uint line = first + get_global_id(0);
    if (line >= lines)
        return;
    const __global real* own = exponents + (size_t)line * m;
    real most = own[0];
    for (uint j = 1; j < m; ++j)
        most = fmax(most, own[j]);
    largest[line] = most;
    __global real* of_line = powers + (size_t)line * stride;
    for (uint j = 0; j < stride; ++j)
        of_line[j] = j < m && own[j] - most > (real)FAINTEST ? exp2(own[j] - most) : (real)0;
}

__kernel
void grid_log_sum_exp(
    const uint first, const uint lines, const uint span,
    const uint n, const uint m, const uint stride, const real cut, // n places, m columns; cut: powers of two
    const __global real* restrict exponents, // (lines, m): e
    const __global real* restrict largest,   // (lines,): e*
    const __global real* restrict powers,    // (lines, stride): 2^(e - e*)
    const __global real* restrict kernels,   // (stride, n filled to LANES): 2^(-(x - y)^2)
    const __global real* restrict x,         // (n filled to LANES with the last one)
    const __global real* restrict y,         // (m, filled to CHUNK with the last one), ascending
    const __global uint* restrict ways,      // for each block the chunk with which it begins, and the first and
                                             // the last column + 1 whose kernel is not 0, multiples of UNROLL
    __global real* restrict found)           // (n, lines)
{
    const uint line = first + get_global_id(1);
    const uint blocks = (n + LANES - 1) / LANES;
    const uint begin = get_global_id(0) * span;
    if (line >= lines || begin >= blocks)
        return;
    const __global real* own = exponents + (size_t)line * m;
    const __global real* power = powers + (size_t)line * stride;
    const real most = largest[line];
    const uint end = min(blocks, begin + span);
    for (uint block = begin; block < end; ++block) {
        const uint i = block * LANES;
        reals sums[UNROLL];
#pragma unroll
        for (uint c = 0; c < UNROLL; ++c)
            sums[c] = (reals)((real)0);
        const uint last = ways[3 * block + 2];
        for (uint j = ways[3 * block + 1]; j < last; j += UNROLL) {
#pragma unroll
            for (uint c = 0; c < UNROLL; ++c)
                sums[c] += (reals)(power[j + c]) * LOAD((size_t)(j + c) * (blocks * LANES) + i, kernels);
        }
        reals top = (reals)(most);
        reals sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        if (SOME(sum < (reals)((real)LEAST))) {
            const reals u = LOAD(i, x);
            const real low = fmin(x[i], x[i + LANES - 1]);
            const real high = fmax(x[i], x[i + LANES - 1]);
            const uint start = ways[3 * block] * CHUNK;
            top = (reals)((real)SENTINEL);
            sum = (reals)((real)0);
            add_chunk(own, y, start, m, u, &top, &sum);
            for (uint j = start + CHUNK; j < m; j += CHUNK) {
                if (y[j] >= high && !MATTERS(y[j]))
                    break;
                add_chunk(own, y, j, m, u, &top, &sum);
            }
            for (uint j = start; j > 0; j -= CHUNK) {
                if (y[j - 1] <= low && !MATTERS(y[j - 1]))
                    break;
                add_chunk(own, y, j - CHUNK, m, u, &top, &sum);
            }
        }
        const reals result = top + log2(sum);
#if LANES == 1
        found[(size_t)i * lines + line] = result;
#else
        real results[LANES];
        CONCAT(vstore, LANES)(result, 0, results);
        for (uint lane = 0; lane < LANES && i + lane < n; ++lane)
            found[(size_t)(i + lane) * lines + line] = results[lane];
#endif
    }
}
