// Heterogeneous media: free flights and transmittance by null collisions. Called by `shade` and `shadow_transmittance`.
// A ray crosses a coarse grid of cells that bound the extinction coefficient; in each, tentative collisions are sampled
// with the maximum as their density, and accepted in proportion to the coefficient at their place. Woodcock et al.,
// "Techniques Used in the GEM Code", 1965.
#pragma once
#include "media/medium.h"
#include "util/random.h"

#if FEATURE_HETEROGENEOUS
// A ray in units of the cells of extinction bounds, and the cell that it is in. Amanatides and Woo, "A Fast Voxel
// Traversal Algorithm for Ray Tracing", 1987.
typedef struct {
    Vec3 start;      // world position where t is 0
    Vec3 direction;  // unit vector
    Vec3 cell_origin, cell_direction;
    int x, y, z;  // the cell
    float t, end;
} CellWalk;

// Clips the part of a ray from *begin to *end to an interval of an axis.
INLINE void clip_to_axis(float lower, float upper, float origin, float direction, float* begin, float* end)
{
    if (abs_float(direction) < 1e-30f) {
        if (origin < lower || origin > upper) *end = -1.0f;
        return;
    }
    const float inverse = 1.0f / direction;
    const float t_lower = (lower - origin) * inverse, t_upper = (upper - origin) * inverse;
    *begin = MAX(*begin, MIN(t_lower, t_upper));
    *end = MIN(*end, MAX(t_lower, t_upper));
}

INLINE int first_cell(float position, uint count)
{
    return MIN((int)MAX(position, 0.0f), (int)count - 1);
}

// Begins at `*begin`, or where the ray enters the medium's box; `*begin` is set to that. Returns whether any of the ray
// is in the box.
INLINE bool begin_cell_walk(CellWalk* walk, __global const HeterogeneousMedium* medium, Vec3 origin, Vec3 direction,
                            float* begin, float end)
{
    if (!(*begin < end)) return false;  // a ray of no length has no direction
    clip_to_axis(medium->lower[0], medium->upper[0], origin.x, direction.x, begin, &end);
    clip_to_axis(medium->lower[1], medium->upper[1], origin.y, direction.y, begin, &end);
    clip_to_axis(medium->lower[2], medium->upper[2], origin.z, direction.z, begin, &end);
    if (!(*begin < end)) return false;
    float m[12];
    load_matrix(medium->to_cells, m);
    walk->start = add3(origin, scale3(direction, *begin));
    walk->direction = direction;
    walk->cell_origin = transform_point(m, walk->start);
    walk->cell_direction = transform_direction(m, direction);
    walk->x = first_cell(walk->cell_origin.x, medium->cells[0]);
    walk->y = first_cell(walk->cell_origin.y, medium->cells[1]);
    walk->z = first_cell(walk->cell_origin.z, medium->cells[2]);
    walk->t = 0.0f;
    walk->end = end - *begin;
    return true;
}

// Where the ray leaves the cell along one axis.
INLINE float axis_exit(int cell, float origin, float direction)
{
    if (abs_float(direction) < 1e-30f) return INFINITY;
    return ((float)(direction > 0.0f ? cell + 1 : cell) - origin) / direction;
}

INLINE Vec3 cell_exits(const CellWalk* walk)
{
    return vec3(axis_exit(walk->x, walk->cell_origin.x, walk->cell_direction.x),
                axis_exit(walk->y, walk->cell_origin.y, walk->cell_direction.y),
                axis_exit(walk->z, walk->cell_origin.z, walk->cell_direction.z));
}

// The distance at which the ray leaves the cell or the box; never before walk->t.
INLINE float cell_end(const CellWalk* walk, Vec3 exits)
{
    return MAX(MIN(MIN(MIN(exits.x, exits.y), exits.z), walk->end), walk->t);
}

// Moves to the next cell at distance `t`. Returns whether there is one.
INLINE bool next_cell(CellWalk* walk, __global const HeterogeneousMedium* medium, Vec3 exits, float t)
{
    walk->t = t;
    if (t >= walk->end) return false;
    if (exits.x <= exits.y && exits.x <= exits.z) {
        walk->x += walk->cell_direction.x > 0.0f ? 1 : -1;
        return (uint)walk->x < medium->cells[0];
    }
    if (exits.y <= exits.z) {
        walk->y += walk->cell_direction.y > 0.0f ? 1 : -1;
        return (uint)walk->y < medium->cells[1];
    }
    walk->z += walk->cell_direction.z > 0.0f ? 1 : -1;
    return (uint)walk->z < medium->cells[2];
}

// Minimum and maximum of the extinction coefficient in the cell.
INLINE Vec2 cell_extinction(const HeterogeneousMedia* media, __global const HeterogeneousMedium* medium,
                            const CellWalk* walk)
{
    const uint row = (uint)walk->z * medium->cells[1] + (uint)walk->y;
    const size_t cell = medium->first_cell + row * medium->cells[0] + (uint)walk->x;
    return vec2(media->bounds[2u * cell], media->bounds[2u * cell + 1u]);
}

// The extinction coefficient at walk->t, within the bounds of the cell, which rounding may violate.
INLINE Vec3 extinction_at(const HeterogeneousMedia* media, Vec3 scale, uint grid, const CellWalk* walk, Vec2 bounds)
{
    const Vec3 point = add3(walk->start, scale3(walk->direction, walk->t));
    const Vec3 sigma = mul3(scale, grid_value(media, grid, point));
    return vec3(MIN(MAX(sigma.x, bounds.x), bounds.y), MIN(MAX(sigma.y, bounds.x), bounds.y),
                MIN(MAX(sigma.z, bounds.x), bounds.y));
}

// An exponentially distributed optical depth. `u`, `u_low`: 48 bits, so that thin media keep their probabilities.
INLINE float sample_optical_depth(float u, float u_low)
{
    const float low = 0x1p-24f * u_low;
    return u < 0.5f ? -log1p(-(u + low)) : -log((1.0f - u) - low);
}

// Free-flight sampling: `sample_medium` for a heterogeneous medium. A tentative collision is accepted with a
// probability that is the mean of the channels' ones, weighted by the throughput. The weight is divided by it, so that
// the sum of the channels does not grow. Kutz et al., "Spectral and Decomposition Tracking for Rendering Heterogeneous
// Volumes", 2017, section 5 (history-aware). `u`: acceptance, distance, distance (low bits), acceptance (low bits), of
// the first collision; those of others come from `stream`.
NOINLINE bool sample_heterogeneous_medium(const HeterogeneousMedia* media, __global const Medium* uniform_media,
                                          uint index, Vec3 origin, Vec3 direction, Vec4 u, RandomStream* stream,
                                          float* distance, Vec3* weight)
{
    __global const HeterogeneousMedium* medium = media->media + index;
    const Vec3 scale = LOAD3(0, uniform_media[index].sigma_t);
    float begin = 0.0f;
    CellWalk walk;
    if (!begin_cell_walk(&walk, medium, origin, direction, &begin, *distance)) return false;
    float optical_depth = sample_optical_depth(u.y, u.z);
    for (;;) {
        const Vec2 bounds = cell_extinction(media, medium, &walk);
        const Vec3 exits = cell_exits(&walk);
        const float end = cell_end(&walk, exits), cell_depth = bounds.y * (end - walk.t);
        if (!(optical_depth < cell_depth)) {
            optical_depth -= cell_depth;
            if (!next_cell(&walk, medium, exits, end)) return false;
            continue;
        }
        walk.t = MIN(walk.t + optical_depth / bounds.y, end);
        const Vec3 share = div3(extinction_at(media, scale, medium->sigma_t, &walk, bounds), splat3(bounds.y));
        const float probability = dot3(*weight, share) / (weight->x + weight->y + weight->z);
        if (probability >= 1.0f || u.x + 0x1p-24f * u.w < probability) {
            *distance = begin + walk.t;
            *weight = mul3(*weight, div3(mul3(LOAD3(0, uniform_media[index].albedo), share), splat3(probability)));
            if (medium->albedo != NONE) {
                const Vec3 point = add3(walk.start, scale3(direction, walk.t));
                *weight = mul3(*weight, grid_value(media, medium->albedo, point));
            }
            return true;
        }
        *weight = mul3(*weight, div3(sub3(splat3(1.0f), share), splat3(1.0f - probability)));
        u = next_random(stream);
        optical_depth = sample_optical_depth(u.y, u.z);
    }
}

#if FEATURE_NEXT_EVENT
// Estimates the transmittance of a part of a ray: exactly for the minimum of each cell, by ratio tracking for what is
// above it. Novak et al., "Residual Ratio Tracking for Estimating Attenuation in Participating Media", 2014. Below 5 %,
// Russian roulette ends the estimate.
NOINLINE Vec4 heterogeneous_transmittance(const HeterogeneousMedia* media, __global const Medium* uniform_media,
                                          uint index, Vec3 origin, Vec3 direction, float begin, float end,
                                          RandomStream* stream)
{
    __global const HeterogeneousMedium* medium = media->media + index;
    const Vec3 scale = LOAD3(0, uniform_media[index].sigma_t);
    CellWalk walk;
    Vec3 transmittance = splat3(1.0f);
    if (!begin_cell_walk(&walk, medium, origin, direction, &begin, end)) return vec4_from(transmittance, 0.0f);
    float minimal_depth = 0.0f;  // optical depth of the minima
    Vec4 u = next_random(stream);
    float optical_depth = sample_optical_depth(u.y, u.z);
    for (;;) {
        const Vec2 bounds = cell_extinction(media, medium, &walk);
        const Vec3 exits = cell_exits(&walk);
        const float cell_t = cell_end(&walk, exits), range = bounds.y - bounds.x;
        const float cell_depth = range * (cell_t - walk.t);
        if (!(optical_depth < cell_depth)) {
            optical_depth -= cell_depth;
            minimal_depth += bounds.x * (cell_t - walk.t);
            if (!next_cell(&walk, medium, exits, cell_t)) break;
            continue;
        }
        const float t = MIN(walk.t + optical_depth / range, cell_t);
        minimal_depth += bounds.x * (t - walk.t);
        walk.t = t;
        const Vec3 above = sub3(extinction_at(media, scale, medium->sigma_t, &walk, bounds), splat3(bounds.x));
        transmittance = mul3(transmittance, sub3(splat3(1.0f), div3(above, splat3(range))));
        if (max_component3(transmittance) < 0.05f) {
            if (u.x < 0.75f) return vec4_from(splat3(0.0f), 0.0f);
            transmittance = scale3(transmittance, 4.0f);
        }
        u = next_random(stream);
        optical_depth = sample_optical_depth(u.y, u.z);
    }
    return vec4_from(scale3(transmittance, exp(-minimal_depth)), 0.0f);
}
#endif
#endif
