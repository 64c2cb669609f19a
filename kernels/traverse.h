// The walk of a ray through the hierarchy, from leaf to leaf. The stages that trace rays include it; they differ in what they do
// with a leaf and in when they stop.
#pragma once
#include "bvh.h"
#include "paths.h"

// host/isonoise/scene/bvh.py never builds a tree that needs more than 256; two entries more mark an end.
#define STACK_SIZE 258
// Not the number of any leaf: the walk is at its end; and, within it, the walk through an instance is.
#define NO_LEAF 0x7FFFFFFFu
#define END_OF_INSTANCE 0x7FFFFFFEu

typedef struct {
    Ray ray;     // in the space of the instance that it is in
    uint2 skip;  // primitives, numbered as there, that it does not meet
    uint height;
#if FEATURE_COUNT_TESTS
    uint nodes;  // so far
#endif
#if FEATURE_INSTANCES
    float4 origin, direction;  // in the world
    uint start;                // the instance that it starts in
    uint start_primitive;
    uint inside;               // the instance that it is in, NONE: the world
    __global const Instance* instances;
    uint first_instance;       // number of the leaf that is the first instance
#endif
} Walk;

// An entry of the stack: the distance at which the ray enters what is there, as bits, above the reference. Distances are not
// negative, so that entries stand in their order.
INLINE ulong stack_entry(float distance, uint reference)
{
    return (ulong)as_uint(distance) << 32 | reference;
}

#if FEATURE_INSTANCES
INLINE void enter_world(Walk* walk)
{
    walk->inside = NONE;
    walk->skip.x = walk->start_primitive;
    walk->ray = make_ray(walk->origin, walk->direction);
}

INLINE void enter_instance(Walk* walk, uint inside)
{
    walk->inside = inside;
    walk->skip.x = skip_inside(walk->start_primitive, walk->start, inside);
    walk->ray = make_object_ray(walk->instances + inside, walk->origin, walk->direction);
}
#endif

// To the root. With instances the members about them that say where the ray starts are set before.
INLINE void begin_walk(Walk* walk, ulong* stack, Vec3 from, Vec3 towards, uint2 skip)
{
    const float4 origin = packed(from), direction = packed(towards);
    walk->skip = skip;
#if FEATURE_INSTANCES
    walk->origin = origin;
    walk->direction = direction;
    walk->start_primitive = skip.x;
    enter_world(walk);
#else
    walk->ray = make_ray(origin, direction);
#endif
#if FEATURE_COUNT_TESTS
    walk->nodes = 0u;
#endif
    stack[0] = stack_entry(0.0f, ~NO_LEAF);
    stack[1] = stack_entry(0.0f, 0u);
    walk->height = 2u;
}

// What waits on the stack is not in the cache when its turn comes: the lines of a node, or of most of a block.
INLINE void fetch_ahead(__global const float8* nodes, __global const float8* blocks, int reference)
{
    const size_t from = reference < 0 ? (size_t)(blocks + ~reference) : (size_t)(nodes + reference);
    FETCH_AHEAD(from, 0);
    FETCH_AHEAD(from, 64);
    FETCH_AHEAD(from, 128);
    FETCH_AHEAD(from, 192);
}

// The next leaf whose box the ray meets before t_max, NO_LEAF if there is none. `in_order`: boxes met earlier come first, and
// t_max may shrink from call to call.
INLINE uint next_leaf(Walk* walk, ulong* stack, __global const float8* nodes, __global const float8* blocks, float t_max,
                      bool in_order)
{
    uint height = walk->height;
    for (;;) {
        const ulong top = stack[--height];
        if (in_order && as_float((uint)(top >> 32)) >= t_max) continue;
        int reference = (int)(uint)top;
        while (reference >= 0) {
            __global const float8* node = nodes + reference;
            __global const uint* children = (__global const uint*)(node + 6);
            Lanes entry;
            uint met = children_met(node, &walk->ray, t_max, &entry.all);
#if FEATURE_COUNT_TESTS
            ++walk->nodes;
#endif
            if (!met) break;
            uint child = lowest_bit(met);
            met &= met - 1u;
            if (!in_order) {
                for (; met; met &= met - 1u) stack[height++] = stack_entry(0.0f, children[lowest_bit(met)]);
                reference = (int)children[child];
                continue;
            }
            if (!met) {
                reference = (int)children[child];
                continue;
            }
            // the nearest is next, the others go to the stack with the farthest lowest
            ulong nearest = stack_entry(entry.lane[child], children[child]);
            const uint base = height;
            for (; met; met &= met - 1u) {
                child = lowest_bit(met);
                const ulong other = stack_entry(entry.lane[child], children[child]);
                const ulong farther = GREATER(nearest, other);
                nearest = LESSER(nearest, other);
                fetch_ahead(nodes, blocks, (int)(uint)farther);
                uint place = height++;
                for (; place > base && stack[place - 1u] < farther; --place) stack[place] = stack[place - 1u];
                stack[place] = farther;
            }
            reference = (int)(uint)nearest;
        }
        if (reference >= 0) continue;
        const uint leaf = (uint)~reference;
#if FEATURE_INSTANCES
        if (leaf >= walk->first_instance && leaf != NO_LEAF) {
            if (leaf == END_OF_INSTANCE) {
                enter_world(walk);
            } else {
                enter_instance(walk, leaf - walk->first_instance);
                stack[height++] = stack_entry(0.0f, ~END_OF_INSTANCE);
                stack[height++] = stack_entry(0.0f, NODE_ROWS * walk->instances[walk->inside].root);
            }
            continue;
        }
#endif
        walk->height = height;
        return leaf;
    }
}

#if FEATURE_ANALYTICS
// Distance to the analytic shape in a leaf, INFINITY if the ray does not meet it before t_max.
INLINE float leaf_distance(const Walk* walk, __global const Analytic* analytics, uint index, float t_max)
{
    return analytic_distance(analytics, index, unpacked(walk->ray.origin), unpacked(walk->ray.direction), walk->skip.x,
                             walk->skip.y, t_max);
}
#endif
