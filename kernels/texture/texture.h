// Texture lookup: a colour, a number, or the gradient of a number at a point of a surface. Called for parameters of
// BSDFs (bsdf/context.h) and for emission. Conventions are Mitsuba 3's: v = 0 is the top row of an image, texel centres
// are at half-integers, values are not clamped. The tables are made by host/isonoise/scene/material/textures.py.
#pragma once
#include "texture/wrap.h"
#include "util/math.h"

#if FEATURE_TEXTURES
// The textures of a scene. Tables that the scene does not need are NULL.
typedef struct {
    __global const Texture* records;
    __global const uchar* bytes;       // texels of 8-bit images, 4 bytes each
    __global const float* floats;      // texels of other images, linear, 4 floats each
    __global const float* srgb;        // linear values of the 256 sRGB bytes
    __global const float* attributes;  // mesh attributes, RGB
    __global const uint* faces;        // vertex indices of the triangles
} Textures;

// A point of a surface, as textures need it.
typedef struct {
    Vec2 uv;
    uint triangle;     // NONE on analytic shapes, where mesh attributes are zero
    Vec2 barycentric;  // weights of the second and third corner
} TexturePoint;

#if FEATURE_BITMAPS || FEATURE_CHECKERBOARDS
INLINE Vec2 texture_uv(__global const Texture* t, Vec2 uv)
{
    return vec2(t->to_uv[0] * uv.x + t->to_uv[1] * uv.y + t->to_uv[2],
                t->to_uv[3] * uv.x + t->to_uv[4] * uv.y + t->to_uv[5]);
}
#endif

#if FEATURE_BITMAPS
INLINE Vec3 texel(const Textures* textures, __global const Texture* t, int x, int y)
{
    const uint index = t->first + (uint)y * t->size[0] + (uint)x;
    if (t->flags & TEXTURE_FLOATS) return LOAD3(0, textures->floats + 4u * (size_t)index);
    const uint encoded = ((__global const uint*)textures->bytes)[index];  // one load: devices are little-endian
    const uint r = encoded & 0xFFu, g = encoded >> 8 & 0xFFu, b = encoded >> 16 & 0xFFu;
    if (t->flags & TEXTURE_RAW) return scale3(vec3((float)r, (float)g, (float)b), 1.0f / 255.0f);
    return vec3(textures->srgb[r], textures->srgb[g], textures->srgb[b]);
}

// The four texels around a point of the image. Returns the weights of the second column and row. For the filter
// 'nearest', v00 is the texel that contains the point, and the weights are 0.
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
// Gradient of the luminance over the surface's u and v; zero for the filter 'nearest'.
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
// Whether a point is in a square of the second colour.
INLINE bool is_second_checker_color(__global const Texture* t, Vec2 uv)
{
    uv = texture_uv(t, uv);
    return (uv.x - floor_float(uv.x) > 0.5f) != (uv.y - floor_float(uv.y) > 0.5f);
}
#endif

#if FEATURE_MESH_ATTRIBUTES
INLINE Vec3 mesh_attribute_rgb(const Textures* textures, __global const Texture* t, const TexturePoint* point)
{
    if (point->triangle == NONE) return splat3(0.0f);
    const Vec3 scale = LOAD3(0, t->colour);
    if (t->flags & TEXTURE_PER_FACE) return mul3(scale, LOAD3(t->first + point->triangle, textures->attributes));
    __global const uint* corner = textures->faces + 3u * point->triangle;
    const float u = point->barycentric.x, v = point->barycentric.y;
    const uint first = t->first;  // may be negative modulo 2^32; first + corner is in range again
    return mul3(scale, weighted_sum3(1.0f - u - v, LOAD3(first + corner[0], textures->attributes), u,
                                     LOAD3(first + corner[1], textures->attributes), v,
                                     LOAD3(first + corner[2], textures->attributes)));
}
#endif

// The texture that a checkerboard shows at a point; any other texture is returned itself. Read as numbers, the two
// colours are swapped, as in Mitsuba 3 (3.9.1, checkerboard.cpp, eval_1).
INLINE __global const Texture* resolve_texture(const Textures* textures, uint texture, Vec2 uv, bool as_number)
{
    __global const Texture* t = textures->records + texture;
#if FEATURE_CHECKERBOARDS
    while (t->kind == TEXTURE_CHECKERBOARD)
        t = textures->records + t->nested[is_second_checker_color(t, uv) != as_number];
#endif
    return t;
}

// Loops over lanes vectorise only without calls. Elsewhere the code is too long to inline into its many callers.
#if LANES > 1 && !FEATURE_CHECKERBOARDS
#define TEXTURE_FUNCTION INLINE
#else
#define TEXTURE_FUNCTION NOINLINE
#endif

// Linear RGB and 0.
TEXTURE_FUNCTION Vec4 texture_rgb_vec4(const Textures* textures, uint texture, const TexturePoint* point)
{
    __global const Texture* t = resolve_texture(textures, texture, point->uv, false);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return vec4_from(bitmap_rgb(textures, t, point->uv), 0.0f);
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return vec4_from(mesh_attribute_rgb(textures, t, point), 0.0f);
#endif
    return vec4_from(LOAD3(0, t->colour), 0.0f);
}

// Linear RGB. The function that is not inlined returns a Vec4, because Intel's CPU compiler corrupts a Vec3 that such a
// function returns to several work-items at once.
INLINE Vec3 texture_rgb(const Textures* textures, uint texture, const TexturePoint* point)
{
    return xyz(texture_rgb_vec4(textures, texture, point));
}

// A number: the luminance of bitmaps and mesh attributes, the mean of the channels of plain colours.
TEXTURE_FUNCTION float texture_float(const Textures* textures, uint texture, const TexturePoint* point)
{
    __global const Texture* t = resolve_texture(textures, texture, point->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return mitsuba_luminance(bitmap_rgb(textures, t, point->uv));
#endif
#if FEATURE_MESH_ATTRIBUTES
    if (t->kind == TEXTURE_MESH_ATTRIBUTE) return mitsuba_luminance(mesh_attribute_rgb(textures, t, point));
#endif
    return (t->colour[0] + t->colour[1] + t->colour[2]) * (1.0f / 3.0f);
}

#if FEATURE_BUMP
// Gradient of the number over u and v. Only bitmaps have one: checkerboards are piecewise constant, mesh attributes do
// not vary with u and v.
TEXTURE_FUNCTION Vec2 texture_gradient(const Textures* textures, uint texture, const TexturePoint* point)
{
    __global const Texture* t = resolve_texture(textures, texture, point->uv, true);
#if FEATURE_BITMAPS
    if (t->kind == TEXTURE_BITMAP) return bitmap_gradient(textures, t, point->uv);
#endif
    return splat2(0.0f);
}
#endif
#endif
