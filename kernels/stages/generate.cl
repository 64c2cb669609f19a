// Stage: generates camera rays, one for each sample of the slice from first_sample on, into the pool from first_slot
// on. Reads the sample list; writes the path state; clears the sample.
#include "path/path_state.h"
#include "util/random.h"
#include "util/math.h"

// Samples the reconstruction filter along one axis: the offset from the pixel centre. A sample thus contributes to one
// pixel only. Ernst, Stamminger, Greiner, "Filter Importance Sampling", 2006.
INLINE float sample_filter(float u, float radius, __global const float* inverse_cdf, uint cells)
{
#if FEATURE_FILTER_TABLE
    const float position = u * cells;
    const uint cell = MIN((uint)position, cells - 1u);
    return inverse_cdf[cell] + (position - cell) * (inverse_cdf[cell + 1u] - inverse_cdf[cell]);
#else
    return (2.0f * u - 1.0f) * radius;
#endif
}

__kernel void generate(
#include "generated/generate_parameters.h"
)
{
    const size_t begin = get_global_id(0) * LANES;
    FOR_LANES(k, LANES) {
        const size_t i = begin + k;
        if (i >= count_new) continue;
        const size_t slot = first_slot + i;
        const uint sample = first_sample + (uint)i;
        const uint pixel = sample_pixel[sample], index = sample_index[sample];

        const Vec4 u = random_block(seed, pixel, index, BLOCK_CAMERA);
        const uint width = camera->film_size[0], row = pixel / width;
        const Vec2 corner = vec2((float)(pixel - row * width), (float)row);
        const float radius = camera->filter_radius;
        const Vec2 offset = vec2(sample_filter(u.x, radius, inverse_cdf, inverse_cdf_cells),
                                 sample_filter(u.y, radius, inverse_cdf, inverse_cdf_cells));
        const float film_x = (corner.x + 0.5f + offset.x) / (float)camera->film_size[0];
        const float film_y = (corner.y + 0.5f + offset.y) / (float)camera->film_size[1];
        // on the plane z = 1 of camera space
        const Vec2 film_point = vec2((1.0f - 2.0f * (film_x + camera->principal_point[0])) * camera->tan_half_fov[0],
                                     (1.0f - 2.0f * (film_y + camera->principal_point[1])) * camera->tan_half_fov[1]);
        float m[12];
        load_matrix(camera->to_world, m);
        Vec3 camera_direction = vec3_from(film_point, 1.0f), center = vec3(m[3], m[7], m[11]);
#if FEATURE_THIN_LENS
        if (camera->kind == CAMERA_THIN_LENS) {  // from a point on the lens to the point in focus
            const Vec2 lens = scale2(square_to_disk(vec2(u.z, u.w)), camera->aperture_radius);
            const float focus = camera->focus_distance;
            camera_direction = vec3(film_point.x - lens.x / focus, film_point.y - lens.y / focus, 1.0f);
            center = add3(center, transform_direction(m, vec3_from(lens, 0.0f)));
        }
#endif
        camera_direction = normalize3(camera_direction);
        Vec3 direction = normalize3(transform_direction(m, camera_direction));
        Vec3 origin = add3(center, scale3(direction, camera->near_clip / camera_direction.z));
        float t_max = (camera->far_clip - camera->near_clip) / camera_direction.z;
#if FEATURE_ORTHOGRAPHIC
        if (camera->kind == CAMERA_ORTHOGRAPHIC) {
            direction = normalize3(vec3(m[2], m[6], m[10]));
            origin = transform_point(m, vec3_from(film_point, camera->near_clip));
            t_max = camera->far_clip - camera->near_clip;
        }
#endif
        store_planes4(vec4_from(origin, t_max), ray_origin, slot, plane_stride);
        store_planes4(vec4_from(direction, PDF_WITHOUT_MIS), ray_direction, slot, plane_stride);
        store_planes4(vec4(1.0f, 1.0f, 1.0f, 1.0f), throughput, slot, plane_stride);
        PLANE(PATH_SAMPLE, path_ids, plane_stride)[slot] = sample;
        PLANE(PATH_START_PRIMITIVE, path_ids, plane_stride)[slot] = NONE;
        PLANE(PATH_SAMPLE_INDEX, path_ids, plane_stride)[slot] = index;
        PLANE(PATH_DEPTH, path_ids, plane_stride)[slot] = 0u;
#include "generated/init_path_state.h"
        STORE3(splat3(0.0f), sample, samples);
    }
}
