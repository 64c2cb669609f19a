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

// The value of a grid at a point of the world: interpolated, or that of the nearest cell.
INLINE Vec3 grid_value(const HeterogeneousMedia* media, uint index, Vec3 point)
{
    __global const Grid* grid = media->grids + index;
    float m[12];
    load_matrix(grid->to_local, m);
    const Vec3 in_cube = transform_point(m, point);
    int x[2], y[2], z[2];
    const float u = grid_neighbours(grid->flags, in_cube.x, (int)grid->size[0], &x[0], &x[1]);
    const float v = grid_neighbours(grid->flags, in_cube.y, (int)grid->size[1], &y[0], &y[1]);
    const float w = grid_neighbours(grid->flags, in_cube.z, (int)grid->size[2], &z[0], &z[1]);
    if (grid->flags & TEXTURE_NEAREST) return grid_cell(media, grid, x[0], y[0], z[0]);
    Vec3 sum = splat3(0.0f);
    for (uint k = 0u; k < 8u; ++k) {
        const uint i = k & 1u, j = k >> 1u & 1u, l = k >> 2u;
        const float weight = (i ? u : 1.0f - u) * (j ? v : 1.0f - v) * (l ? w : 1.0f - w);
        sum = add3(sum, scale3(grid_cell(media, grid, x[i], y[j], z[l]), weight));
    }
    return sum;
}
#endif
