// The diffuse base of smooth and rough plastic: light that the coat reflects back to the base is scattered there again,
// so the base's reflectance r becomes r / (1 - r R), with R the mean inner reflectance of the coat. Conventions are
// Mitsuba 3's.
#pragma once
#include "bsdf/context.h"

#if HAS_PLASTIC_BASE
// A row with the helper PLASTIC_BASE begins with the slots of _PLASTIC and has inner_reflectance as its first constant:
// the numbers are positions (host/isonoise/scene/material/bsdf_kinds.py).

// Reflectance of the base, with interreflection below the coat, over the coat's index of refraction squared.
INLINE Vec3 diffuse_base_reflectance(const BsdfContext* ctx)
{
    const Vec3 base = bsdf_rgb(ctx, SLOT_PLASTIC_DIFFUSE_REFLECTANCE);
    const float inner = material(ctx).constants[CONSTANT_PLASTIC_INNER_REFLECTANCE],
                eta = bsdf_float(ctx, SLOT_PLASTIC_IOR);
    const Vec3 loss = material(ctx).flags & BSDF_NONLINEAR ? scale3(base, inner) : splat3(inner);
    return div3(base, scale3(sub3(splat3(1.0f), loss), eta * eta));
}

// Probability of sampling the specular lobe, if the coat reflects this share: in proportion to the light that either
// lobe reflects.
INLINE float specular_probability(const BsdfContext* ctx, float reflectance)
{
    const Vec3 specular = bsdf_rgb(ctx, SLOT_PLASTIC_SPECULAR_REFLECTANCE),
               base = bsdf_rgb(ctx, SLOT_PLASTIC_DIFFUSE_REFLECTANCE);
    const float specular_part = reflectance * (specular.x + specular.y + specular.z);
    const float total = specular_part + (1.0f - reflectance) * (base.x + base.y + base.z);
    return total > 0.0f ? specular_part / total : 0.0f;
}
#endif
