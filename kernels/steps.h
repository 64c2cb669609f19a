// Shading in steps, where one loop over paths would do too much: each step is a loop over those that it concerns, and so becomes
// vector instructions by itself. Paths are listed by what they met, by the kind of light they look at, by the kind of material;
// what cannot be done as vector instructions - wrapped materials, checkerboards, the tree of lights - is done path by path.
#pragma once
#include "kept.h"

#if LANES > 1
// The paths of a work-item.
typedef struct {
    size_t begin;
    const int* met;  // of them, those that met something, where others are listed apart
    uint count;
} Batch;

INLINE size_t path_of(const Batch* batch, size_t k)
{
    return SPLITS ? (size_t)((int)batch->begin + batch->met[k]) : batch->begin + k;
}

// The same of a lane from a list: by a signed place, of which 16 are gathered at once.
INLINE size_t listed_path(const Batch* batch, int lane)
{
    return (size_t)((int)batch->begin + (SPLITS ? batch->met[lane] : lane));
}

// Lanes for which a condition holds, 0 or 1; `k` is the lane. No jump depends on it, none can be mispredicted.
#define LIST_OF(list, found, k, count, condition) \
    uint found = 0u;                              \
    for (uint k = 0u; k < (count); ++k) {         \
        list[found] = (int)k;                        \
        found += (uint)(condition);               \
    }

#if FEATURE_LIGHT_LIST && (HAS_SKY || FEATURE_AREA_LIGHTS)
// Asks for the probability with which a path's last vertex would have picked a light.
INLINE void ask(const Path* p, uint light, float* asked, size_t lane)
{
    keep3(p->last_vertex, asked, ASKED_POINT, lane);
    keep4(p->was_lit, asked, ASKED_NORMAL, lane);
    keep1(as_float(light), asked, ASKED_LIGHT, lane);
}

// Lights are weighed for all lanes of a vector, also for those beyond the last.
INLINE void ask_nothing(float* asked, uint count)
{
    EACH_OF(k, count) {
        keep3(all3(0.0f), asked, ASKED_POINT, k);
        keep4(vec4(0.0f, 0.0f, 0.0f, 0.0f), asked, ASKED_NORMAL, k);
        keep1(as_float(0u), asked, ASKED_LIGHT, k);
    }
}

INLINE float answer(const Path* p, const float* asked, size_t lane)
{
    return p->direction_pdf < 0.0f ? 0.0f : kept1(asked, ASKED_PROBABILITY, lane);
}
#endif

#if SPLITS
// What paths bring that leave the scene.
INLINE void add_sky(const Scene* scene, const Paths* of, size_t begin, const int* missed, uint count)
{
#if FEATURE_LIGHT_LIST
    float asked[ASKED * LANES];
    ask_nothing(asked, count);
    EACH_OF(k, count) {
        if (k >= count) continue;
        const Path p = load_path(of, (size_t)((int)begin + missed[k]));
        ask(&p, scene->environment_light, asked, k);
    }
    answer_from_list(&scene->geometry.light_list, asked, count);
#endif
    EACH_OF(k, count) {
        if (k >= count) continue;
        const Path p = load_path(of, (size_t)((int)begin + missed[k]));
#if FEATURE_LIGHT_LIST
        const float pick = answer(&p, asked, k);
#else
        const float pick = pick_before(scene, &p, scene->environment_light);
#endif
        if (!FEATURE_HIDE_EMITTERS || p.depth > 0u) ADD3(arriving_sky(scene, &p, pick), p.sample, of->samples);
    }
}
#endif

INLINE void mark(uint bits, float* kept, size_t lane)
{
    keep1(as_float(kept_bits(kept, KEPT_MARKS, lane) | bits), kept, KEPT_MARKS, lane);
}

INLINE bool is_marked(uint bit, const float* kept, size_t lane)
{
    return kept_bits(kept, KEPT_MARKS, lane) & bit;
}

// The material that a path meets, and whether it looks for a light.
INLINE void meet(const Scene* scene, const Paths* of, size_t i, const Path* p, const Surface* s, float* kept, size_t lane)
{
    Shading at;
    if (meet_material(scene, p, s, &at)) {
#if HAS_SEE_THROUGH
        pass_unseen(of, i, p, s);
#endif
        keep1(as_float(0u), kept, KEPT_KIND, lane);
        return;
    }
    keep_shading(&at, kept, lane);
    uint marks = MARK_SCATTERS;
#if FEATURE_NEXT_EVENT
    marks |= looks_for_light(&at, true) ? MARK_LOOKS : 0u;
#endif
    mark(marks, kept, lane);
}

// Brings a path to `primitive`. Wrapped materials are left to a loop of their own.
INLINE void arrive_at(const Scene* scene, const Paths* of, size_t i, uint primitive, uint max_depth, float* kept, size_t lane)
{
    Path p = load_path(of, i);
    p.primitive = primitive;
    Surface s = meet_surface(scene, of, i, &p);
    bool shines;
    const bool scatters = arrive(scene, of, i, &p, &s, false, &shines) && p.depth + 1u < max_depth;
    keep_surface(&s, kept, lane);
    keep1(as_float((shines ? MARK_SHINES : 0u) | (scatters && HAS_WRAPPERS ? MARK_SCATTERS : 0u)), kept, KEPT_MARKS, lane);
#if !HAS_WRAPPERS
    if (scatters) meet(scene, of, i, &p, &s, kept, lane);
#endif
}

INLINE void arrive_all(const Scene* scene, const Paths* of, const Batch* batch, uint max_depth, float* kept)
{
    const uint count = batch->count;
    __global const uint* met = (__global const uint*)PLANE(3, of->hit, of->pool);
    EACH_OF(k, count) {
        keep1(as_float(0u), kept, KEPT_MARKS, k);
        keep1(as_float(0u), kept, KEPT_KIND, k);
        keep1(as_float(0u), kept, KEPT_BSDF, k);
#if FEATURE_NEXT_EVENT
        keep3(all3(0.0f), kept, KEPT_LIGHT, k);
#endif
#if FEATURE_LIGHT_LIST  // lights are weighed for all lanes
        keep3(all3(0.0f), kept, KEPT_POSITION, k);
        keep4(vec4(0.0f, 0.0f, 0.0f, 0.0f), kept, KEPT_LIT, k);
        keep4(vec4(0.0f, 0.0f, 0.0f, 0.0f), kept, KEPT_LIGHT_RANDOM, k);
#endif
    }
#if FEATURE_TRIANGLES
    EACH_OF(k, count) {
        if (k >= count) continue;
        const uint primitive = met[path_of(batch, k)];
        if (primitive & ANALYTIC_BIT) continue;
        arrive_at(scene, of, path_of(batch, k), primitive & ~ANALYTIC_BIT, max_depth, kept, k);
    }
#endif
#if FEATURE_ANALYTICS
    int list[LANES + 1];
    LIST_OF(list, found, k, count, (met[path_of(batch, k)] >= ANALYTIC_BIT) & (met[path_of(batch, k)] != NONE))
    EACH_OF(j, found) {
        if (j >= found) continue;
        const size_t i = listed_path(batch, list[j]);
        arrive_at(scene, of, i, met[i] | ANALYTIC_BIT, max_depth, kept, list[j]);
    }
#endif
#if HAS_WRAPPERS
    for (uint k = 0u; k < count; ++k) {
        if (!is_marked(MARK_SCATTERS, kept, k)) continue;
        const size_t i = path_of(batch, k);
        const Path p = load_path(of, i);
        const Surface s = kept_surface(kept, k);
        keep1(as_float(kept_bits(kept, KEPT_MARKS, k) & ~MARK_SCATTERS), kept, KEPT_MARKS, k);
        meet(scene, of, i, &p, &s, kept, k);
    }
#endif
}

#if FEATURE_AREA_LIGHTS
// What paths bring that met lights.
INLINE void add_emission(const Scene* scene, const Paths* of, const Batch* batch, const float* kept)
{
    int list[LANES + 1];
    LIST_OF(list, found, k, batch->count, is_marked(MARK_SHINES, kept, k))
#if FEATURE_LIGHT_LIST
    float asked[ASKED * LANES];
    ask_nothing(asked, found);
    EACH_OF(j, found) {
        if (j >= found) continue;
        const Path p = load_path(of, listed_path(batch, list[j]));
        ask(&p, kept_bits(kept, KEPT_SURFACE_LIGHT, list[j]), asked, j);
    }
    answer_from_list(&scene->geometry.light_list, asked, found);
#endif
    EACH_OF(j, found) {
        if (j >= found) continue;
        const Path p = load_path(of, listed_path(batch, list[j]));
        const Surface s = kept_surface(kept, list[j]);
#if FEATURE_LIGHT_LIST
        const float pick = answer(&p, asked, j);
#else
        const float pick = pick_before(scene, &p, s.light);
#endif
        ADD3(arriving_emission(scene, &p, &s, pick), (int)p.sample, of->samples);
    }
}
#endif

// Four random numbers for every path: of the light, which is picked at once if that is soon done, and of the direction in which
// it goes on.
INLINE void draw_random(const Scene* scene, const Paths* of, const Batch* batch, float* kept)
{
    const uint count = batch->count;
    EACH_OF(k, count) {
        if (k >= count) continue;
        const Path p = load_path(of, path_of(batch, k));
        const Vec4 u = path_random(scene, &p, BLOCK_BSDF(event_of(&p)));
        keep4(u, kept, KEPT_RANDOM, k);
#if FEATURE_NEXT_EVENT
        const Vec4 v = path_random(scene, &p, BLOCK_LIGHT(event_of(&p)));
        keep4(vec4(v.x, v.w, v.y, v.z), kept, KEPT_LIGHT_RANDOM, k);
#if !HAS_LIT
        keep_pick(pick_light(&scene->geometry, scene->lights, scene->light_alias, scene->light_count, all3(0.0f),
                             p.was_lit, v.x, v.w), kept, k);
#endif
#endif
    }
}

#if FEATURE_NEXT_EVENT
#if FEATURE_LIGHT_LIST
INLINE void pick_lights(const Scene* scene, uint count, float* kept)
{
    pick_all_from_list(&scene->geometry.light_list, kept + KEPT_POSITION * LANES, kept + KEPT_LIT * LANES,
                       kept + KEPT_LIGHT_RANDOM * LANES, kept + KEPT_PICK * LANES, count);
}
#elif FEATURE_LIGHT_TREE
INLINE void pick_lights(const Scene* scene, uint count, float* kept)
{
    for (uint k = 0u; k < count; ++k) {
        LightPick pick = {0u, 0.0f};
        if (is_marked(MARK_LOOKS, kept, k))
            pick = pick_light(&scene->geometry, scene->lights, scene->light_alias, scene->light_count,
                              kept3(kept, KEPT_POSITION, k), kept4(kept, KEPT_LIT, k), kept1(kept, KEPT_LIGHT_RANDOM, k),
                              kept1(kept, KEPT_LIGHT_RANDOM + 1u, k));
        keep_pick(pick, kept, k);
    }
}
#endif

// Looks at the light that was picked, if it is of one of these kinds; leaves the shadow ray, and keeps the sample.
INLINE void look(const Scene* scene, const Paths* of, size_t i, uint kinds, float* kept, size_t lane)
{
    const LightPick pick = kept_pick(kept, lane);
    const Path p = load_path(of, i);
    const Surface s = kept_surface(kept, lane);
    const Vec2 u = vec2(kept1(kept, KEPT_LIGHT_RANDOM + 2u, lane), kept1(kept, KEPT_LIGHT_RANDOM + 3u, lane));
    const LightSample light = sample_light_of(kinds, &scene->geometry, scene->lights, pick, s.position, u);
    if (pick.probability > 0.0f && may_light(&light)) {
        leave_shadow_ray(of, i, &p, &s, &light);
        keep_light(&light, kept, lane);
    } else {
        keep1(as_float(kept_bits(kept, KEPT_MARKS, lane) & ~MARK_LOOKS), kept, KEPT_MARKS, lane);
    }
}

#define HAS_OTHER_LIGHTS                                                                                                  \
    (FEATURE_SPHERE_LIGHTS || FEATURE_DISK_LIGHTS || FEATURE_CYLINDER_LIGHTS || FEATURE_POINT_LIGHTS || FEATURE_SPOT_LIGHTS || \
     FEATURE_DIRECTIONAL_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP)

#if FEATURE_TRIANGLE_LIGHTS && HAS_OTHER_LIGHTS
INLINE bool looks_at_triangle(const Scene* scene, const float* kept, size_t lane)
{
    return Light_at(scene->lights, kept_bits(kept, KEPT_PICK, lane)).kind & LIGHT_TRIANGLE;
}
#endif

INLINE void look_for_lights(const Scene* scene, const Paths* of, const Batch* batch, float* kept)
{
    const uint count = batch->count;
#if FEATURE_TRIANGLE_LIGHTS && HAS_OTHER_LIGHTS
    int list[LANES + 1];
    LIST_OF(list, others, k, count, is_marked(MARK_LOOKS, kept, k) & !looks_at_triangle(scene, kept, k))
    EACH_OF(k, count) {
        if (k >= count || !is_marked(MARK_LOOKS, kept, k) || !looks_at_triangle(scene, kept, k)) continue;
        look(scene, of, path_of(batch, k), LIGHT_TRIANGLE, kept, k);
    }
    EACH_OF(j, others) {
        if (j >= others) continue;
        look(scene, of, listed_path(batch, list[j]), ~LIGHT_TRIANGLE, kept, list[j]);
    }
#else
    EACH_OF(k, count) {
        if (k >= count || !is_marked(MARK_LOOKS, kept, k)) continue;
        look(scene, of, path_of(batch, k), ~0u, kept, k);
    }
#endif
}
#endif

#if FEATURE_TEXTURES
// What textures show, slot by slot of those in which the scene has some.
INLINE void look_up_textures(const Scene* scene, const Batch* batch, float* kept)
{
    int list[LANES + 1];
    for (uint slot = 0u; slot < BSDF_SLOTS; ++slot) {
        if (!(scene->textured_slots & (1u << slot))) continue;
        LIST_OF(list, found, k, batch->count, is_marked(MARK_SCATTERS, kept, k) &
                (scene->bsdfs[kept_bits(kept, KEPT_BSDF, k)].textures[slot] != NONE))
        EACH_OF(j, found) {
            if (j >= found) continue;
            const Surface s = kept_surface(kept, list[j]);
            const TexturePoint point = texture_point(&s);
            __global const Bsdf* bsdf = scene->bsdfs + kept_bits(kept, KEPT_BSDF, list[j]);
            const bool number = bsdf->numbers & (1u << slot);
            const Vec3 shown = number ? all3(texture_number(&scene->geometry.textures, bsdf->textures[slot], &point))
                                      : texture_rgb(&scene->geometry.textures, bsdf->textures[slot], &point);
            keep3(shown, kept, KEPT_PARAMETERS + 3u * slot, list[j]);
        }
    }
}
#endif

// What a material of this kind scatters of the light, and where a path goes on from it.
INLINE void scatter(const Scene* scene, const Paths* of, size_t i, uint kind, float* kept, size_t lane)
{
    const Shading at = kept_shading(scene, kind, load_planes3(of->ray_direction, i, of->pool), kept, lane);
#if FEATURE_NEXT_EVENT
    if (kind & ~DELTA_BSDFS) {  // of all: those that looked at no light have none to be asked about, and do no harm
        float pdf = 0.0f;
        const Vec3 scattered = eval_kind(kind, &at, kept3(kept, KEPT_LIGHT, lane), &pdf);
        keep4(with_w(scattered, pdf), kept, KEPT_SCATTERED, lane);
    }
#endif
    const BsdfSample next = sample_kind(kind, &at, kept3(kept, KEPT_RANDOM, lane));
    keep_next(&next, kept, lane);
}

// All of one kind. What is soon done is done for all that there are, without a list: to gather them would cost more.
INLINE void scatter_all(const Scene* scene, const Paths* of, const Batch* batch, uint kind, float* kept)
{
    if (kind == BSDF_DIFFUSE) {
        EACH_OF(k, batch->count) {
            if (k >= batch->count || kept_bits(kept, KEPT_KIND, k) != kind) continue;
            scatter(scene, of, path_of(batch, k), kind, kept, k);
        }
    } else {
        int list[LANES + 1];
        LIST_OF(list, found, k, batch->count, kept_bits(kept, KEPT_KIND, k) == kind)
        EACH_OF(j, found) {
            if (j >= found) continue;
            scatter(scene, of, listed_path(batch, list[j]), kind, kept, list[j]);
        }
    }
}

// Leaves what is to arrive by the shadow rays, and the paths that go on.
INLINE void leave_all(const Scene* scene, const Paths* of, const Batch* batch, uint max_depth, uint rr_depth, const float* kept)
{
    const uint count = batch->count;
    EACH_OF(k, count) {
        if (k >= count || !is_marked(MARK_SCATTERS, kept, k)) continue;
        const size_t i = path_of(batch, k);
        Path p = load_path(of, i);
        const Surface s = kept_surface(kept, k);
        const Shading at = kept_shading(scene, 0u, p.direction, kept, k);
#if FEATURE_NEXT_EVENT
        if (is_marked(MARK_LOOKS, kept, k)) {
            const LightSample light = kept_light(kept, k);
            const Vec3 radiance = direct_light(&p, &s, &at, &light, kept3(kept, KEPT_SCATTERED, k), kept1(kept, KEPT_SCATTERED + 3u, k));
            store_planes3(radiance, of->shadow_radiance, i, of->pool);
            if (radiance.x + radiance.y + radiance.z == 0.0f) PLANE(3, of->shadow_direction, of->pool)[i] = 0.0f;
        }
#endif
        const BsdfSample next = kept_next(kept, k);
        go_on(of, i, &p, &s, &at, next, kept1(kept, KEPT_RANDOM + 3u, k), false, rr_depth);
    }
}

INLINE void shade_in_steps(const Scene* scene, const Paths* of, size_t begin, uint count, uint max_depth, uint rr_depth)
{
    EACH_OF(k, count) {
        if (k >= count) continue;
        of->alive[begin + k] = 0;
#if FEATURE_NEXT_EVENT
        PLANE(3, of->shadow_direction, of->pool)[begin + k] = 0.0f;
#endif
    }
#if SPLITS
    int met[LANES + 1], missed[LANES + 1];
    __global const uint* primitives = (__global const uint*)PLANE(3, of->hit, of->pool) + begin;
    LIST_OF(met, count_met, k, count, primitives[k] != NONE)
    LIST_OF(missed, count_missed, k, count, primitives[k] == NONE)
    add_sky(scene, of, begin, missed, count_missed);
    const Batch paths = {begin, met, count_met};
#else
    const Batch paths = {begin, 0, count};
#endif
    const Batch* batch = &paths;
    float kept[KEPT * LANES];
    arrive_all(scene, of, batch, max_depth, kept);
#if FEATURE_AREA_LIGHTS
    add_emission(scene, of, batch, kept);
#endif
    draw_random(scene, of, batch, kept);
#if FEATURE_NEXT_EVENT
#if HAS_LIT
    pick_lights(scene, batch->count, kept);
#endif
    look_for_lights(scene, of, batch, kept);
#endif
#if FEATURE_TEXTURES
    look_up_textures(scene, batch, kept);
#endif
#if FEATURE_DIFFUSE
    scatter_all(scene, of, batch, BSDF_DIFFUSE, kept);
#endif
#if FEATURE_DIELECTRIC
    scatter_all(scene, of, batch, BSDF_DIELECTRIC, kept);
#endif
#if FEATURE_THIN_DIELECTRIC
    scatter_all(scene, of, batch, BSDF_THIN_DIELECTRIC, kept);
#endif
#if FEATURE_CONDUCTOR
    scatter_all(scene, of, batch, BSDF_CONDUCTOR, kept);
#endif
#if FEATURE_ROUGH_CONDUCTOR
    scatter_all(scene, of, batch, BSDF_ROUGH_CONDUCTOR, kept);
#endif
#if FEATURE_ROUGH_DIELECTRIC
    scatter_all(scene, of, batch, BSDF_ROUGH_DIELECTRIC, kept);
#endif
#if FEATURE_PLASTIC
    scatter_all(scene, of, batch, BSDF_PLASTIC, kept);
#endif
#if FEATURE_ROUGH_PLASTIC
    scatter_all(scene, of, batch, BSDF_ROUGH_PLASTIC, kept);
#endif
#if FEATURE_PRINCIPLED
    scatter_all(scene, of, batch, BSDF_PRINCIPLED, kept);
#endif
    leave_all(scene, of, batch, max_depth, rr_depth, kept);
}
#endif
