// Geometry and trigonometry of Vec2 and Vec3, affine transforms, ray offsets. Included by most kernel files.
#pragma once
#include "util/vec.h"

// Rec. 709, the digits of the standard: statistics and environment maps. On the host: isonoise/luminance.py.
INLINE float luminance(Vec3 rgb)
{
    return dot3(rgb, vec3(0.2126f, 0.7152f, 0.0722f));
}

// Rec. 709, Mitsuba's digits: textures and tints, which have to match Mitsuba. On the host: isonoise/scene/spectra.py.
INLINE float mitsuba_luminance(Vec3 rgb)
{
    return dot3(rgb, vec3(0.212671f, 0.715160f, 0.072169f));
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

// Unit vector along v; zero for zero. If the square would underflow or overflow, v is first scaled by a power of two.
INLINE Vec3 normalize3(Vec3 v)
{
    const float square = dot3(v, v);
    v = scale3(v, square < 1e-30f ? 0x1p100f : square > 1e30f ? 0x1p-80f : 1.0f);
    const float scaled_square = dot3(v, v);
    return scale3(v, scaled_square > 0.0f ? 1.0f / SQRT(scaled_square) : 0.0f);
}

// Cosine and sine of an angle in [-pi/4, pi/4]: Taylor polynomials. The first omitted terms are below 3e-8.
INLINE Vec2 cos_sin_small(float angle)
{
    const float a2 = angle * angle;
    const float c = 1.0f + a2 * (-0.5f + a2 * (4.1666667e-2f + a2 * (-1.3888889e-3f + a2 * 2.4801587e-5f)));
    const float s =
        angle * (1.0f + a2 * (-1.6666667e-1f + a2 * (8.3333333e-3f + a2 * (-1.9841270e-4f + a2 * 2.7557319e-6f))));
    return vec2(c, s);
}

// The angle of (x, y) in [-pi, pi]. The polynomial is fitted to atan(q) / q for |q| <= tan(pi / 8), relative error
// 2e-8.
INLINE float atan2_float(float y, float x)
{
    const float ax = abs_float(x), ay = abs_float(y), smaller = MIN(ax, ay), larger = MAX(ax, ay);
    const bool near_diagonal = smaller > 0.41421356f * larger;  // then the angle is measured from the diagonal
    const float q =
        (near_diagonal ? smaller - larger : smaller) / MAX(near_diagonal ? smaller + larger : larger, 1e-37f);
    const float q2 = q * q;
    float angle = q + q * q2 * (-0.33332956f + q2 * (0.19977924f + q2 * (-0.13879836f + q2 * 0.080602668f)));
    angle += near_diagonal ? M_PI_4_F : 0.0f;
    angle = ay > ax ? M_PI_2_F - angle : angle;
    return copy_sign(x < 0.0f ? M_PI_F - angle : angle, y);
}

// Cosine and sine of u turns, u in [0, 1].
INLINE Vec2 cos_sin_turns(float u)
{
    const int quadrant = (int)(4.0f * u + 0.5f);
    const Vec2 p = cos_sin_small(M_PI_2_F * (4.0f * u - (float)quadrant));
    const Vec2 rotated = quadrant & 1 ? vec2(-p.y, p.x) : p;
    return quadrant & 2 ? neg2(rotated) : rotated;
}

INLINE void load_matrix(__global const float* source, float* matrix)
{
#pragma unroll
    for (int i = 0; i < 12; ++i) matrix[i] = source[i];
}

// An affine 3x4 matrix, stored by rows, applied to a point or a direction.
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

// Applies the transposed linear part of m: with the world-to-object matrix a normal goes from object to world space.
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

// Area-preserving map from the unit square to the unit disk.
// Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997.
INLINE Vec2 square_to_disk(Vec2 u)
{
    const Vec2 c = sub2(scale2(u, 2.0f), splat2(1.0f));
    const bool x_is_larger = abs_float(c.x) > abs_float(c.y);
    const float r = x_is_larger ? c.x : c.y;
    if (r == 0.0f) return splat2(0.0f);
    const Vec2 p = scale2(cos_sin_small(M_PI_4_F * ((x_is_larger ? c.y : c.x) / r)), r);
    // per component: selecting structs compiles to a jump
    return vec2(x_is_larger ? p.x : p.y, x_is_larger ? p.y : p.x);
}

// Area-preserving map from the unit square to two barycentric coordinates of a triangle.
// Heitz, "A Low-Distortion Map Between Triangle and Square", 2019.
INLINE Vec2 square_to_triangle(Vec2 u)
{
    const float smaller = 0.5f * MIN(u.x, u.y);
    return u.y > u.x ? vec2(smaller, u.y - smaller) : vec2(u.x - smaller, smaller);
}

// A direction around +z with density cos / pi (Malley's method).
INLINE Vec3 square_to_hemisphere(Vec2 u)
{
    const Vec2 disk = square_to_disk(u);
    return vec3(disk.x, disk.y, SQRT(MAX(1.0f - dot2(disk, disk), 0.0f)));
}

// A direction on the sphere in a form that keeps precision near both poles.
typedef struct {
    Vec2 azimuth;       // unit vector
    float one_minus_z;  // of |z|
    bool is_upper;      // z > 0
} SpherePoint;

// Area-preserving map from the unit square to the unit sphere, by an octahedron whose lower half is unfolded around the
// upper one. Clarberg, "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD", Journal of Graphics Tools 13(3), 2008.
INLINE SpherePoint square_to_sphere_point(Vec2 u)
{
    const float x = 2.0f * u.x - 1.0f, y = 2.0f * u.y - 1.0f, ax = abs_float(x), ay = abs_float(y);
    const float to_equator = 1.0f - (ax + ay), r = 1.0f - abs_float(to_equator);
    const Vec2 p = cos_sin_small(r > 0.0f ? M_PI_4_F * ((ay - ax) / r) : 0.0f);  // from the diagonal of the quadrant
    SpherePoint point;
    point.azimuth = vec2(copy_sign(M_SQRT1_2_F * (p.x - p.y), x), copy_sign(M_SQRT1_2_F * (p.x + p.y), y));
    point.one_minus_z = r * r;
    point.is_upper = to_equator >= 0.0f;
    return point;
}

INLINE Vec3 square_to_sphere(Vec2 u)
{
    const SpherePoint p = square_to_sphere_point(u);
    const float z = 1.0f - p.one_minus_z, sine = SQRT(p.one_minus_z * (1.0f + z));
    return vec3_from(scale2(p.azimuth, sine), p.is_upper ? z : -z);
}

// Rotates a direction given relative to +z so that it is relative to `n`.
INLINE Vec3 rotate_to_normal(Vec3 n, Vec3 local_direction)
{
    Vec3 s, t;
    coordinate_system(n, &s, &t);
    return weighted_sum3(local_direction.x, s, local_direction.y, t, local_direction.z, n);
}

// Origin of a ray that leaves a surface and must not hit it again: the point, moved along the geometric normal by its
// error bound to the side of `direction`. Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 6.8.6.
INLINE Vec3 offset_ray_origin(Vec3 p, Vec3 error, Vec3 normal, Vec3 direction)
{
    const float distance = dot3(abs3(normal), error);
    const Vec3 offset = scale3(normal, copy_sign(distance, dot3(direction, normal)));
    // one more float spacing, for the rounding of this sum
    return add3(add3(p, offset), copy_sign3(scale3(p, 0x1p-23f), offset));
}
