// Textures: a colour, a number or the slope of a number at a point of a surface. Conventions are Mitsuba 3's: v = 0 is
// the top row of an image, texel centres lie at one half, nothing is clamped. Records and stores:
// host/isonoise/scene/textures.py.
#pragma once
#include "util/math.h"

#if FEATURE_TEXTURES
// All that describes the textures of a scene; members that it does not need are NULL.
typedef struct {
    __global const Texture* records;
    __global const uchar* bytes;       // texels of 8-bit images, four numbers each
    __global const float* floats;      // texels of others, linear, four numbers each
    __global const float* srgb;        // linear value of an encoded byte
    __global const float* attributes;  // of meshes, RGB
    __global const uint* faces;        // vertices of the triangles
} Textures;

// Where a surface was met, as textures see it.
typedef struct {
    Vec2 uv;
    uint triangle;     // NONE on other surfaces: mesh attributes are zero there
    Vec2 barycentric;  // weights of its second and third corner
} TexturePoint;

#if FEATURE_BITMAPS || FEATURE_CHECKERBOARDS
INLINE Vec2 texture_uv(__global const Texture* t, Vec2 uv)
{
    return vec2(t->to_uv[0] * uv.x + t->to_uv[1] * uv.y + t->to_uv[2],
                t->to_uv[3] * uv.x + t->to_uv[4] * uv.y + t->to_uv[5]);
}

// Largest whole number not above x, for |x| < 2^31.
INLINE float floor_float(float x)
{
    const float whole = (float)(int)x;
    return whole > x ? whole - 1.0f : whole;
}
#endif

#if FEATURE_BITMAPS
INLINE Vec3 texel(const Textures* textures, __global const Texture* t, int x, int y)
{
    const uint index = t->first + (uint)y * t->size[0] + (uint)x;
    if (t->flags & TEXTURE_FLOATS) return LOAD3(0, textures->floats + 4u * (size_t)index);
    const uint encoded = ((__global const uint*)textures->bytes)[index];  // at once: devices are little-endian
    const uint r = encoded & 0xFFu, g = encoded >> 8 & 0xFFu, b = encoded >> 16 & 0xFFu;
    if (t->flags & TEXTURE_RAW) return scale3(vec3((float)r, (float)g, (float)b), 1.0f / 255.0f);
    return vec3(textures->srgb[r], textures->srgb[g], textures->srgb[b]);
}

// A coordinate brought near the image by its wrap mode, in texels: what is left of it lies in [0, size], for mirrored
// ones in [0, 2 size]. What is no number, or so large that it has no fraction, becomes 0.
INLINE float wrap_coordinate(uint flags, float x, float size)
{
    if (!(abs_float(x) < 0x1p24f)) x = flags & TEXTURE_CLAMP && x > 0.0f ? 1.0f : 0.0f;
    if (flags & TEXTURE_CLAMP) return size * MIN(MAX(x, 0.0f), 1.0f);
    if (flags & TEXTURE_MIRROR) return 2.0f * size * (0.5f * x - floor_float(0.5f * x));
    return size * (x - floor_float(x));
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
    return i < 0 ? 0 : MIN(i, size - 1);
}

// The four texels around a point of the image, by row, and the weights of the later column and row. Where texels are
// not interpolated the first is the one that the point lies in, and the weights are 0.
INLINE Vec2 texel_neighbourhood(const Textures* textures, __global const Texture* t, Vec2 uv, Vec3* v00, Vec3* v10,
                                Vec3* v01, Vec3* v11)
{
    const int width = (int)t->size[0], height = (int)t->size[1];
    const bool nearest = t->flags & TEXTURE_NEAREST;
    const float to_center = nearest ? 0.0f : 0.5f;
    const float x = wrap_coordinate(t->flags, uv.x, (float)width) - to_center;
    const float y = wrap_coordinate(t->flags, uv.y, (float)height) - to_center;
    const float left = floor_float(x), top = floor_float(y);
    const int x0 = wrap_texel(t->flags, (int)left, width), x1 = wrap_texel(t->flags, (int)left + 1, width);
    const int y0 = wrap_texel(t->flags, (int)top, height), y1 = wrap_texel(t->flags, (int)top + 1, height);
    *v00 = texel(textures, t, x0, y0);
    *v10 = texel(textures, t, x1, y0);
    *v01 = texel(textures, t, x0, y1);
    *v11 = texel(textures, t, x1, y1);
    return nearest ? splat2(0.0f) : vec2(x - left, y - top);
}

INLINE Vec3 bitmap_rgb(const Textures* textures, __global const Texture* t, Vec2 uv)
{
    Vec3 v00, v10, v01, v11;
    const Vec2 w = texel_neighbourhood(textures, t, texture_uv(t, uv), &v00, &v10, &v01, &v11);
    const Vec3 upper = add3(scale3(v00, 1.0f - w.x), scale3(v10, w.x)),
               lower = add3(scale3(v01, 1.0f - w.x), scale3(v11, w.x));
    return add3(scale3(upper, 1.0f - w.y), scale3(lower, w.y));
}

#if FEATURE_BUMP
// Slope of the luminance along the surface's u and v; zero where texels are not interpolated.
INLINE Vec2 bitmap_gradient(const Textures* textures, __global const Texture* t, Vec2 uv)
{
    if (t->flags & TEXTURE_NEAREST) return splat2(0.0f);
    Vec3 v00, v10, v01, v11;
    const Vec2 w = texel_neighbourhood(textures, t, texture_uv(t, uv), &v00, &v10, &v01, &v11);
    const Vec3 across = add3(scale3(sub3(v10, v00), 1.0f - w.y), scale3(sub3(v11, v01), w.y));
    const Vec3 down = add3(scale3(sub3(v01, v00), 1.0f - w.x), scale3(sub3(v11, v10), w.x));
    const float dx = mitsuba_luminance(across) * (float)t->size[0], dy = mitsuba_luminance(down) * (float)t->size[1];
    return vec2(t->to_uv[0] * dx + t->to_uv[3] * dy, t->to_uv[1] * dx + t->to_uv[4] * dy);
}
#endif
#endif

#if FEATURE_CHECKERBOARDS
// Whether a point lies in a patch of the second colour.
INLINE bool is_second_checker_color(__global const Texture* t, Vec2 uv)
{
    uv = texture_uv(t, uv);
    return (uv.x - floor_float(uv.x) > 0.5f) != (uv.y - floor_float(uv.y) > 0.5f);
}
#endif

#if FEATURE_MESH_ATTRIBUTES
INLINE Vec3 mesh_attribute_rgb(const Textures* textures, __global const Texture* t, const TexturePoint* at)
{
    if (at->triangle == NONE) return splat3(0.0f);
    const Vec3 scale = LOAD3(0, t->colour);
    if (t->flags & TEXTURE_PER_FACE) return mul3(scale, LOAD3(t->first + at->triangle, textures->attributes));
    __global const uint* corner = textures->faces + 3u * at->triangle;
    const float u = at->barycentric.x, v = at->barycentric.y;
    const uint first = t->first;  // it may be below 0: with a corner's number it is none of these that wraps around
    return mul3(scale, weighted_sum3(1.0f - u - v, LOAD3(first + corner[0], textures->attributes), u,
                                     LOAD3(first + corner[1], textures->attributes), v,
                                     LOAD3(first + corner[2], textures->attributes)));
}
#endif

// The texture that a checkerboard shows at a point, or the texture itself if it is none. As numbers the two colours
// change places: so it is in Mitsuba 3 (3.9.1, checkerboard.cpp, eval_1).
INLINE __global const Texture* resolve_texture(const Textures* textures, uint texture, Vec2 uv, bool as_number)
{
    __global const Texture* t = textures->records + texture;
#if FEATURE_CHECKERBOARDS
    while (t->kind == TEXTURE_CHECKERBOARD)
        t = textures->records + t->nested[is_second_checker_color(t, uv) != as_number];
#endif
    return t;
}

// Where many paths are looked at together a call would part them; else the code is long, and its callers many.
#if LANES > 1 && !FEATURE_CHECKERBOARDS
#define TEXTURE_FUNCTION INLINE
#else
#define TEXTURE_FUNCTION NOINLINE
#endif

// Linear RGB, and nothing.
TEXTURE_FUNCTION Vec4 texture_rgb_vec4(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = resolve_texture(textures, texture, at->uv, false);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return vec4_from(bitmap_rgb(textures, t, at->uv), 0.0f);
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return vec4_from(mesh_attribute_rgb(textures, t, at), 0.0f);
#endif
    return vec4_from(LOAD3(0, t->colour), 0.0f);
}

// Linear RGB. Intel's compiler for CPUs mislays a Vec3 that a function out of line returns to several work-items at
// once.
INLINE Vec3 texture_rgb(const Textures* textures, uint texture, const TexturePoint* at)
{
    return xyz(texture_rgb_vec4(textures, texture, at));
}

// A number: the luminance, of plain colours the mean.
TEXTURE_FUNCTION float texture_float(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = resolve_texture(textures, texture, at->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return mitsuba_luminance(bitmap_rgb(textures, t, at->uv));
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return mitsuba_luminance(mesh_attribute_rgb(textures, t, at));
#endif
    return (t->colour[0] + t->colour[1] + t->colour[2]) * (1.0f / 3.0f);
}

#if FEATURE_BUMP
// Slope of the number along u and v. Only bitmaps have one: what else there is is constant in pieces, or not along u
// and v.
TEXTURE_FUNCTION Vec2 texture_gradient(const Textures* textures, uint texture, const TexturePoint* at)
{
    __global const Texture* t = resolve_texture(textures, texture, at->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return bitmap_gradient(textures, t, at->uv);
#endif
    return splat2(0.0f);
}
#endif
#endif
