// What the principled BSDF (bsdf/principled.h) and its thin variant (bsdf/principled_thin.h) have in common: roughness,
// Schlick's weights, tints and the shape of the diffuse base. Sources and names as in bsdf/principled.h.
#pragma once
#include "bsdf/microfacet.h"

#if HAS_PRINCIPLED_LOBES
INLINE MicrofacetDistribution principled_facets(float roughness, float anisotropic)
{
    const float aspect = SQRT(1.0f - 0.9f * anisotropic), square = roughness * roughness;
    return make_microfacets(MAX(square / aspect, 1e-3f), MAX(square * aspect, 1e-3f), 0u);
}

INLINE float schlick_weight(float cosine)
{
    const float m = MIN(MAX(1.0f - cosine, 0.0f), 1.0f), m2 = m * m;
    return m2 * m2 * m;
}

// Schlick's weight between the reflectance at normal incidence and 1; from the denser side it uses the angle of
// refraction.
INLINE float schlick_at_interface(float cosine, float eta)
{
    return schlick_weight(eta > 1.0f ? cosine : SQRT(MAX(1.0f - (1.0f - cosine * cosine) / (eta * eta), 0.0f)));
}

// Blend by `tint` from white to the colour divided by its luminance.
INLINE Vec3 tint_color(Vec3 colour, float tint)
{
    const float y = mitsuba_luminance(colour);
    const Vec3 pure = y > 0.0f ? div_scalar3(colour, y) : splat3(1.0f);
    return add3(splat3(1.0f), scale3(sub3(pure, splat3(1.0f)), tint));
}

// Blend by `tint` from the reflectance of a dielectric, by Fresnel's formula, to Schlick's approximation in the colour
// of the base. `towards_one`: `schlick_at_interface`.
INLINE Vec3 partly_tinted_reflectance(Vec3 base, float tint, float eta, float towards_one, float reflectance)
{
    const float n = (eta - 1.0f) / (eta + 1.0f);
    const Vec3 normal_incidence = scale3(tint_color(base, 1.0f), n * n);
    const Vec3 coloured = add3(normal_incidence, scale3(sub3(splat3(1.0f), normal_incidence), towards_one));
    return add3(splat3((1.0f - tint) * reflectance), scale3(coloured, tint));
}

// Diffuse reflection, retro-reflection and flattened subsurface scattering, relative to Lambert's constant.
INLINE float diffuse_shape(float roughness, float flatness, float cos_w, float cos_o, float cos_m)
{
    const float fw = schlick_weight(cos_w), fo = schlick_weight(cos_o), retro = 2.0f * roughness * cos_m * cos_m;
    const float lambert = (1.0f - 0.5f * fw) * (1.0f - 0.5f * fo) + retro * (fo + fw + fo * fw * (retro - 1.0f));
    const float flat = (1.0f + fo * (0.5f * retro - 1.0f)) * (1.0f + fw * (0.5f * retro - 1.0f));
    const float subsurface = 1.25f * (flat * (1.0f / (cos_o + cos_w) - 0.5f) + 0.5f);
    return lambert + flatness * (subsurface - lambert);
}
#endif
