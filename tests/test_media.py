"""Paths in media: free flights, scattering, and next-event estimation across boundaries, against closed forms."""

import math

import numpy as np
import pytest
from media_scenes import LAMBERT, NULL, PLAIN, henyey_greenstein, medium, one_ray, radiance, rgb, transform
from shared_programs import share_programs

import isonoise

shared_programs = share_programs(PLAIN)

# Free flights: a bright sky around, an index-matched ball and cube.

SKY = {"type": "constant", "radiance": 1.0}


def under_sky(sensor: dict, ball: dict, cube: dict | None = None, depth: int = -1, rr_depth: int = 5, **more) -> dict:
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": depth, "rr_depth": rr_depth},
        "sensor": sensor,
        "sky": SKY,
        "ball": {"type": "sphere", "center": [0.0, 0.0, -3.0], "bsdf": NULL, "interior": ball},
        "cube": {"type": "cube", "bsdf": NULL, "interior": cube or ball},
        **more,
    }


FRONT = one_ray((0.1, 0.2, 5.0), (0.1, 0.2, 0.0))


@pytest.mark.parametrize(
    ("sigma_t", "g"),
    [(0.5, None), (6.0, 0.9), pytest.param(6.0, -0.9, marks=pytest.mark.long), (rgb(0.1, 1.0, 3.0), 0.5)],
)
def test_white_furnace(sigma_t, g):
    """Media without absorption are invisible in front of a constant sky, to five standard errors of the luminance, or
    to 15 for coloured media."""
    seen, error = radiance(under_sky(FRONT, medium(sigma_t, 1.0, g), rr_depth=10**6), spp=4096)
    assert error < 0.02
    assert seen == pytest.approx([1.0] * 3, abs=5 * error * (3 if isinstance(sigma_t, dict) else 1))


def test_absorption_without_scattering():
    """Through the cube and the ball: exp(-sigma d). 15 standard errors of the luminance, because media are coloured."""
    seen, error = radiance(under_sky(FRONT, medium(rgb(0.1, 0.5, 1.0)), medium(rgb(0.2, 0.0, 0.3))), spp=2**16)
    through_ball = 2 * math.sqrt(1 - 0.1**2 - 0.2**2)
    expected = np.exp(-through_ball * np.array([0.1, 0.5, 1.0]) - 2 * np.array([0.2, 0.0, 0.3]))
    assert seen == pytest.approx(expected, rel=15 * error)


def h_function(albedo: float, mu: float) -> float:
    """Chandrasekhar's H for isotropic scattering: H(m) = 1 / (sqrt(1 - w) + w/2 integral n H(n) / (m + n) dn)."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    nodes, weights = (nodes + 1) / 2, weights / 2

    def step(at):
        return 1 / (math.sqrt(1 - albedo) + albedo / 2 * (weights * nodes * h / (at[:, None] + nodes)).sum(axis=1))

    h = np.ones(64)
    for _ in range(500):
        h = step(nodes)
    return step(np.array([mu])).item()


@pytest.mark.parametrize(
    ("sigma_t", "place"),
    [
        pytest.param(1e2, 0.0, marks=pytest.mark.long),
        (1e4, 0.0),
        (1e6, 0.0),
        pytest.param(1e4, 60.0, marks=pytest.mark.long),
    ],
    ids=["100", "1e4", "1e6", "1e4 far away"],
)
@pytest.mark.parametrize("shape", ["cube", "ball"])
def test_dense_media_reflect_as_half_spaces(shape, sigma_t, place):
    """Under a sky of radiance 1 a half space sends 1 - H(mu) sqrt(1 - w) back (S. Chandrasekhar, Radiative Transfer,
    1950, by reciprocity from its plane albedo). Where free flights come down to the steps of the float grid, paths
    begin deeper by the error of the surface: the loss, five steps of flight length at most, is what 32-bit floats cost.
    Nothing may become brighter, by light that leaks. The ball's curvature adds 1 / sigma_t."""
    albedo = 0.8
    center = np.array([0.1, 0.2, 0.0 if shape == "cube" else -3.0]) + place
    mu = 1.0
    sensor = one_ray(center + np.array([0.0, 0.0, 30.0]), center)
    dense, empty = medium(sigma_t, albedo), medium(0.0)
    scene = under_sky(sensor, dense if shape == "ball" else empty, dense if shape == "cube" else empty)
    scene["cube"]["to_world"] = transform(place, place, place)
    scene["ball"]["center"] = [place, place, place - 3.0]
    if shape == "ball":
        mu = math.sqrt(1 - 0.1**2 - 0.2**2)
    seen, error = radiance(scene, spp=2**15)
    expected = 1 - h_function(albedo, mu) * math.sqrt(1 - albedo)
    lost = 5 * 2**-23 * (abs(scene["ball"]["center"][2]) + 1 if shape == "ball" else place + 1) * sigma_t
    noise = 5 * error + 2 / sigma_t * (shape == "ball")
    assert expected * (1 - lost - noise) < seen[0] < expected * (1 + noise)


def test_a_camera_within_a_medium():
    """Rays leave the ball for a sky of 1: exp(-sigma d). The medium of the sensor counts, not the ball's.

    The distance is 1 without the near_clip of 0.01.
    """
    sensor = one_ray((0.0, 0.0, -3.0), (0.0, 0.0, -9.0)) | {"medium": medium(1.5)}
    seen, error = radiance(under_sky(sensor, medium(0.0)), spp=2**16)
    assert seen == pytest.approx([math.exp(-1.5 * 0.99)] * 3, rel=5 * error + 1e-4)


def test_thin_media_scatter_as_often_as_they_should():
    """Optical depth 2e-5 scatters one sample in 50,000, all of which is absorbed."""
    sensor = one_ray((0.1, 0.2, 0.0), (0.1, 0.2, 5.0))  # in the cube: the optical depth is sigma_t
    scene = under_sky(sensor | {"medium": medium(2e-5)}, medium(0.0), medium(2e-5))
    samples = 2**20
    statistics = isonoise.render(scene, spp=samples, strategy="uniform", seed=3).statistics
    lost = (1 - statistics.mean.astype(float).item()) * samples
    assert lost == pytest.approx(2e-5 * samples, abs=5 * math.sqrt(2e-5 * samples) + 1)


# Single scattering.


@pytest.mark.parametrize("g", [0.0, 0.7])
def test_single_scattering(g):
    """A ball of a medium, a point light beside it, max_depth 2: the integral of sigma_s p(theta) I / d^2 times the
    transmittance to light and camera, with 4,096 points in float64. 15 standard errors for coloured media."""
    sigma_t, albedo, radius, light = (
        np.array([0.4, 0.8, 1.6]),
        np.array([0.9, 0.6, 0.3]),
        1.0,
        np.array([1.5, 0.0, 1.0]),
    )
    inside = medium(rgb(*(sigma_t / 2)), rgb(*albedo), g, scale=2.0)
    ball = {"type": "sphere", "bsdf": NULL, "interior": inside}
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 2},
        "sensor": one_ray((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)),
        "light": {"type": "point", "position": light.tolist(), "intensity": 2.0},
        "ball": ball,
    }
    seen, error = radiance(scene, spp=2**16)
    t = (np.arange(4096) + 0.5) / 4096 * 2 * radius
    points = np.stack([0 * t, 0 * t, radius - t], axis=1)
    arm = light - points
    distance = np.linalg.norm(arm, axis=1)
    to_light = arm / distance[:, None]
    b = (points * to_light).sum(axis=1)
    out = -b + np.sqrt(b * b - (points**2).sum(axis=1) + radius**2)
    through = np.exp(-np.outer(t + np.minimum(out, distance), sigma_t))
    phase = henyey_greenstein(
        g, -to_light @ np.array([0.0, 0.0, 1.0])
    )  # from the direction of the light to that of the camera
    integrand = through * (phase * 2.0 / distance**2)[:, None]
    expected = sigma_t * albedo * integrand.sum(axis=0) * (2 * radius / 4096)
    assert seen == pytest.approx(expected, rel=15 * error)


# Multiple importance sampling across boundaries.


@pytest.mark.parametrize("boundary", [0.1, 0.5, 1.1])
def test_weights_hold_across_boundaries(boundary):
    """Null boundaries around a lamp change nothing: the pdf of a point on a light is relative to the last vertex, not
    to the boundary. The lamp is a sphere of radiance L: E = pi L R^2 / d^2 cos(theta). Five standard errors."""
    center, radius, at, emitted = np.array([0.0, 0.0, 1.2]), 0.4, np.array([0.4, 0.0, 0.0]), 5.0
    sphere = {"type": "sphere", "center": center.tolist()}
    seen, error = radiance(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 2},
            "sensor": one_ray((0.8, 0.0, 0.3), at),
            "floor": {"type": "rectangle", "bsdf": LAMBERT},
            "lamp": sphere | {"radius": radius, "emitter": {"type": "area", "radiance": emitted}},
            "around": sphere | {"radius": radius + boundary, "bsdf": NULL},
            "cover": {"type": "rectangle", "to_world": transform(z=0.02, scale=3.0), "bsdf": NULL},
        },
        spp=2**15,
    )
    irradiance = math.pi * emitted * radius**2 * center[2] / np.linalg.norm(center - at) ** 3
    assert seen == pytest.approx([LAMBERT["reflectance"] / math.pi * irradiance] * 3, rel=5 * error)
