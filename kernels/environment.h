// Environment map: the radiance from a direction, and directions sampled nearly in proportion to it. What the map and its table
// are: host/isonoise/scene/environment.py.
#pragma once
#include "vectors.h"

#if FEATURE_ENVIRONMENT_MAP
typedef struct {
    __global const Environment* record;
    __global const float* texels;         // four numbers each: RGB, and as bits the bound of the cell that begins there
    __global const EnvironmentRow* rows;  // of texels
    __global const uint* columns;         // guides to the bounds: of the rows, then of the columns of each row
} EnvironmentMap;

#define LEAST_SINE 1e-20f  // at a pole the density is infinite and what it weighs nothing: both stay numbers

// Four texels, the weights of their rows, and a place between them.
typedef struct {
    Vec3 texel00, texel10, texel01, texel11;  // texel `column row`
    float sine0, sine1;
    float s, t;  // in [0, 1], along columns and rows
} EnvironmentCell;

INLINE Vec3 load_texel(__global const float* row, uint column)
{
    return vec3(row[4u * column], row[4u * column + 1u], row[4u * column + 2u]);
}

INLINE EnvironmentCell environment_cell(const EnvironmentMap* map, uint column, uint row)
{
    const uint width = map->record->size[0], next = column + 1u == width ? 0u : column + 1u;
    __global const float* upper = map->texels + 4u * row * width;
    __global const float* lower = upper + 4u * width;
    EnvironmentCell cell;
    cell.texel00 = load_texel(upper, column);
    cell.texel10 = load_texel(upper, next);
    cell.texel01 = load_texel(lower, column);
    cell.texel11 = load_texel(lower, next);
    cell.sine0 = map->rows[row].sine;
    cell.sine1 = map->rows[row + 1u].sine;
    return cell;
}

// The radiance at the cell's place; *weight gets the interpolated luminance * sine there.
INLINE Vec3 cell_radiance(const EnvironmentMap* map, const EnvironmentCell* c, float* weight)
{
    const Vec3 upper = add3(scale3(c->texel00, 1.0f - c->s), scale3(c->texel10, c->s));
    const Vec3 lower = add3(scale3(c->texel01, 1.0f - c->s), scale3(c->texel11, c->s));
    *weight = (1.0f - c->t) * c->sine0 * luminance(upper) + c->t * c->sine1 * luminance(lower);
    return scale3(add3(scale3(upper, 1.0f - c->t), scale3(lower, c->t)), map->record->scale);
}

// Radiance from a unit direction, and the density with which `environment_sample` finds it.
INLINE Vec3 environment_radiance(const EnvironmentMap* map, Vec3 direction, float* pdf)
{
    __global const Environment* record = map->record;
    const Vec3 x_part = scale3(LOAD3(0, record->to_world), direction.x), y_part = scale3(LOAD3(1, record->to_world), direction.y);
    const Vec3 turned = add3(add3(x_part, y_part), scale3(LOAD3(2, record->to_world), direction.z));
    const float sine = SQRT(turned.x * turned.x + turned.z * turned.z);
    const int width = (int)record->size[0], cells = (int)record->size[1] - 1;
    const float x = angle_of(turned.x, -turned.z) * (0.5f * M_1_PI_F) * (float)width - 0.5f;
    const float y = angle_of(sine, turned.y) * M_1_PI_F * (float)cells;  // near the poles acos would be coarse
    const int whole = (int)x, left = (float)whole > x ? whole - 1 : whole;
    // unsigned: what is no number ends in the last cell, not beside the map
    const uint column = LESSER((uint)(left < 0 ? left + width : left), (uint)width - 1u);
    const uint row = LESSER((uint)(int)y, (uint)cells - 1u);
    EnvironmentCell cell = environment_cell(map, column, row);
    cell.s = x - (float)left;
    cell.t = LESSER(y - (float)row, 1.0f);
    float weight;
    const Vec3 radiance = cell_radiance(map, &cell, &weight);
    *pdf = record->density * weight / GREATER(sine, LEAST_SINE);
    return radiance;
}

#if FEATURE_NEXT_EVENT
// The last of some ascending bounds, `stride` words apart, that is not above `key`; the first is 0. A guide says where it lies
// for the first bits of the key, so that few are left to be compared (Chen and Asau, "On Generating Random Variates from an
// Empirical Distribution", AIIE Transactions 6, 1974).
INLINE uint last_bound(__global const uint* bounds, uint stride, __global const uint* guide, uint shift, uint key)
{
    guide += key >> shift;
    uint found = guide[0], count = guide[1] - found + 1u;
    // as often as the longest search needs: loops over paths become vector instructions only without loops of their own
#pragma unroll
    for (uint step = 0; step < SEARCH_STEPS; ++step) {
        const uint half_way = count >> 1;
        found += bounds[stride * (found + half_way)] <= key ? half_way : 0u;
        count -= half_way;
    }
    return found;
}

// Place of `key` between two bounds.
INLINE float place_between(uint low, uint high, uint key)
{
    return (float)(key - low) / (float)(high - low);
}

// Inverts the distribution of a density that goes from a at 0 to b at 1 in a straight line; written so that nothing cancels.
// What is so small that its square vanishes is as good as never picked.
INLINE float sample_linear(float u, float a, float b)
{
    const float x = u * (a + b) / GREATER(a + SQRT((1.0f - u) * a * a + u * b * b), 1e-30f);
    return LESSER(x, 1.0f);
}

// A direction, the radiance from there, and the density in solid angle with which it was found; 0 if all is dark.
INLINE Vec3 environment_sample(const EnvironmentMap* map, Vec2 u, Vec3* direction, float* pdf)
{
    __global const Environment* record = map->record;
    const uint width = record->size[0], cells = record->size[1] - 1u;
    // a row of cells, a cell of it; the rest of each number serves within
    const uint row_key = (uint)(u.y * 0x1p24f) << 8, column_key = (uint)(u.x * 0x1p24f) << 8;
    __global const uint* row_bounds = (__global const uint*)map->rows;
    const uint row = last_bound(row_bounds, 2u, map->columns, record->row_shift, row_key);
    const uint row_end = row + 1u == cells ? 0xFFFFFFFFu : row_bounds[2u * row + 2u];
    __global const uint* bounds = (__global const uint*)map->texels + 4u * row * width + 3u;
    __global const uint* guide = map->columns + record->row_guide + row * record->column_guide;
    const uint column = last_bound(bounds, 4u, guide, record->column_shift, column_key);
    const uint column_end = column + 1u == width ? 0xFFFFFFFFu : bounds[4u * column + 4u];
    EnvironmentCell cell = environment_cell(map, column, row);
    const float w00 = cell.sine0 * luminance(cell.texel00), w10 = cell.sine0 * luminance(cell.texel10);
    const float w01 = cell.sine1 * luminance(cell.texel01), w11 = cell.sine1 * luminance(cell.texel11);
    cell.t = sample_linear(place_between(row_bounds[2u * row], row_end, row_key), w00 + w10, w01 + w11);
    cell.s = sample_linear(place_between(bounds[4u * column], column_end, column_key), (1.0f - cell.t) * w00 + cell.t * w01,
                           (1.0f - cell.t) * w10 + cell.t * w11);
    float weight;
    const Vec3 radiance = cell_radiance(map, &cell, &weight);

    // angles are counted from the nearer pole, where a small one is more precise
    const bool southern = 2u * row >= cells;
    const float steps = southern ? (float)(cells - row) - cell.t : (float)row + cell.t;
    const Vec2 polar = circle(0.5f * steps / (float)cells);
    const float turns = ((float)column + 0.5f + cell.s) / (float)width;
    const Vec2 around = circle(turns < 1.0f ? turns : turns - 1.0f);
    const Vec3 turned = vec3(polar.y * around.y, southern ? -polar.x : polar.x, -polar.y * around.x);
    *direction = vec3(dot3(LOAD3(0, record->to_world), turned), dot3(LOAD3(1, record->to_world), turned),
                      dot3(LOAD3(2, record->to_world), turned));
    *pdf = record->density * weight / GREATER(polar.y, LEAST_SINE);
    return radiance;
}
#endif
#endif
