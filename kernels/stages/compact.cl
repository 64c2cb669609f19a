// Stages between two bounces: the paths that go on move to the front of the pool, in their order; new ones are generated behind
// them. So the pool stays dense, and paths of one age, which behave alike, stay side by side.
// Stable and without atomics: count per block, scan the blocks, move. One work-item a block.
#include "path/path_state.h"

__kernel void count_alive(
#include "generated/count_alive_parameters.h"
)
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
__kernel void scan_blocks(
#include "generated/scan_blocks_parameters.h"
)
{
    if (get_global_id(0) != 0) return;
    uint sum = 0;
    for (uint block = 0; block < blocks_in_use; ++block) {
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

__kernel void move_paths(
#include "generated/move_paths_parameters.h"
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
#include "generated/move_path_state.h"
}
