// Stages between two bounces: the paths that go on move to the front of the pool, in their order; new ones are generated behind
// them. So the pool stays dense, and paths of one age, which behave alike, stay side by side.
// Stable and without atomics: count per block, scan the blocks, move. One work-item a block.
#include "path/path_state.h"

__kernel void count_alive(__global const uint* alive, uint path_count, __global uint* block_alive)
{
    const uint block = get_global_id(0);
    const uint begin = block * PATHS_PER_BLOCK;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATHS_PER_BLOCK, path_count);
    uint sum = 0;
    for (uint i = begin; i < end; ++i) sum += alive[i];
    block_alive[block] = sum;
}

// Turns the counts into the number alive before each block; total_alive gets the sum.
__kernel void scan_blocks(__global uint* block_alive, uint blocks, __global uint* total_alive)
{
    if (get_global_id(0) != 0) return;
    uint sum = 0;
    for (uint block = 0; block < blocks; ++block) {
        const uint here = block_alive[block];
        block_alive[block] = sum;
        sum += here;
    }
    *total_alive = sum;
}

// A plane of the paths whose places are listed moves to where they are in a row.
INLINE void move_plane(__global const uint* plane, __global uint* to, const uint* from, uint count)
{
#if LANES > 1
#pragma clang loop vectorize(assume_safety)
#endif
    for (size_t k = 0; k < count; ++k) to[k] = plane[from[k]];
}

INLINE void move_planes(uint number, __global const uint* planes, __global uint* to, uint plane_stride, const uint* from, uint count)
{
    for (uint k = 0; k < number; ++k) move_plane(PLANE(k, planes, plane_stride), PLANE(k, to, plane_stride), from, count);
}

__kernel void move_paths(__global const uint* alive, uint path_count, uint plane_stride, __global const uint* block_alive,
                         __global const uint* ray_origin, __global const uint* ray_direction,
                         __global const uint* throughput, __global const uint* path, __global uint* next_ray_origin,
                         __global uint* next_ray_direction, __global uint* next_throughput, __global uint* next_path
#if FEATURE_INSTANCES
                         , __global const uint* instance, __global uint* next_instance
#endif
#if FEATURE_VOLPATH
                         , __global const uint* crossing, __global uint* next_crossing
#endif
#if FEATURE_MEDIA
                         , __global const uint* medium, __global uint* next_medium
#endif
#if FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST
                         , __global const uint* mis_normal, __global uint* next_lit
#endif
                         )
{
    const uint block = get_global_id(0);
    const uint begin = block * PATHS_PER_BLOCK;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATHS_PER_BLOCK, path_count), to = block_alive[block];
    uint from[PATHS_PER_BLOCK], count = 0;
    for (uint i = begin; i < end; ++i) {
        from[count] = i;
        count += alive[i];
    }
    move_planes(4u, ray_origin, next_ray_origin + to, plane_stride, from, count);
    move_planes(4u, ray_direction, next_ray_direction + to, plane_stride, from, count);
    move_planes(4u, throughput, next_throughput + to, plane_stride, from, count);
    move_planes(4u, path, next_path + to, plane_stride, from, count);
#if FEATURE_INSTANCES
    move_planes(1u, instance, next_instance + to, plane_stride, from, count);
#endif
#if FEATURE_VOLPATH
    move_planes(2u, crossing, next_crossing + to, plane_stride, from, count);
#endif
#if FEATURE_MEDIA
    move_planes(1u, medium, next_medium + to, plane_stride, from, count);
#endif
#if FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST
    move_planes(4u, mis_normal, next_lit + to, plane_stride, from, count);
#endif
}
