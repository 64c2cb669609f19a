// Stages between two bounces: the queue keeps the slots whose paths go on and those that begin a new sample.
// Stable and without atomics: count per block, scan the blocks, scatter. One work-item a block.
#include "plain.h"

__kernel void count_alive(__global const uchar* alive, uint queue_length, uint block_size, __global uint* block_alive)
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size;
    if (begin >= queue_length) return;
    const uint end = LESSER(begin + block_size, queue_length);
    uint sum = 0;
    for (uint i = begin; i < end; ++i) sum += alive[i];
    block_alive[block] = sum;
}

// Turns the counts into the number alive before each block; total gets the sum.
__kernel void scan_blocks(__global uint* block_alive, uint blocks, __global uint* total)
{
    if (get_global_id(0) != 0) return;
    uint sum = 0;
    for (uint block = 0; block < blocks; ++block) {
        const uint here = block_alive[block];
        block_alive[block] = sum;
        sum += here;
    }
    *total = sum;
}

// Of the slots that fell free, the first `samples_left` in queue order begin a new sample: they go to `spawn`, and stay queued.
__kernel void scatter(__global const uchar* alive, uint queue_length, uint block_size, __global const uint* block_alive,
                      uint samples_left, __global const uint* queue, __global uint* next_queue, __global uint* spawn)
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size;
    if (begin >= queue_length) return;
    const uint end = LESSER(begin + block_size, queue_length);
    uint living = block_alive[block], dead = begin - living;
    for (uint i = begin; i < end; ++i) {
        const uint slot = queue[i];
        if (alive[i]) {
            next_queue[living + LESSER(dead, samples_left)] = slot;
            ++living;
        } else {
            if (dead < samples_left) {
                next_queue[living + dead] = slot;
                spawn[dead] = slot;
            }
            ++dead;
        }
    }
}
