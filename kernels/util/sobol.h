// The sampler `sobol`: pairs of numbers from the (0,2)-sequence of van der Corput and Sobol'. Used by util/random.h.
//
// Every pair of dimensions of every pixel has its own copy of the sequence, whose order and points are scrambled by
// hash functions (padding; Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020). An aligned run of 2^m
// samples of a pixel is a net: with 2^m = 2^a 2^b it has one point in each of the 2^a x 2^b equal rectangles of the
// unit square. Owen, "Randomly Permuted (t,m,s)-Nets and (t,s)-Sequences", 1995.
#pragma once
#include "util/vec.h"

#if FEATURE_SOBOL
INLINE uint reverse_bits(uint x)
{
#if defined(__has_builtin) && __has_builtin(__builtin_bitreverse32)
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

// Nested uniform scramble of a number with its bits reversed: flips every bit depending on the lower ones.
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

// A point of the sequence with this key, multiples of 2^-24. `reversed_index`: bits of the sample index, reversed.
INLINE Vec2 sobol_pair(uint key, uint reversed_index)
{
    const uint key_x = hash_uint(key ^ 0x9E3779B9u), key_y = hash_uint(key ^ 0x85EBCA6Bu);
    const uint index = reverse_bits(scramble_reversed(reversed_index, key));
    const uint x = reverse_bits(scramble_reversed(index, key_x));
    const uint y = reverse_bits(scramble_reversed(reversed_sobol(index), key_y));
    return scale2(vec2((float)(x >> 8u), (float)(y >> 8u)), 0x1p-24f);
}

// Two pairs. Keys of different seeds must not be the same keys in another order of the pixels, so seed and pixel are
// hashed before they are combined.
INLINE Vec4 sobol_block(uint2 seed, uint pixel, uint index, uint block)
{
    const uint pixel_key = hash_uint(pixel) ^ hash_uint(seed.x ^ 0xBB67AE85u);
    const uint block_key = hash_uint(seed.y ^ hash_uint(seed.x + 0x3C6EF372u)) + 2u * 0x9E3779B9u * block;
    const uint reversed_index = reverse_bits(index);
    const Vec2 first = sobol_pair(hash_uint(pixel_key + block_key), reversed_index);
    const Vec2 second = sobol_pair(hash_uint(pixel_key + block_key + 0x9E3779B9u), reversed_index);
    return vec4(first.x, first.y, second.x, second.y);
}
#endif
