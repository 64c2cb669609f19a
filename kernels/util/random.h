// Random numbers: a pure function of (seed, pixel, sample index, dimension block). Used by `generate` and `shade`.
// Nothing is stored per pixel. A caller names a dimension block and gets its four numbers, two pairs.
#pragma once
#include "util/philox.h"
#include "util/sobol.h"

// Dimension blocks, by random_vertex_index. The camera has one. A path vertex has four: BSDF and light are numbered
// together, materials and media in ranges of their own. So the numbers of a block do not depend on the features. The
// first pairs of an even block and of the odd one after it form a group (util/sobol.h): camera and first light, BSDF
// and light of the next vertex.
#define BLOCK_CAMERA 1u  // filter x, filter y, lens x, lens y
#define BLOCKS_PER_VERTEX 2u
#define BLOCK_LIGHT(depth) (BLOCKS_PER_VERTEX * (depth))      // light and x, y, low bits of x, unused
#define BLOCK_BSDF(depth) (3u + BLOCKS_PER_VERTEX * (depth))  // direction x, direction y, lobe, Russian roulette
#define BLOCK_MATERIAL(depth) (0x80000001u + BLOCKS_PER_VERTEX * (depth))  // choice of a nested material
#define BLOCK_MEDIUM(depth) (0xC0000001u + BLOCKS_PER_VERTEX * (depth))    // of a free flight
#define BLOCK_SHADOW(depth) (0xC0000002u + BLOCKS_PER_VERTEX * (depth))    // seeds the stream of a shadow ray

// The four numbers of one dimension block of one sample: in [0, 1), multiples of 2^-24. The pairs (x, y) and (z, w) are
// well distributed over consecutive samples of a pixel with the sampler `sobol`, else independent.
INLINE Vec4 random_block(uint2 seed, uint pixel, uint index, uint block)
{
#if FEATURE_SOBOL
    return sobol_block(seed, pixel, index, block);
#else
    return philox_block(seed, pixel, index, block, 0u);
#endif
}

#if FEATURE_HETEROGENEOUS
// As many independent numbers as a free flight or a shadow ray needs. They are a function of a dimension block and a
// running number.
typedef struct {
    uint2 seed;
    uint pixel, index, block;
    uint number;  // of the last four numbers
} RandomStream;

INLINE RandomStream random_stream(uint2 seed, uint pixel, uint index, uint block)
{
    const RandomStream stream = {seed, pixel, index, block, 0u};
    return stream;
}

INLINE Vec4 next_random(RandomStream* stream)
{
    ++stream->number;
    return philox_block(stream->seed, stream->pixel, stream->index, stream->block, stream->number);
}
#endif
