// Particles in motion, widths of their own, and their sort into bins, without atomics, so that the
// result does not depend on scheduling. A particle that starts at a and ends at b is at time t at
//
//     z = (1 - t) a + t b,   p = (z - 1/2) scale + center,
//
// z and the spacing in units of the common frame, p in pixels; weights and colors move alike.
//
// Particles are sorted in two steps: count them by bin, then put each into its place (the order
// inside a bin is the particles' own). Bins: see bins.cl.
//
// Widths can differ between particles: each then has one of WIDTH_LEVELS widths,
//
//     sigma 2^((level - BASE_LEVEL) / LEVELS_PER_OCTAVE),
//
// and every level has bins of its own.
//
// Launch: one work-item for each particle, from `first` on; or for each slice of the list of particles.
//
// -D WIDTH_LEVELS       number of widths, at most 256
// -D BASE_LEVEL         the level whose width is sigma
// -D LEVELS_PER_OCTAVE  levels from one width to twice that

#include "common.cl"
#include "bins.cl"

#if !defined(WIDTH_LEVELS) || !defined(BASE_LEVEL) || !defined(LEVELS_PER_OCTAVE)
#error "WIDTH_LEVELS, BASE_LEVEL and LEVELS_PER_OCTAVE must be given, see above"
#endif

// Position, weight, color and spacing of every particle at time t. One work-item each.
__kernel void advect(
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
__kernel void pack_weights(
    const uint first,
    const __global float4* restrict samples, // (particles,): weight, color
    __global float4* restrict packed)        // (particles,): weight, weight, 0, 0
{
    const size_t i = (size_t)first + get_global_id(0);
    const float weight = samples[i].x;
    packed[i] = (float4)(weight, weight, 0.0f, 0.0f);
}

// Width level of every particle: its width is the larger of sigma times its own spacing and of half
// the distance between particles where it stands, which is read between pixels, bilinearly.
// Its weight is scaled so that the kernel's sum is that of sigma.
__kernel void choose_width_levels(
    const uint first, const int2 shape, // (width, height) of the canvas
    const float sigma,
    const __global float* restrict distances,  // (height, width): pixels
    const __global float2* restrict positions, // (particles,)
    const __global float4* restrict samples,   // (particles,): weight, color
    const __global float* restrict spacings,   // (particles,): pixels
    __global uchar* restrict width_levels,     // (particles,)
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
    const float level = rint(LEVELS_PER_OCTAVE * log2(max(width, 1e-30f))) + BASE_LEVEL;
    width_levels[i] = (uchar)clamp(level, 0.0f, WIDTH_LEVELS - 1.0f);
    // (sigma / width)^2, for the width of the level
    const float ratio = exp2((BASE_LEVEL - (float)width_levels[i]) * (2.0f / LEVELS_PER_OCTAVE));
    scaled[i] = (float4)(samples[i].x * ratio, samples[i].y, samples[i].z, samples[i].w);
}

// counts[slice][bin] = particles of this slice in the bin. One work-item a slice of
// consecutive particles, from first_slice on; counts are zero before. Slices come first so
// that no two cores write to the same cache line.
__kernel void count_bins(
    const uint n_particles, const uint slice_size, const uint first_slice, const uint all_bins,
    const float bins_per_pixel, const int margin, const int2 n_bins,
    const uint level_bins, // bins of one width level; 0 if all have the same width
    const __global float2* restrict positions, // (n_particles,)
    const __global uchar* restrict width_levels, // (n_particles,)
    __global uint* restrict counts)            // (slices, bins of all levels)
{
    const uint slice = first_slice + get_global_id(0);
    const uint end = min(n_particles, (slice + 1) * slice_size);
    __global uint* own = counts + (size_t)slice * all_bins;
    for (uint i = slice * slice_size; i < end; ++i)
        ++own[(size_t)level_bins * width_levels[i] + bin_of(positions[i], bins_per_pixel, margin, n_bins)];
}

// Sort into bins: slots[slice][bin] is where the slice's first particle of the bin goes.
__kernel void fill_bins(
    const uint n_particles, const uint slice_size, const uint first_slice, const uint all_bins,
    const float bins_per_pixel, const int margin, const int2 n_bins,
    const uint level_bins, // bins of one width level; 0 if all have the same width
    const __global float2* restrict positions, // (n_particles,)
    const __global uchar* restrict width_levels, // (n_particles,)
    const __global float4* restrict samples,   // (n_particles,)
    __global uint* restrict slots,             // (slices, bins of all levels)
    __global uint* restrict order,             // (n_particles,)
    __global float2* restrict sorted_positions,
    __global float4* restrict sorted_samples)  // (n_particles,): weight, weight times color
{
    const uint slice = first_slice + get_global_id(0);
    const uint end = min(n_particles, (slice + 1) * slice_size);
    __global uint* own = slots + (size_t)slice * all_bins;
    for (uint i = slice * slice_size; i < end; ++i) {
        const size_t bin =
            (size_t)level_bins * width_levels[i] + bin_of(positions[i], bins_per_pixel, margin, n_bins);
        const uint slot = own[bin]++;
        order[slot] = i;
        sorted_positions[slot] = positions[i];
        const float4 sample = samples[i];
        const float weight = sample.x;
        sorted_samples[slot] =
            (float4)(weight, weight * sample.y, weight * sample.z, weight * sample.w);
    }
}
