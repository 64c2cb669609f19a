// Picking one of many lights by a tree: from node to node, by how much light each child could send to the point that is lit.
// Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018; without the splitting, as
// in pbrt-v4 and Cycles, but with 8 children a node. What the tree holds is told in host/isonoise/scene/light_tree.py.
#pragma once
#include "vectors.h"

#if FEATURE_LIGHT_TREE
#define LIGHT_NODE_ROWS 12
#define SHARE_BY_INTENSITY 0x1p-10f  // of the picks: so that nothing that a bound misses by rounding is never picked

typedef struct {
    __global const float8* nodes;
    __global const uint* places;  // 8 * parent + slot of every light, then of every node; NONE has none
    uint lights;
} LightTree;

// Between the cosine of an angle and its bound, if the angle may be smaller by that under which a sphere appears, whose sine is
// `apparent`: the bound is 0 where nothing can be seen, but for a wide sphere most light comes from near its middle.
INLINE float8 likely_cosine(float8 cosine, float8 bound)
{
    return 0.5f * (LESSER(bound, (float8)(1.0f)) + GREATER(cosine, (float8)(0.0f)));
}

INLINE float sum_of(float8 v)
{
    const float4 four = v.lo + v.hi;
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}

INLINE float8 root_of(float8 v)
{
    Lanes lanes;
    lanes.all = v;
    for (int i = 0; i < 8; ++i) lanes.lane[i] = SQRT(lanes.lane[i]);
    return lanes.all;
}

// Probabilities of the children of a node, for a point that is lit. `normal`: there; its w is 1 where light from all sides counts
// (then the rest is 0), else 0.
INLINE float8 light_node_probabilities(__global const float8* node, float3 point, float4 normal)
{
    const float8 x = node[0] - point.x, y = node[1] - point.y, z = node[2] - point.z;
    const float8 radius = node[3], share = node[4];
    const float8 distance2 = GREATER(x * x + y * y + z * z, (float8)(1e-36f)), inverse = 1.0f / root_of(distance2);
    // sine of half the angle under which the sphere appears; above 1 within it
    const float8 apparent = radius * inverse;
    const float8 incidence = (normal.x * x + normal.y * y + normal.z * z) * inverse + normal.w;
    const float8 along = -(node[5] * x + node[6] * y + node[7] * z) * inverse;
    const float8 across = root_of(GREATER(1.0f - along * along, (float8)(0.0f)));
    const float8 spread = node[8];
    const float8 emission = along > spread ? (float8)(1.0f) : along * spread + across * node[9];
    const float8 brightness = share * likely_cosine(emission, emission + apparent) *
                              likely_cosine(incidence, GREATER(incidence + apparent, (float8)(0.0f)));
    const float8 weight = emission + apparent > node[10] ? brightness / GREATER(distance2, 0.25f * radius * radius) : (float8)(0.0f);
    const float total = sum_of(weight);
    return total > 0.0f ? (1.0f - SHARE_BY_INTENSITY) / total * weight + SHARE_BY_INTENSITY * share : share;
}

// Picks a light by a random number in [0, 1), given as `u` and what lies below its last bit. At every node the number is
// scaled anew to [0, 1), as the sum of two floats, so that its 48 bits last for a million lights.
INLINE uint pick_from_tree(const LightTree* tree, float3 point, float4 normal, float u, float u_low, float* probability)
{
    *probability = 1.0f;
    int at = 0;
    float rest = 0x1p-24f * u_low;
    do {
        __global const float8* node = tree->nodes + LIGHT_NODE_ROWS * at;
        Lanes lanes;
        lanes.all = light_node_probabilities(node, point, normal);
        uint child = 0;
        float begin = 0.0f, end = 0.0f;
        for (uint i = 0; i < 8u; ++i) {
            const bool reached = end <= u && lanes.lane[i] > 0.0f;
            child = reached ? i : child;
            begin = reached ? end : begin;
            end += lanes.lane[i];
        }
        const float picked = lanes.lane[child], past = u - begin, lost = (u - past) - begin;
        const float whole = past / picked;
        rest = (FMA(-whole, picked, past) + (lost + rest)) / picked;
        u = GREATER(whole + rest, 0.0f);
        rest -= u - whole;
        u = LESSER(u, 0x1.fffffep-1f);
        *probability *= picked;
        at = ((__global const int*)(node + 11))[child];
    } while (at > 0);
    return (uint)~at;
}

// Probability with which `pick_from_tree` would have picked this light.
INLINE float light_tree_probability(const LightTree* tree, uint light, float3 point, float4 normal)
{
    uint place = tree->places[light];
    float probability = place == NONE ? 0.0f : 1.0f;
    while (place != NONE) {
        const uint node = place >> 3;
        Lanes lanes;
        lanes.all = light_node_probabilities(tree->nodes + LIGHT_NODE_ROWS * node, point, normal);
        probability *= lanes.lane[place & 7u];
        place = tree->places[tree->lights + node];
    }
    return probability;
}
#endif
