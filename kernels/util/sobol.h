// The sampler `sobol`: pairs of numbers from the (0,2)-sequence of van der Corput and Sobol'. Used by util/random.h.
//
// Two pairs form a group: where a ray goes (the pixel filter, or the direction of a BSDF) and where the next-event
// estimation at its end looks. Each pair is a (0,2)-sequence: an aligned run of 2^m samples of a pixel has one point in
// each of the 2^a x 2^b = 2^m equal rectangles of the unit square. The second pair reads the index through a matrix,
// which also spreads both pairs together in four dimensions. Groups are independent of each other (padding): the order
// of the samples is scrambled by a hash function of pixel and group. Burley, "Practical Hash-based Owen Scrambling",
// JCGT 9(4), 2020.
//
// The numbers of the first pair are Owen-scrambled: below the resolution of the samples they are random, so that fine
// textures do not alias. Those of the second pair get a random digital shift, which keeps their regular distances:
// Kollig and Keller, "Efficient Multidimensional Sampling", 2002. relMSE at 64 samples per pixel: groups 0.95 of padded
// pairs (cornell), shifted lights 0.87 of Owen-scrambled ones (mesh-82k, an environment map).
#pragma once
#include "util/vec.h"

#if FEATURE_SOBOL
INLINE uint reverse_bits(uint x)
{
#if HAS_BUILTIN(__builtin_bitreverse32)
    return __builtin_bitreverse32(x);
#else
    x = ((x >> 1u) & 0x55555555u) | ((x & 0x55555555u) << 1u);
    x = ((x >> 2u) & 0x33333333u) | ((x & 0x33333333u) << 2u);
    x = ((x >> 4u) & 0x0F0F0F0Fu) | ((x & 0x0F0F0F0Fu) << 4u);
    x = ((x >> 8u) & 0x00FF00FFu) | ((x & 0x00FF00FFu) << 8u);
    return (x >> 16u) | (x << 16u);
#endif
}

// A bijection whose output bits each depend on all input bits: "lowbias32" of C. Wellons, "Prospecting for Hash
// Functions", 2018.
INLINE uint hash_uint(uint x)
{
    x = (x ^ (x >> 16u)) * 0x7FEB352Du;
    x = (x ^ (x >> 15u)) * 0x846CA68Bu;
    return x ^ (x >> 16u);
}

// Nested uniform scramble of an index with its bits reversed: flips every bit depending on the lower ones. Unreversed,
// it swaps the halves of every aligned run of 2^m samples, or does not, independently.
// Laine and Karras, "Stratified Sampling for Stochastic Transparency", EGSR 2011, with the constants of N. Vegdahl,
// "Building a Better LK Hash", 2021.
INLINE uint scramble_reversed(uint x, uint seed)
{
    x ^= x * 0x3D20ADEAu;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526C56u;
    x ^= x * 0x53A22864u;
    return x;
}

// Bit j of the result is the sum modulo 2 of the bits k of `index` for which the binomial coefficient C(k, j) is odd:
// that holds if all bits of j are set in k (Lucas), so five steps suffice. The bits, reversed, are the second dimension
// of the Sobol' sequence.
INLINE uint reversed_sobol(uint index)
{
    index ^= (index & 0xAAAAAAAAu) >> 1u;
    index ^= (index & 0xCCCCCCCCu) >> 2u;
    index ^= (index & 0xF0F0F0F0u) >> 4u;
    index ^= (index & 0xFF00FF00u) >> 8u;
    return index ^ (index >> 16u);
}

// The matrix of the second pair, by columns, for 16 bits of the index; higher bits stay. It is upper triangular with
// ones on its diagonal, so that it permutes the samples within aligned runs. Found by a beam search, column by column,
// for the least linear dependence between the rows of the four dimensions: in 2^10 samples, any dimensions of both
// pairs form a (t,m,2)-net with t <= 3.
__constant uint SECOND_PAIR[16] = {0x1u,   0x2u,   0x5u,   0xBu,   0x17u,   0x3Du,   0x62u,   0xA9u,
                                   0x147u, 0x396u, 0x6BAu, 0xF2Fu, 0x1864u, 0x352Du, 0x66F7u, 0xC672u};

INLINE uint second_pair_index(uint index)
{
    uint result = index & 0xFFFF0000u;
#pragma unroll
    for (uint k = 0; k < 16u; ++k) result ^= (0u - ((index >> k) & 1u)) & SECOND_PAIR[k];
    return result;
}

// A point of the sequence with this key, multiples of 2^-24. `reversed_index`: bits of the sample index, reversed.
INLINE Vec2 sobol_pair(uint key, uint reversed_index, bool is_second)
{
    const uint key_x = hash_uint(key ^ (is_second ? 0x3C6EF372u : 0x9E3779B9u));
    const uint key_y = (key_x >> 16u) ^ (key_x * 0x85EBCA6Bu);  // an odd factor and a shift: other low and high bits
    const uint shuffled_index = reverse_bits(scramble_reversed(reversed_index, key));
    uint x, y;
    if (is_second) {
        const uint index = second_pair_index(shuffled_index);
        x = reverse_bits(index) ^ key_x;
        y = reverse_bits(reversed_sobol(index)) ^ key_y;
    } else {
        x = reverse_bits(scramble_reversed(shuffled_index, key_x));
        y = reverse_bits(scramble_reversed(reversed_sobol(shuffled_index), key_y));
    }
    return scale2(vec2((float)(x >> 8u), (float)(y >> 8u)), 0x1p-24f);
}

// The numbers of a dimension block: a pair of a group, the first if `block` is odd, and a pair of its own. Keys of
// different seeds must not be the same keys in another order of the pixels, so seed and pixel are hashed before they
// are combined.
INLINE Vec4 sobol_block(uint2 seed, uint pixel, uint index, uint block)
{
    const uint pixel_key = hash_uint(pixel) ^ hash_uint(seed.x ^ 0xBB67AE85u);
    const uint group_key = hash_uint(seed.y ^ hash_uint(seed.x + 0x3C6EF372u)) + 0x9E3779B9u * (block >> 1u);
    const uint own_key = group_key + (block & 1u ? 0x85EBCA6Bu : 0xC2B2AE35u);
    const uint reversed_index = reverse_bits(index);
    const Vec2 first = sobol_pair(hash_uint(pixel_key + group_key), reversed_index, !(block & 1u));
    const Vec2 second = sobol_pair(hash_uint(pixel_key + own_key), reversed_index, false);
    return vec4(first.x, first.y, second.x, second.y);
}
#endif
