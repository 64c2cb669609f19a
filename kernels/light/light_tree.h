// Light sampling with a light tree, for scenes of many lights, called by next-event estimation and MIS in `shade`:
// descends from node to node with probability proportional to the importance of the children for the shading point.
// Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018; without
// splitting, as in pbrt-v4 and Cycles, but with 8 children a node. host/isonoise/scene/light/light_tree.py documents
// the nodes.
#pragma once
#include "util/math.h"

#if FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST
// Rows of a node, each a float8 with one vector lane a child: 0-2 center and 3 radius of the bounding sphere, 4
// fraction of the power, 5-7 axis of the cone of normals, 8 cosine and 9 sine of its half angle, 10 cosine of the angle
// to a normal up to which light is emitted, 11 child (int bits): > 0 a node, else ~light.
#define LIGHT_NODE_ROWS 12
#define DEFENSIVE_FRACTION 0x1p-10f  // of the selections go by power alone, in case rounding makes an importance 0
#define MIN_TOTAL_IMPORTANCE 1e-30f  // its inverse is finite; below it selections go by power alone

typedef struct {
    __global const float8* nodes;
    // 8 * parent node + child slot, of every light, then of every node; NONE without a parent
    __global const uint* parents;
    uint light_count;
} LightTree;

INLINE float8 sqrt8(float8 v)
{
    Float8Lanes lanes;
    lanes.vector = v;
    for (int i = 0; i < 8; ++i) lanes.lane[i] = SQRT(lanes.lane[i]);
    return lanes.vector;
}

// Shift the vector lanes up by 1, 2 or 4 and fill with zeros.
#define SHIFT_LANES_1(v) (float8)(0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5, v.s6)
#define SHIFT_LANES_2(v) (float8)(0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5)
#define SHIFT_LANES_4(v) (float8)(0.0f, 0.0f, 0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3)

INLINE float sum8(float8 v)
{
    const float4 sum4 = v.lo + v.hi;
    const float2 sum2 = sum4.lo + sum4.hi;
    return sum2.x + sum2.y;
}

INLINE float min_component8(float8 v)
{
    const float4 min4 = MIN(v.lo, v.hi);
    const float2 min2 = MIN(min4.lo, min4.hi);
    return MIN(min2.x, min2.y);
}

// Estimates a cosine over a bounding sphere: the mean of the cosine at the centre and its upper bound over the sphere,
// both clamped to [0, 1]. It is 0 only if no light can arrive. The cosines and the result are multiplied by the
// distance.
INLINE float8 cosine_estimate(float8 center_cosine, float8 max_cosine, float8 distance)
{
    return 0.5f * (MIN(MAX(max_cosine, (float8)(0.0f)), distance) + MAX(center_cosine, (float8)(0.0f)));
}

// Importance of the children of a node for a point: an estimate of the irradiance, without unit. `normal`: at the
// point; w is 1 where light from all sides counts (then xyz is 0), else 0. A sphere subtends an angle with sine radius
// / distance to either side of its centre; adding this sine to a cosine approximates the cosine of the angle minus
// that, and is 0 where it is 0.
INLINE float8 light_node_importance(__global const float8* node, Vec3 point, Vec4 normal)
{
    const float8 x = node[0] - point.x, y = node[1] - point.y, z = node[2] - point.z, radius = node[3];
    const float8 distance2 = MAX(x * x + y * y + z * z, (float8)(1e-36f)), distance = sqrt8(distance2);
    // cosines times the distance
    const float8 incidence = normal.x * x + normal.y * y + normal.z * z + normal.w * distance;
    const float8 cosine = -(node[5] * x + node[6] * y + node[7] * z), cos_spread = node[8], sin_spread = node[9];
    const float8 sine = sqrt8(MAX(distance2 - cosine * cosine, (float8)(0.0f)));
    const float8 emission = cosine > cos_spread * distance ? distance : cosine * cos_spread + sine * sin_spread;
    const float8 cosines = cosine_estimate(emission, emission + radius, distance) * (1.0f / distance2) *
                           cosine_estimate(incidence, incidence + radius, distance);
    const float8 clamped2 = MAX(distance2, 0.25f * radius * radius);
    const float8 importance = node[4] * cosines * (min_component8(clamped2) / clamped2);  // below 1 at any scale
    return emission + radius > node[10] * distance ? importance : (float8)(0.0f);
}

// Probability of a child, from its importance, that of all children, and its fraction of their power.
INLINE float child_pmf(float importance, float total, float power_fraction)
{
    if (!(total > MIN_TOTAL_IMPORTANCE)) return power_fraction;
    return (1.0f - DEFENSIVE_FRACTION) / total * importance + DEFENSIVE_FRACTION * power_fraction;
}

// Index of the last vector lane that is set in a mask, from the exponent of its bits as a float; 0 if none is set.
INLINE uint last_set_lane(int8 mask)
{
    return (as_uint((float)(mask_bits(mask) | 1u)) >> 23) - 127u;
}

// Selects a light by the random number *random + 2^-24 u_low, in [0, 1). `pmf` receives its probability. At every node
// the random number is rescaled to [0, 1), as a double-float: its 48 bits are enough for a million lights. *random
// receives what is left of it.
INLINE uint select_from_tree(const LightTree* tree, Vec3 point, Vec4 normal, float* random, float u_low, float* pmf)
{
    float u = *random;
    *pmf = 1.0f;
    u_low = 0x1p-24f * u_low;
    int node_index = 0;
    do {
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * node_index;
        // the mixture of importance and power: u selects one of them, then a child by its weight
        Float8Lanes importance, weight, cdf;
        weight.vector = importance.vector = light_node_importance(node, point, normal);
        const float total = sum8(importance.vector);
        float scale = (1.0f - DEFENSIVE_FRACTION) / total;
        if (!(total > MIN_TOTAL_IMPORTANCE)) {
            weight.vector = node[4];
            scale = 1.0f;
        } else if (u >= 1.0f - DEFENSIVE_FRACTION) {
            weight.vector = node[4];
            scale = 1.0f;
            u = (u - (1.0f - DEFENSIVE_FRACTION)) / DEFENSIVE_FRACTION;
            u_low /= DEFENSIVE_FRACTION;
        }
        // CDF: exclusive prefix sum of the weights
        const float8 sum1 = SHIFT_LANES_1(weight.vector), sum2 = sum1 + SHIFT_LANES_1(sum1);
        const float8 sum4 = sum2 + SHIFT_LANES_2(sum2);
        cdf.vector = scale * (sum4 + SHIFT_LANES_4(sum4));
        const uint child = last_set_lane((cdf.vector <= u) & (weight.vector > 0.0f));

        // (u - cdf) / width as a double-float, clamped to [0, 1)
        const float width = scale * weight.lane[child], inverse = 1.0f / width;
        const float difference = u - cdf.lane[child], rounding = (u - difference) - cdf.lane[child];
        const float quotient = difference * inverse;
        u_low = (FMA(-quotient, width, difference) + (rounding + u_low)) * inverse;
        u = MAX(quotient + u_low, 0.0f);
        u_low -= u - quotient;
        u = MIN(u, 0x1.fffffep-1f);
        *pmf *= child_pmf(importance.lane[child], total, ((__global const float*)(node + 4))[child]);
        node_index = ((__global const int*)(node + 11))[child];
    } while (node_index > 0);
    *random = u;
    return (uint)~node_index;
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Probability of selecting this light with `select_from_tree`, for MIS: climbs from the leaf to the root.
INLINE float light_tree_pmf(const LightTree* tree, uint light, Vec3 point, Vec4 normal)
{
    uint parent_slot = tree->parents[light];
    float pmf = parent_slot == NONE ? 0.0f : 1.0f;
    while (parent_slot != NONE) {
        const uint parent = parent_slot >> 3, slot = parent_slot & 7u;
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * parent;
        Float8Lanes importance;
        importance.vector = light_node_importance(node, point, normal);
        pmf *= child_pmf(importance.lane[slot], sum8(importance.vector), ((__global const float*)(node + 4))[slot]);
        parent_slot = tree->parents[tree->light_count + parent];
    }
    return pmf;
}
#endif
#endif
