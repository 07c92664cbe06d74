// Bounds of e_ij for `mark_columns` (near_field.cl), over the rows of one vector and many columns at once.
//
// With the rows' box [low, high], and w for which limit_i - w . u_i hardly depends on i, no e_ij - limit_i of
// a column exceeds
//
//     h_j' + sum_d max(low_d z_d, high_d z_d) - min_i (limit_i - w . u_i),   z = k (v - (p - q)) - w,
//
// where h_j' is e_ij at u_i = 0. Most pairs of tiles hold no such column, so another bound comes first, before
// the tile is staged: that of a box of columns, low <= v <= high. With column slopes a, for which
// h_j - k a . v_j hardly depends on j, and s = u + (p - q) + a,
//
//     e_ij - w . u_i <= level_pq + max_j (h_j - k a . v_j)
//                       + sum_d max over u_d, v_d of  k v_d (s_d - v_d / 2) - u_d (k (p - q) + w)_d.
//
// In each dimension the largest term is at an end of the rows' box, and there at the v_d nearest to s_d.
//
// Included by near_field.cl, where GROUP is 1 and WIDTH is not.

// The box of WIDTH rows, u_i, and the least of their limits, from which slopes . u_i is taken: limits are
// close to linear in u.
typedef struct {
    float low[DIM], high[DIM], slopes[DIM];
    float least;
} rows_box;

INLINE float extreme(const vreal v, const float sign)
{
    float lanes[WIDTH];
    VSTORE(sign * v, 0, lanes);
    float most = lanes[0];
    for (int lane = 1; lane < WIDTH; ++lane)
        most = max(most, lanes[lane]);
    return sign * most;
}

#define BOX_ROUNDING 9.5367432e-7f // 2^-20: of sums of 2 DIM + 2 terms, relative to the sum of their sizes

INLINE void set_box(const ereal* u, const vreal limit, const __global float* slopes, rows_box* box)
{
    vreal rest = limit;
    vreal size = fabs(limit);
    for (int d = 0; d < DIM; ++d) {
        const vreal own = e_nearest(u[d]);
        box->slopes[d] = slopes[d];
        box->low[d] = extreme(own, -1.0f);
        box->high[d] = extreme(own, 1.0f);
        rest -= slopes[d] * own;
        size += fabs(slopes[d] * own);
    }
    box->least = extreme(rest - BOX_ROUNDING * size, -1.0f);
}

// Whether one of the columns first + j, 0 <= j < WIDTH, may be above the limit of one of the rows.
INLINE int may_be_above(const rows_box* box, const __local staged_real* staged, const uint first)
{
    vreal bound = VLOAD(0, staged + DIM * STAGED_ROW + first);
    vreal size = fabs(bound);
#pragma unroll
    for (int d = 0; d < DIM; ++d) {
        const vreal slope = VLOAD(0, staged + d * STAGED_ROW + first) - box->slopes[d];
        const vreal most = max(slope * box->low[d], slope * box->high[d]);
        bound += most;
        size += fabs(most);
    }
    return ANY(bound + BOX_ROUNDING * size > box->least);
}

// Boxes of columns: a tile has WIDTH of them, of BOX columns each.
#define BOX (TILE / WIDTH)
#define BOXES_ROUNDING 3.8146973e-6f // 2^-18: of e_ij and its bound, DIM + 2 terms of up to 8 operations

// What the bounds of the boxes of a column tile have in common for all rows of a row tile.
typedef struct {
    float shift[DIM]; // (p - q) + a
    float rest[DIM];  // k (p - q) + w
    vreal bound;      // level_pq + max_j (h_j - k a . v_j) of each box, and the bound's rounding error
} columns_frame;

INLINE void set_frame(
    const __global float* row_center, const __global float* row_slope, const float* row_sides,
    const __global float* column_center, const __global float* column_slope, const __global float* column_sides,
    const float k, const float level, const vreal most, columns_frame* frame)
{
    vreal size = fabs(level) + fabs(most);
    for (int d = 0; d < DIM; ++d) {
        const float between = row_center[d] - column_center[d];
        const float slope = column_slope[d];
        frame->shift[d] = between + slope;
        frame->rest[d] = k * between + row_slope[d];
        const float sides = row_sides[d] + fabs(between) + fabs(slope) + column_sides[d];
        size += k * sides * sides + 2.0f * row_sides[d] * fabs(row_slope[d]);
    }
    frame->bound = level + most + BOXES_ROUNDING * size;
}

// The largest term of one dimension for rows at u: at the v nearest to s = u + shift.
INLINE vreal largest_term(
    const float u, const float shift, const float rest, const float k, const vreal low, const vreal high)
{
    const float s = u + shift;
    const vreal v = clamp((vreal)s, low, high);
    return k * v * (s - 0.5f * v) - u * rest;
}

// Bits of the boxes that may hold a column above the limit of one of the rows.
INLINE uint boxes_above(
    const rows_box* rows, const columns_frame* frame, const float k, const __global float* lows,
    const __global float* highs, const size_t stride)
{
    vreal bound = frame->bound;
#pragma unroll
    for (int d = 0; d < DIM; ++d) {
        const vreal low = VLOAD(0, lows + d * stride);
        const vreal high = VLOAD(0, highs + d * stride);
        bound += max(largest_term(rows->low[d], frame->shift[d], frame->rest[d], k, low, high),
                     largest_term(rows->high[d], frame->shift[d], frame->rest[d], k, low, high));
    }
    const vint above = ~IS_TRUE(bound <= rows->least); // also where it is no number
    if (!ANY(above))
        return 0;
    int lanes[WIDTH];
    VSTORE(above, 0, lanes);
    uint bits = 0;
    for (int lane = 0; lane < WIDTH; ++lane)
        bits |= lanes[lane] ? 1u << lane : 0u;
    return bits;
}

// Bits of the boxes that hold the columns first + j, 0 <= j < STEP.
#define BOXES_OF(first) ((2u << (((first) + STEP - 1) / BOX)) - (1u << ((first) / BOX)))
