// Small vector helpers that several stages share.
#pragma once

// Plain comparisons: one instruction where fmin and fmax need three for their NaN rules.
#define LESSER(a, b) ((a) < (b) ? (a) : (b))
#define GREATER(a, b) ((a) > (b) ? (a) : (b))

inline float luminance(float3 rgb)
{
    return dot(rgb, (float3)(0.2126f, 0.7152f, 0.0722f));  // Rec. 709
}

inline float largest(float3 v)
{
    return GREATER(GREATER(v.x, v.y), v.z);
}

// Unit vector along v; scaled first, so that edges of 10^-10 or 10^10 neither vanish nor overflow when squared.
inline float3 unit(float3 v)
{
    const float scale = largest(fabs(v));
    if (!(scale > 0.0f)) return (float3)(0.0f);
    v /= scale;
    return v / sqrt(dot(v, v));
}

// Rows of an affine 3x4 matrix applied to a point and to a direction.
inline float3 transform_point(const float* m, float3 p)
{
    return (float3)(fma(m[0], p.x, fma(m[1], p.y, fma(m[2], p.z, m[3]))),
                    fma(m[4], p.x, fma(m[5], p.y, fma(m[6], p.z, m[7]))),
                    fma(m[8], p.x, fma(m[9], p.y, fma(m[10], p.z, m[11]))));
}

inline float3 transform_direction(const float* m, float3 d)
{
    return (float3)(fma(m[0], d.x, fma(m[1], d.y, m[2] * d.z)), fma(m[4], d.x, fma(m[5], d.y, m[6] * d.z)),
                    fma(m[8], d.x, fma(m[9], d.y, m[10] * d.z)));
}

// Transposed linear part: takes a normal of object space to world space if m is the world-to-object matrix.
inline float3 transform_normal(const float* m, float3 n)
{
    return (float3)(fma(m[0], n.x, fma(m[4], n.y, m[8] * n.z)), fma(m[1], n.x, fma(m[5], n.y, m[9] * n.z)),
                    fma(m[2], n.x, fma(m[6], n.y, m[10] * n.z)));
}

// Two unit vectors orthogonal to the unit vector n and each other.
// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
inline void basis(float3 n, float3* s, float3* t)
{
    const float sign = copysign(1.0f, n.z);
    const float a = -1.0f / (sign + n.z);
    const float b = n.x * n.y * a;
    *s = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *t = (float3)(b, sign + n.y * n.y * a, -n.y);
}

// The unit square to the unit disk, areas kept. Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997.
inline float2 square_to_disk(float2 u)
{
    const float2 c = 2.0f * u - 1.0f;
    const bool wide = fabs(c.x) > fabs(c.y);
    const float r = wide ? c.x : c.y;
    if (r == 0.0f) return (float2)(0.0f);
    const float phi = wide ? M_PI_4_F * (c.y / c.x) : M_PI_2_F - M_PI_4_F * (c.x / c.y);
    return r * (float2)(cos(phi), sin(phi));
}

// Where a ray that leaves a surface may start without meeting it again: the point moved along the geometric normal past its
// own error bound, to the side of `direction`. Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 6.8.6.
inline float3 offset_origin(float3 p, float3 error, float3 normal, float3 direction)
{
    const float distance = dot(fabs(normal), error);
    const float3 offset = dot(direction, normal) < 0.0f ? -distance * normal : distance * normal;
    const float3 moved = p + offset;
    const float3 away = select((float3)(-INFINITY), (float3)(INFINITY), isgreater(offset, (float3)(0.0f)));
    return select(moved, nextafter(moved, away), isnotequal(offset, (float3)(0.0f)));
}
