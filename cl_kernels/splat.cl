// From particles to the two sums of a Nadaraya-Watson frame (paper, 3.3),
//
//     numerator(p) = sum_k w_k K(p - p_k) c_k,   denominator(p) = sum_k w_k K(p - p_k),
//     K(d) = exp(-|d|^2 / (2 sigma^2)) where |d_x|, |d_y| <= radius, else 0,
//
// distances, sigma and radius in pixels, without atomics, so that the result does not depend on
// scheduling: particles come sorted into bins (see particles.cl and bins.cl), and every tile of pixels
// gathers the bins within its reach. Where particles are many, gauss_transform.cl takes the place of
// the gather. Particles of different width levels are gathered one level after the other.
//
// -D CHUNK       particles added up before they join the total (bounds rounding)
// -D TILE_GROUP  work-items of a splatting work-group along x and y

#include "common.cl"
#include "bins.cl"

#if !defined(CHUNK) || !defined(TILE_GROUP)
#error "CHUNK and TILE_GROUP must be given, see above"
#endif

// One-dimensional kernel at WIDTH pixels. nearest: the box of one pixel, half open, in
// which every particle falls into exactly one pixel.
INLINE vreal kernel_1d(
    const vreal d, const float exponent_scale, const float radius, const int nearest)
{
    const vreal one = (vreal)(1.0f);
    const vreal zero = (vreal)(0.0f);
    if (nearest) {
        const vint inside = (d >= -0.5f) & (d < 0.5f);
        return select(zero, one, inside);
    }
    const vreal value = exp2_nonpositive(d * d * exponent_scale);
    const vint inside = fabs(d) <= radius;
    return select(zero, value, inside);
}

#if WIDTH == 1
#define RAMP 0.0f
#elif WIDTH == 2
#define RAMP (float2)(0, 1)
#elif WIDTH == 4
#define RAMP (float4)(0, 1, 2, 3)
#elif WIDTH == 8
#define RAMP (float8)(0, 1, 2, 3, 4, 5, 6, 7)
#else
#define RAMP (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#endif

// Gather. A work-item owns WIDTH x WIDTH pixels, a work-group a block of TILE_GROUP x
// TILE_GROUP of those; get_group_id(0) counts blocks row by row, from first_block on. Only
// particles first_particle <= i < last_particle are added, to what sums already holds: a
// launch is bounded in both. The output is padded to whole blocks.
__kernel __attribute__((reqd_work_group_size(TILE_GROUP, TILE_GROUP, 1)))
void splat(
    const uint first_block, const uint blocks_x, const uint first_particle,
    const uint last_particle, const float bins_per_pixel, const int margin, const int2 n_bins,
    const float exponent_scale, // -log2(e) / (2 sigma^2)
    const float radius, const int nearest,
    const __global uint* restrict bin_starts,     // (bins + 1,) of this width level
    const __global float2* restrict positions,    // sorted into bins
    const __global float4* restrict samples,      // sorted into bins: weight, weighed color
    const ulong plane,                            // padded height * padded width
    __global float* restrict sums)                // (4, padded height, padded width)
{
    const uint block = first_block + get_group_id(0);
    const uint block_y = block / blocks_x;
    const uint block_x = block - block_y * blocks_x;
    const uint left = (block_x * TILE_GROUP + get_local_id(0)) * WIDTH;
    const uint top = (block_y * TILE_GROUP + get_local_id(1)) * WIDTH;
    const size_t stride = (size_t)blocks_x * TILE_GROUP * WIDTH;
    const float x0 = (float)left;
    const float y0 = (float)top;
    const vreal pixel_x = x0 + RAMP;
    const vreal pixel_y = y0 + RAMP;
    const float last = WIDTH - 1.0f;

    vreal total[4 * WIDTH];
    for (int y = 0; y < WIDTH; ++y)
        for (int channel = 0; channel < 4; ++channel)
            total[4 * y + channel] =
                VLOAD((size_t)(channel * plane) + (top + y) * stride + left, sums);

    const float2 low = (float2)(x0 - radius, y0 - radius);
    const float2 high = (float2)(x0 + last + radius, y0 + last + radius);
    const uint bin_low = bin_of(low, bins_per_pixel, margin, n_bins);
    const uint bin_high = bin_of(high, bins_per_pixel, margin, n_bins);
    const int bin_width = (int)(bin_high % n_bins.x) - (int)(bin_low % n_bins.x);
    for (uint row = bin_low; row <= bin_high; row += n_bins.x) {
        const uint end = min(last_particle, bin_starts[row + bin_width + 1]);
        for (uint chunk = max(first_particle, bin_starts[row]); chunk < end; chunk += CHUNK) {
            vreal partial[4 * WIDTH];
            for (int i = 0; i < 4 * WIDTH; ++i)
                partial[i] = (vreal)(0.0f);
            const uint chunk_end = min(end, chunk + CHUNK);
            for (uint i = chunk; i < chunk_end; ++i) {
                const float2 p = positions[i];
                if (p.x < low.x || p.y < low.y || p.x > high.x || p.y > high.y)
                    continue;
                const float4 sample = samples[i];
                const vreal kernel_x = kernel_1d(pixel_x - p.x, exponent_scale, radius, nearest);
                const vreal kx = kernel_x * sample.x;
                const vreal kr = kernel_x * sample.y;
                const vreal kg = kernel_x * sample.z;
                const vreal kb = kernel_x * sample.w;
                float ky[WIDTH];
                VSTORE(kernel_1d(pixel_y - p.y, exponent_scale, radius, nearest), 0, ky);
                const int y_begin = max(0, (int)floor(p.y - y0 - radius));
                const int y_end = min(WIDTH, (int)floor(p.y - y0 + radius) + 1);
                for (int y = y_begin; y < y_end; ++y) {
                    partial[4 * y] += ky[y] * kx;
                    partial[4 * y + 1] += ky[y] * kr;
                    partial[4 * y + 2] += ky[y] * kg;
                    partial[4 * y + 3] += ky[y] * kb;
                }
            }
            for (int i = 0; i < 4 * WIDTH; ++i)
                total[i] += partial[i];
        }
    }
    for (int y = 0; y < WIDTH; ++y)
        for (int channel = 0; channel < 4; ++channel)
            VSTORE(total[4 * y + channel],
                   (size_t)(channel * plane) + (top + y) * stride + left, sums);
}
