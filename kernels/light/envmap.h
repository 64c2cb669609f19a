// Environment map: radiance from a direction, and sampling of directions nearly in proportion to radiance. Called by
// light/environment_light.h. The image and its sampling tables are made by host/isonoise/scene/light/envmap.py.
#pragma once
#include "path/path_state.h"
#include "util/math.h"

#if FEATURE_ENVIRONMENT_MAP
typedef struct {
    __global const Environment* record;
    __global const float* texels;  // 4 floats a texel: RGB, CDF (bits) of the cell that begins there, in its row
    __global const float* rows;    // 3 floats a row: CDF (bits), guide (bits), sine
    __global const uint* guide;    // of the columns: an entry a cell, row by row
} Envmap;

#define MIN_SINE 1e-20f  // at a pole the pdf would be infinite and the radiance weigh nothing: keeps both finite

// A cell of the map: the area between four texel centres. Its texels, the sines of its rows, and a position in it.
typedef struct {
    Vec3 texel00, texel10, texel01, texel11;  // texel `column row`
    float sine0, sine1;
    float s, t;  // in [0, 1], along columns and rows
} EnvmapCell;

INLINE EnvmapCell envmap_cell(const Envmap* map, uint column, uint row)
{
    const uint width = map->record->size[0], next = column + 1u == width ? 0u : column + 1u;
    const int upper = (int)(row * width), lower = upper + (int)width;
    EnvmapCell cell;
    cell.texel00 = LOAD3_AT(4 * (upper + (int)column), map->texels);
    cell.texel10 = LOAD3_AT(4 * (upper + (int)next), map->texels);
    cell.texel01 = LOAD3_AT(4 * (lower + (int)column), map->texels);
    cell.texel11 = LOAD3_AT(4 * (lower + (int)next), map->texels);
    cell.sine0 = map->rows[3 * (int)row + 2];
    cell.sine1 = map->rows[3 * (int)row + 5];
    return cell;
}

// Radiance at the position in the cell, interpolated bilinearly. *weight gets the interpolated luminance * sine.
INLINE Vec3 cell_radiance(const Envmap* map, const EnvmapCell* c, float* weight)
{
    const Vec3 upper = add3(scale3(c->texel00, 1.0f - c->s), scale3(c->texel10, c->s));
    const Vec3 lower = add3(scale3(c->texel01, 1.0f - c->s), scale3(c->texel11, c->s));
    *weight = (1.0f - c->t) * c->sine0 * luminance(upper) + c->t * c->sine1 * luminance(lower);
    return scale3(add3(scale3(upper, 1.0f - c->t), scale3(lower, c->t)), map->record->scale);
}

// Radiance from a unit direction, and the pdf with which `envmap_sample` samples it.
INLINE Vec3 envmap_radiance(const Envmap* map, Vec3 direction, float* pdf)
{
    __global const Environment* record = map->record;
    const Vec3 x_part = scale3(LOAD3(0, record->to_world), direction.x),
               y_part = scale3(LOAD3(1, record->to_world), direction.y);
    const Vec3 local_direction = add3(add3(x_part, y_part), scale3(LOAD3(2, record->to_world), direction.z));
    const float sine = SQRT(local_direction.x * local_direction.x + local_direction.z * local_direction.z);
    const int width = (int)record->size[0], cells = (int)record->size[1] - 1;
    const float x = atan2_float(local_direction.x, -local_direction.z) * (0.5f * M_1_PI_F) * (float)width - 0.5f;
    const float y = atan2_float(sine, local_direction.y) * M_1_PI_F * (float)cells;  // acos is imprecise near the poles
    const int whole = (int)x, left = (float)whole > x ? whole - 1 : whole;
    // unsigned: NaN becomes the last cell, not an index outside of the map
    const uint column = MIN((uint)(left < 0 ? left + width : left), (uint)width - 1u);
    const uint row = MIN((uint)(int)y, (uint)cells - 1u);
    EnvmapCell cell = envmap_cell(map, column, row);
    cell.s = x - (float)left;
    cell.t = MIN(y - (float)row, 1.0f);
    float weight;
    const Vec3 radiance = cell_radiance(map, &cell, &weight);
    *pdf = record->density * weight / MAX(sine, MIN_SINE);
    return radiance;
}

#if FEATURE_NEXT_EVENT
// A cell is sampled by inversion, first its row and then its column: neighbouring numbers lead to neighbouring cells. A
// CDF holds the probability below each of its cells, in units of 2^-32. It is searched by bisection between two cells
// that a guide table gives for equal parts of [0, 1): Chen and Asau, "On Generating Random Variates from an Empirical
// Distribution", AIIE Transactions 6, 1974.

// Whether a search is over. `range`: the cells that it still has to choose from, first | last << 16.
INLINE bool is_found(uint range)
{
    return (range & 0xFFFFu) == range >> 16;
}

// One bisection. The CDF of cell k is cdf[first + stride * k].
INLINE uint halve_range(__global const float* cdf, int first, int stride, uint range, uint u)
{
    const uint low = range & 0xFFFFu, high = range >> 16, middle = (low + high + 1u) >> 1;
    const bool above = as_uint(cdf[first + stride * (int)middle]) <= u;
    return above ? middle | high << 16 : low | (middle - 1u) << 16;
}

// Both numbers in units of 2^-32: 24 bits, and 8 bits more from a hash of the other number. Cells far less probable
// than 2^-24 are so sampled in proportion.
INLINE void extend_random_numbers(Vec2 u, uint* x, uint* y)
{
    const uint high_x = (uint)(u.x * 0x1p24f), high_y = (uint)(u.y * 0x1p24f);
    *x = high_x << 8 | high_y * 0x9E3779B1u >> 24;
    *y = high_y << 8 | high_x * 0x9E3779B1u >> 24;
}

// Entry of a guide table of `count` entries.
INLINE uint guide_entry(uint u, uint count)
{
    return (uint)(((ulong)u * count) >> 32);
}

INLINE int first_column_cdf(const Envmap* map, uint row)
{
    return 4 * (int)(row * map->record->size[0]) + 3;
}

INLINE uint row_range(const Envmap* map, uint u)
{
    return as_uint(map->rows[3 * (int)guide_entry(u, map->record->size[1] - 1u) + 1]);
}

INLINE uint column_range(const Envmap* map, uint row, uint u)
{
    const uint width = map->record->size[0];
    return map->guide[(int)(row * width + guide_entry(u, width))];
}

// A position along rows or columns: the cell, and the random number rescaled to it in units of 2^-16.
INLINE uint position_in_cell(uint cell, uint u, uint begin, uint end)
{
    const float rest = ((float)(u - begin) + 0.5f) / ((float)(end - begin - 1u) + 1.0f);  // `end` of the last one: 0
    return cell << 16 | MIN((uint)(rest * 0x1p16f), 0xFFFFu);
}

INLINE uint row_position(const Envmap* map, uint row, uint u)
{
    const uint next = row + 2u < map->record->size[1] ? as_uint(map->rows[3 * (int)row + 3]) : 0u;
    return position_in_cell(row, u, as_uint(map->rows[3 * (int)row]), next);
}

INLINE uint column_position(const Envmap* map, uint row, uint column, uint u)
{
    const uint width = map->record->size[0];
    const int cdf = first_column_cdf(map, row) + 4 * (int)column;
    return position_in_cell(column, u, as_uint(map->texels[cdf]),
                            column + 1u < width ? as_uint(map->texels[cdf + 4]) : 0u);
}

// The position that two random numbers select: `position_in_cell` along columns and rows.
INLINE Vec2 envmap_position(const Envmap* map, Vec2 u)
{
    uint x, y;
    extend_random_numbers(u, &x, &y);
    uint range = row_range(map, y);
    while (!is_found(range)) range = halve_range(map->rows, 0, 3, range, y);
    const uint row = range & 0xFFFFu;
    range = column_range(map, row, x);
    while (!is_found(range)) range = halve_range(map->texels, first_column_cdf(map, row), 4, range, x);
    return vec2(as_float(column_position(map, row, range & 0xFFFFu, x)), as_float(row_position(map, row, y)));
}

#if LANES > 1
// Number of bisections that end every search of these lanes.
INLINE uint count_bisections(const uint* range, uint count)
{
    uint widest = 0u, steps = 0u;
    FOR_LANES(k, count) {
        const uint width = (range[k] >> 16) - (range[k] & 0xFFFFu);
        widest = MAX(widest, width);
    }
    while (widest >> steps) ++steps;
    return steps;
}

// The same for `count` lanes together: positions replace the random numbers. A loop over lanes with searches inside
// would not be vectorised.
INLINE void envmap_positions(const Envmap* map, float* u_x, float* u_y, uint count)
{
    uint range[LANES], row[LANES], x[LANES], y[LANES];
    FOR_LANES(k, count) {
        extend_random_numbers(vec2(u_x[k], u_y[k]), x + k, y + k);
        range[k] = row_range(map, y[k]);
    }
    for (uint step = count_bisections(range, count); step > 0u; --step) {
        FOR_LANES(k, count) range[k] = halve_range(map->rows, 0, 3, range[k], y[k]);
    }
    FOR_LANES(k, count) {
        row[k] = range[k] & 0xFFFFu;
        u_y[k] = as_float(row_position(map, row[k], y[k]));
        range[k] = column_range(map, row[k], x[k]);
    }
    for (uint step = count_bisections(range, count); step > 0u; --step) {
        FOR_LANES(k, count) range[k] = halve_range(map->texels, first_column_cdf(map, row[k]), 4, range[k], x[k]);
    }
    FOR_LANES(k, count) u_x[k] = as_float(column_position(map, row[k], range[k] & 0xFFFFu, x[k]));
}
#endif

// Samples the linear density from a at 0 to b at 1 by inversion, in a form without cancellation. Weights whose square
// underflows are practically never selected.
INLINE float sample_linear(float u, float a, float b)
{
    const float x = u * (a + b) / MAX(a + SQRT((1.0f - u) * a * a + u * b * b), 1e-30f);
    return MIN(x, 1.0f);
}

// Samples the direction of a position. Returns the radiance from it; *pdf is in solid angle, 0 if the whole map is
// black.
INLINE Vec3 envmap_sample(const Envmap* map, Vec2 position, Vec3* direction, float* pdf)
{
    __global const Environment* record = map->record;
    const uint width = record->size[0], cells = record->size[1] - 1u;
    const uint column = as_uint(position.x) >> 16, row = as_uint(position.y) >> 16;
    const float along = 0x1p-16f * ((float)(as_uint(position.x) & 0xFFFFu) + 0.5f);
    const float down = 0x1p-16f * ((float)(as_uint(position.y) & 0xFFFFu) + 0.5f);
    EnvmapCell cell = envmap_cell(map, column, row);
    const float w00 = cell.sine0 * luminance(cell.texel00), w10 = cell.sine0 * luminance(cell.texel10);
    const float w01 = cell.sine1 * luminance(cell.texel01), w11 = cell.sine1 * luminance(cell.texel11);
    cell.t = sample_linear(down, w00 + w10, w01 + w11);
    cell.s = sample_linear(along, (1.0f - cell.t) * w00 + cell.t * w01, (1.0f - cell.t) * w10 + cell.t * w11);
    float weight;
    const Vec3 radiance = cell_radiance(map, &cell, &weight);

    // angles from the nearer pole: small ones are more precise
    const bool southern = 2u * row >= cells;
    const float steps = southern ? (float)(cells - row) - cell.t : (float)row + cell.t;
    const Vec2 polar = cos_sin_turns(0.5f * steps / (float)cells);
    const float turns = ((float)column + 0.5f + cell.s) / (float)width;
    const Vec2 azimuth = cos_sin_turns(turns < 1.0f ? turns : turns - 1.0f);
    const Vec3 local_direction = vec3(polar.y * azimuth.y, southern ? -polar.x : polar.x, -polar.y * azimuth.x);
    *direction =
        vec3(dot3(LOAD3(0, record->to_world), local_direction), dot3(LOAD3(1, record->to_world), local_direction),
             dot3(LOAD3(2, record->to_world), local_direction));
    *pdf = record->density * weight / MAX(polar.y, MIN_SINE);
    return radiance;
}
#endif
#endif
