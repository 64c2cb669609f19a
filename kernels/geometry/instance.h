// Instances: groups of shapes that have a space of their own and stand in several places of the world.
#pragma once
#include "geometry/analytic.h"

#if FEATURE_INSTANCES
// A ray of the world in the space of the instance's group. Affine: distances along it stay the same.
INLINE void ray_to_object(__global const Instance* instance, Vec3* origin, Vec3* direction)
{
    float m[12];
    load_matrix(instance->to_object, m);
    *origin = transform_point(m, *origin);
    *direction = transform_direction(m, *direction);
}

// The primitive that a ray starts on, as seen in the group of the instance `inside`: numbers of primitives are those of the group,
// so that in other instances of it they mean other surfaces. `start_instance`: the instance of that primitive, NONE if it stands in the world.
INLINE uint skip_in_instance(uint primitive, uint start_instance, uint inside)
{
    return start_instance == NONE || start_instance == inside ? primitive : NONE;
}
#endif
