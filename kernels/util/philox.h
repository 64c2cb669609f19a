// The sampler `independent`, and streams of random numbers: a counter-based generator. Used by util/random.h.
#pragma once
#include "util/vec.h"

#if !FEATURE_SOBOL || FEATURE_HETEROGENEOUS
// Philox4x32 with 7 rounds, the smallest number of rounds that passes BigCrush.
// Salmon, Moraes, Dror, Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011, section 3.3 and table 2.
INLINE Vec4 philox_block(uint2 seed, uint pixel, uint index, uint block, uint number)
{
    uint a = pixel, b = index, c = block, d = number;
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
#endif
