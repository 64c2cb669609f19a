// Stage: camera rays for the slots of the pool from first_slot on, one for each sample of the slice from first_sample on.
// Reads the sample list and the per-pixel counts; writes the path state; clears the sample.
// path = (sample of the slice, primitive that the ray starts on, index of the sample in its pixel, depth).
#include "random.h"
#include "vectors.h"

// Offset of a sample from the pixel's centre along one axis, distributed as the reconstruction filter, so that a sample
// belongs to one pixel alone. Ernst, Stamminger, Greiner, "Filter Importance Sampling", 2006.
INLINE float filter_offset(float u, float radius, __global const float* inverse_cdf, uint cells)
{
#if FEATURE_FILTER_TABLE
    const float at = u * cells;
    const uint cell = LESSER((uint)at, cells - 1u);
    return inverse_cdf[cell] + (at - cell) * (inverse_cdf[cell + 1u] - inverse_cdf[cell]);
#else
    return (2.0f * u - 1.0f) * radius;
#endif
}

__kernel void generate(uint count_new, uint first_slot, uint first_sample, uint2 seed,
                       __global const Camera* camera, __global const float* inverse_cdf, uint inverse_cdf_cells,
                       __global const uint* sample_pixel, __global const uint* pixel_offset, __global const uint* count,
                       __global const uint* rejected, __global float4* ray_origin, __global float4* ray_direction,
                       __global float4* throughput, __global uint4* path, __global float* samples
#if FEATURE_INSTANCES
                       , __global uint* instance
#endif
#if FEATURE_VOLPATH
                       , __global uint2* crossing
#endif
#if FEATURE_MEDIA
                       , __global uint* medium, uint sensor_medium
#endif
                       )
{
    const uint i = get_global_id(0);
    if (i >= count_new) return;
    const uint slot = first_slot + i, sample = first_sample + i;
    const uint pixel = sample_pixel[sample];
    const uint index = count[pixel] + rejected[pixel] + (sample - pixel_offset[pixel]);

    const float4 u = random_block(seed, pixel, index, BLOCK_CAMERA);
    const uint width = camera->crop_size[0], row = pixel / width;
    const float2 corner = (float2)((float)(camera->crop_offset[0] + pixel - row * width), (float)(camera->crop_offset[1] + row));
    const float2 offset = (float2)(filter_offset(u.x, camera->filter_radius, inverse_cdf, inverse_cdf_cells),
                                   filter_offset(u.y, camera->filter_radius, inverse_cdf, inverse_cdf_cells));
    const float2 film = (corner + 0.5f + offset) / (float2)((float)camera->film_size[0], (float)camera->film_size[1]);
    const float2 centered = 1.0f - 2.0f * (film + (float2)(camera->principal_point[0], camera->principal_point[1]));
    const float2 on_plane = centered * (float2)(camera->tan_half_fov[0], camera->tan_half_fov[1]);
    float m[12];
    for (int k = 0; k < 12; ++k) m[k] = camera->to_world[k];
    float3 ahead = (float3)(on_plane, 1.0f), center = (float3)(m[3], m[7], m[11]);
#if FEATURE_THIN_LENS
    if (camera->kind == CAMERA_THIN_LENS) {  // towards the point in focus, from a point of the lens
        const float2 lens = camera->aperture_radius * square_to_disk(u.zw);
        ahead.xy -= lens / camera->focus_distance;
        center += transform_direction(m, (float3)(lens, 0.0f));
    }
#endif
    ahead = unit(ahead);
    float3 direction = unit(transform_direction(m, ahead));
    float3 origin = center + camera->near_clip / ahead.z * direction;
    float reach = (camera->far_clip - camera->near_clip) / ahead.z;
#if FEATURE_ORTHOGRAPHIC
    if (camera->kind == CAMERA_ORTHOGRAPHIC) {
        direction = unit((float3)(m[2], m[6], m[10]));
        origin = transform_point(m, (float3)(on_plane, camera->near_clip));
        reach = camera->far_clip - camera->near_clip;
    }
#endif
    ray_origin[slot] = (float4)(origin, reach);
    ray_direction[slot] = (float4)(direction, -1.0f);
    throughput[slot] = (float4)(1.0f);
    path[slot] = (uint4)(sample, NONE, index, 0u);
#if FEATURE_INSTANCES
    instance[slot] = NONE;
#endif
#if FEATURE_VOLPATH
    crossing[slot] = (uint2)(0u);
#endif
#if FEATURE_MEDIA
    medium[slot] = sensor_medium;
#endif
    store3((float3)(0.0f), sample, samples);
}
