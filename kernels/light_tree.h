// Picking one of many lights by a tree: from node to node, by how much light each child could send to the point that is lit.
// Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018; without the splitting, as
// in pbrt-v4 and Cycles, but with 8 children a node. What the tree holds is told in host/isonoise/scene/light_tree.py.
#pragma once
#include "vectors.h"

#if FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST
#define LIGHT_NODE_ROWS 12
#define BY_SHARE 0x1p-10f  // of the picks: so that nothing that a bound misses by rounding is never picked
#define LEAST_WEIGHT 1e-30f  // of all children of a node: its inverse is a number; below it the shares decide

typedef struct {
    __global const float8* nodes;
    __global const uint* places;  // 8 * parent + slot of every light, then of every node; NONE has none
    uint lights;
} LightTree;

INLINE float8 root_of(float8 v)
{
    Lanes lanes;
    lanes.all = v;
    for (int i = 0; i < 8; ++i) lanes.lane[i] = SQRT(lanes.lane[i]);
    return lanes.all;
}

// The lanes moved up by so many places, after zeros.
#define UP_BY_1(v) (float8)(0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5, v.s6)
#define UP_BY_2(v) (float8)(0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3, v.s4, v.s5)
#define UP_BY_4(v) (float8)(0.0f, 0.0f, 0.0f, 0.0f, v.s0, v.s1, v.s2, v.s3)

INLINE float sum_of(float8 v)
{
    const float4 four = v.lo + v.hi;
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}

INLINE float least_of(float8 v)
{
    const float4 four = LESSER(v.lo, v.hi);
    const float2 two = LESSER(four.lo, four.hi);
    return LESSER(two.x, two.y);
}

// `distance` times a cosine: between the one of a sphere's middle and its bound over the sphere, from which the light that
// arrives is left out only if none does. All three are given times the distance.
INLINE float8 likely_cosine(float8 middle, float8 bound, float8 distance)
{
    return 0.5f * (LESSER(GREATER(bound, (float8)(0.0f)), distance) + GREATER(middle, (float8)(0.0f)));
}

// How much light the children of a node could send to a point, in a unit of its own. `normal`: there; its w is 1 where light
// from all sides counts (then the rest is 0), else 0. The sine of half the angle under which a sphere appears is radius /
// distance; adding it to a cosine comes close to the cosine of the difference, and is 0 where that is.
INLINE float8 light_node_weights(__global const float8* node, Vec3 point, Vec4 normal)
{
    const float8 x = node[0] - point.x, y = node[1] - point.y, z = node[2] - point.z, radius = node[3];
    const float8 distance2 = GREATER(x * x + y * y + z * z, (float8)(1e-36f)), distance = root_of(distance2);
    const float8 incidence = normal.x * x + normal.y * y + normal.z * z + normal.w * distance;
    const float8 along = -(node[5] * x + node[6] * y + node[7] * z), spread = node[8];
    const float8 across = root_of(GREATER(distance2 - along * along, (float8)(0.0f)));
    const float8 emission = along > spread * distance ? distance : along * spread + across * node[9];
    const float8 cosines = likely_cosine(emission, emission + radius, distance) * (1.0f / distance2) *
                           likely_cosine(incidence, incidence + radius, distance);
    const float8 reach2 = GREATER(distance2, 0.25f * radius * radius);
    const float8 weight = node[4] * cosines * (least_of(reach2) / reach2);  // whatever the scale, it is below 1
    return emission + radius > node[10] * distance ? weight : (float8)(0.0f);
}

// Probability of a child, from its weight, those of all children, and its share of their intensity.
INLINE float child_probability(float weight, float total, float share)
{
    return total > LEAST_WEIGHT ? (1.0f - BY_SHARE) / total * weight + BY_SHARE * share : share;
}

// The last lane of a mask: from the exponent of its bits as a float. 0 if there is none.
INLINE uint last_lane(int8 mask)
{
    const int8 lanes = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 four = lanes.lo | lanes.hi;
    const int2 two = four.lo | four.hi;
    return (as_uint((float)(two.x | two.y | 1)) >> 23) - 127u;
}

// Picks a light by a random number in [0, 1), given as `u` and what lies below its last bit. At every node what is left of the
// number is scaled to [0, 1) again, as the sum of two floats, so that its 48 bits last for a million lights.
INLINE uint pick_from_tree(const LightTree* tree, Vec3 point, Vec4 normal, float u, float u_low, float* probability)
{
    *probability = 1.0f;
    float rest = 0x1p-24f * u_low;
    int at = 0;
    do {
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * at;
        Lanes weight, part, begin;
        part.all = weight.all = light_node_weights(node, point, normal);
        const float total = sum_of(weight.all);
        float scale = (1.0f - BY_SHARE) / total;
        if (!(total > LEAST_WEIGHT)) {
            part.all = node[4];
            scale = 1.0f;
        } else if (u >= 1.0f - BY_SHARE) {
            part.all = node[4];
            scale = 1.0f;
            u = (u - (1.0f - BY_SHARE)) / BY_SHARE;
            rest /= BY_SHARE;
        }
        // sums of the parts before each lane
        const float8 one = UP_BY_1(part.all), two = one + UP_BY_1(one), four = two + UP_BY_2(two);
        begin.all = scale * (four + UP_BY_4(four));
        const uint child = last_lane((begin.all <= u) & (part.all > 0.0f));

        const float width = scale * part.lane[child], inverse = 1.0f / width;
        const float past = u - begin.lane[child], lost = (u - past) - begin.lane[child], whole = past * inverse;
        rest = (FMA(-whole, width, past) + (lost + rest)) * inverse;
        u = GREATER(whole + rest, 0.0f);
        rest -= u - whole;
        u = LESSER(u, 0x1.fffffep-1f);
        *probability *= child_probability(weight.lane[child], total, ((__global const float*)(node + 4))[child]);
        at = ((__global const int*)(node + 11))[child];
    } while (at > 0);
    return (uint)~at;
}

// Probability with which `pick_from_tree` would have picked this light.
INLINE float light_tree_probability(const LightTree* tree, uint light, Vec3 point, Vec4 normal)
{
    uint place = tree->places[light];
    float probability = place == NONE ? 0.0f : 1.0f;
    while (place != NONE) {
        const uint parent = place >> 3, slot = place & 7u;
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * parent;
        Lanes weight;
        weight.all = light_node_weights(node, point, normal);
        probability *= child_probability(weight.lane[slot], sum_of(weight.all), ((__global const float*)(node + 4))[slot]);
        place = tree->places[tree->lights + parent];
    }
    return probability;
}
#endif
