// Fields of a morph's layers, paths along them, and frames: the sum of two layers, each a picture that
// moves and changes its colors. The formulas stand in clmorph/backends/interface.py, Operations.
//
// A picture is the cubic spline through its pixels, whose coefficients come from the host (Unser
// 1999). Beyond the centers of its outermost pixels it is constant.
//
// Places come from the host, in float64, for each row and each column of a grid, as two numbers: a
// whole one, and the part to be added to it, so that float32 is as exact at pixel 4000 as at pixel 0.
//
// Launch: one work-item for each point of some rows of a grid, or pixel of the canvas: get_global_id(0) is
// the column, which may exceed the grid, and get_global_id(1) the row, counted from `first_row`.
//
// Units: places and displacements in points of a grid, (row, column) in this order as .x and .y.
//
// -D WIDTH           cells that a mean takes at once, see common.cl
// -D LEAST_LIKENESS  what unlike cells count in a mean

#include "common.cl"

#ifndef LEAST_LIKENESS
#error "LEAST_LIKENESS (what unlike cells count in a mean) must be given"
#endif

// Channels of values and of guides at most.
#define CHANNELS 8
// A place farther outside would leave the range of integers.
#define FARTHEST 1e6f

INLINE float sum_of_lanes(const vreal v)
{
#if WIDTH == 1
    return v;
#else
    float lanes[WIDTH];
    VSTORE(v, 0, lanes);
    float sum = 0.0f;
    for (int lane = 0; lane < WIDTH; ++lane)
        sum += lanes[lane];
    return sum;
#endif
}

// Sums over some rows of the cells around each point, added to those that are there: the weights,
// then each channel of the values times the weights.
__kernel void edge_preserving_mean(
    const uint first_row, const uint width,       // of the points
    const uint2 channels,                         // of the values and of the guide
    const int2 cells,                             // rows of cells, and cells of a padded row
    const int2 window,                            // rows and cells of a row around a point
    const int2 rows,                              // of the window: the first one, and the end
    const float sharpness,                        // such that exp2(-|sharpness (G - g)|^2) is the likeness
    const __global int* restrict first_rows,      // (points' rows,): the first cell around a point
    const __global int* restrict first_columns,   // (width,)
    const __global float* restrict down,          // (points' rows, window.x): weights of distances
    const __global float* restrict along,         // (width, window.y)
    const __global float* restrict planes,        // (1 + channels, cells): weights, values, guide
    const __global float* restrict fine_guide,    // (points' rows, width, channels.y)
    __global float* restrict sums)                // (points' rows, width, 1 + channels.x)
{
    const uint column = get_global_id(0);
    if (column >= width)
        return;
    const size_t row = (size_t)first_row + get_global_id(1);
    const size_t point = row * width + column;
    const size_t plane = (size_t)cells.x * cells.y;
    float own[CHANNELS];
    vreal found[CHANNELS], total = 0.0f;
#pragma unroll
    for (uint c = 0; c < CHANNELS; ++c) {
        own[c] = c < channels.y ? fine_guide[point * channels.y + c] : 0.0f;
        found[c] = 0.0f;
    }
    const __global float* along_row = along + (size_t)column * window.y;
    for (int k = rows.x; k < rows.y; ++k) {
        const int i = first_rows[row] + k;
        if (i < 0 || i >= cells.x)
            continue;
        const float far = down[row * window.x + k];
        const __global float* cell = planes + (size_t)i * cells.y + first_columns[column];
        for (int j = 0; j < window.y; j += WIDTH, cell += WIDTH) {
            const __global float* at = cell + (1 + channels.x) * plane;
            vreal unlike = 0.0f;
#pragma unroll
            for (uint c = 0; c < CHANNELS; ++c)
                if (c < channels.y) {
                    const vreal apart = sharpness * (own[c] - VLOAD(0, at + c * plane));
                    unlike += apart * apart;
                }
            const vreal likeness = exp2_nonpositive(-unlike) + LEAST_LIKENESS;
            const vreal weight = likeness * VLOAD(0, cell) * (far * VLOAD(j, along_row));
            total += weight;
            at = cell + plane;
#pragma unroll
            for (uint c = 0; c < CHANNELS; ++c)
                if (c < channels.x)
                    found[c] += weight * VLOAD(0, at + c * plane);
        }
    }
    __global float* of_point = sums + point * (1 + channels.x);
    of_point[0] += sum_of_lanes(total);
#pragma unroll
    for (uint c = 0; c < CHANNELS; ++c)
        if (c < channels.x)
            of_point[1 + c] += sum_of_lanes(found[c]);
}

// The two neighbors of a place on a grid that is constant beyond its border, and the weight of the
// second one.
INLINE int2 between(const float whole, const float part, const int side, float* weight)
{
    const float near = clamp(part, -FARTHEST, FARTHEST);
    const float lower = floor(near);
    const int i = (int)whole + (int)lower;
    *weight = near - lower;
    return (int2)(clamp(i, 0, side - 1), clamp(i + 1, 0, side - 1));
}

// Displacements along a field at the times 0, 1 / steps, ..., 1. Each work-item follows one point.
__kernel void follow_paths(
    const uint first_row, const uint2 shape,      // rows and columns of the points
    const int2 grid,                              // height and width of the field
    const uint steps, const uint rounds,
    const __global float* restrict rows,          // (2, shape.x): places on the field
    const __global float* restrict columns,       // (2, shape.y)
    const __global float4* restrict field,        // (grid height, grid width), and how steep it is
    __global float2* restrict paths)              // (steps + 1, shape.x, shape.y)
{
    const uint column = get_global_id(0);
    if (column >= shape.y)
        return;
    const uint row = first_row + get_global_id(1);
    const size_t point = (size_t)row * shape.y + column, points = (size_t)shape.x * shape.y;
    const float2 whole = (float2)(rows[row], columns[column]);
    const float2 part = (float2)(rows[shape.x + row], columns[shape.y + column]);
    float2 moved = (float2)(0.0f);
    paths[point] = moved;
    for (uint step = 1; step <= steps; ++step) {
        const float t = (float)step / (float)steps;
        for (uint round = 0; round < rounds; ++round) {
            const float2 place = part + moved;
            float down, across;
            const int2 i = between(whole.x, place.x, grid.x, &down);
            const int2 j = between(whole.y, place.y, grid.y, &across);
            const __global float4* above = field + (size_t)i.x * grid.y;
            const __global float4* below = field + (size_t)i.y * grid.y;
            const float4 v = mix(
                mix(above[j.x], above[j.y], across), mix(below[j.x], below[j.y], across), down);
            moved -= (moved + t * v.xy) / (1.0f + t * v.z);
        }
        paths[step * points + point] = moved;
    }
}

// The displacement of a point between two stored steps.
INLINE float2 at_point(
    const __global float2* paths, const size_t point, const size_t points, const float weight)
{
    return mix(paths[point], paths[points + point], weight);
}

INLINE float squared(const float2 v)
{
    return dot(v, v);
}

// A layer at one time, for each point of the paths' grid: displacement (.x, .y), weight (.z), and more
// than 0 where a point next to it comes from farther away than `limit` (.w). Inside a cell whose
// corners have 0, and between it and the next one, nothing is torn.
__kernel void place_layer(
    const uint first_row, const int2 shape,       // height and width of the grid
    const float weight,                           // of the second of the two stored steps
    const float2 step,                            // from points of the field to pixels of the picture
    const float limit,                            // in pixels of the picture, squared; below 0: none
    const __global float2* restrict paths,        // (steps + 1, height, width)
    const uint stored,                            // the first of the two steps
    const __global float* restrict weights,       // (height, width)
    __global float* restrict layer)               // (height, width, 4)
{
    const int column = get_global_id(0);
    if (column >= shape.y)
        return;
    const int row = (int)first_row + (int)get_global_id(1);
    const size_t points = (size_t)shape.x * shape.y;
    const __global float2* at = paths + stored * points;
    const size_t point = (size_t)row * shape.y + column;
    const size_t up = row > 0 ? shape.y : 0, down = row + 1 < shape.x ? shape.y : 0;
    const size_t left = column > 0 ? 1 : 0, right = column + 1 < shape.y ? 1 : 0;
    const float2 moved = at_point(at, point, points, weight);
    const float farthest = max(
        max(squared(step * (at_point(at, point - up, points, weight) - moved)),
            squared(step * (at_point(at, point + down, points, weight) - moved))),
        max(squared(step * (at_point(at, point - left, points, weight) - moved)),
            squared(step * (at_point(at, point + right, points, weight) - moved))));
    // One by one: Oclgrind takes a vector that is made of numbers for uninitialized.
    __global float* own = layer + 4 * point;
    own[0] = moved.x;
    own[1] = moved.y;
    own[2] = weights[point];
    // Not 0 or 1: for such a choice PoCL 3.1 takes ten times as long.
    own[3] = clamp(farthest - limit, 0.0f, 1.0f);
}

// A layer, and where the pixels of the canvas stand on its grids: tables of whole numbers and parts for
// the rows and the columns of the canvas. On the paths' grid places are inside it.
#define ON_PATHS 0
#define ON_FIELD 2
#define ON_PICTURE 4
#define TABLES 6

typedef struct {
    const __global float* rows;                   // (TABLES, canvas height)
    const __global float* columns;                // (TABLES, canvas width)
    const __global float4* points;                // (paths.x, paths.y), see place_layer
    const __global float4* change;                // (field.x, field.y, 2): of color, and the guide
    const __global float4* coefficients;          // (picture.x, picture.y)
    const __global float* shares;                 // (paths.x, paths.y): weights of the fourth channel
    int2 canvas, paths, field, picture;           // height and width
    float2 step;                                  // from points of the field to pixels of the picture
    float tearing;                                // 1 over the distance at which tears begin
    float way;
    float sharpness;                              // such that 1 / (1 + sharpness |G - g|^2) is the likeness
} Layer;

// Whole numbers, or parts, of a pixel's place. Places are added as vectors: Oclgrind 21.10 crashes
// where .x of one vector and .y of another are added.
INLINE float2 in_tables(const Layer layer, const int table, const int row, const int column)
{
    return (float2)(layer.rows[table * layer.canvas.x + row],
                    layer.columns[table * layer.canvas.y + column]);
}

// What an image on a grid shows at a place inside it.
INLINE float4 inside(
    const __global float4* image, const int2 shape, const float2 whole, const float2 part)
{
    const int i = (int)whole.x, j = (int)whole.y;
    const __global float4* above = image + (size_t)i * shape.y + j;
    const __global float4* below = above + (i + 1 < shape.x ? shape.y : 0);
    const int right = j + 1 < shape.y ? 1 : 0;
    return mix(
        mix(above[0], above[right], part.y), mix(below[0], below[right], part.y), part.x);
}

// Displacement (.x, .y), weight (.z), and 0 (.w) where nothing can be torn, at a pixel.
INLINE float4 at_pixel(const Layer layer, const int row, const int column)
{
    return inside(
        layer.points, layer.paths, in_tables(layer, ON_PATHS, row, column),
        in_tables(layer, ON_PATHS + 1, row, column));
}

// Weight of the fourth channel at a pixel.
INLINE float share_at(const Layer layer, const int row, const int column)
{
    const float2 whole = in_tables(layer, ON_PATHS, row, column);
    const float2 part = in_tables(layer, ON_PATHS + 1, row, column);
    const int i = (int)whole.x, j = (int)whole.y;
    const __global float* above = layer.shares + (size_t)i * layer.paths.y + j;
    const __global float* below = above + (i + 1 < layer.paths.x ? layer.paths.y : 0);
    const int right = j + 1 < layer.paths.y ? 1 : 0;
    return mix(
        mix(above[0], above[right], part.y), mix(below[0], below[right], part.y), part.x);
}

// The index inside 0 <= i < n that -1, n or n + 1 mirrors.
INLINE int mirrored(const int i, const int n)
{
    const int once = abs(i);
    return max(0, min(once, 2 * n - 2 - once));
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

// What a picture shows at a place.
INLINE float4 of_picture(
    const __global float4* coefficients, const int2 shape, const float2 whole, const float2 part)
{
    const float2 last = (float2)(shape.x - 1, shape.y - 1);
    const float2 near = clamp(part, -whole, last - whole);
    const float2 lower = floor(near);
    const float4 along_rows = cubic_weights(near.x - lower.x);
    const float4 along_columns = cubic_weights(near.y - lower.y);
    const int y = (int)whole.x + (int)lower.x - 1, x = (int)whole.y + (int)lower.y - 1;
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
    return sum;
}

// The color that a layer has at a pixel of this displacement. The change of color is that of the points
// around it whose guide is like its own color: at an edge of the picture it is not blurred.
INLINE float4 color_at(const Layer layer, const int row, const int column, const float2 moved)
{
    const float4 picture = of_picture(
        layer.coefficients, layer.picture, in_tables(layer, ON_PICTURE, row, column),
        in_tables(layer, ON_PICTURE + 1, row, column) + layer.step * moved);
    const float2 whole = in_tables(layer, ON_FIELD, row, column);
    const float2 place = in_tables(layer, ON_FIELD + 1, row, column) + moved;
    float down, across;
    const int2 i = between(whole.x, place.x, layer.field.x, &down);
    const int2 j = between(whole.y, place.y, layer.field.y, &across);
    // Each point of the field has its change, then its guide. Not unrolled: GPUs would lack registers.
    float total = 0.0f;
    float4 change = (float4)(0.0f);
#pragma unroll 1
    for (int corner = 0; corner < 4; ++corner) {
        const bool below = corner > 1, right = corner % 2 > 0;
        const __global float4* point
            = layer.change + 2 * ((size_t)(below ? i.y : i.x) * layer.field.y + (right ? j.y : j.x));
        const float4 unlike = point[1] - picture;
        const float apart
            = layer.sharpness * (unlike.x * unlike.x + unlike.y * unlike.y + unlike.z * unlike.z);
        const float near = (below ? down : 1.0f - down) * (right ? across : 1.0f - across);
        // For huge colors it is infinite, and all weights would be 0.
        const float weight = near / (1.0f + min(apart, 1e12f));
        total += weight;
        change += weight * point[0];
    }
    return picture + layer.way / total * change;
}

// Square of the distance in the picture between a pixel and a neighbor, which stands inside the canvas.
INLINE float apart(
    const Layer layer, const int row, const int column, const int other_row,
    const int other_column, const float2 moved)
{
    const float4 other = at_pixel(layer, other_row, other_column);
    const float2 way = in_tables(layer, ON_PICTURE, other_row, other_column)
        - in_tables(layer, ON_PICTURE, row, column)
        + (in_tables(layer, ON_PICTURE + 1, other_row, other_column)
           - in_tables(layer, ON_PICTURE + 1, row, column))
        + layer.step * ((float2)(other.x, other.y) - moved);
    return squared(way);
}

// What a layer adds to a pixel.
INLINE float4 of_layer(const Layer layer, const int row, const int column)
{
    const float4 here = at_pixel(layer, row, column);
    const float share = share_at(layer, row, column);
    if (here.z == 0.0f && share == 0.0f)
        return (float4)(0.0f);
    const float2 moved = (float2)(here.x, here.y);
    float4 color = color_at(layer, row, column, moved);
    float torn = 0.0f;
    if (here.w > 0.0f) {
        const int up = max(row - 1, 0), low = min(row + 1, layer.canvas.x - 1);
        const int left = max(column - 1, 0), right = min(column + 1, layer.canvas.y - 1);
        const float farthest = max(
            max(apart(layer, row, column, up, column, moved),
                apart(layer, row, column, low, column, moved)),
            max(apart(layer, row, column, row, left, moved),
                apart(layer, row, column, row, right, moved)));
        torn = clamp(sqrt(farthest) * layer.tearing - 1.0f, 0.0f, 1.0f);
    }
    if (torn > 0.0f) {
        float4 mean = (float4)(0.0f);
        for (int down = -1; down <= 1; ++down) {
            for (int across = -1; across <= 1; ++across) {
                const int i = clamp(row + down, 0, layer.canvas.x - 1);
                const int j = clamp(column + across, 0, layer.canvas.y - 1);
                const float4 other = at_pixel(layer, i, j);
                const float weight = (down ? 0.25f : 0.5f) * (across ? 0.25f : 0.5f);
                mean += weight * color_at(layer, i, j, (float2)(other.x, other.y));
            }
        }
        color = mix(color, mean, torn);
    }
    return (float4)(here.z, here.z, here.z, share) * color;
}

// Two layers, each times its weight, plus an image on a grid over the canvas.
__kernel void draw_layers(
    const uint first_row,
    const int2 canvas,                            // height and width
    const __global float* restrict rows,          // (2 + 2 TABLES, canvas height): the first on `low`
    const __global float* restrict columns,       // (2 + 2 TABLES, canvas width)
    const int2 low_shape, const __global float4* restrict low,
    const int4 paths, const int4 fields, const int4 pictures, // height and width of both layers'
    const float4 step,                            // those of both layers
    const float2 tearing, const float2 way, const float sharpness,
    const __global float4* restrict points_a, const __global float4* restrict change_a,
    const __global float4* restrict coefficients_a, const __global float* restrict shares_a,
    const __global float4* restrict points_b, const __global float4* restrict change_b,
    const __global float4* restrict coefficients_b, const __global float* restrict shares_b,
    __global float4* restrict frame)              // (rows of this launch, canvas width)
{
    const int column = get_global_id(0);
    if (column >= canvas.y)
        return;
    const int local_row = get_global_id(1);
    const int row = (int)first_row + local_row;

    float4 sum = inside(
        low, low_shape, (float2)(rows[row], columns[column]),
        (float2)(rows[canvas.x + row], columns[canvas.y + column]));

    Layer layer;
    layer.canvas = canvas;
    for (int second = 0; second < 2; ++second) {
        layer.rows = rows + (2 + second * TABLES) * canvas.x;
        layer.columns = columns + (2 + second * TABLES) * canvas.y;
        layer.points = second ? points_b : points_a;
        layer.change = second ? change_b : change_a;
        layer.coefficients = second ? coefficients_b : coefficients_a;
        layer.shares = second ? shares_b : shares_a;
        layer.paths = second ? (int2)(paths.z, paths.w) : (int2)(paths.x, paths.y);
        layer.field = second ? (int2)(fields.z, fields.w) : (int2)(fields.x, fields.y);
        layer.picture = second ? (int2)(pictures.z, pictures.w) : (int2)(pictures.x, pictures.y);
        layer.step = second ? (float2)(step.z, step.w) : (float2)(step.x, step.y);
        layer.tearing = second ? tearing.y : tearing.x;
        layer.way = second ? way.y : way.x;
        layer.sharpness = sharpness;
        sum += of_layer(layer, row, column);
    }
    frame[(size_t)local_row * canvas.y + column] = sum;
}
