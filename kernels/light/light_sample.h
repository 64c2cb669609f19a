// A point sampled on a light, or a direction towards it. Returned by `sample_light` and the headers of the kinds of
// light.
#pragma once
#include "geometry/surface.h"

#if FEATURE_NEXT_EVENT
typedef struct {
    Vec3 position, error, normal;  // normal is zero if the light has no surface
    uint primitive;                // that the position is on and that a ray hits there first, with TWO_TRIANGLES_BIT;
                                   // else NONE
    Vec3 direction;                // unit, from the reference point to the light
    Vec3 radiance;                 // unoccluded, before the division by pdf; 0 if the light faces away
    float pdf;  // in solid angle, times the probability of selecting the light; of delta lights that alone
    bool is_delta, is_infinite;
} LightSample;

// Every member is set: in a loop over lanes an unset one would be the previous lane's.
INLINE LightSample empty_light_sample(void)
{
    LightSample none;
    none.position = none.error = none.normal = none.direction = none.radiance = splat3(0.0f);
    none.primitive = NONE;
    none.pdf = 0.0f;
    none.is_delta = none.is_infinite = false;
    return none;
}
#endif
