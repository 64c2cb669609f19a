// Stages between two bounces: the paths that go on move to the front of the pool, in their order; new ones are generated behind
// them. So the pool stays dense, and paths of one age, which behave alike, stay side by side.
// Stable and without atomics: count per block, scan the blocks, move. One work-item a block.
#include "paths.h"

__kernel void count_alive(__global const uchar* alive, uint paths, uint block_size, __global uint* block_alive)
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size;
    if (begin >= paths) return;
    const uint end = LESSER(begin + block_size, paths);
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

__kernel void move_paths(__global const uchar* alive, uint paths, uint pool, uint block_size, __global const uint* block_alive,
                         __global const float* ray_origin, __global const float* ray_direction,
                         __global const float* throughput, __global const uint* path, __global float* next_ray_origin,
                         __global float* next_ray_direction, __global float* next_throughput, __global uint* next_path
#if FEATURE_INSTANCES
                         , __global const uint* instance, __global uint* next_instance
#endif
#if FEATURE_VOLPATH
                         , __global const uint* crossing, __global uint* next_crossing
#endif
#if FEATURE_MEDIA
                         , __global const uint* medium, __global uint* next_medium
#endif
#if FEATURE_LIGHT_TREE
                         , __global const float* lit, __global float* next_lit
#endif
                         )
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size;
    if (begin >= paths) return;
    const uint end = LESSER(begin + block_size, paths);
    uint to = block_alive[block];
    for (uint i = begin; i < end; ++i) {
        if (!alive[i]) continue;
        store_planes4(load_planes4(ray_origin, i, pool), next_ray_origin, to, pool);
        store_planes4(load_planes4(ray_direction, i, pool), next_ray_direction, to, pool);
        store_planes4(load_planes4(throughput, i, pool), next_throughput, to, pool);
        for (uint k = 0; k < 4u; ++k) PLANE(k, next_path, pool)[to] = PLANE(k, path, pool)[i];
#if FEATURE_INSTANCES
        next_instance[to] = instance[i];
#endif
#if FEATURE_VOLPATH
        for (uint k = 0; k < 2u; ++k) PLANE(k, next_crossing, pool)[to] = PLANE(k, crossing, pool)[i];
#endif
#if FEATURE_MEDIA
        next_medium[to] = medium[i];
#endif
#if FEATURE_LIGHT_TREE
        store_planes4(load_planes4(lit, i, pool), next_lit, to, pool);
#endif
        ++to;
    }
}
