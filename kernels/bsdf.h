// Scattering at a surface. Directions are unit and point away from the surface; cosines are against the shading normal.
#pragma once
#include "vectors.h"

// Mirrored and refracted directions are made unit again: over a path of many such steps their rounding would add up.
typedef struct {
    float3 direction;  // unit
    float3 weight;  // bsdf * |cos| / pdf
    float pdf;      // solid angle; negative if the lobe is a delta function
    float eta;      // index of the side that `direction` is on over that of the incident side
} BsdfSample;

// Whether next-event estimation can find anything.
INLINE bool bsdf_is_smooth(__global const Bsdf* bsdf)
{
#if FEATURE_DIFFUSE && (FEATURE_DIELECTRIC || FEATURE_CONDUCTOR)
    return bsdf->kind == BSDF_DIFFUSE;
#else
    return FEATURE_DIFFUSE;
#endif
}

#if FEATURE_DIFFUSE
// bsdf * cos and the pdf of sampling `wo`.
INLINE float3 diffuse_eval(__global const Bsdf* bsdf, float cos_i, float cos_o, float* pdf)
{
    const bool lit = cos_i > 0.0f && cos_o > 0.0f;
    *pdf = lit ? cos_o * M_1_PI_F : 0.0f;
    return *pdf * LOAD3(0, bsdf->reflectance);
}

INLINE BsdfSample diffuse_sample(__global const Bsdf* bsdf, float3 normal, float cos_i, float2 u)
{
    const float2 disk = square_to_disk(u);
    const float cos_o = SQRT(GREATER(1.0f - dot2(disk, disk), 0.0f));
    float3 s, t;
    basis(normal, &s, &t);
    BsdfSample sample;
    sample.direction = disk.x * s + disk.y * t + cos_o * normal;
    sample.weight = cos_i > 0.0f && cos_o > 0.0f ? LOAD3(0, bsdf->reflectance) : (float3)(0.0f);
    sample.pdf = cos_o * M_1_PI_F;
    sample.eta = 1.0f;
    return sample;
}
#endif

#if FEATURE_DIELECTRIC
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

INLINE BsdfSample dielectric_sample(__global const Bsdf* bsdf, float3 normal, float3 wi, float cos_i, float u)
{
    const bool inside = cos_i < 0.0f;
    const float eta = inside ? 1.0f / bsdf->eta[0] : bsdf->eta[0];
    const float3 facing = inside ? -normal : normal;
    float cos_t;
    const float reflectance = fresnel_dielectric(abs1(cos_i), eta, &cos_t);
    BsdfSample sample;
    sample.pdf = -1.0f;
    if (u <= reflectance) {
        sample.direction = unit(2.0f * abs1(cos_i) * facing - wi);
        sample.weight = LOAD3(0, bsdf->reflectance);
        sample.eta = 1.0f;
    } else {
        sample.direction = unit((abs1(cos_i) / eta - cos_t) * facing - wi / eta);
        // radiance is squeezed into a smaller solid angle: Veach's thesis, 5.2
        sample.weight = LOAD3(0, bsdf->transmittance) / (eta * eta);
        sample.eta = eta;
    }
    return sample;
}
#endif

#if FEATURE_CONDUCTOR
// Unpolarised reflectance of a metal, from eta + ik per colour. Born and Wolf, 14.2, in the form of
// S. Lagarde, "Memo on Fresnel equations", 2013.
INLINE float3 fresnel_conductor(float cos_i, float3 eta, float3 k)
{
    const float cos2 = cos_i * cos_i, sin2 = 1.0f - cos2;
    const float3 eta2 = eta * eta, k2 = k * k;
    const float3 t0 = eta2 - k2 - sin2;
    const float3 a2_plus_b2 = sqrt(t0 * t0 + 4.0f * eta2 * k2);
    const float3 a = sqrt(fmax(0.5f * (a2_plus_b2 + t0), 0.0f));
    const float3 t1 = a2_plus_b2 + cos2, t2 = 2.0f * cos_i * a;
    const float3 perpendicular = (t1 - t2) / (t1 + t2);
    const float3 t3 = cos2 * a2_plus_b2 + sin2 * sin2, t4 = t2 * sin2;
    const float3 parallel = perpendicular * (t3 - t4) / (t3 + t4);
    return 0.5f * (parallel + perpendicular);
}

INLINE BsdfSample conductor_sample(__global const Bsdf* bsdf, float3 normal, float3 wi, float cos_i)
{
    BsdfSample sample;
    sample.direction = unit(2.0f * cos_i * normal - wi);
    sample.weight = (float3)(0.0f);
    if (cos_i > 0.0f)
        sample.weight = LOAD3(0, bsdf->reflectance) * fresnel_conductor(cos_i, LOAD3(0, bsdf->eta), LOAD3(0, bsdf->k));
    sample.pdf = -1.0f;
    sample.eta = 1.0f;
    return sample;
}
#endif

// `u`: lobe, direction x, direction y.
INLINE BsdfSample bsdf_sample(__global const Bsdf* bsdf, float3 normal, float3 wi, float cos_i, float3 u)
{
    BsdfSample sample;
    sample.weight = (float3)(0.0f);
    switch (bsdf->kind) {
#if FEATURE_DIFFUSE
    case BSDF_DIFFUSE: sample = diffuse_sample(bsdf, normal, cos_i, u.yz); break;
#endif
#if FEATURE_DIELECTRIC
    case BSDF_DIELECTRIC: sample = dielectric_sample(bsdf, normal, wi, cos_i, u.x); break;
#endif
#if FEATURE_CONDUCTOR
    case BSDF_CONDUCTOR: sample = conductor_sample(bsdf, normal, wi, cos_i); break;
#endif
    default: break;
    }
    return sample;
}
