// Small vector helpers that several stages share.
#pragma once
#include "plain.h"

INLINE float luminance(float3 rgb)
{
    return dot3(rgb, (float3)(0.2126f, 0.7152f, 0.0722f));  // Rec. 709
}

INLINE float3 cross3(float3 a, float3 b)
{
    return (float3)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// Unit vector along v, zero for zero. What would vanish or overflow when squared is scaled first.
INLINE float3 unit(float3 v)
{
    const float square = dot3(v, v);
    if (square > 1e-30f && square < 1e30f) return v * (1.0f / SQRT(square));
    const float scale = largest(abs3(v));
    if (!(scale > 0.0f)) return (float3)(0.0f);
    v /= scale;
    return v / SQRT(dot3(v, v));
}

// Cosine and sine of an angle in [-pi/4, pi/4]: Taylor's polynomials, whose first omitted terms are below 3e-8 there.
INLINE float2 small_angle(float angle)
{
    const float a2 = angle * angle;
    const float c = 1.0f + a2 * (-0.5f + a2 * (4.1666667e-2f + a2 * (-1.3888889e-3f + a2 * 2.4801587e-5f)));
    const float s = angle * (1.0f + a2 * (-1.6666667e-1f + a2 * (8.3333333e-3f + a2 * (-1.9841270e-4f + a2 * 2.7557319e-6f))));
    return (float2)(c, s);
}

// Point of the unit circle at u turns, u in [0, 1].
INLINE float2 circle(float u)
{
    const int quadrant = (int)(4.0f * u + 0.5f);
    const float2 p = small_angle(M_PI_2_F * (4.0f * u - (float)quadrant));
    const float2 turned = quadrant & 1 ? (float2)(-p.y, p.x) : p;
    return quadrant & 2 ? -turned : turned;
}

// Rows of an affine 3x4 matrix applied to a point and to a direction.
INLINE float3 transform_point(const float* m, float3 p)
{
    return (float3)(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3],
                    m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                    m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]);
}

INLINE float3 transform_direction(const float* m, float3 d)
{
    return (float3)(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[4] * d.x + m[5] * d.y + m[6] * d.z,
                    m[8] * d.x + m[9] * d.y + m[10] * d.z);
}

// Transposed linear part: takes a normal of object space to world space if m is the world-to-object matrix.
INLINE float3 transform_normal(const float* m, float3 n)
{
    return (float3)(m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z,
                    m[2] * n.x + m[6] * n.y + m[10] * n.z);
}

// Two unit vectors orthogonal to the unit vector n and each other.
// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
INLINE void basis(float3 n, float3* s, float3* t)
{
    const float sign = with_sign(1.0f, n.z);
    const float a = -1.0f / (sign + n.z);
    const float b = n.x * n.y * a;
    *s = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *t = (float3)(b, sign + n.y * n.y * a, -n.y);
}

// The unit square to the unit disk, areas kept. Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997.
INLINE float2 square_to_disk(float2 u)
{
    const float2 c = 2.0f * u - 1.0f;
    const bool wide = abs1(c.x) > abs1(c.y);
    const float r = wide ? c.x : c.y;
    if (r == 0.0f) return (float2)(0.0f);
    const float2 p = r * small_angle(M_PI_4_F * ((wide ? c.y : c.x) / r));
    return (float2)(wide ? p.x : p.y, wide ? p.y : p.x);  // scalars: a choice of vectors becomes a jump
}

// Where a ray that leaves a surface may start without meeting it again: the point moved along the geometric normal past its
// own error bound, to the side of `direction`. Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 6.8.6.
INLINE float3 offset_origin(float3 p, float3 error, float3 normal, float3 direction)
{
    const float distance = dot3(abs3(normal), error);
    const float3 offset = with_sign(distance, dot3(direction, normal)) * normal;
    // one more step of the float grid, for the rounding of this sum
    return p + offset + with_sign3(0x1p-23f * p, offset);
}
