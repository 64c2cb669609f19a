// Stage: the closest surface along the ray of every path.
// Reads ray_origin, ray_direction, path (the primitive that the ray starts on); writes hit = (t, u, v, primitive bits).
// With instances: reads in which one the ray starts, writes in which one it ends; NONE is the world.
#include "bvh.h"
#include "paths.h"

__kernel void intersect(uint paths, uint pool, __global const float8* nodes, __global const float8* blocks, uint block_count,
                        __global const Analytic* analytics, __global const float* ray_origin,
                        __global const float* ray_direction, __global const uint* path, __global float* hit
#if FEATURE_INSTANCES
                        , __global const Instance* instances, uint first_instance, __global uint* instance
#endif
                        )
{
    const uint i = get_global_id(0);
    if (i >= paths) return;
    const Vec4 start_of_ray = load_planes4(ray_origin, i, pool);
    const Vec3 origin = xyz(start_of_ray), direction = load_planes3(ray_direction, i, pool);
    Ray ray = make_ray(origin, direction);

    uint2 skip = (uint2)(PLANE(PATH_START, path, pool)[i], NONE);
#if FEATURE_INSTANCES
    const uint start = instance[i];
    uint inside = NONE, hit_instance = NONE, bottom = 0;  // bottom: the part of the stack that is of the world
#endif

    float t_max = start_of_ray.w, hit_u = 0.0f, hit_v = 0.0f;
    uint primitive = NONE;
    int stack[STACK_SIZE];
    float stack_entry[STACK_SIZE];
    uint height = 0;
    int reference = 0;
    for (;;) {
        if (reference >= 0) {
            __global const float8* node = nodes + NODE_STRIDE * reference;
            __global const int* children = (__global const int*)(node + 6);
            Lanes entry;
            uint met = children_met(node, &ray, t_max, &entry.all);
            // nearest on top: insertion into the part of the stack that this node adds
            const uint base = height;
            for (; met; met &= met - 1u) {
                const uint child = lowest_bit(met);
                uint place = height++;
                for (; place > base && stack_entry[place - 1] < entry.lane[child]; --place) {
                    stack[place] = stack[place - 1];
                    stack_entry[place] = stack_entry[place - 1];
                }
                stack[place] = children[child];
                stack_entry[place] = entry.lane[child];
            }
        } else {
            const uint leaf = (uint)(~reference);
#if FEATURE_INSTANCES
            if (leaf >= first_instance) {
                inside = leaf - first_instance;
                bottom = height;
                skip.x = skip_inside(PLANE(PATH_START, path, pool)[i], start, inside);
                ray = make_object_ray(instances + inside, origin, direction);
                reference = (int)instances[inside].root;
                continue;
            }
#endif
#if FEATURE_TRIANGLES
            if (leaf < block_count) {
                __global const float8* block = blocks + BLOCK_STRIDE * leaf;
                Lanes t, u, v;
                for (uint met = triangles_met(block, &ray, skip, t_max, &t.all, &u.all, &v.all); met; met &= met - 1u) {
                    const uint lane = lowest_bit(met);
                    if (t.lane[lane] < t_max) {
                        t_max = t.lane[lane];
                        hit_u = u.lane[lane];
                        hit_v = v.lane[lane];
                        primitive = ((__global const uint*)(block + 9))[lane];
#if FEATURE_INSTANCES
                        hit_instance = inside;
#endif
                    }
                }
            }
#endif
#if FEATURE_ANALYTICS
            if (leaf >= block_count) {
                const float t = analytic_distance(analytics, leaf - block_count, ray.origin, ray.direction, skip.x, skip.y, t_max);
                if (t < t_max) {
                    t_max = t;
                    primitive = ANALYTIC_BIT | (leaf - block_count);
#if FEATURE_INSTANCES
                    hit_instance = inside;
#endif
                }
            }
#endif
        }
        do {
#if FEATURE_INSTANCES
            if (inside != NONE && height == bottom) {
                inside = NONE;
                ray = make_ray(origin, direction);
            }
#endif
            if (height == 0) {
                store_planes4(vec4(t_max, hit_u, hit_v, as_float(primitive)), hit, i, pool);
#if FEATURE_INSTANCES
                instance[i] = hit_instance;
#endif
                return;
            }
            --height;
        } while (stack_entry[height] >= t_max);
        reference = stack[height];
    }
}
