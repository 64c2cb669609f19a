// Values on a grid in space, of heterogeneous media. Conventions are Mitsuba 3's: values are at the centres of the
// cells of the unit cube. The tables are made by host/isonoise/scene/volume/heterogeneous.py.
#pragma once
#include "texture/wrap.h"
#include "util/math.h"

#if FEATURE_HETEROGENEOUS
typedef struct {
    __global const HeterogeneousMedium* media;  // one for each of all media
    __global const Grid* grids;
    __global const float* values;
    __global const float* bounds;  // minimum and maximum of the extinction coefficient in each cell
} HeterogeneousMedia;

// The value of a cell: RGB, or a number in all three channels.
INLINE Vec3 grid_cell(const HeterogeneousMedia* media, __global const Grid* grid, int x, int y, int z)
{
    const size_t cell = ((size_t)z * grid->size[1] + (size_t)y) * grid->size[0] + (size_t)x;
    __global const float* value = media->values + grid->first + cell * grid->channels;
    return grid->channels == 1u ? splat3(value[0]) : vec3(value[0], value[1], value[2]);
}

// Where a coordinate falls among the values of an axis: their indices, and the weight of the second one.
INLINE float grid_neighbours(uint flags, float x, int size, int* first, int* second)
{
    const float position = wrap_coordinate(flags, x, (float)size) - (flags & TEXTURE_NEAREST ? 0.0f : 0.5f);
    const float lower = floor_float(position);
    *first = wrap_texel(flags, (int)lower, size);
    *second = wrap_texel(flags, (int)lower + 1, size);
    return flags & TEXTURE_NEAREST ? 0.0f : position - lower;
}

// The value of a grid at a point of the world, and 0: interpolated, or that of the nearest cell. Not inlined, and its
// loop is not unrolled: callers on GPUs would need more registers. Returns a Vec4 for the reason that texture/texture.h
// states.
NOINLINE Vec4 grid_value_vec4(const HeterogeneousMedia* media, uint index, Vec3 point)
{
    __global const Grid* grid = media->grids + index;
    float m[12];
    load_matrix(grid->to_local, m);
    const Vec3 in_cube = transform_point(m, point);
    int x0, x1, y0, y1, z0, z1;
    const float u = grid_neighbours(grid->flags, in_cube.x, (int)grid->size[0], &x0, &x1);
    const float v = grid_neighbours(grid->flags, in_cube.y, (int)grid->size[1], &y0, &y1);
    const float w = grid_neighbours(grid->flags, in_cube.z, (int)grid->size[2], &z0, &z1);
    if (grid->flags & TEXTURE_NEAREST) return vec4_from(grid_cell(media, grid, x0, y0, z0), 0.0f);
    Vec3 sum = splat3(0.0f);
    NO_UNROLL
    for (uint k = 0u; k < 4u; ++k) {
        const int y = k & 1u ? y1 : y0, z = k & 2u ? z1 : z0;
        const float weight = (k & 1u ? v : 1.0f - v) * (k & 2u ? w : 1.0f - w);
        sum = add3(sum, scale3(grid_cell(media, grid, x0, y, z), weight * (1.0f - u)));
        sum = add3(sum, scale3(grid_cell(media, grid, x1, y, z), weight * u));
    }
    return vec4_from(sum, 0.0f);
}

INLINE Vec3 grid_value(const HeterogeneousMedia* media, uint index, Vec3 point)
{
    return xyz(grid_value_vec4(media, index, point));
}
#endif
