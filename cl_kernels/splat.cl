// From particles to the two sums of a Nadaraya-Watson frame,
//
//     numerator(p) = sum_k w_k K(p - p_k) c_k,   denominator(p) = sum_k w_k K(p - p_k),
//     K(d) = exp(-|d|^2 / (2 sigma^2)) where |d_x|, |d_y| <= radius, else 0,
//
// in four steps without atomics, so that the result does not depend on scheduling:
// place the particles at time t, count them by bin, sort them into bins (the order
// inside a bin is the particles' own), and let every tile of pixels gather the bins
// within its reach. Bins are squares of 1 / bins_per_pixel pixels, a power of two; bin
// (0, 0) begins `margin` bins outside the canvas, and particles farther out fall into the
// outermost ones. Where particles are many, moments.cl takes the place of the last step.
//
// Widths can differ between particles: each then stands on a rung of a ladder of widths
// (choose_rungs), every rung has bins of its own, and rungs are gathered one by one.
//
// -D RUNGS       rungs of the ladder
// -D BASE_RUNG   the one whose width is sigma; RUNGS_PER_OCTAVE of them double the width
// -D CHUNK       particles added up before they join the total (bounds rounding)
// -D TILE_GROUP  work-items of a splatting work-group along x and y

#include "common.cl"

#ifndef RUNGS
#error "RUNGS, BASE_RUNG and RUNGS_PER_OCTAVE (ladder of widths) must be given"
#endif
#ifndef CHUNK
#define CHUNK 256 // rounding grows with CHUNK + n / CHUNK
#endif
#ifndef TILE_GROUP
#define TILE_GROUP 1
#endif

// Position, weight, color and spacing of every particle at time t. One work-item each.
__kernel void place(
    const uint first, const float t, const float2 scale, const float2 center,
    const __global float* restrict table,       // (points, 6): x, y in the frame, color, spacing
    const __global uint2* restrict links,       // (particles,): where it starts, where it ends
    const __global float2* restrict weights,    // (particles,): weight at t = 0 and at t = 1
    __global float* restrict positions,         // (particles, 2): pixels
    __global float* restrict samples,           // (particles, 4): weight, color
    __global float* restrict spacings)          // (particles,): pixels
{
    const size_t i = (size_t)first + get_global_id(0);
    const uint2 link = links[i];
    const __global float* a = table + 6 * (size_t)link.x;
    const __global float* b = table + 6 * (size_t)link.y;
    const float s = 1.0f - t;
    positions[2 * i] = (s * a[0] + t * b[0] - 0.5f) * scale.x + center.x;
    positions[2 * i + 1] = (s * a[1] + t * b[1] - 0.5f) * scale.y + center.y;
    samples[4 * i] = s * weights[i].x + t * weights[i].y;
    for (int channel = 0; channel < 3; ++channel)
        samples[4 * i + 1 + channel] = s * a[2 + channel] + t * b[2 + channel];
    spacings[i] = (s * a[5] + t * b[5]) * 0.5f * (scale.x + scale.y);
}

// Samples whose first color is the weight: their sums are those of masses and of squares.
__kernel void weigh(
    const uint first,
    const __global float4* restrict samples, // (particles,): weight, color
    __global float4* restrict weighed)       // (particles,): weight, weight, 0, 0
{
    const size_t i = (size_t)first + get_global_id(0);
    const float weight = samples[i].x;
    weighed[i] = (float4)(weight, weight, 0.0f, 0.0f);
}

// Rung of every particle: its width is the larger of sigma times its own spacing and of half
// the distance between particles where it stands, which is read between pixels, bilinearly.
// Its weight is scaled so that the kernel's sum is that of sigma.
__kernel void choose_rungs(
    const uint first, const int2 shape, // (width, height) of the canvas
    const float sigma,
    const __global float* restrict distances,  // (height, width): pixels
    const __global float2* restrict positions, // (particles,)
    const __global float4* restrict samples,   // (particles,): weight, color
    const __global float* restrict spacings,   // (particles,): pixels
    __global uchar* restrict rungs,            // (particles,)
    __global float4* restrict scaled)          // (particles,): samples, their weights scaled
{
    const size_t i = (size_t)first + get_global_id(0);
    const float x = clamp(positions[i].x, 0.0f, shape.x - 1.0f);
    const float y = clamp(positions[i].y, 0.0f, shape.y - 1.0f);
    const int x0 = min((int)x, max(0, shape.x - 2));
    const int y0 = min((int)y, max(0, shape.y - 2));
    const int x1 = min(x0 + 1, shape.x - 1);
    const int y1 = min(y0 + 1, shape.y - 1);
    const float u = x - x0;
    const float v = y - y0;
    const float above = (1.0f - u) * distances[y0 * shape.x + x0] + u * distances[y0 * shape.x + x1];
    const float below = (1.0f - u) * distances[y1 * shape.x + x0] + u * distances[y1 * shape.x + x1];
    const float gap = 0.5f * ((1.0f - v) * above + v * below);
    const float width = max(sigma * spacings[i], gap) / sigma;
    const float rung = rint(RUNGS_PER_OCTAVE * log2(max(width, 1e-30f))) + BASE_RUNG;
    rungs[i] = (uchar)clamp(rung, 0.0f, RUNGS - 1.0f);
    // (sigma / width)^2, for the width of the rung
    const float ratio = exp2((BASE_RUNG - (float)rungs[i]) * (2.0f / RUNGS_PER_OCTAVE));
    scaled[i] = (float4)(samples[i].x * ratio, samples[i].y, samples[i].z, samples[i].w);
}

// Which bin a pixel position falls into. (n_bins_x, n_bins_y) include the margins.
static inline uint bin_of(
    const float2 position, const float bins_per_pixel, const int margin, const int2 n_bins)
{
    const int bx = (int)clamp(floor(position.x * bins_per_pixel) + margin, 0.0f, n_bins.x - 1.0f);
    const int by = (int)clamp(floor(position.y * bins_per_pixel) + margin, 0.0f, n_bins.y - 1.0f);
    return (uint)(by * n_bins.x + bx);
}

// counts[slice][bin] = particles of this slice in the bin. One work-item a slice of
// consecutive particles, from first_slice on; counts are zero before. Slices come first so
// that no two cores write to the same cache line.
__kernel void count_bins(
    const uint n_particles, const uint slice_size, const uint first_slice, const uint all_bins,
    const float bins_per_pixel, const int margin, const int2 n_bins,
    const uint rung_bins, // bins of one rung; 0 if there are no rungs
    const __global float2* restrict positions, // (n_particles,)
    const __global uchar* restrict rungs,      // (n_particles,)
    __global uint* restrict counts)            // (slices, bins of all rungs)
{
    const uint slice = first_slice + get_global_id(0);
    const uint end = min(n_particles, (slice + 1) * slice_size);
    __global uint* own = counts + (size_t)slice * all_bins;
    for (uint i = slice * slice_size; i < end; ++i)
        ++own[(size_t)rung_bins * rungs[i] + bin_of(positions[i], bins_per_pixel, margin, n_bins)];
}

// Sort into bins: slots[slice][bin] is where the slice's first particle of the bin goes.
__kernel void fill_bins(
    const uint n_particles, const uint slice_size, const uint first_slice, const uint all_bins,
    const float bins_per_pixel, const int margin, const int2 n_bins,
    const uint rung_bins, // bins of one rung; 0 if there are no rungs
    const __global float2* restrict positions, // (n_particles,)
    const __global uchar* restrict rungs,      // (n_particles,)
    const __global float4* restrict samples,   // (n_particles,)
    __global uint* restrict slots,             // (slices, bins of all rungs)
    __global uint* restrict order,             // (n_particles,)
    __global float2* restrict sorted_positions,
    __global float4* restrict sorted_samples)  // (n_particles,): weight, weight times color
{
    const uint slice = first_slice + get_global_id(0);
    const uint end = min(n_particles, (slice + 1) * slice_size);
    __global uint* own = slots + (size_t)slice * all_bins;
    for (uint i = slice * slice_size; i < end; ++i) {
        const size_t bin =
            (size_t)rung_bins * rungs[i] + bin_of(positions[i], bins_per_pixel, margin, n_bins);
        const uint slot = own[bin]++;
        order[slot] = i;
        sorted_positions[slot] = positions[i];
        const float4 sample = samples[i];
        const float weight = sample.x;
        sorted_samples[slot] =
            (float4)(weight, weight * sample.y, weight * sample.z, weight * sample.w);
    }
}

// One-dimensional kernel at WIDTH pixels. nearest: the box of one pixel, half open, in
// which every particle falls into exactly one pixel.
static inline vreal kernel_1d(
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
    const __global uint* restrict bin_starts,     // (bins + 1,) of this rung
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
