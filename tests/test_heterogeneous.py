"""Paths and shadow rays in heterogeneous media, against closed forms, float64 integrals and homogeneous media."""

import math

import numpy as np
import pytest
from grid_reference import grid, ramp, value_at
from media_scenes import NULL, PLAIN, lit_floor, one_ray, radiance, rgb, transform
from shared_programs import share_programs

import isonoise

pytestmark = pytest.mark.long  # they compile programs of their own
shared_programs = share_programs((*PLAIN, "HETEROGENEOUS"))

BOX = transform(x=-2, y=-2, scale=(4.0, 4.0, 2.0))  # the unit cube becomes [-2, 2]^2 x [0, 2]
SHELL = {"type": "cube", "to_world": transform(z=1.0, scale=(2.0, 2.0, 1.0)), "bsdf": NULL}
SKY = {"type": "constant", "radiance": 1.0}
FAR = {"far_sphere": {"type": "sphere", "center": [50.0, 0.0, 0.0], "bsdf": NULL}}
DOWN = one_ray((0.1, 0.2, 5.0), (0.1, 0.2, 0.0))


def smoke(sigma_t, albedo=0.0, g: float | None = None, **more) -> dict:
    phase = {} if g is None else {"phase": {"type": "hg", "g": g}}
    return {"type": "heterogeneous", "sigma_t": sigma_t, "albedo": albedo, **phase, **more}


def seen_through(medium: dict, sensor: dict = DOWN, rr_depth: int = 1000, **objects) -> dict:
    """A box of the medium under a constant sky of radiance 1."""
    integrator = {"type": "volpath", "max_depth": -1, "rr_depth": rr_depth}
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": sensor,
        "sky": SKY,
        "box": SHELL | {"interior": medium},
        **objects,
    }


def transmittance(values: np.ndarray, begin, end, scale: float = 1.0, **wrap) -> np.ndarray:
    """Returns exp(-integral) between two points of the unit cube's space, in float64. `scale`: of lengths as well."""
    steps = 200_000
    t = (np.arange(steps)[:, None] + 0.5) / steps
    sigma = value_at(values.reshape(*values.shape[:3], -1), np.asarray(begin) + t * np.subtract(end, begin), **wrap)
    return np.exp(-scale * sigma.mean(axis=0))


def under_lamp(medium: dict) -> dict:
    """A floor lit through a box of the medium; 1 without it."""
    return lit_floor(**FAR, box=SHELL | {"to_world": transform(z=1.0, scale=(2.0, 2.0, 0.9)), "interior": medium})


RAMPS = {  # sigma_t, wrap_mode and filter, scale
    "a ramp": (ramp(0, 1), {}, 1.0),
    "a falling ramp": (ramp(2, 0), {}, 1.0),
    "thin": (ramp(0, 1), {}, 1e-4),
    "colours": (np.stack([ramp(0, 1), ramp(0.3, 0), ramp(1, 2)], axis=-1), {}, 1.0),
    "constant": (ramp(0.5, 0.5), {}, 1.0),
    "nearest": (ramp(0, 1, 5), {"filter_type": "nearest"}, 1.0),
    "empty": (ramp(0, 0), {}, 1.0),
    "mostly empty": (np.eye(24, dtype=np.float32)[3][:, None, None] * 5, {}, 1.0),
}


@pytest.mark.parametrize("name", RAMPS)
def test_transmittance_of_ramps(name):
    """Of shadow rays and of camera rays: exp(-integral) in float64, to five standard errors. Those of the channels are
    at most those of numbers of 0 and 1, or of 0 and 3."""
    values, more, scale = RAMPS[name]
    medium = smoke(grid(values, BOX, **more), scale=scale)
    nearest = more.get("filter_type") == "nearest"
    values = values.reshape(*values.shape[:3], -1)
    expected = transmittance(values, (0.5, 0.5, 0.05), (0.5, 0.5, 0.95), 1.8 * scale, nearest=nearest)
    seen, _ = radiance(under_lamp(medium), spp=2**16)
    assert (np.abs(seen - expected) <= 5 * np.sqrt(expected * (1 - expected) / 2**16) + 3e-5).all()
    expected = transmittance(values, (0.5, 0.5, 0.0), (0.5, 0.5, 1.0), 2.0 * scale, nearest=nearest)
    seen, _ = radiance(seen_through(medium), spp=2**16)
    assert (np.abs(seen - expected) <= 5 * np.sqrt(expected * (3 - expected) / 2**16) + 3e-5).all()


def noise(channels: int = 1, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((9, 8, 10, channels)).astype(np.float32) ** 2


@pytest.mark.parametrize("wrap", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
def test_transmittance_of_slanted_rays_through_turned_grids(wrap, filter_type):
    """The medium fills the world-aligned box around the turned grid, and wrap_mode says what is beside the grid."""
    turn = np.array([[0.8, -0.6, 0, 0], [0.6, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    to_world = transform(z=0.3) @ turn @ transform(x=-0.4, y=-0.6, scale=(1.0, 1.2, 1.4))
    corners = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) @ to_world.T
    lower, upper = corners[:, :3].min(axis=0), corners[:, :3].max(axis=0)
    values = noise(3)
    medium = smoke(grid(values, to_world, wrap_mode=wrap, filter_type=filter_type), scale=1.5)
    for target in ((0.3, 0.2, 0.9), (-0.6, 0.5, 1.2), (0.8, -0.5, 0.6)):
        eye = np.array([0.3, 1.0, 5.0])
        towards = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
        with np.errstate(divide="ignore"):
            distances = np.sort(np.stack([(lower - eye) / towards, (upper - eye) / towards]), axis=0)
        begin, end = distances[0].max(), distances[1].min()
        assert begin < end
        places = (np.append(eye + t * towards, 1) @ np.linalg.inv(to_world).T for t in (begin, end))
        first, last = (place[:3] for place in places)
        more = {"wrap": wrap, "nearest": filter_type == "nearest"}
        expected = transmittance(values, first, last, 1.5 * (end - begin), **more)
        seen, error = radiance(seen_through(medium, one_ray(eye, target)), spp=2**16)
        assert seen == pytest.approx(expected, rel=15 * error + 1e-4)


@pytest.mark.parametrize("name", ["grey", "forwards", "coloured", "dense", "a gap"])
def test_white_furnace(name):
    """Media without absorption are invisible in front of a constant sky. Five standard errors; 15 for colours."""
    sigma_t, g, scale = {
        "grey": (noise(), None, 3.0),
        "forwards": (noise(), 0.8, 10.0),
        "coloured": (noise(3), 0.3, 4.0),
        "dense": (noise(), None, 20.0),
        "a gap": (ramp(1, 0) * (ramp(0, 1) > 0.5), -0.5, 8.0),
    }[name]
    for albedo in (1.0, grid(np.ones((2, 2, 2)), BOX)):
        medium = smoke(grid(sigma_t, BOX), albedo, g, scale=scale)
        seen, error = radiance(seen_through(medium, rr_depth=10**6), spp=2048)
        assert error < 0.02
        assert seen == pytest.approx([1.0] * 3, abs=5 * error * (3 if name == "coloured" else 1))


CONSTANTS = {
    "grid": grid(np.full((3, 4, 5), 1.5), BOX),
    "coloured grid": grid(np.broadcast_to(np.array([1.5, 0.5, 1.0]), (3, 4, 5, 3)), BOX),
    "constvolume": {"type": "constvolume", "value": rgb(1.5, 0.5, 1.0), "to_world": BOX},
}


@pytest.mark.parametrize("name", CONSTANTS)
def test_constant_volumes_are_homogeneous_media(name):
    """With an albedo of one colour, and with a grid of the same; lit by a lamp and the sky."""
    sigma_t = 1.5 if name == "grid" else rgb(1.5, 0.5, 1.0)
    albedo = rgb(0.9, 0.5, 0.7)
    lamp = {"lamp": {"type": "point", "position": [1.0, 2.0, 3.0], "intensity": 5.0}}
    uniform = {"type": "homogeneous", "sigma_t": sigma_t, "albedo": albedo, "phase": {"type": "hg", "g": 0.4}}
    expected, expected_error = radiance(seen_through(uniform, rr_depth=5, **lamp), spp=2**16, seed=2)
    coloured = grid(np.broadcast_to(np.array([0.9, 0.5, 0.7]), (2, 2, 2, 3)), BOX)
    for each in (albedo, coloured):
        seen, error = radiance(seen_through(smoke(CONSTANTS[name], each, 0.4), rr_depth=5, **lamp), spp=2**16)
        assert seen == pytest.approx(expected, rel=15 * math.hypot(error, expected_error))


def test_albedo_of_a_grid_is_read_where_the_path_scatters():
    """Thin medium, one bounce: in-scattered light is the integral of sigma_s over the ray, to first order."""
    albedo = ramp(0, 1)
    medium = smoke(1e-3, grid(albedo, BOX))
    medium["sigma_t"] = {"type": "constvolume", "value": 1e-3, "to_world": BOX}
    lamp = {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": 1.0}
    scene = seen_through(medium) | {"sky": lamp, "integrator": {"type": "volpath", "max_depth": 2, "rr_depth": 99}}
    seen, error = radiance(scene, spp=2**20)
    assert seen == pytest.approx([1e-3 * 2 * 0.5 / (4 * math.pi)] * 3, rel=5 * error + 2e-3)
    assert error < 0.02


@pytest.mark.parametrize("thickness", [1e3, 1e4, 1e6])
def test_extremely_dense_media(thickness):
    """Finite numbers, and no light through them. A dense cell beside empty ones leaves the rest of the volume empty."""
    values = np.zeros((16, 16, 16), np.float32)
    values[8, 3, 3] = 1.0
    beside, _ = radiance(seen_through(smoke(grid(values, BOX), 0.5, scale=thickness), rr_depth=5), spp=256)
    assert beside == pytest.approx([1.0] * 3, abs=1e-6)
    through = one_ray((-1.1, -1.1, 5.0), (-1.1, -1.1, 0.0))
    seen, _ = radiance(seen_through(smoke(grid(values, BOX), 0.0, scale=thickness), through, rr_depth=5), spp=256)
    assert seen.max() == 0
    solid = smoke(grid(noise() + 0.1, BOX), 0.8, scale=thickness)
    seen, _ = radiance(seen_through(solid, rr_depth=5), spp=1024)
    assert 0.2 < seen[0] < 0.6
    assert radiance(under_lamp(solid | {"albedo": 0.0}), spp=256)[0].max() == 0


def test_the_camera_inside_and_a_scene_far_away():
    """A camera in the middle of the volume sees half of it; far from the origin, the same picture."""
    values = ramp(0, 1)[..., None]
    expected = transmittance(values, (0.5, 0.5, 0.5), (0.5, 0.5, 1.0), 1.0)
    for shift, size in ((0.0, 1.0), (1e4, 1.0), (0.0, 1e-9)):
        move = transform(shift, shift, shift, scale=size)
        medium = smoke(grid(values, move @ BOX), scale=1 / size)
        camera = one_ray((0, 0, 1), (0, 0, 2), medium=medium)
        camera |= {"to_world": transform(shift, shift, shift) @ transform(scale=size) @ camera["to_world"]}
        camera |= {"near_clip": 1e-6, "far_clip": 1e6}
        scene = seen_through(medium, camera)
        scene["box"] = scene["box"] | {"to_world": move @ SHELL["to_world"]}
        seen, error = radiance(scene, spp=2**14)
        assert seen == pytest.approx(np.broadcast_to(expected, 3), rel=5 * error)


def test_many_interfaces_and_nested_media():
    """Slabs of a grid inside a fog, with other slabs of nothing: each part of the ray counts once."""
    values = ramp(0, 2)[..., None]
    medium = smoke(grid(values, BOX))
    shapes = {}
    for number in range(12):
        low = 0.2 + 0.15 * number
        to_world = transform(z=low + 0.04, scale=(1.9, 1.9, 0.04))
        shapes[f"slab {number}"] = {"type": "cube", "to_world": to_world, "bsdf": NULL, "interior": medium}
    depth = sum(
        -math.log(transmittance(values, (0.5, 0.5, z / 2), (0.5, 0.5, z / 2 + 0.04), 0.08)[0])
        for z in (0.2 + 0.15 * number for number in range(12))
    )
    seen, error = radiance(lit_floor(**FAR, **shapes), spp=2**14)
    assert seen == pytest.approx([math.exp(-depth)] * 3, rel=5 * error + 1e-4)
    fog = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.0}
    shapes["fog"] = SHELL | {"to_world": transform(z=1.0, scale=(2.0, 2.0, 0.95)), "interior": fog}
    for number in range(12):
        shapes[f"slab {number}"] |= {"exterior": fog}
    seen, error = radiance(lit_floor(**FAR, **shapes), spp=2**14)
    assert seen == pytest.approx([math.exp(-depth - 0.3 * (1.9 - 12 * 0.08))] * 3, rel=5 * error + 1e-4)


def test_the_size_of_the_pool_changes_no_bit():
    """Random numbers depend on seed, pixel, sample and vertex, not on the place of a path in the pool."""
    scene = seen_through(smoke(grid(noise(3), BOX), 0.8, 0.3, scale=4.0), rr_depth=3, **FAR)
    scene["sensor"] = DOWN | {"film": DOWN["film"] | {"width": 24, "height": 16}}
    images = []
    for pool_size in (1 << 11, 1 << 14):
        renderer = isonoise.Renderer(scene, strategy="uniform:wave_spp=32", seed=5, pool_size=pool_size)
        renderer.step()
        images.append(renderer.statistics().rgb)
    assert (images[0] == images[1]).all()
    assert images[0].min() > 0
