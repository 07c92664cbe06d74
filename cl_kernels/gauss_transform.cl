// The sums of splat.cl for many particles per pixel, by an improved fast Gauss transform
// (Greengard and Strain 1991; Yang, Duraiswami, Gumerov and Davis 2003): a particle at
// c + delta, in a square cell around c, adds to pixel p
//
//     w K(p - c - delta) = w sum_ab A_a(p_x - c_x) A_b(p_y - c_y) T_a(delta_x) T_b(delta_y),
//
// T: Chebyshev polynomials on the cell, A: coefficients of the Gaussian in them, from the
// host. So every cell first sums w T_a T_b and w T_a T_b color over its particles, its
// moments; then these are summed against A_a along rows of cells, and that against A_b
// along columns. A particle costs the same however wide the kernel is.
//
// Pairs (a, b), TERMS = 40 of them: b = 0 to 2 with a = 0 to 7, then b = 3 to 6 with a = 0
// to 3; that is all of a + b <= 6 and what it takes to fill vectors. A cell's moments are
// TERMS x (weight, red, green, blue), b slowest.
//
// Particles come in bins as particles.cl sorts them, cells x cells to a bin; those in an
// outermost bin, yet outside of it, are beyond any pixel's reach and left out. A strip of
// rows of bins is done at a time, all steps of it.
//
// -D WIDTH         1: a work-group of MOMENT_GROUP to a bin; else one work-item, in vectors
// -D MOMENT_GROUP  its work-items, 1 if WIDTH is more
// -D MOMENT_CHUNK  particles of a bin added up before they join the total (bounds rounding)

#include "common.cl"

#if !defined(MOMENT_GROUP) || !defined(MOMENT_CHUNK)
#error "MOMENT_GROUP and MOMENT_CHUNK must be given, see above"
#endif
#if WIDTH > 1 && MOMENT_GROUP != 1
#error "MOMENT_GROUP must be 1 where WIDTH is more"
#endif

#define TERMS 40
#define ORDERS 8 // of T_a, and rounded up, of T_b
#define ROWS 7   // values of b

// BLOCK terms are taken together: of one b, and of consecutive a.
#if WIDTH == 1
#define BLOCK 1
typedef float4 vblock;
#define LOAD_BLOCK(i, p) vload4(i, p)
#define STORE_BLOCK(v, i, p) vstore4(v, i, p)
INLINE float4 fold(const vblock v)
{
    return v;
}
#else
#define BLOCK 4
typedef float16 vblock;
#define LOAD_BLOCK(i, p) vload16(i, p)
#define STORE_BLOCK(v, i, p) vstore16(v, i, p)
INLINE float4 fold(const vblock v) // Oclgrind takes shuffles for uninitialized
{
    float parts[16];
    vstore16(v, 0, parts);
    return vload4(0, parts) + vload4(1, parts) + (vload4(2, parts) + vload4(3, parts));
}
#endif
#define BLOCKS (TERMS / BLOCK)
#define TERM_B(term) ((term) < 24 ? (term) / 8 : (term) / 4 - 3)
#define TERM_A(term) ((term) < 24 ? (term) % 8 : (term) % 4)

#if WIDTH == 1
// T_0 to T_7 at x and at y.
INLINE void chebyshev(const float2 x, float* t_x, float* t_y)
{
    float2 t = (float2)(1.0f), next = x;
#pragma unroll
    for (int order = 0; order < ORDERS; ++order) {
        t_x[order] = t.x;
        t_y[order] = t.y;
        const float2 after = 2.0f * x * next - t;
        t = next;
        next = after;
    }
}

// Cell of a bin that a particle is in, -1 if in none, and where in it: within [-1, 1].
// corner is the bin's in units of cells, which are a power of two of pixels: no rounding.
INLINE int cell_of(
    const float2 position, const float per_pixel, const float2 corner, const int cells,
    float2* inside)
{
    const float2 u = position * per_pixel - corner;
    if (!(u.x >= 0.0f && u.y >= 0.0f && u.x <= cells && u.y <= cells))
        return -1;
    // u rounds up to `cells` just left of the bin's end.
    const int x = min((int)u.x, cells - 1);
    const int y = min((int)u.y, cells - 1);
    *inside = 2.0f * (u - (float2)((float)x, (float)y)) - 1.0f;
    return y * cells + x;
}

// Add the moments of particles begin <= i < end of one bin to `table`.
static void add_moments(
    const uint begin, const uint end, const float per_pixel, const float2 corner,
    const int cells, const __global float2* positions, const __global float4* samples,
    __local float* t_x, __local float* t_y, __local int* where, __local float4* weighed,
    __global float* table)
{
    const uint item = get_local_id(0);
    for (uint first = begin; first < end; first += MOMENT_GROUP) {
        const uint count = min((uint)MOMENT_GROUP, end - first);
        if (item < count) {
            float own_x[ORDERS], own_y[ORDERS];
            float2 inside = (float2)(0.0f);
            where[item] = cell_of(positions[first + item], per_pixel, corner, cells, &inside);
            weighed[item] = samples[first + item];
            chebyshev(inside, own_x, own_y);
            for (int order = 0; order < ORDERS; ++order) {
                t_x[ORDERS * item + order] = own_x[order];
                t_y[ORDERS * item + order] = own_y[order];
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        // A term belongs to one work-item, in every cell: no two write to the same place.
        for (uint term = item; term < TERMS; term += MOMENT_GROUP) {
            const uint a = TERM_A(term);
            const uint b = TERM_B(term);
            for (uint i = 0; i < count; ++i) {
                if (where[i] < 0)
                    continue;
                const size_t at = (size_t)where[i] * TERMS + term;
                vstore4(vload4(at, table)
                        + t_x[ORDERS * i + a] * t_y[ORDERS * i + b] * weighed[i], at, table);
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
#else
#define LANES 16 // particles whose polynomials are formed at once

// The same, in vectors.
INLINE void add_moments(
    const uint begin, const uint end, const float per_pixel, const float2 corner,
    const int cells, const __global float2* positions, const __global float4* samples,
    __global float* table)
{
    const float16 one = (float16)(1.0f);
    const int16 second = (int16)((int4)(0), (int4)(-1), (int4)(0), (int4)(0));
    const int16 third = (int16)((int4)(0), (int4)(0), (int4)(-1), (int4)(0));
    const int16 fourth = (int16)((int4)(0), (int4)(0), (int4)(0), (int4)(-1));
    for (uint first = begin; first < end; first += LANES) {
        const uint count = min((uint)LANES, end - first);
        float p_x[LANES], p_y[LANES];
        for (uint i = 0; i < LANES; ++i) {
            const float2 position = positions[min(first + i, end - 1)];
            p_x[i] = position.x;
            p_y[i] = position.y;
        }
        const float16 u_x = vload16(0, p_x) * per_pixel - corner.x;
        const float16 u_y = vload16(0, p_y) * per_pixel - corner.y;
        const float most = (float)cells;
        const int16 within = (u_x >= 0.0f) & (u_y >= 0.0f) & (u_x <= most) & (u_y <= most);
        // u rounds up to `cells` just left of the bin's end.
        const float16 cell_x = fmin(floor(u_x), most - 1.0f);
        const float16 cell_y = fmin(floor(u_y), most - 1.0f);
        float t_x[ORDERS][LANES], t_y[ORDERS][LANES];
        const float16 x = 2.0f * (u_x - cell_x) - 1.0f;
        const float16 y = 2.0f * (u_y - cell_y) - 1.0f;
        float16 x_0 = one, x_1 = x, y_0 = one, y_1 = y;
        for (int order = 1; order < ORDERS; ++order) {
            vstore16(x_1, 0, t_x[order]);
            vstore16(y_1, 0, t_y[order]);
            const float16 x_2 = 2.0f * x * x_1 - x_0;
            const float16 y_2 = 2.0f * y * y_1 - y_0;
            x_0 = x_1; x_1 = x_2; y_0 = y_1; y_1 = y_2;
        }
        int where[LANES];
        const float16 cell = (cell_y * most + cell_x) * (4.0f * TERMS);
        vstore16(select((int16)(-1), convert_int16(cell), within), 0, where);
        for (uint i = 0; i < count; ++i) {
            if (where[i] < 0)
                continue;
            const float16 sample = samples[first + i].s0123012301230123;
            float16 low = select(one, (float16)(t_x[1][i]), second);
            low = select(low, (float16)(t_x[2][i]), third);
            low = sample * select(low, (float16)(t_x[3][i]), fourth);
            float16 high = select((float16)(t_x[4][i]), (float16)(t_x[5][i]), second);
            high = select(high, (float16)(t_x[6][i]), third);
            high = sample * select(high, (float16)(t_x[7][i]), fourth);
            __global float* own = table + where[i];
            vstore16(vload16(0, own) + low, 0, own);
            vstore16(vload16(1, own) + high, 1, own);
            vstore16(vload16(2, own) + low * t_y[1][i], 2, own);
            vstore16(vload16(3, own) + high * t_y[1][i], 3, own);
            vstore16(vload16(4, own) + low * t_y[2][i], 4, own);
            vstore16(vload16(5, own) + high * t_y[2][i], 5, own);
            vstore16(vload16(6, own) + low * t_y[3][i], 6, own);
            vstore16(vload16(7, own) + low * t_y[4][i], 7, own);
            vstore16(vload16(8, own) + low * t_y[5][i], 8, own);
            vstore16(vload16(9, own) + low * t_y[6][i], 9, own);
        }
    }
}
#endif

// Moments of the cells of every bin from first_bin on, one work-group a bin. Of particles
// first_particle <= i < last_particle; bins with particles before these already hold the
// moments of those.
__kernel __attribute__((reqd_work_group_size(MOMENT_GROUP, 1, 1)))
void sum_moments(
    const uint first_bin, const uint strip_bin, // first bin of the strip, of this launch
    const uint first_particle, const uint last_particle,
    const int margin, const int n_bins_x, const int cells, const float per_pixel,
    const __global uint* restrict bin_starts,   // (bins + 1,) of this width level
    const __global float2* restrict positions,  // sorted into bins
    const __global float4* restrict samples,    // sorted into bins: weight, weighed color
    __global float* restrict moments,           // (bins of the strip, cells, cells, TERMS, 4)
    __global float* restrict partial)           // the same
{
    const uint bin = first_bin + get_group_id(0);
    const int bin_y = (int)(bin / (uint)n_bins_x);
    const int bin_x = (int)bin - bin_y * n_bins_x;
    const float2 corner = (float2)((float)((bin_x - margin) * cells),
                                   (float)((bin_y - margin) * cells));
    const int blocks = BLOCKS * cells * cells;
    const size_t offset = (size_t)(bin - strip_bin) * (4 * BLOCK * blocks);
    __global float* own = moments + offset;
    __global float* part = partial + offset;
    const uint start = bin_starts[bin];
    const uint begin = max(first_particle, start);
    const uint end = min(last_particle, bin_starts[bin + 1]);
    // Work-items zero and add up the terms that they own in add_moments.
    const uint item = get_local_id(0);
#if WIDTH == 1
    __local float t_x[ORDERS * MOMENT_GROUP], t_y[ORDERS * MOMENT_GROUP];
    __local int where[MOMENT_GROUP];
    __local float4 weighed[MOMENT_GROUP];
#define LOCALS t_x, t_y, where, weighed,
#define OWN_TERMS(i)                                                                           \
    for (uint term = item; term < TERMS; term += MOMENT_GROUP)                                 \
        for (int i = (int)term; i < blocks; i += TERMS)
#else
#define LOCALS
#define OWN_TERMS(i) for (int i = (int)item; i < blocks; ++i)
#endif
    const vblock zero = (vblock)(0.0f);
    if (start >= first_particle && start < bin_starts[bin + 1]) // an empty bin is not read
        OWN_TERMS(i) STORE_BLOCK(zero, i, own);
    const int direct = start >= first_particle && end <= begin + MOMENT_CHUNK;
    __global float* target = direct ? own : part;
    for (uint chunk = begin; chunk < end; chunk += MOMENT_CHUNK) {
        if (!direct)
            OWN_TERMS(i) STORE_BLOCK(zero, i, part);
        add_moments(chunk, min(end, chunk + MOMENT_CHUNK), per_pixel, corner, cells,
                    positions, samples, LOCALS target);
        if (!direct)
            OWN_TERMS(i) STORE_BLOCK(LOAD_BLOCK(i, own) + LOAD_BLOCK(i, part), i, own);
    }
}

// Where the cells begin that pixel i can get something from, and its row of coefficients.
// Cells are half, quarter... pixels (per_pixel to a pixel), or a number of pixels (phases).
INLINE int first_cell(const int i, const int per_pixel, const int phases, const int reach)
{
    return (i / phases) * per_pixel - reach;
}

// along_x[row][x][b] = sum over cells of the row, and over a, of A_a times moment (a, b).
// Work-item (x, row): `span` pixels of a row of cells, from first_row on, within the strip.
__kernel void sum_rows(
    const uint first_row, const int span, const int width,
    const uint strip_bin, const int margin, const int n_bins_x, const int cells,
    const int per_pixel, const int phases, const int reach, const int taps,
    const __global uint* restrict bin_starts,    // (bins + 1,) of this width level
    const __global float* restrict coefficients, // (phases, taps, ORDERS, 4 equal ones)
    const __global float* restrict moments,      // (bins of the strip, cells, cells, TERMS, 4)
    __global float* restrict along_x)            // (rows of the strip, width, ORDERS, 4)
{
    const int row = (int)(first_row + get_global_id(1));
    const int bin_y = row / cells;
    const int y = row & (cells - 1); // a power of two
    const int begin = (int)get_global_id(0) * span;
    const int end = min(width, begin + span);
    for (int x = begin; x < end; ++x) {
        vblock sums[ROWS];
        for (int b = 0; b < ROWS; ++b)
            sums[b] = (vblock)(0.0f);
        const int phase = x & (phases - 1); // a power of two
        const int first = first_cell(x, per_pixel, phases, reach) + margin * cells;
        const int last = min(first + taps, n_bins_x * cells);
        for (int bin_x = max(0, first) / cells; bin_x * cells < last; ++bin_x) {
            const int bin = bin_y * n_bins_x + bin_x;
            if (bin_starts[strip_bin + bin] == bin_starts[strip_bin + bin + 1])
                continue;
            const int left = bin_x * cells;
            const int cell_end = min(left + cells, last);
            for (int cell = max(left, first); cell < cell_end; ++cell) {
                const size_t at = ((size_t)bin * cells + y) * cells + (cell - left);
                const __global float* own = moments + at * (4 * TERMS);
                const __global float* factors =
                    coefficients + 4 * ORDERS * (phase * taps + cell - first);
                #pragma unroll
                for (int block = 0; block < BLOCKS; ++block)
                    sums[TERM_B(BLOCK * block)] +=
                        LOAD_BLOCK(TERM_A(BLOCK * block) / BLOCK, factors)
                        * LOAD_BLOCK(block, own);
            }
        }
        const size_t at = ORDERS * ((size_t)row * width + x);
        for (int b = 0; b < ROWS; ++b)
            vstore4(fold(sums[b]), at + b, along_x);
    }
}

// sums[y][x] += sum over rows of cells of the strip, and over b, of A_b times along_x.
// Work-item (x, y): `span` pixels, of the pixel rows from first_y on.
__kernel void sum_columns(
    const uint first_y, const int span, const int width,
    const int strip_row, const int rows, // of cells: the strip's first, without margin; count
    const int per_pixel, const int phases, const int reach, const int taps,
    const __global float* restrict coefficients, // (phases, taps, ORDERS, 4 equal ones)
    const __global float* restrict along_x,      // (rows of the strip, width, ORDERS, 4)
    const ulong plane, const ulong stride,       // of the sums
    __global float* restrict sums)               // (4, padded height, padded width)
{
    const int y = (int)(first_y + get_global_id(1));
    const int phase = y & (phases - 1); // a power of two
    const int first = first_cell(y, per_pixel, phases, reach) - strip_row;
    const int begin = (int)get_global_id(0) * span;
    const int end = min(width, begin + span);
    const int tap_end = min(taps, rows - first);
    for (int x = begin; x < end; ++x) {
        float4 total = (float4)(0.0f);
        for (int tap = max(0, -first); tap < tap_end; ++tap) {
            const __global float* own = along_x + 4 * ORDERS * ((size_t)(first + tap) * width + x);
            const __global float* factors = coefficients + 4 * ORDERS * (phase * taps + tap);
            for (int b = 0; b < ROWS; ++b)
                total += vload4(b, factors) * vload4(b, own);
        }
        const size_t at = (size_t)y * stride + x;
        sums[at] += total.x;
        sums[plane + at] += total.y;
        sums[2 * plane + at] += total.z;
        sums[3 * plane + at] += total.w;
    }
}
