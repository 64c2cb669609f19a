// Microfacet distributions, masking and sampling of normals, in the shading frame: z is the surface's normal.
// Used by the rough BSDFs. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; names
// and numbers as in Mitsuba 3.
#pragma once
#include "bsdf/context.h"

#define MIN_ALPHA 1e-4f

#if FEATURE_BECKMANN || HAS_EXP_APPROX
// e^x for x <= 0, relative error 2e-7: 2^k times Taylor's polynomial on |rest| <= ln(2) / 2.
INLINE float exp_approx(float x)
{
    if (x < -87.0f) return 0.0f;
    const int k = (int)(1.44269504f * x - 0.5f);
    const float r = x - (float)k * 0.693145752f - (float)k * 1.42860677e-6f;
    const float r2 = r * r;
    const float p = (1.0f + r) + r2 * (0.5f + r * 1.6666667e-1f) +
                    r2 * r2 * (4.1666667e-2f + r * 8.3333333e-3f + r2 * 1.3888889e-3f);
    return p * as_float((uint)(k + 127) << 23);
}

// Natural logarithm of a positive normal number: the series of atanh on [1 / sqrt(2), sqrt(2)].
INLINE float log_approx(float x)
{
    const uint shifted = as_uint(x) - 0x3F3504F3u;  // of 1 / sqrt(2)
    const float m = as_float((shifted & 0x7FFFFFu) + 0x3F3504F3u), k = (float)((int)shifted >> 23);
    const float t = (m - 1.0f) / (m + 1.0f), t2 = t * t;
    return k * 0.693147181f +
           t * (2.0f + t2 * (6.6666667e-1f + t2 * (0.4f + t2 * (2.8571429e-1f + t2 * 2.2222222e-1f))));
}
#endif

#if FEATURE_BECKMANN
// erf(x) for x >= 0, absolute error 1.5e-7; `gaussian` is e^(-x^2). Abramowitz and Stegun, Handbook of Mathematical
// Functions, 7.1.26.
INLINE float erf_approx(float x, float gaussian)
{
    const float t = 1.0f / (1.0f + 0.3275911f * x);
    const float p = -0.284496736f + t * (1.421413741f + t * (-1.453152027f + t * 1.061405429f));
    return 1.0f - gaussian * t * (0.254829592f + t * p);
}

// M. Giles, "Approximating the erfinv Function", GPU Computing Gems, Jade Edition, 2011. -1 < x < 1.
INLINE float erfinv_approx(float x)
{
    float w = -log_approx((1.0f - x) * (1.0f + x)), p;
    if (w < 5.0f) {
        w -= 2.5f;
        const float w2 = w * w, w4 = w2 * w2;  // short dependency chains: latency is the only cost here
        p = (1.50140941f + w * 0.246640727f) + w2 * (-0.00417768164f - w * 0.00125372503f) +
            w4 * ((0.00021858087f - w * 4.39150654e-06f) + w2 * (-3.5233877e-06f + w * 3.43273939e-07f)) +
            w4 * w4 * 2.81022636e-08f;
    } else {
        w = SQRT(w) - 3.0f;
        p = -0.000200214257f;
        p = 0.000100950558f + p * w;
        p = 0.00134934322f + p * w;
        p = -0.00367342844f + p * w;
        p = 0.00573950773f + p * w;
        p = -0.0076224613f + p * w;
        p = 0.00943887047f + p * w;
        p = 1.00167406f + p * w;
        p = 2.83297682f + p * w;
    }
    return p * x;
}
#endif

#if HAS_MICROFACETS
typedef struct {
    float alpha_u, alpha_v;  // roughness along x and y
    bool is_ggx;             // else Beckmann
    bool sample_all;         // sample all normals, not only the visible ones
} MicrofacetDistribution;

INLINE MicrofacetDistribution make_microfacets(float alpha_u, float alpha_v, uint flags)
{
    MicrofacetDistribution d;
    d.alpha_u = MAX(alpha_u, MIN_ALPHA);
    d.alpha_v = MAX(alpha_v, MIN_ALPHA);
    d.is_ggx = !(FEATURE_BECKMANN && (flags & BSDF_BECKMANN));
    d.sample_all = FEATURE_SAMPLE_ALL_NORMALS && (flags & BSDF_SAMPLE_ALL_NORMALS);
    return d;
}

// D(m): area of the facets with normal m per area of the surface.
INLINE float microfacet_d(const MicrofacetDistribution* d, Vec3 m)
{
    const float x = m.x / d->alpha_u, y = m.y / d->alpha_v, slope2 = x * x + y * y, cos2 = m.z * m.z;
    const float area = M_PI_F * d->alpha_u * d->alpha_v;
    float density;
#if FEATURE_BECKMANN
    if (!d->is_ggx)
        density = exp_approx(-slope2 / cos2) / (area * cos2 * cos2);
    else
#endif
        density = 1.0f / (area * (slope2 + cos2) * (slope2 + cos2));
    return density * m.z > 1e-20f ? density : 0.0f;  // Mitsuba's bound; also catches NaN
}

// Smith's G1(v) / |cos v|, without a division by the cosine, which may vanish. G1 is the share of the facets visible
// from v.
INLINE float smith_g1_over_cos(const MicrofacetDistribution* d, Vec3 v)
{
    const float x = d->alpha_u * v.x, y = d->alpha_v * v.y, q = x * x + y * y, z = abs_float(v.z);
#if FEATURE_BECKMANN
    if (!d->is_ggx) {  // Walter's fit, to 0.35 %
        const float s = SQRT(q);
        return z >= 1.6f * s ? 1.0f / z : (3.535f * s + 2.181f * z) / (q + 2.276f * s * z + 2.577f * z * z);
    }
#endif
    return 2.0f / (z + SQRT(z * z + q));
}

INLINE float smith_g1(const MicrofacetDistribution* d, Vec3 v)
{
    return smith_g1_over_cos(d, v) * abs_float(v.z);
}

// Pdf of `sample_microfacet` in solid angle for a normal m visible from w; `density` is D(m).
INLINE float microfacet_pdf(const MicrofacetDistribution* d, Vec3 w, Vec3 m, float density)
{
    return density * (d->sample_all ? m.z : smith_g1_over_cos(d, w) * dot3(w, m));
}

// The normals seen from v, where the surface is stretched to roughness 1, are halfway between v and the directions of a
// spherical cap with uniform density. J. Dupuy and A. Benyoub, "Sampling Visible GGX Normals with Spherical Caps",
// Computer Graphics Forum 42(8), 2023; the cap by a concentric map, written without cancellation at its edge.
INLINE Vec3 sample_visible_ggx(const MicrofacetDistribution* d, Vec3 w, Vec2 u)
{
    const Vec3 v = normalize3(vec3(d->alpha_u * w.x, d->alpha_v * w.y, w.z));
    const Vec2 p = square_to_disk(u);
    // r^2 of the disk is (1 - z) / (1 + v.z) of the cap: 1 at its edge, where z = -v.z
    const float height = 1.0f + v.z, to_edge = MAX(1.0f - dot2(p, p), 0x1p-26f);
    const float scale = SQRT(v.x * v.x + v.y * v.y + height * height * to_edge);
    return normalize3(vec3(d->alpha_u * (p.x * scale + v.x), d->alpha_v * (p.y * scale + v.y), height * to_edge));
}

#if FEATURE_BECKMANN
// Visible slope along the plane of incidence of a surface of roughness 1; `tangent` is that of the angle of incidence.
// Inverts the distribution function in the variable x = erf(slope), in which it is nearly linear, by two steps of
// Halley's method, to 3e-5. After W. Jakob, "An Improved Visible Normal Sampling Routine for the Beckmann
// Distribution", 2014, whose steps are Newton's.
INLINE float sample_visible_slope_beckmann(float tangent, float u)
{
    const float cotangent = 1.0f / tangent, bound = 0x1.fffffep-1f;  // of no tangent: 1 / 0, and erf is 1
    const float end = exp_approx(-cotangent * cotangent), most = erf_approx(cotangent, end);
    const float t = 0.564189584f * tangent, target = u * (1.0f + most + t * end);  // 1 / sqrt(pi)
    float x = most - (most + 1.0f) * erf_approx(SQRT(-log_approx(u)), u);          // the solution at grazing incidence
    float slope = 0.0f, step = 0.0f;
#pragma unroll
    for (uint i = 0; i < 2u; ++i) {
        x = MIN(MAX(x, -bound), bound);
        slope = erfinv_approx(x);
        const float gaussian = exp_approx(-slope * slope), rate = 0.886226925f / gaussian;  // sqrt(pi) / 2
        const float value = 1.0f + x + t * gaussian - target, derivative = MAX(1.0f - slope * tangent, 1e-6f);
        const float square = derivative * derivative;
        const float next = x - value * derivative / MAX(square + 0.5f * value * tangent * rate, 0.25f * square);
        step = rate * (MIN(MAX(next, -bound), MIN(most, bound)) - x);
        x = next;
    }
    return slope + step * (1.0f + slope * step);  // erf's inverse about the last one but one
}

INLINE Vec3 sample_visible_beckmann(const MicrofacetDistribution* d, Vec3 w, Vec2 u)
{
    u = vec2(MAX(u.x, 0x1p-24f), MAX(u.y, 0x1p-24f));
    const float x = d->alpha_u * w.x, y = d->alpha_v * w.y, s = SQRT(x * x + y * y);
    const float cos_phi = s > 0.0f ? x / s : 1.0f, sin_phi = s > 0.0f ? y / s : 0.0f;
    const float along = sample_visible_slope_beckmann(s / w.z, u.x), across = erfinv_approx(2.0f * u.y - 1.0f);
    return normalize3(vec3(-d->alpha_u * (cos_phi * along - sin_phi * across),
                           -d->alpha_v * (sin_phi * along + cos_phi * across), 1.0f));
}
#endif

#if FEATURE_SAMPLE_ALL_NORMALS
// Samples with density D(m) cos m: slopes of a surface of roughness 1, stretched. r^2 of the disk is the distribution
// function of the squared slope.
INLINE Vec3 sample_all_microfacets(const MicrofacetDistribution* d, Vec2 u)
{
    const Vec2 p = square_to_disk(u);
    const float r2 = dot2(p, p), to_edge = MAX(1.0f - r2, 0x1p-26f);
    float square = 1.0f / to_edge;  // (slope / r)^2
#if FEATURE_BECKMANN
    if (!d->is_ggx) square = r2 > 0x1p-20f ? -log_approx(to_edge) / r2 : 1.0f;
#endif
    const float scale = SQRT(square);
    return normalize3(vec3(d->alpha_u * p.x * scale, d->alpha_v * p.y * scale, 1.0f));
}
#endif

// Samples the normal of a facet for a path from w, w.z > 0.
INLINE Vec3 sample_microfacet(const MicrofacetDistribution* d, Vec3 w, Vec2 u)
{
#if FEATURE_SAMPLE_ALL_NORMALS
    if (d->sample_all) return sample_all_microfacets(d, u);
#endif
#if FEATURE_BECKMANN
    if (!d->is_ggx) return sample_visible_beckmann(d, w, u);
#endif
    return sample_visible_ggx(d, w, u);
}

#if (FEATURE_ROUGH_DIELECTRIC && FEATURE_NEXT_EVENT) || HAS_PRINCIPLED_LOBES
// The microfacet of a rough interface that reflects or refracts w, w.z > 0, into o: its normal m, the cosines between m
// and w, o, and the Jacobian |dm / do|. `eta`: index of the far side over that of the near side. Returns whether there
// is such a facet.
INLINE bool generalized_half_vector(Vec3 w, Vec3 o, float eta, Vec3* m, float* cos_w, float* cos_o, float* jacobian)
{
    const bool reflects = o.z > 0.0f;
    const Vec3 between = reflects ? add3(w, o) : add3(w, scale3(o, eta));
    *m = normalize3(between);
    *m = scale3(*m, copy_sign(1.0f, (*m).z));
    *cos_w = dot3(w, *m);
    *cos_o = dot3(o, *m);
    *jacobian = reflects ? 0.25f / *cos_o : eta * eta * abs_float(*cos_o) / dot3(between, between);
    return *cos_w > 0.0f && *cos_o * o.z > 0.0f && *jacobian < INFINITY;
}
#endif
#endif
