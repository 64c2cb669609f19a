// Traversal of the 8-wide bounding volume hierarchy; its layout is told in host/isonoise/scene/bvh.py.
// Included by the stages that trace rays; they differ in what they do with a leaf and in when they stop.
#pragma once
#include "instance.h"
#include "vectors.h"

#define STACK_SIZE 256  // host/isonoise/scene/bvh.py never builds a tree that needs more
#define NODE_STRIDE 7
#define BLOCK_STRIDE 10
#define LANE_BITS (int8)(1, 2, 4, 8, 16, 32, 64, 128)

typedef struct {
    Vec3 origin, direction;
    Vec3 inverse;     // 1 / direction, finite: a zero component becomes +-10^37
    int3 near;          // which row of a node holds the near plane of each axis
    int3 axis;          // x, y, z permuted so that |direction| is largest along the last
    Vec3 shear;         // Woop's shear constants for the permuted axes
    Vec3 permuted;      // origin, permuted
} Ray;

INLINE float component(Vec3 v, int i)
{
    return i == 0 ? v.x : i == 1 ? v.y : v.z;
}

INLINE float inverse_of(float d)
{
    return 1.0f / (abs1(d) < 1e-37f ? with_sign(1e-37f, d) : d);
}

INLINE Ray make_ray(Vec3 origin, Vec3 direction)
{
    Ray ray;
    ray.origin = origin;
    ray.direction = direction;
    const Vec3 size = abs3(direction);
    ray.inverse = vec3(inverse_of(direction.x), inverse_of(direction.y), inverse_of(direction.z));
    ray.near = (int3)(ray.inverse.x < 0.0f ? 3 : 0, ray.inverse.y < 0.0f ? 4 : 1, ray.inverse.z < 0.0f ? 5 : 2);
    const int kz = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    const int next = kz == 2 ? 0 : kz + 1, after = 3 - kz - next;
    // exchanging the first two axes keeps the orientation of triangles for negative directions
    const bool flip = component(direction, kz) < 0.0f;
    ray.axis = (int3)(flip ? after : next, flip ? next : after, kz);
    const float scale = 1.0f / component(direction, kz);
    ray.shear = vec3(component(direction, ray.axis.x) * scale, component(direction, ray.axis.y) * scale, scale);
    ray.permuted = vec3(component(origin, ray.axis.x), component(origin, ray.axis.y), component(origin, kz));
    return ray;
}

#if FEATURE_INSTANCES
// The same for a ray of the world, in the space of an instance's group.
INLINE Ray make_object_ray(__global const Instance* instance, Vec3 origin, Vec3 direction)
{
    ray_to_object(instance, &origin, &direction);
    return make_ray(origin, direction);
}
#endif

INLINE uint mask_bits(int8 mask)
{
    const int8 lanes = mask & LANE_BITS;
    const int4 half_lanes = lanes.lo | lanes.hi;
    const int2 quarter = half_lanes.lo | half_lanes.hi;
    return (uint)(quarter.x | quarter.y);
}

// Which of the node's children the ray meets before t_max, as bits; `entry` gets the distances at which it enters them.
// The far planes are widened by 2 gamma(3), so that rounding never loses a child: Ize, "Robust BVH Ray Traversal", JCGT 2013.
INLINE uint children_met(__global const float8* node, const Ray* ray, float t_max, float8* entry)
{
    const int3 near = ray->near, far = (int3)(3, 5, 7) - near;
    const float8 near_x = (node[near.x] - ray->origin.x) * ray->inverse.x;
    const float8 near_y = (node[near.y] - ray->origin.y) * ray->inverse.y;
    const float8 near_z = (node[near.z] - ray->origin.z) * ray->inverse.z;
    const float8 far_x = (node[far.x] - ray->origin.x) * ray->inverse.x;
    const float8 far_y = (node[far.y] - ray->origin.y) * ray->inverse.y;
    const float8 far_z = (node[far.z] - ray->origin.z) * ray->inverse.z;
    const float8 near_yz = GREATER(near_y, near_z), near_x0 = GREATER(near_x, (float8)(0.0f));
    const float8 far_yz = LESSER(far_y, far_z), far_xt = LESSER(far_x, (float8)(t_max));
    *entry = GREATER(near_yz, near_x0);
    const float8 leave = LESSER(far_yz, far_xt) * 1.0000008f;
    return mask_bits(*entry <= leave);
}

#if FEATURE_TRIANGLES
// The ray against the 8 triangles of a block: bits of those met in (0, t_max), their distances and barycentric coordinates
// (of the second and third corner). Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2013, without the
// double precision fall-back: an edge function that rounds to zero counts as inside for both neighbours, so nothing leaks.
// The edge functions are written without fma: then neighbours get exactly opposite values on a shared edge.
// A plane cannot be met again by a ray that starts or ends on it, but rounding can say so: the two primitives in `skip` are left
// out, which needs no epsilon.
INLINE uint triangles_met(__global const float8* block, const Ray* ray, uint2 skip, float t_max, float8* t, float8* u, float8* v)
{
    const int3 k = ray->axis;
    const Vec3 o = ray->permuted, s = ray->shear;
    const float8 az = block[k.z] - o.z, bz = block[3 + k.z] - o.z, cz = block[6 + k.z] - o.z;
    const float8 ax = (block[k.x] - o.x) - s.x * az, ay = (block[k.y] - o.y) - s.y * az;
    const float8 bx = (block[3 + k.x] - o.x) - s.x * bz, by = (block[3 + k.y] - o.y) - s.y * bz;
    const float8 cx = (block[6 + k.x] - o.x) - s.x * cz, cy = (block[6 + k.y] - o.y) - s.y * cz;
    const float8 edge_a = cx * by - cy * bx, edge_b = ax * cy - ay * cx, edge_c = bx * ay - by * ax;
    const float8 lowest = LESSER(LESSER(edge_a, edge_b), edge_c), highest = GREATER(GREATER(edge_a, edge_b), edge_c);
    const float8 determinant = edge_a + edge_b + edge_c;
    const int8 inside = ((lowest >= 0.0f) | (highest <= 0.0f)) & (determinant != 0.0f);
    const float8 inverse = 1.0f / determinant;
    *t = (edge_a * az + edge_b * bz + edge_c * cz) * s.z * inverse;
    *u = edge_b * inverse;
    *v = edge_c * inverse;
    const uint8 ids = as_uint8(block[9]);
    return mask_bits(inside & (*t > 0.0f) & (*t < t_max) & (ids != skip.x) & (ids != skip.y));
}
#endif
