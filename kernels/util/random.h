// Random numbers: a pure function of (seed, pixel, sample index, dimension block). Used by `generate` and `shade`.
// Nothing is stored per pixel. A caller names a dimension block and gets its four numbers.
#pragma once
#include "util/vec.h"

// Dimension blocks, by random_vertex_index. The camera has one. A path vertex has four: BSDF and light are numbered
// together, materials and media in ranges of their own. So the numbers of a block do not depend on the features.
#define BLOCK_CAMERA 0u  // filter x, filter y, lens x, lens y
#define BLOCKS_PER_VERTEX 2u
#define BLOCK_BSDF(depth) (1u + BLOCKS_PER_VERTEX * (depth))   // lobe, direction x, direction y, Russian roulette
#define BLOCK_LIGHT(depth) (2u + BLOCKS_PER_VERTEX * (depth))  // light and x, y, low bits of x, unused
#define BLOCK_MATERIAL(depth) (0x80000000u + (depth))          // choice of a nested material
#define BLOCK_MEDIUM(depth) (0xC0000000u + (depth))            // channel, distance, distance (low bits)

// The four numbers of one dimension block of one sample: in [0, 1), multiples of 2^-24. Philox4x32 with 7 rounds, the
// smallest number of rounds that passes BigCrush.
// Salmon, Moraes, Dror, Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011, section 3.3 and table 2.
INLINE Vec4 random_block(uint2 seed, uint pixel, uint index, uint block)
{
    uint a = pixel, b = index, c = block, d = 0u;
    // unrolled: LLVM does not vectorise a loop over paths that contains another loop
#pragma unroll
    for (uint round = 0; round < 7u; ++round) {
        // high halves from 64-bit products: mul_hi may be a call; low halves separately, which is cheap in vectors
        const uint low_a = 0xD2511F53u * a, low_c = 0xCD9E8D57u * c;
        const uint high_a = (uint)(((ulong)0xD2511F53u * a) >> 32), high_c = (uint)(((ulong)0xCD9E8D57u * c) >> 32);
        a = high_c ^ b ^ (seed.x + round * 0x9E3779B9u);
        b = low_c;
        c = high_a ^ d ^ (seed.y + round * 0xBB67AE85u);
        d = low_a;
    }
    return scale4(vec4((float)(a >> 8u), (float)(b >> 8u), (float)(c >> 8u), (float)(d >> 8u)), 0x1p-24f);
}
