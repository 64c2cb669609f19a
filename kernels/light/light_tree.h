// Picking one of many lights by a tree: from node to node, by how much light each child could send to the point that is lit.
// Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018; without the splitting, as
// in pbrt-v4 and Cycles, but with 8 children a node. What the tree holds is told in host/isonoise/scene/light_tree.py.
#pragma once
#include "util/math.h"

#if FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST
#define LIGHT_NODE_ROWS 12
#define POWER_FRACTION 0x1p-10f  // of the picks: so that nothing that a bound misses by rounding is never picked
#define MIN_TOTAL_IMPORTANCE 1e-30f  // of all children of a node: its inverse is a number; below it the shares decide

typedef struct {
    __global const float8* nodes;
    __global const uint* places;  // 8 * parent + slot of every light, then of every node; NONE has none
    uint lights;
} LightTree;

INLINE float8 sqrt8(float8 v)
{
    Float8Lanes lanes;
    lanes.vector = v;
    for (int i = 0; i < 8; ++i) lanes.lane[i] = SQRT(lanes.lane[i]);
    return lanes.vector;
}

// The lanes moved up by so many places, after zeros.
#define SHIFT_LANES_1(v) (float8)(0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5, v.s6)
#define SHIFT_LANES_2(v) (float8)(0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5)
#define SHIFT_LANES_4(v) (float8)(0.0f, 0.0f, 0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3)

INLINE float sum8(float8 v)
{
    const float4 four = v.lo + v.hi;
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}

INLINE float min_component8(float8 v)
{
    const float4 four = MIN(v.lo, v.hi);
    const float2 two = MIN(four.lo, four.hi);
    return MIN(two.x, two.y);
}

// `distance` times a cosine: between the one of a sphere's middle and its bound over the sphere, from which the light that
// arrives is left out only if none does. All three are given times the distance.
INLINE float8 cosine_estimate(float8 middle, float8 bound, float8 distance)
{
    return 0.5f * (MIN(MAX(bound, (float8)(0.0f)), distance) + MAX(middle, (float8)(0.0f)));
}

// How much light the children of a node could send to a point, in a unit of its own. `normal`: there; its w is 1 where light
// from all sides counts (then the rest is 0), else 0. The sine of half the angle under which a sphere appears is radius /
// distance; adding it to a cosine comes close to the cosine of the difference, and is 0 where that is.
INLINE float8 light_node_importance(__global const float8* node, Vec3 point, Vec4 normal)
{
    const float8 x = node[0] - point.x, y = node[1] - point.y, z = node[2] - point.z, radius = node[3];
    const float8 distance2 = MAX(x * x + y * y + z * z, (float8)(1e-36f)), distance = sqrt8(distance2);
    const float8 incidence = normal.x * x + normal.y * y + normal.z * z + normal.w * distance;
    const float8 along = -(node[5] * x + node[6] * y + node[7] * z), spread = node[8];
    const float8 across = sqrt8(MAX(distance2 - along * along, (float8)(0.0f)));
    const float8 emission = along > spread * distance ? distance : along * spread + across * node[9];
    const float8 cosines = cosine_estimate(emission, emission + radius, distance) * (1.0f / distance2) *
                           cosine_estimate(incidence, incidence + radius, distance);
    const float8 reach2 = MAX(distance2, 0.25f * radius * radius);
    const float8 weight = node[4] * cosines * (min_component8(reach2) / reach2);  // whatever the scale, it is below 1
    return emission + radius > node[10] * distance ? weight : (float8)(0.0f);
}

// Probability of a child, from its weight, those of all children, and its share of their intensity.
INLINE float child_pmf(float weight, float total, float share)
{
    return total > MIN_TOTAL_IMPORTANCE ? (1.0f - POWER_FRACTION) / total * weight + POWER_FRACTION * share : share;
}

// The last lane of a mask: from the exponent of its bits as a float. 0 if there is none.
INLINE uint last_set_lane(int8 mask)
{
    const int8 lanes = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 four = lanes.lo | lanes.hi;
    const int2 two = four.lo | four.hi;
    return (as_uint((float)(two.x | two.y | 1)) >> 23) - 127u;
}

// Picks a light by a random number in [0, 1), given as `u` and what lies below its last bit. At every node what is left of the
// number is scaled to [0, 1) again, as the sum of two floats, so that its 48 bits last for a million lights.
INLINE uint select_from_tree(const LightTree* tree, Vec3 point, Vec4 normal, float u, float u_low, float* probability)
{
    *probability = 1.0f;
    float rest = 0x1p-24f * u_low;
    int node_index = 0;
    do {
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * node_index;
        Float8Lanes weight, part, begin;
        part.vector = weight.vector = light_node_importance(node, point, normal);
        const float total = sum8(weight.vector);
        float scale = (1.0f - POWER_FRACTION) / total;
        if (!(total > MIN_TOTAL_IMPORTANCE)) {
            part.vector = node[4];
            scale = 1.0f;
        } else if (u >= 1.0f - POWER_FRACTION) {
            part.vector = node[4];
            scale = 1.0f;
            u = (u - (1.0f - POWER_FRACTION)) / POWER_FRACTION;
            rest /= POWER_FRACTION;
        }
        // sums of the parts before each lane
        const float8 one = SHIFT_LANES_1(part.vector), two = one + SHIFT_LANES_1(one), four = two + SHIFT_LANES_2(two);
        begin.vector = scale * (four + SHIFT_LANES_4(four));
        const uint child = last_set_lane((begin.vector <= u) & (part.vector > 0.0f));

        const float width = scale * part.lane[child], inverse = 1.0f / width;
        const float past = u - begin.lane[child], lost = (u - past) - begin.lane[child], whole = past * inverse;
        rest = (FMA(-whole, width, past) + (lost + rest)) * inverse;
        u = MAX(whole + rest, 0.0f);
        rest -= u - whole;
        u = MIN(u, 0x1.fffffep-1f);
        *probability *= child_pmf(weight.lane[child], total, ((__global const float*)(node + 4))[child]);
        node_index = ((__global const int*)(node + 11))[child];
    } while (node_index > 0);
    return (uint)~node_index;
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Probability with which `select_from_tree` would have picked this light.
INLINE float light_tree_pmf(const LightTree* tree, uint light, Vec3 point, Vec4 normal)
{
    uint place = tree->places[light];
    float probability = place == NONE ? 0.0f : 1.0f;
    while (place != NONE) {
        const uint parent = place >> 3, slot = place & 7u;
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * parent;
        Float8Lanes weight;
        weight.vector = light_node_importance(node, point, normal);
        probability *= child_pmf(weight.lane[slot], sum8(weight.vector), ((__global const float*)(node + 4))[slot]);
        place = tree->places[tree->lights + parent];
    }
    return probability;
}
#endif
#endif
