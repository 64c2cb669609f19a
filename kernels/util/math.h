// Small vector helpers that several stages share.
#pragma once
#include "util/vec.h"

INLINE float luminance(Vec3 rgb)
{
    return dot3(rgb, vec3(0.2126f, 0.7152f, 0.0722f));  // Rec. 709
}

INLINE Vec3 cross3(Vec3 a, Vec3 b)
{
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// u a + v b + w c
INLINE Vec3 weighted_sum3(float u, Vec3 a, float v, Vec3 b, float w, Vec3 c)
{
    return add3(add3(scale3(a, u), scale3(b, v)), scale3(c, w));
}

INLINE Vec3 vec3_from(Vec2 v, float z)
{
    return vec3(v.x, v.y, z);
}

// Unit vector along v, zero for zero. What would vanish or overflow when squared is scaled first, by a power of two.
INLINE Vec3 normalize3(Vec3 v)
{
    const float square = dot3(v, v);
    v = scale3(v, square < 1e-30f ? 0x1p100f : square > 1e30f ? 0x1p-80f : 1.0f);
    const float scaled = dot3(v, v);
    return scale3(v, scaled > 0.0f ? 1.0f / SQRT(scaled) : 0.0f);
}

// Cosine and sine of an angle in [-pi/4, pi/4]: Taylor's polynomials, whose first omitted terms are below 3e-8 there.
INLINE Vec2 cos_sin_small(float angle)
{
    const float a2 = angle * angle;
    const float c = 1.0f + a2 * (-0.5f + a2 * (4.1666667e-2f + a2 * (-1.3888889e-3f + a2 * 2.4801587e-5f)));
    const float s = angle * (1.0f + a2 * (-1.6666667e-1f + a2 * (8.3333333e-3f + a2 * (-1.9841270e-4f + a2 * 2.7557319e-6f))));
    return vec2(c, s);
}

// The angle of (x, y) in [-pi, pi]. The polynomial is fitted to atan(q) / q over |q| <= tan(pi / 8), off by 2e-8 of it.
INLINE float atan2_float(float y, float x)
{
    const float ax = abs_float(x), ay = abs_float(y), less = MIN(ax, ay), more = MAX(ax, ay);
    const bool steep = less > 0.41421356f * more;  // then the angle is counted from the diagonal
    const float q = (steep ? less - more : less) / MAX(steep ? less + more : more, 1e-37f);
    const float q2 = q * q;
    float angle =
        q + q * q2 * (-0.33332956f + q2 * (0.19977924f + q2 * (-0.13879836f + q2 * 0.080602668f)));
    angle += steep ? M_PI_4_F : 0.0f;
    angle = ay > ax ? M_PI_2_F - angle : angle;
    return copy_sign(x < 0.0f ? M_PI_F - angle : angle, y);
}

// Point of the unit circle at u turns, u in [0, 1].
INLINE Vec2 cos_sin_turns(float u)
{
    const int quadrant = (int)(4.0f * u + 0.5f);
    const Vec2 p = cos_sin_small(M_PI_2_F * (4.0f * u - (float)quadrant));
    const Vec2 rotated = quadrant & 1 ? vec2(-p.y, p.x) : p;
    return quadrant & 2 ? neg2(rotated) : rotated;
}

INLINE void load_matrix(__global const float* from, float* to)
{
#pragma unroll
    for (int i = 0; i < 12; ++i) to[i] = from[i];
}

// Rows of an affine 3x4 matrix applied to a point and to a direction.
INLINE Vec3 transform_point(const float* m, Vec3 p)
{
    return vec3(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]);
}

INLINE Vec3 transform_direction(const float* m, Vec3 d)
{
    return vec3(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[4] * d.x + m[5] * d.y + m[6] * d.z,
                m[8] * d.x + m[9] * d.y + m[10] * d.z);
}

// Transposed linear part: takes a normal of object space to world space if m is the world-to-object matrix.
INLINE Vec3 transform_normal(const float* m, Vec3 n)
{
    return vec3(m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z,
                m[2] * n.x + m[6] * n.y + m[10] * n.z);
}

// Two unit vectors orthogonal to the unit vector n and each other.
// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
INLINE void coordinate_system(Vec3 n, Vec3* s, Vec3* t)
{
    const float sign = copy_sign(1.0f, n.z);
    const float a = -1.0f / (sign + n.z);
    const float b = n.x * n.y * a;
    *s = vec3(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *t = vec3(b, sign + n.y * n.y * a, -n.y);
}

// The unit square to the unit disk, areas kept. Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997.
INLINE Vec2 square_to_disk(Vec2 u)
{
    const Vec2 c = sub2(scale2(u, 2.0f), splat2(1.0f));
    const bool wide = abs_float(c.x) > abs_float(c.y);
    const float r = wide ? c.x : c.y;
    if (r == 0.0f) return splat2(0.0f);
    const Vec2 p = scale2(cos_sin_small(M_PI_4_F * ((wide ? c.y : c.x) / r)), r);
    return vec2(wide ? p.x : p.y, wide ? p.y : p.x);  // scalars: a choice of vectors becomes a jump
}

// Where a ray that leaves a surface may start without meeting it again: the point moved along the geometric normal past its
// own error bound, to the side of `direction`. Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 6.8.6.
INLINE Vec3 offset_ray_origin(Vec3 p, Vec3 error, Vec3 normal, Vec3 direction)
{
    const float distance = dot3(abs3(normal), error);
    const Vec3 offset = scale3(normal, copy_sign(distance, dot3(direction, normal)));
    // one more step of the float grid, for the rounding of this sum
    return add3(add3(p, offset), copy_sign3(scale3(p, 0x1p-23f), offset));
}
