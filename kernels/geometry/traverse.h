// The walk of a ray through the hierarchy, from leaf to leaf. The stages that trace rays include it; they differ in what they do
// with a leaf and in when they stop.
#pragma once
#include "geometry/bvh.h"
#include "path/path_state.h"

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
    uint start_instance;                // the instance that it starts in
    uint start_primitive;
    uint inside;               // the instance that it is in, NONE: the world
    __global const Instance* instances;
    uint first_instance;       // number of the leaf that is the first instance
#endif
} Traversal;

// An entry of the stack: the distance at which the ray enters what is there, as bits, above the reference. Distances are not
// negative, so that entries stand in their order.
INLINE ulong stack_entry(float distance, uint reference)
{
    return (ulong)as_uint(distance) << 32 | reference;
}

#if FEATURE_INSTANCES
INLINE void enter_world(Traversal* traversal)
{
    traversal->inside = NONE;
    traversal->skip.x = traversal->start_primitive;
    traversal->ray = make_ray(traversal->origin, traversal->direction);
}

INLINE void enter_instance(Traversal* traversal, uint inside)
{
    traversal->inside = inside;
    traversal->skip.x = skip_in_instance(traversal->start_primitive, traversal->start_instance, inside);
    traversal->ray = make_object_ray(traversal->instances + inside, traversal->origin, traversal->direction);
}
#endif

// To the root. With instances the members about them that say where the ray starts are set before.
INLINE void begin_traversal(Traversal* traversal, ulong* stack, Vec3 from, Vec3 towards, uint2 skip)
{
    const float4 origin = to_float4(from), direction = to_float4(towards);
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
    traversal->nodes = 0u;
#endif
    stack[0] = stack_entry(0.0f, ~NO_LEAF);
    stack[1] = stack_entry(0.0f, 0u);
    traversal->height = 2u;
}

// What waits on the stack is not in the cache when its turn comes: the lines of a node, or of most of a block.
INLINE void prefetch_child(__global const float8* nodes, __global const float8* blocks, int reference)
{
    const size_t from = reference < 0 ? (size_t)(blocks + ~reference) : (size_t)(nodes + reference);
    PREFETCH(from, 0);
    PREFETCH(from, 64);
    PREFETCH(from, 128);
    PREFETCH(from, 192);
}

// The next leaf whose box the ray meets before t_max, NO_LEAF if there is none. `in_order`: boxes met earlier come first, and
// t_max may shrink from call to call.
INLINE uint next_leaf(Traversal* traversal, ulong* stack, __global const float8* nodes, __global const float8* blocks, float t_max,
                      bool in_order)
{
    uint height = traversal->height;
    for (;;) {
        const ulong top = stack[--height];
        if (in_order && as_float((uint)(top >> 32)) >= t_max) continue;
        int reference = (int)(uint)top;
        while (reference >= 0) {
            __global const float8* node = nodes + reference;
            __global const uint* children = (__global const uint*)(node + 6);
            Float8Lanes entry;
            uint hits = intersect_node(node, &traversal->ray, t_max, &entry.all);
#if FEATURE_COUNT_TESTS
            ++traversal->nodes;
#endif
            if (!hits) break;
            uint child = lowest_set_bit(hits);
            hits &= hits - 1u;
            if (!in_order) {
                for (; hits; hits &= hits - 1u) stack[height++] = stack_entry(0.0f, children[lowest_set_bit(hits)]);
                reference = (int)children[child];
                continue;
            }
            if (!hits) {
                reference = (int)children[child];
                continue;
            }
            // the nearest is next, the others go to the stack with the farthest lowest
            ulong nearest = stack_entry(entry.lane[child], children[child]);
            const uint base = height;
            for (; hits; hits &= hits - 1u) {
                child = lowest_set_bit(hits);
                const ulong other = stack_entry(entry.lane[child], children[child]);
                const ulong farther = MAX(nearest, other);
                nearest = MIN(nearest, other);
                prefetch_child(nodes, blocks, (int)(uint)farther);
                uint place = height++;
                for (; place > base && stack[place - 1u] < farther; --place) stack[place] = stack[place - 1u];
                stack[place] = farther;
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
                stack[height++] = stack_entry(0.0f, ~END_OF_INSTANCE);
                stack[height++] = stack_entry(0.0f, NODE_ROWS * traversal->instances[traversal->inside].root);
            }
            continue;
        }
#endif
        traversal->height = height;
        return leaf;
    }
}

#if FEATURE_ANALYTICS
// Distance to the analytic shape in a leaf, INFINITY if the ray does not meet it before t_max.
INLINE float intersect_analytic_leaf(const Traversal* traversal, __global const Analytic* analytics, uint index, float t_max)
{
    return analytic_distance(analytics, index, from_float4(traversal->ray.origin), from_float4(traversal->ray.direction), traversal->skip.x,
                             traversal->skip.y, t_max);
}
#endif
