// Random numbers: a pure function of (seed, pixel, stream, sample index, dimension), nothing is stored per pixel.
// Whoever needs numbers names a dimension block and gets its four numbers; how they come about is known here alone.
#pragma once

// Dimension blocks. The camera has one; every path vertex has BLOCKS_PER_VERTEX, whatever the features.
#define BLOCK_CAMERA 0u          // filter x, filter y, lens x, lens y
#define BLOCKS_PER_VERTEX 2u
#define BLOCK_BSDF(depth) (1u + BLOCKS_PER_VERTEX * (depth))   // lobe, direction x, direction y, roulette
#define BLOCK_LIGHT(depth) (2u + BLOCKS_PER_VERTEX * (depth))  // pick, position x, position y, pick (low bits)

// Philox4x32 with 7 rounds, the fewest that pass BigCrush.
// Salmon, Moraes, Dror, Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011, section 3.3 and table 2.
inline uint4 philox(uint4 counter, uint2 key)
{
    for (int round = 0; round < 7; ++round) {
        const uint high0 = mul_hi(0xD2511F53u, counter.x), low0 = 0xD2511F53u * counter.x;
        const uint high1 = mul_hi(0xCD9E8D57u, counter.z), low1 = 0xCD9E8D57u * counter.z;
        counter = (uint4)(high1 ^ counter.y ^ key.x, low1, high0 ^ counter.w ^ key.y, low0);
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

// Four numbers in [0, 1), multiples of 2^-24, of one dimension block of one sample.
inline float4 random_block(uint2 seed, uint pixel, uint index, uint block)
{
    return convert_float4(philox((uint4)(pixel, index, block, 0u), seed) >> 8u) * 0x1p-24f;
}
