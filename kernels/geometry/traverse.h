// BVH traversal of one ray, as an iterator over leaves. Included by the stages intersect, shadow and
// shadow_transmittance, which intersect the leaf and decide when to stop. The stack has STACK_SIZE entries, enough for
// the scene's BVH: host/isonoise/device/form.py.
#pragma once
#include "geometry/bvh.h"
#include "path/path_state.h"

// Leaf numbers that mark the end of the traversal, and of the traversal of an instance.
#define NO_LEAF 0x7FFFFFFFu
#define END_OF_INSTANCE 0x7FFFFFFEu

typedef struct {
    Ray ray;     // in the space of the instance that is being traversed
    uint2 skip;  // primitives of that instance that the ray starts and ends on: not tested
    uint stack_size;
#if FEATURE_COUNT_TESTS
    uint nodes_tested;
#endif
#if FEATURE_INSTANCES
    float4 origin, direction;  // in world space
    uint start_instance;       // the instance that the ray starts in; NONE: the world
    uint start_primitive;      // the primitive of that instance that it starts on
    uint instance;             // the instance that is being traversed; NONE: the world
    __global const Instance* instances;
    uint first_instance;  // leaf number of the first instance
#endif
} Traversal;

// A stack entry: the bits of the entry distance in the upper half, the node reference in the lower half. Distances are
// not negative, so entries compare like distances.
INLINE ulong stack_entry(float distance, uint reference)
{
    return (ulong)as_uint(distance) << 32 | reference;
}

#if FEATURE_INSTANCES
INLINE void enter_world(Traversal* traversal)
{
    traversal->instance = NONE;
    traversal->skip.x = traversal->start_primitive;
    traversal->ray = make_ray(traversal->origin, traversal->direction);
}

INLINE void enter_instance(Traversal* traversal, uint instance)
{
    traversal->instance = instance;
    traversal->skip.x = skip_in_instance(traversal->start_primitive, traversal->start_instance, instance);
    traversal->ray = make_object_ray(traversal->instances + instance, traversal->origin, traversal->direction);
}
#endif

// Starts at the root. With instances the caller sets instances, first_instance and start_instance before.
INLINE void begin_traversal(Traversal* traversal, ulong* stack, Vec3 ray_origin, Vec3 ray_direction, uint2 skip)
{
    const float4 origin = to_float4(ray_origin), direction = to_float4(ray_direction);
    traversal->skip = skip;
#if FEATURE_INSTANCES
    traversal->origin = origin;
    traversal->direction = direction;
    traversal->start_primitive = skip.x;
    enter_world(traversal);
#else
    traversal->ray = make_ray(origin, direction);
#endif
#if FEATURE_COUNT_TESTS
    traversal->nodes_tested = 0u;
#endif
    stack[0] = stack_entry(0.0f, ~NO_LEAF);
    stack[1] = stack_entry(0.0f, 0u);
    traversal->stack_size = 2u;
}

// Prefetches a child that goes on the stack: a whole node, or most of a triangle block. Else it is not in the cache
// when it is popped.
INLINE void prefetch_child(__global const float8* nodes, __global const float8* triangle_blocks, int reference)
{
    const size_t address = reference < 0 ? (size_t)(triangle_blocks + ~reference) : (size_t)(nodes + reference);
    PREFETCH(address, 0);
    PREFETCH(address, 64);
    PREFETCH(address, 128);
    PREFETCH(address, 192);
}

// The next leaf whose box the ray enters before t_max; NO_LEAF if there is none. With `front_to_back` nearer boxes come
// first, and t_max may shrink from call to call.
INLINE uint next_leaf(Traversal* traversal, ulong* stack, __global const float8* nodes,
                      __global const float8* triangle_blocks, float t_max, bool front_to_back)
{
    uint stack_size = traversal->stack_size;
    for (;;) {
        const ulong top = stack[--stack_size];
        if (front_to_back && as_float((uint)(top >> 32)) >= t_max) continue;
        int reference = (int)(uint)top;
        while (reference >= 0) {
            __global const float8* node = nodes + reference;
            __global const uint* children = (__global const uint*)(node + 6);
            ChildDistances entry;
            uint hits = intersect_node(node, &traversal->ray, t_max, &entry);
#if FEATURE_COUNT_TESTS
            ++traversal->nodes_tested;
#endif
            if (!hits) break;
            uint child = lowest_set_bit(hits);
            hits &= hits - 1u;
            if (!front_to_back) {
                for (; hits; hits &= hits - 1u) stack[stack_size++] = stack_entry(0.0f, children[lowest_set_bit(hits)]);
                reference = (int)children[child];
                continue;
            }
            if (!hits) {
                reference = (int)children[child];
                continue;
            }
            // visit the nearest child next; insertion sort puts the others on the stack, the farthest at the bottom
            ulong nearest = stack_entry(entry.lane[child], children[child]);
            const uint base = stack_size;
            for (; hits; hits &= hits - 1u) {
                child = lowest_set_bit(hits);
                const ulong other = stack_entry(entry.lane[child], children[child]);
                const ulong farther = MAX(nearest, other);
                nearest = MIN(nearest, other);
                prefetch_child(nodes, triangle_blocks, (int)(uint)farther);
                uint slot = stack_size++;
                for (; slot > base && stack[slot - 1u] < farther; --slot) stack[slot] = stack[slot - 1u];
                stack[slot] = farther;
            }
            reference = (int)(uint)nearest;
        }
        if (reference >= 0) continue;
        const uint leaf = (uint)~reference;
#if FEATURE_INSTANCES
        if (leaf >= traversal->first_instance && leaf != NO_LEAF) {
            if (leaf == END_OF_INSTANCE) {
                enter_world(traversal);
            } else {
                enter_instance(traversal, leaf - traversal->first_instance);
                stack[stack_size++] = stack_entry(0.0f, ~END_OF_INSTANCE);
                stack[stack_size++] = stack_entry(0.0f, NODE_ROWS * traversal->instances[traversal->instance].root);
            }
            continue;
        }
#endif
        traversal->stack_size = stack_size;
        return leaf;
    }
}

#if FEATURE_ANALYTICS
// Distance to the analytic shape of a leaf; INFINITY if there is no hit before t_max.
INLINE float intersect_analytic_leaf(const Traversal* traversal, __global const Analytic* analytics, uint index,
                                     float t_max)
{
    const Vec3 origin = from_float4(traversal->ray.origin), direction = from_float4(traversal->ray.direction);
    return analytic_distance(analytics, index, origin, direction, traversal->skip.x, traversal->skip.y, t_max);
}
#endif
