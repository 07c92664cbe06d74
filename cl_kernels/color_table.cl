// Colors after a table in three dimensions, by tetrahedral interpolation.
//
// The table has N x N x N nodes over the cube [0, 1]^3, the last coordinate fastest. A color c stands in the
// cell of its node i = floor(c (N - 1)), at f = c (N - 1) - i. On the way from the corner i to the corner
// i + (1, 1, 1) along the axes in the order of their f, from the largest one to the smallest, it passes four
// corners, which are those of a tetrahedron around it, and takes
//
//     (1 - f1) v0 + (f1 - f2) v1 + (f2 - f3) v2 + f3 v3,   f1 >= f2 >= f3.
//
// So grays depend on grays alone. The formula is continuous: where two f are equal, the corner between them
// has the weight 0.
//
// Launch: one work-item for each color from `first` to `end`; those beyond do nothing.

#include "common.cl"

__kernel void apply_table(
    const uint first, const uint end, const int nodes, // nodes: N >= 2
    const __global float4* restrict table,             // (N, N, N); .w is not used
    const __global float* restrict colors,             // (end, 3)
    __global float* restrict found)                    // (end, 3)
{
    const uint color = first + get_global_id(0);
    if (color >= end)
        return;
    const float last = (float)(nodes - 1);
    const __global float* own = colors + (size_t)3 * color;
    const float x = clamp(own[0], 0.0f, 1.0f) * last;
    const float y = clamp(own[1], 0.0f, 1.0f) * last;
    const float z = clamp(own[2], 0.0f, 1.0f) * last;
    const int i = min((int)x, nodes - 2);
    const int j = min((int)y, nodes - 2);
    const int k = min((int)z, nodes - 2);
    const float fx = x - (float)i, fy = y - (float)j, fz = z - (float)k;
    const int along_x = nodes * nodes, along_y = nodes, along_z = 1;
    const float most = max(fx, max(fy, fz));
    const float least = min(fx, min(fy, fz));
    const float middle = max(min(fx, fy), min(max(fx, fy), fz));
    // The axis of the largest f, and that of the smallest; they differ, also among equals.
    const int to_most = fx >= fy ? (fx >= fz ? along_x : along_z) : (fy >= fz ? along_y : along_z);
    const int to_least = fx < fy ? (fx < fz ? along_x : along_z) : (fy < fz ? along_y : along_z);
    const int whole = along_x + along_y + along_z;
    const __global float4* corner = table + ((i * nodes + j) * nodes + k);
    const float4 value = (1.0f - most) * corner[0] + (most - middle) * corner[to_most]
        + (middle - least) * corner[whole - to_least] + least * corner[whole];
    __global float* result = found + (size_t)3 * color;
    result[0] = value.x;
    result[1] = value.y;
    result[2] = value.z;
}
