// Textures: a colour, a number or the slope of a number at a point of a surface. Conventions are Mitsuba 3's: v = 0 is the top
// row of an image, texel centres lie at one half, nothing is clamped. Records and stores: host/isonoise/scene/textures.py.
#pragma once
#include "plain.h"

#if FEATURE_TEXTURES
// All that describes the textures of a scene; members that it does not need are NULL.
typedef struct {
    __global const Texture* records;
    __global const uchar4* bytes;      // texels of 8-bit images
    __global const float4* floats;     // texels of others, linear
    __global const float* srgb;        // linear value of an encoded byte
    __global const float* attributes;  // of meshes, RGB
    __global const uint* faces;        // vertices of the triangles
} Textures;

// Where a surface was met, as textures see it.
typedef struct {
    float2 uv;
    uint triangle;       // NONE on other surfaces: mesh attributes are zero there
    float2 barycentric;  // weights of its second and third corner
} TexturePoint;

// Luminance with the weights of Mitsuba 3, so that a number read from a coloured image is the same.
INLINE float texture_luminance(float3 rgb)
{
    return dot3(rgb, (float3)(0.212671f, 0.715160f, 0.072169f));
}

INLINE float2 texture_uv(__global const Texture* t, float2 uv)
{
    return (float2)(t->to_uv[0] * uv.x + t->to_uv[1] * uv.y + t->to_uv[2],
                    t->to_uv[3] * uv.x + t->to_uv[4] * uv.y + t->to_uv[5]);
}

// Largest whole number not above x, for |x| < 2^31.
INLINE float floor1(float x)
{
    const float whole = (float)(int)x;
    return whole > x ? whole - 1.0f : whole;
}

#if FEATURE_BITMAPS
INLINE float3 texel(const Textures* textures, __global const Texture* t, int2 at)
{
    const uint index = t->first + (uint)at.y * t->size[0] + (uint)at.x;
    if (t->flags & TEXTURE_FLOATS) return textures->floats[index].xyz;
    const uchar4 encoded = textures->bytes[index];
    if (t->flags & TEXTURE_RAW) return (float3)(encoded.x, encoded.y, encoded.z) * (1.0f / 255.0f);
    return (float3)(textures->srgb[encoded.x], textures->srgb[encoded.y], textures->srgb[encoded.z]);
}

// A coordinate brought near the image by its wrap mode, in texels: what is left of it lies in [0, size], for mirrored ones in
// [0, 2 size]. What is no number, or so large that it has no fraction, becomes 0.
INLINE float wrap_coordinate(uint flags, float x, float size)
{
    if (!(abs1(x) < 0x1p24f)) x = flags & TEXTURE_CLAMP && x > 0.0f ? 1.0f : 0.0f;
    if (flags & TEXTURE_CLAMP) return size * LESSER(GREATER(x, 0.0f), 1.0f);
    if (flags & TEXTURE_MIRROR) return 2.0f * size * (0.5f * x - floor1(0.5f * x));
    return size * (x - floor1(x));
}

// The texel that stands at a place near the image.
INLINE int wrap_texel(uint flags, int i, int size)
{
    if (flags & TEXTURE_MIRROR) {
        i = i < 0 ? -1 - i : i;
        i = i >= size ? 2 * size - 1 - i : i;
    } else if (!(flags & TEXTURE_CLAMP)) {
        i = i < 0 ? i + size : i;
        i = i >= size ? i - size : i;
    }
    return i < 0 ? 0 : LESSER(i, size - 1);
}

// The four texels around a point of the image, by row, and the weights of the later column and row.
INLINE float2 texels_around(const Textures* textures, __global const Texture* t, float2 uv, float3* v00, float3* v10,
                            float3* v01, float3* v11)
{
    const int width = (int)t->size[0], height = (int)t->size[1];
    const float x = wrap_coordinate(t->flags, uv.x, (float)width) - 0.5f;
    const float y = wrap_coordinate(t->flags, uv.y, (float)height) - 0.5f;
    const float left = floor1(x), top = floor1(y);
    const int x0 = wrap_texel(t->flags, (int)left, width), x1 = wrap_texel(t->flags, (int)left + 1, width);
    const int y0 = wrap_texel(t->flags, (int)top, height), y1 = wrap_texel(t->flags, (int)top + 1, height);
    *v00 = texel(textures, t, (int2)(x0, y0));
    *v10 = texel(textures, t, (int2)(x1, y0));
    *v01 = texel(textures, t, (int2)(x0, y1));
    *v11 = texel(textures, t, (int2)(x1, y1));
    return (float2)(x - left, y - top);
}

INLINE float3 bitmap_rgb(const Textures* textures, __global const Texture* t, float2 uv)
{
    uv = texture_uv(t, uv);
    if (t->flags & TEXTURE_NEAREST) {
        const float x = wrap_coordinate(t->flags, uv.x, (float)t->size[0]);
        const float y = wrap_coordinate(t->flags, uv.y, (float)t->size[1]);
        return texel(textures, t, (int2)(wrap_texel(t->flags, (int)x, (int)t->size[0]),
                                         wrap_texel(t->flags, (int)y, (int)t->size[1])));
    }
    float3 v00, v10, v01, v11;
    const float2 w = texels_around(textures, t, uv, &v00, &v10, &v01, &v11);
    return (1.0f - w.y) * ((1.0f - w.x) * v00 + w.x * v10) + w.y * ((1.0f - w.x) * v01 + w.x * v11);
}

// Slope of the luminance along the surface's u and v; zero where texels are not interpolated.
INLINE float2 bitmap_gradient(const Textures* textures, __global const Texture* t, float2 uv)
{
    if (t->flags & TEXTURE_NEAREST) return (float2)(0.0f);
    float3 v00, v10, v01, v11;
    const float2 w = texels_around(textures, t, texture_uv(t, uv), &v00, &v10, &v01, &v11);
    const float dx = texture_luminance((1.0f - w.y) * (v10 - v00) + w.y * (v11 - v01)) * (float)t->size[0];
    const float dy = texture_luminance((1.0f - w.x) * (v01 - v00) + w.x * (v11 - v10)) * (float)t->size[1];
    return (float2)(t->to_uv[0] * dx + t->to_uv[3] * dy, t->to_uv[1] * dx + t->to_uv[4] * dy);
}
#endif

#if FEATURE_CHECKERBOARDS
// Whether a point lies in a patch of the second colour.
INLINE bool in_second_patch(__global const Texture* t, float2 uv)
{
    uv = texture_uv(t, uv);
    return (uv.x - floor1(uv.x) > 0.5f) != (uv.y - floor1(uv.y) > 0.5f);
}
#endif

#if FEATURE_MESH_ATTRIBUTES
INLINE float3 mesh_attribute_rgb(const Textures* textures, __global const Texture* t, const TexturePoint* at)
{
    if (at->triangle == NONE) return (float3)(0.0f);
    const float3 scale = LOAD3(0, t->colour);
    if (t->flags & TEXTURE_PER_FACE) return scale * LOAD3(t->first + at->triangle, textures->attributes);
    const uint3 corner = LOAD3U(at->triangle, textures->faces) + t->first;
    const float u = at->barycentric.x, v = at->barycentric.y;
    return scale * ((1.0f - u - v) * LOAD3(corner.x, textures->attributes) + u * LOAD3(corner.y, textures->attributes) +
                    v * LOAD3(corner.z, textures->attributes));
}
#endif

// The texture that a checkerboard shows at a point, or the texture itself if it is none. As numbers the two colours change
// places: so it is in Mitsuba 3 (3.9.1, checkerboard.cpp, eval_1).
INLINE __global const Texture* texture_shown(const Textures* textures, uint texture, float2 uv, bool as_number)
{
    __global const Texture* t = textures->records + texture;
#if FEATURE_CHECKERBOARDS
    while (t->kind == TEXTURE_CHECKERBOARD) t = textures->records + t->nested[in_second_patch(t, uv) != as_number];
#endif
    return t;
}

// Linear RGB, and nothing.
OUTLINE float4 texture_rgb0(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = texture_shown(textures, texture, at->uv, false);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return (float4)(bitmap_rgb(textures, t, at->uv), 0.0f);
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return (float4)(mesh_attribute_rgb(textures, t, at), 0.0f);
#endif
    return (float4)(LOAD3(0, t->colour), 0.0f);
}

// Linear RGB. Intel's compiler for CPUs mislays a float3 that a function out of line returns to several work-items at once.
INLINE float3 texture_rgb(const Textures* textures, uint texture, const TexturePoint* at)
{
    return texture_rgb0(textures, texture, at).xyz;
}

// A number: the luminance, of plain colours the mean.
OUTLINE float texture_number(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = texture_shown(textures, texture, at->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return texture_luminance(bitmap_rgb(textures, t, at->uv));
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return texture_luminance(mesh_attribute_rgb(textures, t, at));
#endif
    return (t->colour[0] + t->colour[1] + t->colour[2]) * (1.0f / 3.0f);
}

// Slope of the number along u and v. Only bitmaps have one: what else there is is constant in pieces, or not along u and v.
OUTLINE float2 texture_gradient(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = texture_shown(textures, texture, at->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return bitmap_gradient(textures, t, at->uv);
#endif
    return (float2)(0.0f);
}
#endif
