// Instances: groups of shapes with an object space of their own, placed in the world by affine transforms.
// Used by traversal (geometry/traverse.h) and by surfaces of hits (geometry/surface.h).
#pragma once
#include "geometry/analytic.h"

#if FEATURE_INSTANCES
// Takes a ray from world space to the instance's object space. The transform is affine, so distances t stay the same.
INLINE void ray_to_object(__global const Instance* instance, Vec3* origin, Vec3* direction)
{
    float m[12];
    load_matrix(instance->to_object, m);
    *origin = transform_point(m, *origin);
    *direction = transform_direction(m, *direction);
}

// The primitive to skip inside `instance` for a ray that starts on `start_primitive` of `start_instance` (NONE: the
// world). Primitive numbers are those of the group, so in other instances the same number is another surface.
INLINE uint skip_in_instance(uint start_primitive, uint start_instance, uint instance)
{
    return start_instance == NONE || start_instance == instance ? start_primitive : NONE;
}
#endif
