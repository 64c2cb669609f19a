// Fresnel reflectance of dielectrics and metals.
#pragma once
#include "util/math.h"

#if HAS_DIELECTRIC_FRESNEL
// Unpolarised reflectance of a smooth dielectric interface. *cos_t gets the cosine of the refracted direction, 0 with
// total reflection. `eta`: index of refraction of the far side over that of the near side. Born and Wolf, Principles of
// Optics, 7th ed., 1.5.2.
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

#if HAS_CONDUCTOR_FRESNEL
// Square roots of numbers that rounding may have made slightly negative.
INLINE Vec3 safe_sqrt3(Vec3 v)
{
    return vec3(SQRT(MAX(v.x, 0.0f)), SQRT(MAX(v.y, 0.0f)), SQRT(MAX(v.z, 0.0f)));
}

// Unpolarised reflectance of a metal with index eta + ik per channel. Born and Wolf, 14.2, in the form of
// S. Lagarde, "Memo on Fresnel equations", 2013.
INLINE Vec3 fresnel_conductor(float cos_i, Vec3 eta, Vec3 k)
{
    const float cos2 = cos_i * cos_i, sin2 = 1.0f - cos2;
    const Vec3 eta2 = mul3(eta, eta), k2 = mul3(k, k);
    const Vec3 t0 = sub3(sub3(eta2, k2), splat3(sin2));
    const Vec3 a2_plus_b2 = safe_sqrt3(add3(mul3(t0, t0), mul3(scale3(eta2, 4.0f), k2)));
    const Vec3 a = safe_sqrt3(scale3(add3(a2_plus_b2, t0), 0.5f));
    const Vec3 t1 = add3(a2_plus_b2, splat3(cos2)), t2 = scale3(a, 2.0f * cos_i);
    const Vec3 perpendicular = div3(sub3(t1, t2), add3(t1, t2));
    // 1e-30: at normal incidence t3 and t4 vanish in channels with eta = k = 0, which some metals have
    const Vec3 t3 = add3(add3(scale3(a2_plus_b2, cos2), splat3(sin2 * sin2)), splat3(1e-30f)), t4 = scale3(t2, sin2);
    const Vec3 parallel = div3(mul3(perpendicular, sub3(t3, t4)), add3(t3, t4));
    return scale3(add3(parallel, perpendicular), 0.5f);
}
#endif
