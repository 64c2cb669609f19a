// Stages between two bounces: compaction fills the slots of dead paths with live ones from the end of the pool. New
// paths are generated behind them, so the pool stays dense. Most paths stay where they are, and with them their
// neighbours, which behave alike.
// Without atomics: count the live paths per path block (PATH_BLOCK_SIZE paths), scan the counts, list the holes, fill
// them. A path block belongs to one work-item, or to a work-group if BLOCK_WORK_ITEMS is above 1: then that is both the
// size of the group and PATH_BLOCK_SIZE.
// Reads alive and the path state; writes total_alive and the path state.
#include "path/path_state.h"

#if BLOCK_WORK_ITEMS > 1
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

// Replaces the counts by their exclusive prefix sum. total_alive receives the total, and how many of the first `total`
// slots are alive. One work-item or work-group.
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
    barrier(CLK_GLOBAL_MEM_FENCE);
    const uint last_block = sum / PATH_BLOCK_SIZE, i = last_block * PATH_BLOCK_SIZE + get_local_id(0);
    uint in_last_block;
    scan_group(i < sum ? alive[i] : 0u, sums, &in_last_block);
    if (get_global_id(0) == 0) {
        total_alive[0] = sum;
        total_alive[1] = last_block < path_block_count ? path_block_alive[last_block] + in_last_block : sum;
    }
#else
    if (get_global_id(0) != 0) return;
    for (uint block = 0; block < path_block_count; ++block) {
        const uint block_count = path_block_alive[block];
        path_block_alive[block] = sum;
        sum += block_count;
    }
    const uint last_block = sum / PATH_BLOCK_SIZE;
    uint in_front = last_block < path_block_count ? path_block_alive[last_block] : sum;
    for (uint i = last_block * PATH_BLOCK_SIZE; i < sum; ++i) in_front += alive[i];
    total_alive[0] = sum;
    total_alive[1] = in_front;
#endif
}

// The dead paths among the first total_alive slots, the holes, in their order.
__kernel void list_holes(
#include "generated/list_holes_parameters.h"
)
{
    const uint alive_count = total_alive[0];
#if BLOCK_WORK_ITEMS > 1
    __local uint sums[BLOCK_WORK_ITEMS];
    const uint i = get_global_id(0), is_alive = i < path_count ? alive[i] : 0u;
    uint total;
    const uint rank = path_block_alive[get_group_id(0)] + scan_group(is_alive, sums, &total);
    if (i < alive_count && !is_alive) holes[i - rank] = i;
#else
    const uint block = get_global_id(0), begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count || begin >= alive_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, alive_count);
    uint slots[PATH_BLOCK_SIZE + 1], count = 0;
    for (uint i = begin; i < end; ++i) {
        slots[count] = i;
        count += alive[i] ^ 1u;
    }
    __global uint* block_holes = holes + (begin - path_block_alive[block]);
    for (uint k = 0; k < count; ++k) block_holes[k] = slots[k];
#endif
}

// Moves planes of path state from `source_slots` to `target_slots`.
INLINE void move_planes(uint planes, __global uint* state, uint plane_stride, const uint* source_slots,
                        const uint* target_slots, uint count)
{
    for (uint plane = 0; plane < planes; ++plane) {
        __global uint* values = PLANE(plane, state, plane_stride);
#if LANES > 1
#pragma clang loop vectorize(assume_safety)
#endif
        for (size_t k = 0; k < count; ++k) values[target_slots[k]] = values[source_slots[k]];
    }
}

// Moves the live paths behind the first total_alive slots into the holes, of which there are as many, in order.
__kernel void fill_holes(
#include "generated/fill_holes_parameters.h"
)
{
    const uint alive_count = total_alive[0], in_front = total_alive[1];
#if BLOCK_WORK_ITEMS > 1
    __local uint sums[BLOCK_WORK_ITEMS];
    const uint i = get_global_id(0), is_alive = i < path_count ? alive[i] : 0u;
    uint total;
    const uint rank = path_block_alive[get_group_id(0)] + scan_group(is_alive, sums, &total);
    const uint count = i >= alive_count ? is_alive : 0u;
    const uint source_slots[1] = {i}, target_slots[1] = {count ? holes[rank - in_front] : 0u};
#else
    const uint block = get_global_id(0), begin = block * PATH_BLOCK_SIZE;
    if (begin >= path_count) return;
    const uint end = MIN(begin + PATH_BLOCK_SIZE, path_count), first = MAX(begin, alive_count);
    if (first >= end) return;
    uint rank = path_block_alive[block], source_slots[PATH_BLOCK_SIZE + 1], target_slots[PATH_BLOCK_SIZE], count = 0;
    for (uint i = begin; i < first; ++i) rank += alive[i];
    for (uint i = first; i < end; ++i) {
        source_slots[count] = i;
        count += alive[i];
    }
    for (uint k = 0; k < count; ++k) target_slots[k] = holes[rank - in_front + k];
#endif
#include "generated/move_path_state.h"
}
