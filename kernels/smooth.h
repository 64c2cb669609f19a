// Diffuse reflection and smooth boundaries, to one side, of a thin sheet or into a body.
#pragma once
#include "shading.h"

#if FEATURE_DIFFUSE || FEATURE_PLASTIC || FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED
// A direction about z with density cos / pi.
INLINE Vec3 square_to_hemisphere(Vec2 u)
{
    const Vec2 disk = square_to_disk(u);
    return vec3(disk.x, disk.y, SQRT(GREATER(1.0f - dot2(disk, disk), 0.0f)));
}
#endif

#if FEATURE_DIFFUSE || FEATURE_PLASTIC
// A direction about z as one about n.
INLINE Vec3 around(Vec3 n, Vec3 about_z)
{
    Vec3 s, t;
    basis(n, &s, &t);
    return combine3(about_z.x, s, about_z.y, t, about_z.z, n);
}
#endif

#if FEATURE_DIFFUSE
#if FEATURE_NEXT_EVENT
// bsdf * cos and the pdf of sampling `wo`.
INLINE Vec3 diffuse_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(at->normal, wo);
    const bool lit = at->cos_i > 0.0f && cos_o > 0.0f;
    *pdf = lit ? cos_o * M_1_PI_F : 0.0f;
    return scale3(rgb_parameter(at, 0), *pdf);
}
#endif

INLINE BsdfSample diffuse_sample(const Shading* at, Vec2 u)
{
    const Vec3 about_z = square_to_hemisphere(u);
    BsdfSample sample = nothing_sampled();
    sample.direction = around(at->normal, about_z);
    sample.weight = at->cos_i > 0.0f && about_z.z > 0.0f ? rgb_parameter(at, 0) : all3(0.0f);
    sample.pdf = about_z.z * M_1_PI_F;
    sample.eta = 1.0f;
    return sample;
}
#endif

#define HAS_BOUNDARIES                                                                                            \
    (FEATURE_DIELECTRIC || FEATURE_THIN_DIELECTRIC || FEATURE_ROUGH_DIELECTRIC || FEATURE_PLASTIC ||                   \
     FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED)

#if HAS_BOUNDARIES
// Unpolarised reflectance of a smooth boundary; cos_t gets the cosine of the refracted direction, 0 if all is reflected.
// Born and Wolf, Principles of Optics, 7th ed., 1.5.2. `eta` is index of the far side over that of the near side.
INLINE float fresnel_dielectric(float cos_i, float eta, float* cos_t)
{
    const float sin2_t = (1.0f - cos_i * cos_i) / (eta * eta);
    *cos_t = 0.0f;
    if (eta == 1.0f) {
        *cos_t = cos_i;
        return 0.0f;
    }
    if (sin2_t >= 1.0f) return 1.0f;
    *cos_t = SQRT(1.0f - sin2_t);
    const float parallel = (eta * cos_i - *cos_t) / (eta * cos_i + *cos_t);
    const float perpendicular = (cos_i - eta * *cos_t) / (cos_i + eta * *cos_t);
    return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}
#endif

#if FEATURE_DIELECTRIC
INLINE BsdfSample dielectric_sample(const Shading* at, float u)
{
    const bool inside = at->cos_i < 0.0f;
    const float index = number_parameter(at, 2), eta = inside ? 1.0f / index : index, cos_i = abs1(at->cos_i);
    const Vec3 facing = inside ? neg3(at->normal) : at->normal;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_i, eta, &cos_t);
    BsdfSample sample = nothing_sampled();
    sample.pdf = -1.0f;
    if (u <= reflectance) {
        sample.direction = unit(sub3(scale3(facing, 2.0f * cos_i), at->wi));
        sample.weight = rgb_parameter(at, 0);
        sample.eta = 1.0f;
    } else {
        sample.direction = unit(sub3(scale3(facing, cos_i / eta - cos_t), scale3(at->wi, 1.0f / eta)));
        // radiance is squeezed into a smaller solid angle: Veach's thesis, 5.2
        sample.weight = over3(rgb_parameter(at, 1), eta * eta);
        sample.eta = eta;
    }
    return sample;
}
#endif

#if FEATURE_THIN_DIELECTRIC
// Two boundaries so close that what is refracted goes on as it came; reflections between them are summed.
INLINE float thin_dielectric_reflectance(const Shading* at)
{
    float cos_t = 0.0f;
    const float once = fresnel_dielectric(abs1(at->cos_i), number_parameter(at, 2), &cos_t);
    return 2.0f * once / (1.0f + once);
}

INLINE BsdfSample thin_dielectric_sample(const Shading* at, float u)
{
    const bool reflects = u <= thin_dielectric_reflectance(at);
    BsdfSample sample = nothing_sampled();
    sample.direction = reflects ? unit(sub3(scale3(at->normal, 2.0f * at->cos_i), at->wi)) : neg3(at->wi);
    sample.weight = rgb_parameter(at, reflects ? 0 : 1);
    sample.pdf = reflects ? -1.0f : STRAIGHT;
    sample.eta = 1.0f;
    return sample;
}
#endif

#if FEATURE_CONDUCTOR || FEATURE_ROUGH_CONDUCTOR
// Square roots; rounding may have made of 0 less than that.
INLINE Vec3 root3(Vec3 v)
{
    return vec3(SQRT(GREATER(v.x, 0.0f)), SQRT(GREATER(v.y, 0.0f)), SQRT(GREATER(v.z, 0.0f)));
}

// Unpolarised reflectance of a metal, from eta + ik per colour. Born and Wolf, 14.2, in the form of
// S. Lagarde, "Memo on Fresnel equations", 2013.
INLINE Vec3 fresnel_conductor(float cos_i, Vec3 eta, Vec3 k)
{
    const float cos2 = cos_i * cos_i, sin2 = 1.0f - cos2;
    const Vec3 eta2 = mul3(eta, eta), k2 = mul3(k, k);
    const Vec3 t0 = sub3(sub3(eta2, k2), all3(sin2));
    const Vec3 a2_plus_b2 = root3(add3(mul3(t0, t0), mul3(scale3(eta2, 4.0f), k2)));
    const Vec3 a = root3(scale3(add3(a2_plus_b2, t0), 0.5f));
    const Vec3 t1 = add3(a2_plus_b2, all3(cos2)), t2 = scale3(a, 2.0f * cos_i);
    const Vec3 perpendicular = div3(sub3(t1, t2), add3(t1, t2));
    // at normal incidence all of t3 and t4 vanishes where eta and k are 0, as of some metal in one colour
    const Vec3 t3 = add3(add3(scale3(a2_plus_b2, cos2), all3(sin2 * sin2)), all3(1e-30f)), t4 = scale3(t2, sin2);
    const Vec3 parallel = div3(mul3(perpendicular, sub3(t3, t4)), add3(t3, t4));
    return scale3(add3(parallel, perpendicular), 0.5f);
}
#endif

#if FEATURE_CONDUCTOR
INLINE BsdfSample conductor_sample(const Shading* at)
{
    BsdfSample sample = nothing_sampled();
    sample.direction = unit(sub3(scale3(at->normal, 2.0f * at->cos_i), at->wi));
    if (at->cos_i > 0.0f)
        sample.weight = mul3(rgb_parameter(at, 0), fresnel_conductor(at->cos_i, rgb_parameter(at, 2), rgb_parameter(at, 3)));
    sample.pdf = -1.0f;
    sample.eta = 1.0f;
    return sample;
}
#endif
