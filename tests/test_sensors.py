"""Camera rays of every sensor: the kernel `generate` against Mitsuba's sensors for the same random numbers; images."""

import numpy as np
import pytest
from planes import read_rows
from scalar_mitsuba import as_mitsuba, assert_same_picture, import_mitsuba
from small_scene import lamp_over_floor
from test_random import philox_4x32

from isonoise.device.opencl import Device
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import KERNELS, STRUCTS
from isonoise.integrator.stages import Stages
from isonoise.render_scene import render
from isonoise.scene import compile_scene, load_description, structs

BLOCK_CAMERA = 1  # kernels/util/random.h
SEED = (7, 9)
SAMPLES = 8  # per pixel
VIEW = np.array([[0.8, 0, 0.6, 1], [0, 1, 0, 2], [-0.6, 0, 0.8, 3], [0, 0, 0, 1]])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
FILMS = [
    {"width": 9, "height": 5},
    {"width": 4, "height": 7},
    {"width": 16, "height": 12, "crop_offset_x": 3, "crop_offset_y": 4, "crop_width": 6, "crop_height": 5},
]
LENS = {"type": "thinlens", "fov": 40.0, "aperture_radius": 0.3, "focus_distance": 3.0}
SENSORS = {
    "pinhole": {"type": "perspective", "fov": 40.0, "principal_point_offset_x": 0.1, "to_world": VIEW},
    "lens": {**LENS, "to_world": VIEW},
    "wide lens": {**LENS, "aperture_radius": 50.0, "focus_distance": 0.02, "fov_axis": "larger", "to_world": VIEW},
    "lens with defaults": {"type": "thinlens", "aperture_radius": 0.05},
    "lens, mirrored": {**LENS, "near_clip": 0.5, "far_clip": 7.0, "to_world": VIEW @ MIRROR},
    "parallel": {"type": "orthographic", "to_world": VIEW},
    "parallel, scaled": {"type": "orthographic", "near_clip": 0.5, "to_world": VIEW @ np.diag([3.0, 2.0, 5.0, 1.0])},
    "parallel, mirrored": {"type": "orthographic", "to_world": VIEW @ MIRROR, "far_clip": 20.0},
}


def scene_with(sensor: dict, film: dict) -> dict:
    sampler = {"type": "independent"}
    return {
        "type": "scene",
        "sensor": {**sensor, "sampler": sampler, "film": {"type": "hdrfilm", **film, "rfilter": {"type": "box"}}},
    }


def film_pixels(scene) -> np.ndarray:
    """The pixels of the film that are those of the image, (pixels,) uint32."""
    (width, height), (left, top), size = scene.film_window
    in_film = np.arange(width * height, dtype=np.uint32).reshape(height, width)
    return in_film[top : top + size[1], left : left + size[0]].ravel()


def generate_rays(description: dict) -> tuple[np.ndarray, np.ndarray]:
    """Returns origins with lengths, and directions, both (pixels, SAMPLES, 4), as the kernel writes them."""
    scene = compile_scene(load_description(description))
    device = Device()
    constants = structs.CONSTANTS | {"LANES": device.form.lanes}
    stages = Stages(device, {"generate": KERNELS["generate"]}, features(scene), constants, STRUCTS)
    pixels = scene.width * scene.height
    n = pixels * SAMPLES
    out = {name: device.buffer(16 * n, name) for name in ("ray_origin", "ray_direction", "throughput", "path_ids")}
    stages.launch(
        "generate",
        n,
        device.form.lanes,
        **dict.fromkeys(("first_slot", "first_sample", "inverse_cdf_cells"), np.uint32(0)),
        **dict.fromkeys(("count_new", "plane_stride"), np.uint32(n)),
        **out,
        seed=np.array(SEED, np.uint32),
        camera=device.buffer(scene.camera, "camera"),
        inverse_cdf=None,
        sample_pixel=device.buffer(np.repeat(film_pixels(scene), SAMPLES), "list"),
        sample_index=device.buffer(np.tile(np.arange(SAMPLES, dtype=np.uint32), pixels), "indices"),
        samples=device.buffer(12 * n, "samples"),
    )
    return tuple(
        read_rows(device, out[name], n, 4).reshape(pixels, SAMPLES, 4) for name in ("ray_origin", "ray_direction")
    )


@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("name", SENSORS)
def test_rays_equal_mitsubas(name, film):
    """Both map the square to the disk in the same way (Shirley and Chiu), so lens samples can be compared one by one.

    Directions agree to a few roundings of float32, origins to a few roundings of their terms.
    """
    mitsuba = import_mitsuba()
    description = scene_with(SENSORS[name], film)
    theirs = mitsuba.load_dict(as_mitsuba(mitsuba, description["sensor"]))
    origins, directions = generate_rays(description)
    width, height = film.get("crop_width", film["width"]), film.get("crop_height", film["height"])
    in_film = film_pixels(compile_scene(load_description(description))).tolist()
    for pixel, index in np.ndindex(len(origins), SAMPLES):
        u = np.array([word >> 8 for word in philox_4x32((in_film[pixel], index, BLOCK_CAMERA, 0), SEED)]) / 2**24
        at = ((pixel % width + u[0]) / width, (pixel // width + u[1]) / height)
        ray, _ = theirs.sample_ray(0.0, 0.0, at, u[2:])
        np.testing.assert_allclose(directions[pixel, index, :3], np.array(ray.d), atol=2e-6)
        lengths = (
            np.abs(np.array(ray.o)).max() + np.linalg.norm(VIEW[:3, 3]) + SENSORS[name].get("aperture_radius", 0.0)
        )
        np.testing.assert_allclose(origins[pixel, index, :3], np.array(ray.o), atol=1e-6 * lengths)
        assert origins[pixel, index, 3] == pytest.approx(ray.maxt, rel=1e-4)


def test_a_lens_is_sampled_uniformly():
    """Mean 0, variance radius^2 / 4 along each axis, and all within the radius: 5 standard deviations, false alarms
    6e-7 for each of four comparisons. With a near_clip of nearly 0 the origin is on the lens."""
    origins, _ = generate_rays(scene_with({**LENS, "near_clip": 1e-6}, {"width": 40, "height": 30}))
    at = origins[..., :2].reshape(-1, 2).astype(float) / LENS["aperture_radius"]
    assert (at**2).sum(axis=1).max() < 1 + 1e-5
    noise = 5 / np.sqrt(len(at))
    assert np.abs(at.mean(axis=0)) == pytest.approx(0, abs=0.5 * noise)
    assert at.var(axis=0) == pytest.approx(0.25, abs=0.25 * noise)  # the fourth moment is 1/8


def test_rays_through_a_lens_meet_in_the_focal_plane():
    origins, directions = generate_rays(scene_with(LENS, {"width": 1, "height": 1}))
    pinhole, pinhole_directions = generate_rays(scene_with({**LENS, "aperture_radius": 0.0}, {"width": 1, "height": 1}))
    reach = (LENS["focus_distance"] - origins[..., 2:3]) / directions[..., 2:3]
    expected = (LENS["focus_distance"] - pinhole[..., 2:3]) / pinhole_directions[..., 2:3]
    focal_points = origins[..., :3] + reach * directions[..., :3]
    np.testing.assert_allclose(focal_points, pinhole[..., :3] + expected * pinhole_directions[..., :3], atol=1e-5)


def test_no_aperture_is_a_pinhole():
    film = {"width": 9, "height": 5}
    lens = generate_rays(scene_with({**LENS, "aperture_radius": 0.0, "to_world": VIEW}, film))
    pinhole = generate_rays(scene_with({"type": "perspective", "fov": 40.0, "to_world": VIEW}, film))
    for one, other in zip(lens, pinhole, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("radius", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize("focus", [1e-4, 1.0, 1e6])
def test_rays_stay_finite(radius, focus):
    sensor = {**LENS, "aperture_radius": radius, "focus_distance": focus, "to_world": VIEW}
    origins, directions = generate_rays(scene_with(sensor, {"width": 16, "height": 16}))
    assert np.isfinite(origins).all()
    assert np.linalg.norm(directions[..., :3], axis=-1) == pytest.approx(1, abs=1e-6)
    statistics = render(lamp_over_floor() | {"sensor": sensor}, spp=4, size=(96, 72)).statistics
    assert not statistics.rejected.any()
    assert np.isfinite(statistics.rgb).all()


def balls_and_wall(sensor: dict) -> dict:
    """Balls at several distances in front of a wall, under a lamp; the camera looks along -z."""

    def transform(x, y, z, size=1.0):
        matrix = np.diag([size, size, size, 1.0])
        matrix[:3, 3] = x, y, z
        return matrix

    lamp = transform(0, 2.5, -2, 0.8) @ np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    balls = {
        f"ball{i}": {
            "type": "sphere",
            "radius": 0.4,
            "to_world": transform(x, -0.3, z),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}},
        }
        for i, (x, z, colour) in enumerate(
            [(-0.8, -2, [0.8, 0.2, 0.1]), (0, -3, [0.2, 0.8, 0.1]), (0.9, -4, [0.5] * 3)]
        )
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "rr_depth": 5},
        "sensor": {**sensor, "film": {"type": "hdrfilm", "width": 24, "height": 18, "rfilter": {"type": "box"}}},
        "wall": {"type": "rectangle", "to_world": transform(0, 0, -5, 4.0)},
        "lamp": {
            "type": "rectangle",
            "to_world": lamp,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5.0, 4.0, 3.0]}},
        },
        **balls,
    }


LOOK_ALONG_MINUS_Z = np.diag([-1.0, 1.0, -1.0, 1.0])  # along -z, x to the right


@pytest.mark.parametrize(
    "sensor",
    [
        {**LENS, "fov": 50.0, "aperture_radius": 0.15, "to_world": LOOK_ALONG_MINUS_Z},
        {"type": "orthographic", "to_world": LOOK_ALONG_MINUS_Z @ np.diag([1.8, 1.8, 1.0, 1.0])},
    ],
    ids=["lens", "parallel"],
)
def test_images_equal_mitsubas(sensor, tmp_path):
    """False alarms: below 1 % for the pixels, at most 0.8 % for the means."""
    assert_same_picture(balls_and_wall(sensor), tmp_path, spp=32)
