// Coordinates beyond the ends of an image or a grid: repeated, mirrored or clamped. Used by texture/texture.h and
// media/grid.h.
#pragma once
#include "util/vec.h"

#if FEATURE_BITMAPS || FEATURE_CHECKERBOARDS || FEATURE_HETEROGENEOUS
// floor(x) for |x| < 2^31.
INLINE float floor_float(float x)
{
    const float whole = (float)(int)x;
    return whole > x ? whole - 1.0f : whole;
}
#endif

#if FEATURE_BITMAPS || FEATURE_HETEROGENEOUS
// Wraps a coordinate and converts it to texels: [0, size], or [0, 2 size] if it is mirrored. NaN, and numbers so large
// that they have no fraction, become 0.
INLINE float wrap_coordinate(uint flags, float x, float size)
{
    if (!(abs_float(x) < 0x1p24f)) x = flags & TEXTURE_CLAMP && x > 0.0f ? 1.0f : 0.0f;
    if (flags & TEXTURE_CLAMP) return size * MIN(MAX(x, 0.0f), 1.0f);
    if (flags & TEXTURE_MIRROR) return 2.0f * size * (0.5f * x - floor_float(0.5f * x));
    return size * (x - floor_float(x));
}

// Wraps the index of a texel near the image.
INLINE int wrap_texel(uint flags, int i, int size)
{
    if (flags & TEXTURE_MIRROR) {
        i = i < 0 ? -1 - i : i;
        i = i >= size ? 2 * size - 1 - i : i;
    } else if (!(flags & TEXTURE_CLAMP)) {
        i = i < 0 ? i + size : i;
        i = i >= size ? i - size : i;
    }
    return i < 0 ? 0 : MIN(i, size - 1);
}
#endif
