// Environment map: radiance from a direction, and sampling of directions nearly in proportion to radiance. Called by
// light/environment_light.h. The image and its alias tables are made by host/isonoise/scene/light/envmap.py.
#pragma once
#include "util/math.h"

#if FEATURE_ENVIRONMENT_MAP
typedef struct {
    __global const Environment* record;
    __global const float* texels;  // 4 floats a texel: RGB, alias threshold of the cell that begins there
    __global const float* rows;    // 3 floats a row: alias threshold, alias (bits), sine
    __global const uint* aliases;  // alias of every cell
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
// A uniformly selected entry of an alias table, and the rest of the random number, in [0, 1).
typedef struct {
    uint entry;
    float rest;
} AliasEntry;

// `u` is a multiple of 2^-24. The rest is centred within its step, so that entries are selected without bias.
INLINE AliasEntry sample_alias_entry(float u, uint count)
{
    const ulong scaled = (ulong)(uint)(u * 0x1p24f) * count;
    const float rest = 0x1p-24f * ((float)(uint)(scaled & 0xFFFFFFu) + 0.5f * (float)count);
    const AliasEntry pick = {(uint)(scaled >> 24), MIN(rest, 0x1.fffffep-1f)};
    return pick;
}

// The entry or its alias. *rest gets the random number rescaled to [0, 1).
INLINE uint resolve_alias(AliasEntry pick, float threshold, uint alias, float* rest)
{
    const bool keeps_entry = pick.rest < threshold;
    *rest = (keeps_entry ? pick.rest : pick.rest - threshold) / (keeps_entry ? threshold : 1.0f - threshold);
    return keeps_entry ? pick.entry : alias;
}

// Samples the linear density from a at 0 to b at 1 by inversion, in a form without cancellation. Weights whose square
// underflows are practically never selected.
INLINE float sample_linear(float u, float a, float b)
{
    const float x = u * (a + b) / MAX(a + SQRT((1.0f - u) * a * a + u * b * b), 1e-30f);
    return MIN(x, 1.0f);
}

// Samples a direction. Returns the radiance from it; *pdf is in solid angle, 0 if the whole map is black.
INLINE Vec3 envmap_sample(const Envmap* map, Vec2 u, Vec3* direction, float* pdf)
{
    __global const Environment* record = map->record;
    const uint width = record->size[0], cells = record->size[1] - 1u;
    float down, along;
    const AliasEntry row_pick = sample_alias_entry(u.y, cells), column_pick = sample_alias_entry(u.x, width);
    const int in_rows = 3 * (int)row_pick.entry;
    const uint row = resolve_alias(row_pick, map->rows[in_rows], as_uint(map->rows[in_rows + 1]), &down);
    const int in_cells = (int)(row * width + column_pick.entry);
    const uint column = resolve_alias(column_pick, map->texels[4 * in_cells + 3], map->aliases[in_cells], &along);
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
