// Stages between two bounces: compaction moves the live paths to the front of the pool and keeps their order. New paths
// are generated behind them, so the pool stays dense, and paths of the same depth, which behave alike, stay together.
// Stable and without atomics: count per path block (PATH_BLOCK_SIZE paths), scan the counts, move. A path block belongs
// to one work-item, or to a work-group if BLOCK_WORK_ITEMS is above 1: then that is both the size of the group and
// PATH_BLOCK_SIZE.
// Reads alive and the path state; writes total_alive and the other copy of the path state.
#include "path/path_state.h"

#if BLOCK_WORK_ITEMS > 1
#define SHARED __local

// Exclusive prefix sum over the work-group; `total` receives the sum of all. `sums` has BLOCK_WORK_ITEMS numbers.
// Hillis and Steele, "Data Parallel Algorithms", CACM 1986.
INLINE uint scan_group(uint value, __local uint* sums, uint* total)
{
    const uint item = get_local_id(0);
    sums[item] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint distance = 1u; distance < BLOCK_WORK_ITEMS; distance *= 2u) {
        const uint before = item >= distance ? sums[item - distance] : 0u;
        barrier(CLK_LOCAL_MEM_FENCE);
        sums[item] += before;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    *total = sums[BLOCK_WORK_ITEMS - 1u];
    const uint result = sums[item] - value;
    barrier(CLK_LOCAL_MEM_FENCE);  // the next scan may overwrite the sums
    return result;
}
#else
#define SHARED
#endif

__kernel void count_alive(
#include "generated/count_alive_parameters.h"
)
{
#if BLOCK_WORK_ITEMS > 1
    __local uint sums[BLOCK_WORK_ITEMS];
    const uint i = get_global_id(0);
    uint sum;
    scan_group(i < path_count ? alive[i] : 0u, sums, &sum);
    if (get_local_id(0) == 0u) path_block_alive[get_group_id(0)] = sum;
#else
    const uint block = get_global_id(0), begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, path_count);
    uint sum = 0;
    for (uint i = begin; i < end; ++i) sum += alive[i];
    path_block_alive[block] = sum;
#endif
}

// Replaces the counts by their exclusive prefix sum; total_alive receives the total. One work-item or work-group.
__kernel void scan_blocks(
#include "generated/scan_blocks_parameters.h"
)
{
    uint sum = 0;
#if BLOCK_WORK_ITEMS > 1
    __local uint sums[BLOCK_WORK_ITEMS];
    const uint end = get_group_id(0) == 0 ? path_block_count : 0u;
    for (uint first = 0; first < end; first += BLOCK_WORK_ITEMS) {
        const uint block = first + get_local_id(0);
        uint total;
        const uint before = scan_group(block < path_block_count ? path_block_alive[block] : 0u, sums, &total);
        if (block < path_block_count) path_block_alive[block] = sum + before;
        sum += total;
    }
    if (get_global_id(0) == 0) *total_alive = sum;
#else
    if (get_global_id(0) != 0) return;
    for (uint block = 0; block < path_block_count; ++block) {
        const uint block_count = path_block_alive[block];
        path_block_alive[block] = sum;
        sum += block_count;
    }
    *total_alive = sum;
#endif
}

// Gathers one plane of the paths in `source_slots` into consecutive slots of `target`.
INLINE void move_plane(__global const uint* source, __global uint* target, SHARED const uint* source_slots, uint count)
{
#if LANES > 1
#pragma clang loop vectorize(assume_safety)
#endif
    for (size_t k = get_global_id(0) % BLOCK_WORK_ITEMS; k < count; k += BLOCK_WORK_ITEMS)
        target[k] = source[source_slots[k]];
}

INLINE void move_planes(uint planes, __global const uint* source, __global uint* target, uint plane_stride,
                        SHARED const uint* source_slots, uint count)
{
    for (uint k = 0; k < planes; ++k)
        move_plane(PLANE(k, source, plane_stride), PLANE(k, target, plane_stride), source_slots, count);
}

__kernel void move_paths(
#include "generated/move_paths_parameters.h"
)
{
#if BLOCK_WORK_ITEMS > 1
    const uint first_target = path_block_alive[get_group_id(0)];
    __local uint sums[BLOCK_WORK_ITEMS], source_slots[PATH_BLOCK_SIZE];
    const uint i = get_global_id(0);
    const bool is_alive = i < path_count && alive[i];
    uint count;
    const uint rank = scan_group(is_alive, sums, &count);
    if (is_alive) source_slots[rank] = i;
    barrier(CLK_LOCAL_MEM_FENCE);
#else
    const uint block = get_global_id(0), begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, path_count), first_target = path_block_alive[block];
    uint source_slots[PATH_BLOCK_SIZE], count = 0;
    for (uint i = begin; i < end; ++i) {
        source_slots[count] = i;
        count += alive[i];
    }
#endif
#include "generated/move_path_state.h"
}
