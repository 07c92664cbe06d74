// A picture sampled where a smooth motion says: the cubic spline through its pixels, at places
//
//     origin + step * (row, column) + displacement(row, column),
//
// of which the displacement is given on a coarse grid over the canvas and is linear between its points.
// The coefficients of the spline come from the host (Unser 1999). Beyond its border the picture
// is mirrored about the centers of its outermost pixels.
//
// Launch: one work-item for each pixel of some rows of the canvas: get_global_id(0) is the column, which may
// exceed the canvas, and get_global_id(1) the row, counted from `first_row`.
//
// Units: places and displacements in pixels of the picture, (row, column) in this order as .x and .y.

#include "common.cl"

// The index inside 0 <= i < n that a place mirrors, which may be far outside.
INLINE int mirrored(const int i, const int n)
{
    const int period = max(2 * n - 2, 1);
    const int once = (int)((uint)abs(i) % (uint)period);
    return min(once, period - once);
}

// Weights of the four coefficients around a place, f pixels after the second one.
INLINE float4 cubic_weights(const float f)
{
    const float r = 1.0f - f;
    const float first = r * r * r * (1.0f / 6.0f);
    const float last = f * f * f * (1.0f / 6.0f);
    const float second = 2.0f / 3.0f - 0.5f * f * f * (2.0f - f);
    return (float4)(first, second, 1.0f - first - second - last, last);
}

// The lower one of the two grid points around a pixel, and the weight of the other one.
INLINE int grid_point(
    const int pixel, const int pixels, const int points, float* weight)
{
    const float place = ((float)pixel - 0.5f * (float)(pixels - 1)) * ((float)points / (float)pixels)
        + 0.5f * (float)(points - 1);
    const float inside = clamp(place, 0.0f, (float)(points - 1));
    const int low = min((int)inside, max(points - 2, 0));
    *weight = inside - (float)low;
    return low;
}

__kernel void sample_spline(
    const uint first_row,
    const int2 canvas,                              // height and width
    const float2 origin, const float2 step,
    const int2 grid,                                // height and width
    const __global float2* restrict displacements,  // (grid height, grid width)
    const int2 shape,                               // height and width of the picture
    const __global float4* restrict coefficients,   // (height, width): three channels, and 0
    __global float* restrict samples)               // (rows of this launch, canvas width, 3)
{
    const int column = get_global_id(0);
    if (column >= canvas.y)
        return;
    const int local_row = get_global_id(1);
    const int row = (int)first_row + local_row;

    float down, across;
    const int i = grid_point(row, canvas.x, grid.x, &down);
    const int j = grid_point(column, canvas.y, grid.y, &across);
    const __global float2* above = displacements + (size_t)i * grid.y;
    const __global float2* below = displacements + (size_t)min(i + 1, grid.x - 1) * grid.y;
    const int right = min(j + 1, grid.y - 1);
    const float2 displacement = mix(
        mix(above[j], above[right], across), mix(below[j], below[right], across), down);

    // A place far outside would leave the range of integers.
    const float2 place = clamp(
        origin + step * (float2)((float)row, (float)column) + displacement, -1e6f, 1e6f);
    const float2 lower = floor(place);
    const float4 along_rows = cubic_weights(place.x - lower.x);
    const float4 along_columns = cubic_weights(place.y - lower.y);
    const int y = (int)lower.x - 1, x = (int)lower.y - 1;
    float wy[4], wx[4];
    vstore4(along_rows, 0, wy);
    vstore4(along_columns, 0, wx);
    float4 sum = (float4)(0.0f);
    if (y >= 0 && x >= 0 && y + 3 < shape.x && x + 3 < shape.y) {
        const __global float4* corner = coefficients + (size_t)y * shape.y + x;
#pragma unroll
        for (int a = 0; a < 4; ++a) {
            const __global float4* line = corner + (size_t)a * shape.y;
            sum += wy[a] * (wx[0] * line[0] + wx[1] * line[1] + wx[2] * line[2] + wx[3] * line[3]);
        }
    } else {
        for (int a = 0; a < 4; ++a) {
            const __global float4* line = coefficients + (size_t)mirrored(y + a, shape.x) * shape.y;
            for (int b = 0; b < 4; ++b)
                sum += wy[a] * wx[b] * line[mirrored(x + b, shape.y)];
        }
    }
    vstore3(sum.xyz, (size_t)local_row * canvas.y + column, samples);
}
