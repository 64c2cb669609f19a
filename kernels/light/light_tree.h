// Light sampling with a light tree, for scenes of many lights, called by next-event estimation and MIS in `shade`:
// descends from node to node with probability proportional to the importance of the children for the shading point.
// Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", HPG 2018; without
// splitting, as in pbrt-v4 and Cycles, but with 8 children a node. Below a child that is small as seen from the shading
// point, or that sends no light to it, a binary search selects a light by power.
// host/isonoise/scene/light/light_tree.py documents the nodes.
#pragma once
#include "light/cdf_search.h"
#include "path/path_state.h"
#include "util/math.h"

#if FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST
// Nodes have LIGHT_NODE_ROWS rows, each a float8 with one vector lane a child. NODE_<name> is the first row of a
// quantity: host/isonoise/scene/light/light_tree.py, `NodeRow`.
#define MIN_TOTAL_WEIGHT 1e-37f     // its inverse is finite
#define DEFENSIVE_COSINES 0x1p-10f  // added to the product of the cosines, in case rounding makes it 0

typedef struct {
    __global const float8* nodes;
    // 8 * parent node + child slot, of every light, then of every node; NONE without a parent
    __global const uint* parents;
    __global const float* cdf;  // two floats a light: a + 2^-24 b is the sum of the powers of the lights before it
    uint light_count;
} LightTree;

INLINE float8 sqrt8(float8 v)
{
    Float8Lanes lanes;
    lanes.vector = v;
    for (int i = 0; i < 8; ++i) lanes.lane[i] = SQRT(lanes.lane[i]);
    return lanes.vector;
}

// Estimates a cosine over a bounding sphere: the sum of the cosine at the centre and its upper bound over the sphere,
// both clamped to [0, 1]. It is 0 only if no light can arrive. The cosines and the result are multiplied by the
// distance.
INLINE float8 twice_cosine_estimate8(float8 center_cosine, float8 max_cosine, float8 distance)
{
    return MIN(MAX(max_cosine, (float8)(0.0f)), distance) + MAX(center_cosine, (float8)(0.0f));
}

// Weights of the children of a node for a point. `uniform_children`: one bit for each child below which selection goes
// by power.
typedef struct {
    Float8Lanes weight;
    uint uniform_children;
} LightNodeWeights;

// Estimates of the irradiance from the children of a node, without unit. `normal`: at the point; w is 1 where light
// from all sides counts (then xyz is 0), else 0. A sphere subtends an angle with sine radius / distance to either side
// of its centre; adding this sine to a cosine approximates the cosine of the angle minus that, and is 0 where it is 0.
INLINE LightNodeWeights light_node_weights(__global const float8* node, Vec3 point, Vec4 normal)
{
    const float8 x = node[NODE_CENTER] - point.x, y = node[NODE_CENTER + 1] - point.y,
                 z = node[NODE_CENTER + 2] - point.z, radius = node[NODE_RADIUS];
    const float8 distance2 = MAX(x * x + y * y + z * z, (float8)(1e-36f)), distance = sqrt8(distance2);
    // cosines times the distance
    const float8 incidence = normal.x * x + normal.y * y + normal.z * z + normal.w * distance;
    const float8 cosine = -(node[NODE_AXIS] * x + node[NODE_AXIS + 1] * y + node[NODE_AXIS + 2] * z);
    const float8 cos_spread = node[NODE_COS_SPREAD], sin_spread = node[NODE_SIN_SPREAD];
    float8 emission = cosine * cos_spread;
    if (mask_bits(sin_spread > 0.0f)) emission += sqrt8(MAX(distance2 - cosine * cosine, (float8)(0.0f))) * sin_spread;
    emission = cosine > cos_spread * distance ? distance : emission;
    const float8 inverse2 = 1.0f / distance2;
    const float8 max_emission = emission + node[NODE_EMISSION_RADIUS];
    const float8 cosines = twice_cosine_estimate8(emission, max_emission, distance) *
                           twice_cosine_estimate8(incidence, incidence + radius, distance) * inverse2;
    const float8 lit_cosines = max_emission > node[NODE_COS_EDGE] * distance ? cosines : (float8)(0.0f);
    LightNodeWeights w;
    w.weight.vector =
        (lit_cosines + DEFENSIVE_COSINES) * MIN(node[NODE_INTENSITY] * inverse2, node[NODE_MAX_IRRADIANCE]);
    w.uniform_children = mask_bits((MIN(emission, incidence) > node[NODE_MIN_UNIFORM]) | (lit_cosines == 0.0f));
    return w;
}

// The children's probabilities are their weights times this.
INLINE float inverse_weight_sum(const float* weights)
{
    float total = 0.0f;
#pragma unroll
    for (uint child = 0u; child < 8u; ++child) total += weights[child];
    return 1.0f / MAX(total, MIN_TOTAL_WEIGHT);
}

// A descent through the tree. At every node the random number u + u_low is rescaled to [0, 1), as a double-float: its
// 48 bits are enough for a million lights.
typedef struct {
    float u, u_low;
    float pmf;  // product of the probabilities of the children so far
    int node;   // > 0 a node, else ~light
    int slot;   // if selection goes on by power: the child that was selected, an index of an int in the nodes; else -1
} LightDescent;

INLINE LightDescent begin_light_descent(float u, float u_low)
{
    const LightDescent root = {u, 0x1p-24f * u_low, 1.0f, 0, -1};
    return root;
}

// Selects a child of a node by weights.
INLINE void descend_light_tree(const LightTree* tree, const float* weights, uint uniform_children, LightDescent* d)
{
    const float scale = inverse_weight_sum(weights);
    CdfSearch search = begin_cdf_search(d->u, d->u_low);
#pragma unroll
    for (uint child = 0u; child < 8u; ++child) advance_cdf_search(&search, child, scale * weights[child]);
    const float inverse = 1.0f / search.pmf, quotient = search.remainder * inverse;
    const float low = (FMA(-quotient, search.pmf, search.remainder) + search.remainder_low) * inverse;
    const float u = MAX(quotient + low, 0.0f);
    d->u_low = low - (u - quotient);
    d->u = MIN(u, 0x1.fffffep-1f);
    d->pmf *= search.pmf;
    const int slot = 8 * LIGHT_NODE_ROWS * d->node + (int)search.item;
    d->node = ((__global const int*)tree->nodes)[slot + 8 * NODE_CHILD];
    const bool is_uniform = d->node > 0 && ((uniform_children >> search.item) & 1u);
    d->slot = is_uniform ? slot : -1;
    d->node = is_uniform ? -1 : d->node;
}

// Lights in a row of which one is selected by power. `u` and `u_low` are relative to the sum of the powers before the
// first one, `cdf` and `cdf_low`; `power` is the sum of their own.
typedef struct {
    float u, u_low;
    float cdf, cdf_low;
    float power;
    uint light, last;  // `light`: the last one so far that does not exceed u
} LightRange;

INLINE LightRange make_light_range(const LightTree* tree, int slot, float u, float u_low)
{
    const uint first = (uint)((__global const int*)tree->nodes)[slot + 8 * NODE_FIRST_LIGHT];
    LightRange r;
    r.light = first;
    r.last = (uint)((__global const int*)tree->nodes)[slot + 8 * NODE_LAST_LIGHT];
    const bool is_end = r.last + 1u == tree->light_count;
    const int next = is_end ? 0 : 2 * (int)r.last + 2;
    r.cdf = tree->cdf[2 * (int)first];
    r.cdf_low = tree->cdf[2 * (int)first + 1];
    const float width = (is_end ? 1.0f : tree->cdf[next]) - r.cdf;
    const float width_low = 0x1p-24f * ((is_end ? 0.0f : tree->cdf[next + 1]) - r.cdf_low);
    r.power = width + width_low;
    r.u = u * width;
    r.u_low = FMA(u, width, -r.u) + (u * width_low + u_low * width);
    return r;
}

// What is left of the random number beyond the lights of the range before this one. Its sign is exact.
INLINE float light_range_remainder(const LightTree* tree, const LightRange* r, uint light)
{
    __global const float* cdf = tree->cdf + 2 * (int)light;
    return (r->u - (cdf[0] - r->cdf)) + (r->u_low - 0x1p-24f * (cdf[1] - r->cdf_low));
}

// A step of the search for the last light with a remainder that is not negative.
INLINE void advance_in_light_range(const LightTree* tree, LightRange* r, uint step)
{
    const uint next = MIN(r->light + step, r->last);
    r->light = r->light + step == next && light_range_remainder(tree, r, next) >= 0.0f ? next : r->light;
}

#if LANES > 1
#define LIGHT_RANGE_FLOATS 7u

INLINE void store_light_range_lane(const LightRange* r, float* ranges, size_t lane)
{
    store_lane(as_float(r->light), ranges, 0u, lane);
    store_lane(as_float(r->last), ranges, 1u, lane);
    store_lane4(vec4(r->u, r->u_low, r->cdf, r->cdf_low), ranges, 2u, lane);
    store_lane(r->power, ranges, 6u, lane);
}

INLINE LightRange load_light_range_lane(const float* ranges, size_t lane)
{
    LightRange r;
    r.light = as_uint(load_lane(ranges, 0u, lane));
    r.last = as_uint(load_lane(ranges, 1u, lane));
    r.u = load_lane(ranges, 2u, lane);
    r.u_low = load_lane(ranges, 3u, lane);
    r.cdf = load_lane(ranges, 4u, lane);
    r.cdf_low = load_lane(ranges, 5u, lane);
    r.power = load_lane(ranges, 6u, lane);
    return r;
}
#endif

INLINE float light_power(const LightTree* tree, uint light)
{
    const bool is_end = light + 1u == tree->light_count;
    __global const float* cdf = tree->cdf + 2 * (int)light;
    return ((is_end ? 1.0f : cdf[2]) - cdf[0]) + 0x1p-24f * ((is_end ? 0.0f : cdf[3]) - cdf[1]);
}

// Ends a descent with the light that was found in the range.
INLINE void finish_light_range(const LightTree* tree, const LightRange* r, LightDescent* d)
{
    const float power = light_power(tree, r->light);
    d->u = rescaled_random(MAX(light_range_remainder(tree, r, r->light), 0.0f), power);
    d->pmf *= power / r->power;
    d->node = (int)~r->light;
}

// Selects a light by the random number *random + 2^-24 u_low, in [0, 1). `pmf` receives its probability, *random what
// is left of it.
INLINE uint select_from_tree(const LightTree* tree, Vec3 point, Vec4 normal, float* random, float u_low, float* pmf)
{
    LightDescent d = begin_light_descent(*random, u_low);
    do {
        const LightNodeWeights w = light_node_weights(tree->nodes + LIGHT_NODE_ROWS * d.node, point, normal);
        descend_light_tree(tree, w.weight.lane, w.uniform_children, &d);
    } while (d.node > 0);
    if (d.slot >= 0) {
        LightRange r = make_light_range(tree, d.slot, d.u, d.u_low);
        for (uint step = first_search_step(r.last + 1u - r.light); step > 0u; step /= 2u)
            advance_in_light_range(tree, &r, step);
        finish_light_range(tree, &r, &d);
    }
    *random = d.u;
    *pmf = d.pmf;
    return (uint)~d.node;
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Probability of selecting this light with `select_from_tree`, for MIS: climbs from the leaf to the root.
INLINE float light_tree_pmf(const LightTree* tree, uint light, Vec3 point, Vec4 normal)
{
    uint parent_slot = tree->parents[light];
    if (parent_slot == NONE) return 0.0f;
    const float power = light_power(tree, light);
    float pmf = 1.0f;
    bool is_leaf = true;
    while (parent_slot != NONE) {
        const uint parent = parent_slot >> 3, child = parent_slot & 7u;
        const LightNodeWeights w = light_node_weights(tree->nodes + LIGHT_NODE_ROWS * (int)parent, point, normal);
        if (!is_leaf && ((w.uniform_children >> child) & 1u))
            pmf = power / make_light_range(tree, 8 * LIGHT_NODE_ROWS * (int)parent + (int)child, 0.0f, 0.0f).power;
        pmf *= inverse_weight_sum(w.weight.lane) * w.weight.lane[child];
        parent_slot = tree->parents[tree->light_count + parent];
        is_leaf = false;
    }
    return pmf;
}
#endif

#if LANES > 1
// A descent of every lane; arrays of LANES floats per member.
typedef struct {
    const float *points, *normals;  // 3 and 4 members
    float* random;                  // u and what is below its last bit
    float* selections;              // light (during the descent: node) and pmf
    int slots[LANES];
} LightDescentLanes;

INLINE LightDescent load_light_descent_lane(const LightDescentLanes* lanes, size_t lane)
{
    LightDescent d;
    d.u = load_lane(lanes->random, 0u, lane);
    d.u_low = load_lane(lanes->random, 1u, lane);
    d.node = as_int(load_lane(lanes->selections, 0u, lane));
    d.pmf = load_lane(lanes->selections, 1u, lane);
    d.slot = lanes->slots[lane];
    return d;
}

INLINE void store_light_descent_lane(const LightDescent* d, LightDescentLanes* lanes, size_t lane)
{
    store_lane(d->u, lanes->random, 0u, lane);
    store_lane(d->u_low, lanes->random, 1u, lane);
    store_lane(as_float(d->node), lanes->selections, 0u, lane);
    store_lane(d->pmf, lanes->selections, 1u, lane);
    lanes->slots[lane] = d->slot;
}

// Moves the `count` lanes in `list` to children. The weights are computed lane by lane, 8 children at a time; while one
// lane waits, those of others are computed.
INLINE void descend_light_tree_lanes(const LightTree* tree, LightDescentLanes* lanes, const int* list, uint count)
{
    Float8Lanes weights[LANES];
    uint uniform_children[LANES];
    for (uint j = 0u; j < count; ++j) {
        const int node = as_int(load_lane(lanes->selections, 0u, list[j]));
        const LightNodeWeights w =
            light_node_weights(tree->nodes + LIGHT_NODE_ROWS * node, load_lane3(lanes->points, 0u, list[j]),
                               load_lane4(lanes->normals, 0u, list[j]));
        weights[j] = w.weight;
        uniform_children[j] = w.uniform_children;
    }
    FOR_LANES(j, count) {
        if (j >= count) continue;
        LightDescent d = load_light_descent_lane(lanes, list[j]);
        descend_light_tree(tree, (const float*)weights + 8u * j, uniform_children[j], &d);
        store_light_descent_lane(&d, lanes, list[j]);
    }
}

// Selects a light by power for the `count` lanes in `list`.
INLINE void select_in_light_ranges(const LightTree* tree, LightDescentLanes* lanes, const int* list, uint count)
{
    float ranges[LIGHT_RANGE_FLOATS * LANES];
    FOR_LANES(j, count) {
        if (j >= count) continue;
        const LightDescent d = load_light_descent_lane(lanes, list[j]);
        const LightRange r = make_light_range(tree, d.slot, d.u, d.u_low);
        store_light_range_lane(&r, ranges, j);
    }
    uint max_lights = 1u;
    for (uint j = 0u; j < count; ++j) {
        const LightRange r = load_light_range_lane(ranges, j);
        max_lights = MAX(max_lights, r.last + 1u - r.light);
    }
    for (uint step = first_search_step(max_lights); step > 0u; step /= 2u) {
        FOR_LANES(j, count) {
            if (j >= count) continue;
            LightRange r = load_light_range_lane(ranges, j);
            advance_in_light_range(tree, &r, step);
            store_light_range_lane(&r, ranges, j);
        }
    }
    FOR_LANES(j, count) {
        if (j >= count) continue;
        const LightRange r = load_light_range_lane(ranges, j);
        LightDescent d = load_light_descent_lane(lanes, list[j]);
        finish_light_range(tree, &r, &d);
        store_light_descent_lane(&d, lanes, list[j]);
    }
}

// `select_from_tree` for the `list_count` lanes in `list`, of the first `count` lanes, level by level. Arrays of LANES
// floats per member: `points` (3 members), `normals` (4) and `random` (2: u, which receives the rescaled number, and
// u_low, which is overwritten); `selections` receives light and pmf (2). Overwrites `list`.
INLINE void select_lights_from_tree(const LightTree* tree, const float* points, const float* normals, int* list,
                                    uint list_count, float* random, float* selections, uint count)
{
    LightDescentLanes lanes;
    lanes.points = points;
    lanes.normals = normals;
    lanes.random = random;
    lanes.selections = selections;
    FOR_LANES(k, count) {
        LightDescent root = begin_light_descent(load_lane(random, 0u, k), load_lane(random, 1u, k));
        root.node = ~0;  // a valid light for the lanes that are not in the list
        store_light_descent_lane(&root, &lanes, k);
    }
    for (uint j = 0u; j < list_count; ++j) store_lane(as_float(0), selections, 0u, list[j]);
    int range_list[LANES + 1];
    uint range_count = 0u;
    while (list_count > 0u) {
        descend_light_tree_lanes(tree, &lanes, list, list_count);
        uint remaining = 0u;
        for (uint j = 0u; j < list_count; ++j) {
            const int k = list[j];
            list[remaining] = range_list[range_count] = k;
            remaining += as_int(load_lane(selections, 0u, k)) > 0;
            range_count += lanes.slots[k] >= 0;
        }
        list_count = remaining;
    }
    select_in_light_ranges(tree, &lanes, range_list, range_count);
    FOR_LANES(k, count) store_lane(as_float(~as_uint(load_lane(selections, 0u, k))), selections, 0u, k);
}
#endif
#endif
