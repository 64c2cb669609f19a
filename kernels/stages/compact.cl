// Stages between two bounces: compaction moves the live paths to the front of the pool and keeps their order. New paths
// are generated behind them, so the pool stays dense, and paths of the same depth, which behave alike, stay together.
// Stable and without atomics: count per path block (PATH_BLOCK_SIZE paths), scan the counts, move. One work-item per
// path block.
// Reads alive and the path state; writes total_alive and the other copy of the path state.
#include "path/path_state.h"

__kernel void count_alive(
#include "generated/count_alive_parameters.h"
)
{
    const uint block = get_global_id(0);
    const uint begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, path_count);
    uint sum = 0;
    for (uint i = begin; i < end; ++i) sum += alive[i];
    path_block_alive[block] = sum;
}

// Replaces the counts by their exclusive prefix sum; total_alive receives the total.
__kernel void scan_blocks(
#include "generated/scan_blocks_parameters.h"
)
{
    if (get_global_id(0) != 0) return;
    uint sum = 0;
    for (uint block = 0; block < path_block_count; ++block) {
        const uint block_count = path_block_alive[block];
        path_block_alive[block] = sum;
        sum += block_count;
    }
    *total_alive = sum;
}

// Gathers one plane of the paths in `source_slots` into consecutive slots of `target`.
INLINE void move_plane(__global const uint* source, __global uint* target, const uint* source_slots, uint count)
{
#if LANES > 1
#pragma clang loop vectorize(assume_safety)
#endif
    for (size_t k = 0; k < count; ++k) target[k] = source[source_slots[k]];
}

INLINE void move_planes(uint planes, __global const uint* source, __global uint* target, uint plane_stride,
                        const uint* source_slots, uint count)
{
    for (uint k = 0; k < planes; ++k)
        move_plane(PLANE(k, source, plane_stride), PLANE(k, target, plane_stride), source_slots, count);
}

__kernel void move_paths(
#include "generated/move_paths_parameters.h"
)
{
    const uint block = get_global_id(0);
    const uint begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, path_count), first_target = path_block_alive[block];
    uint source_slots[PATH_BLOCK_SIZE], count = 0;
    for (uint i = begin; i < end; ++i) {
        source_slots[count] = i;
        count += alive[i];
    }
#include "generated/move_path_state.h"
}
