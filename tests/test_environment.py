"""Environment maps on the device: radiance against Mitsuba 3 and float64, sampling against its density.

Chi-square statistics are compared as standard normal deviates at Z = 5, two-sided: 6e-7 for each of about 20, so false
alarms are 1e-5 for the file under other seeds. A mean of samples may be off by Z standard errors.
"""

import numpy as np
import pytest
from kernel_build import build_kernels

from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.scene.image.image import Image, read_image
from isonoise.scene.light.envmap import EnvironmentMap, build_environment_map
from isonoise.scene.light.inverse_cdf import MAX_CELLS

Z = 5.0
SAMPLES = 1 << 19
KERNEL = """
#include "light/envmap.h"
__kernel void sample(__global const Environment* record, __global const float* texels,
                     __global const float* rows, __global const uint* guide, __global const float* u,
                     __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Envmap map = {record, texels, rows, guide};
    Vec3 direction;
    float pdf;
    const Vec3 radiance = envmap_sample(&map, envmap_position(&map, vec2(u[2 * i], u[2 * i + 1])), &direction, &pdf);
    STORE3(direction, 0, out + 8 * i);
    out[8 * i + 3] = pdf;
    STORE3(radiance, 0, out + 8 * i + 4);
}

__kernel void radiance(__global const Environment* record, __global const float* texels,
                   __global const float* rows, __global const uint* guide,
                   __global const float* directions, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Envmap map = {record, texels, rows, guide};
    float pdf;
    const Vec3 direction = LOAD3(i, directions), radiance = envmap_radiance(&map, direction, &pdf);
    STORE3(radiance, 0, out + 4 * i);
    out[4 * i + 3] = pdf;
}
"""


class EnvironmentKernels:
    """Runs the kernels on a map."""

    def __init__(self):
        self.device = Device()

    def _run(self, kernel: str, map_: EnvironmentMap, given: np.ndarray, rows: int) -> np.ndarray:
        n = len(given)
        kernels = build_kernels(self.device, KERNEL, ("ENVIRONMENT_MAP", "NEXT_EVENT"))
        arrays = (map_.record, map_.texels, map_.rows, map_.guide, given)
        out = self.device.buffer(16 * rows * n, "results")
        buffers = [self.device.buffer(array, "a map") for array in arrays]
        self.device.launch(kernels[kernel], n, (*buffers, out, np.uint32(n)))
        return self.device.read(out, np.float32, 4 * rows * n).reshape(n, rows, 4).astype(np.float64)

    def sample(self, map_: EnvironmentMap, count: int = SAMPLES, seed: int = 1):
        """Returns directions (n, 3), pdf (n,) and radiance (n, 3)."""
        u = np.random.default_rng(seed).integers(0, 1 << 24, (count, 2)).astype(np.float32) / (1 << 24)
        out = self._run("sample", map_, u, 2)
        return out[:, 0, :3], out[:, 0, 3], out[:, 1, :3]

    def radiance(self, map_: EnvironmentMap, directions: np.ndarray):
        """Returns radiance (n, 3) and pdf (n,)."""
        out = self._run("radiance", map_, np.ascontiguousarray(directions, np.float32), 1)
        return out[:, 0, :3], out[:, 0, 3]


@pytest.fixture(scope="module")
def kernels():
    return EnvironmentKernels()


def rotation(seed: int, mirrored: bool = False, size: float = 1.0) -> np.ndarray:
    """Returns a random rotation, mirrored and scaled."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q)) * (-1 if mirrored else 1) * size
    return np.block([[q, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])


def make_pixels(name: str) -> np.ndarray:
    """Returns linear RGB (height, width, 3) float32."""
    random = np.random.default_rng(2)
    if name == "smallest":
        return random.random((3, 2, 3), dtype=np.float32)
    if name == "noise":
        return random.random((9, 16, 3), dtype=np.float32)
    if name == "plain":
        return np.full((17, 32, 3), (0.5, 0.25, 1.0), np.float32)
    if name == "sun":  # 98,000 times the mean: nearly all of the light
        pixels = random.uniform(0.5, 1.5, (257, 512, 3)).astype(np.float32)
        pixels[70, 130] = 5e6
        return pixels
    if name == "zenith":  # a sun at the pole, where a row is one point, and one beside the seam at the other pole
        pixels = random.uniform(0.5, 1.5, (17, 32, 3)).astype(np.float32)
        pixels[0] = 1e5
        pixels[15, 31] = 1e4
        return pixels
    if name == "lamps":  # black except for a few texels: most rows and cells are never sampled
        pixels = np.zeros((33, 64, 3), np.float32)
        pixels[4, 63], pixels[20, 5:7], pixels[32, 10], pixels[11, 0] = 3.0, 1.0, 7.0, (0.0, 0.0, 1e-3)
        return pixels
    assert name == "steep"  # a factor of 10^12 between neighbours, in small values
    return (1e-20 * 10.0 ** random.uniform(0, 12, (9, 16, 3))).astype(np.float32)


MAPS = ("smallest", "noise", "plain", "sun", "zenith", "lamps", "steep")


def make_map(name: str, to_world=None, scale: float = 1.0) -> EnvironmentMap:
    return build_environment_map(
        Image(make_pixels(name)), rotation(3) if to_world is None else to_world, scale, "envmap"
    )


def to_directions(texel: np.ndarray, to_world: np.ndarray, shape) -> np.ndarray:
    """Returns world directions of texel coordinates (n, 2) = (column, row), texel centres at whole numbers."""
    phi = (texel[:, 0] + 0.5) / shape[1] * 2 * np.pi
    theta = texel[:, 1] / (shape[0] - 1) * np.pi
    sine = np.sin(theta)
    local = np.stack([np.sin(phi) * sine, np.cos(theta), -np.cos(phi) * sine], axis=1)
    return local @ to_world[:3, :3].T


def to_texels(directions: np.ndarray, to_world: np.ndarray, shape) -> np.ndarray:
    """Returns texel coordinates of directions, columns in [0, width)."""
    x, y, z = (directions @ to_world[:3, :3]).T
    column = np.arctan2(x, -z) / (2 * np.pi) * shape[1] - 0.5
    return np.stack([column % shape[1], np.arctan2(np.hypot(x, z), y) / np.pi * (shape[0] - 1)], axis=1)


def bilinear(pixels: np.ndarray, texel: np.ndarray) -> np.ndarray:
    """Returns the bilinear radiance at texel coordinates (n, 2)."""
    height, width, _ = pixels.shape
    left, top = np.floor(texel[:, 0]).astype(int), np.minimum(texel[:, 1].astype(int), height - 2)
    s, t = (texel[:, 0] - left)[:, None], (texel[:, 1] - top)[:, None]
    a, b = left % width, (left + 1) % width
    upper = (1 - s) * pixels[top, a] + s * pixels[top, b]
    lower = (1 - s) * pixels[top + 1, a] + s * pixels[top + 1, b]
    return (1 - t) * upper + t * lower


def quadrature(shape, nodes: int, parts: int = 1):
    """Returns Gauss-Legendre nodes in parts x parts of every cell (cells, nodes^2, 2), and their solid angles."""
    height, width = shape
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2 / parts, w / 2 / parts
    columns, rows = np.meshgrid(np.arange(width * parts) / parts, np.arange((height - 1) * parts) / parts)
    corners = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    inside = np.stack(np.meshgrid(x, x), axis=-1).reshape(1, -1, 2)
    texel = corners + inside
    theta = texel[..., 1] / (height - 1) * np.pi
    solid_angle = np.outer(w, w).ravel() * np.sin(theta) * (2 * np.pi / width) * (np.pi / (height - 1))
    return texel, solid_angle


def normal_deviate(observed: np.ndarray, expected: np.ndarray) -> float:
    """Converts the chi-square statistic (Wilson and Hilferty 1931); bins with fewer than 10 expected are merged."""
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    merged = min(int(np.searchsorted(np.cumsum(expected) > 10, True)) + 1, len(expected))
    merged = max(merged, int(np.searchsorted(expected, 10)))
    observed = np.concatenate([[observed[:merged].sum()], observed[merged:]])
    expected = np.concatenate([[expected[:merged].sum()], expected[merged:]])
    freedom = len(observed) - 1
    chi = ((observed - expected) ** 2 / expected).sum()
    return ((chi / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / np.sqrt(2 / (9 * freedom))


@pytest.mark.parametrize("name", MAPS)
def test_sampling_follows_the_pdf(kernels, name):
    """The chi-square of sampled directions in quarters of cells, against the device's own pdf integrated over them.

    pdf * sin(theta) is bilinear within a cell, so that two nodes a side integrate it exactly. It sums to 1 within 1e-5:
    the pdf is rounded, and texel coordinates are off by 2^-24 of the size.
    """
    map_, to_world = make_map(name), rotation(3)
    shape = map_.texels.shape[:2]
    texel, solid_angle = quadrature(shape, 2, parts=2)
    directions = to_directions(texel.reshape(-1, 2), to_world, shape)
    probability = (kernels.radiance(map_, directions)[1].reshape(solid_angle.shape) * solid_angle).sum(axis=1)
    assert probability.sum() == pytest.approx(1, abs=2e-5)

    sampled, pdf, _ = kernels.sample(map_)
    assert (pdf > 0).all()
    bins = (2 * to_texels(sampled, to_world, shape)).astype(int)
    width = 2 * shape[1]
    index = np.minimum(bins[:, 1], 2 * shape[0] - 3) * width + bins[:, 0] % width
    observed = np.bincount(index, minlength=len(probability))
    assert observed[probability == 0].sum() <= 1e-5 * SAMPLES  # rounded over an edge
    assert abs(normal_deviate(observed, SAMPLES * probability)) < Z


@pytest.mark.parametrize("name", MAPS)
def test_radiance_and_pdf_of_a_sample(kernels, name):
    """Radiance and pdf of a sample equal those of a ray in its direction, and the map in float64.

    The components of a direction are off by a few times 2^-24, the angle around the pole by as much over its sine. So
    are the texel coordinates, which changes radiance by the difference between neighbours, at most the largest of
    them. The same holds for the density; the sine that it is divided by is off itself.
    """
    map_, to_world, pixels = make_map(name, scale=2.5), rotation(3), 2.5 * make_pixels(name).astype(np.float64)
    height, width = shape = map_.texels.shape[:2]
    sampled, pdf, radiance = kernels.sample(map_, 1 << 16, seed=4)
    np.testing.assert_allclose(np.linalg.norm(sampled, axis=1), 1, atol=1e-6)
    looked_up, density = kernels.radiance(map_, sampled)
    texel, step = to_texels(sampled, to_world, shape), np.pi / (height - 1)
    theta = texel[:, 1] * step
    off = 2.0**-21 * (width / (2 * np.pi * np.sin(theta)) + 1 / step)
    columns, rows = np.floor(texel).astype(int).T
    around = [
        pixels[np.clip(rows + j, 0, height - 1), (columns + i) % width] for i in (-1, 0, 1, 2) for j in (-1, 0, 1, 2)
    ]
    largest = np.max(around, axis=(0, 2))
    expected = bilinear(pixels, texel)
    for found in (radiance, looked_up):
        assert (np.abs(found - expected).max(axis=1) <= (off + 1e-6) * largest).all()
    peak = map_.record["density"][0] / map_.record["scale"][0] * largest * np.minimum(np.sin(theta) + step, 1)
    assert (np.abs(pdf - density) <= (off * peak + 2.0**-21 * pdf) / np.sin(theta) + 1e-5 * pdf).all()


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_irradiance(kernels, name, axis):
    """Irradiance of planes that face along the axes, from samples, against quadrature in float64.

    The horizon cuts cells: with 8 x 8 nodes a cell the error is below 3e-4 for the coarsest maps. The samples vary
    mostly by the cosine, even with a sun.
    """
    map_, to_world, pixels = make_map(name), rotation(3), make_pixels(name).astype(np.float64)
    shape = map_.texels.shape[:2]
    texel, solid_angle = quadrature(shape, 2 if name == "sun" else 8)
    cosine = np.maximum(to_directions(texel.reshape(-1, 2), to_world, shape)[:, axis], 0)
    expected = (bilinear(pixels, texel.reshape(-1, 2)) * (cosine * solid_angle.ravel())[:, None]).sum(axis=0)
    sampled, pdf, radiance = kernels.sample(map_, seed=5 + axis)
    estimate = radiance * (np.maximum(sampled[:, axis], 0) / pdf)[:, None]
    se = estimate.std(axis=0) / np.sqrt(SAMPLES)
    assert (np.abs(estimate.mean(axis=0) - expected) <= Z * se + 3e-4 * expected).all()


def test_a_dim_sky_beside_a_sun(kernels):
    """Cells with a probability near 2^-24, the last bit of a number, are sampled in proportion: 64 groups of cells."""
    shape = (4, 8192)
    pixels = np.random.default_rng(11).uniform(0.5, 1.5, (*shape, 3)).astype(np.float32)
    pixels[1, 3000] = 2e7
    map_ = build_environment_map(Image(pixels), np.eye(4), 1.0, "envmap")
    texel, solid_angle = quadrature(shape, 2)
    pdf = kernels.radiance(map_, to_directions(texel.reshape(-1, 2), np.eye(4), shape))[1].reshape(solid_angle.shape)
    is_dim = np.tile(np.abs(np.arange(shape[1]) - 2999.5) > 1, shape[0] - 1)
    probability = (pdf * solid_angle).sum(axis=1) * is_dim
    assert 2.0**-26 < np.median(probability) < 2.0**-23
    cells = to_texels(kernels.sample(map_, 1 << 22)[0], np.eye(4), shape).astype(int)
    index = np.minimum(cells[:, 1], shape[0] - 2) * shape[1] + cells[:, 0] % shape[1]
    observed = np.bincount(index, minlength=len(probability)) * is_dim
    grouped = [a.reshape(-1, 384).sum(axis=1) for a in (observed, (1 << 22) * probability)]
    assert abs(normal_deviate(*grouped)) < Z


def test_mean_radiance(kernels):
    for name in MAPS:
        map_, pixels = make_map(name, scale=3.0), make_pixels(name).astype(np.float64)
        texel, solid_angle = quadrature(pixels.shape[:2], 2 if name == "sun" else 5)
        expected = 3 * (bilinear(pixels, texel.reshape(-1, 2)) * solid_angle.reshape(-1, 1)).sum(axis=0) / (4 * np.pi)
        np.testing.assert_allclose(map_.mean, expected, rtol=1e-6)
        assert map_.largest == pytest.approx(3 * (pixels @ [0.2126, 0.7152, 0.0722]).max(), rel=1e-6)


@pytest.mark.parametrize(("name", "most"), [("plain", 0.06), ("sun", 0.02), ("noise", 0.2), ("zenith", 0.75)])
def test_a_sun_makes_no_noise(kernels, name, most):
    """Luminance over pdf is nearly the same for all samples; its relative standard deviation is at most `most`.

    The rest is the difference between interpolated sines and the sine itself, in maps of few rows. It is largest if
    all light comes from one pole: from a density of 1 - t samples weigh t, which makes sqrt(1 / 2).
    """
    _, pdf, radiance = kernels.sample(make_map(name))
    weight = radiance @ [0.2126, 0.7152, 0.0722] / pdf
    assert weight.std() < most * weight.mean()


@pytest.mark.parametrize("mirrored", [False, True])
def test_radiance_is_mitsubas(kernels, mirrored):
    """Except near a pole, where Mitsuba's acos(y) is inaccurate."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    pixels, to_world = make_pixels("noise"), rotation(7, mirrored)
    map_ = build_environment_map(Image(pixels), to_world, 1.7, "envmap")
    theirs = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "scale": 1.7, "to_world": mi.ScalarTransform4f(to_world)}
    emitter = mi.load_dict(theirs)
    directions = np.random.default_rng(8).normal(size=(1000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions = directions[np.abs(directions @ to_world[:3, 1]) < 0.999]
    expected = []
    for direction in directions:
        si = mi.SurfaceInteraction3f()
        si.wi = -mi.Vector3f(direction)
        expected.append(np.array(emitter.eval(si)))
    np.testing.assert_allclose(kernels.radiance(map_, directions)[0], expected, rtol=0, atol=2e-5)


def test_poles_and_seam(kernels):
    """Exactly along the axes of the map, and slightly off: finite values, and the right radiance."""
    pixels, map_ = make_pixels("noise"), make_map("noise", np.eye(4))
    step = 1e-7
    beside = [[0, 1, 0], [0, -1, 0], [step, 1, 0], [0, -1, -step], [0, 0, -1], [0, 0, 1], [-step, 0, -1], [1e-30, 0, 1]]
    directions = np.array(beside, np.float32)
    radiance, pdf = kernels.radiance(map_, directions)
    assert np.isfinite(radiance).all()
    assert (pdf > 0).all()
    assert np.isfinite(pdf).all()
    expected = bilinear(pixels.astype(np.float64), to_texels(directions.astype(np.float64), np.eye(4), (9, 16)))
    np.testing.assert_allclose(radiance[2:], expected[2:], atol=1e-5)
    for row, found in ((0, radiance[0]), (-1, radiance[1])):  # along an axis the column is arbitrary
        assert (found >= pixels[row].min(axis=0) - 1e-6).all()
        assert (found <= pixels[row].max(axis=0) + 1e-6).all()


def test_invalid_directions(kernels):
    """They read nothing outside of the map."""
    values = np.array([np.nan, np.inf, -np.inf, 0.0, 1e38])
    directions = np.stack(np.meshgrid(values, values, values), axis=-1).reshape(-1, 3)
    kernels.radiance(make_map("sun"), directions)
    radiance, _ = kernels.radiance(make_map("noise"), np.zeros((1, 3)))
    assert np.isfinite(radiance).all()


def test_all_dark(kernels):
    map_ = build_environment_map(Image(np.zeros((5, 8, 3), np.float32)), np.eye(4), 1.0, "envmap")
    _, pdf, radiance = kernels.sample(map_, 1000)
    assert (pdf == 0).all()
    assert (radiance == 0).all()
    assert map_.largest == 0


def test_a_uniform_scale_does_not_matter(kernels):
    directions = np.random.default_rng(9).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    plain, scaled = make_map("noise", rotation(3)), make_map("noise", rotation(3, size=4.0))
    assert (kernels.radiance(plain, directions)[0] == kernels.radiance(scaled, directions)[0]).all()


def test_images_of_bytes_and_of_one_channel(kernels):
    grey = np.random.default_rng(10).integers(0, 256, (9, 16, 1), dtype=np.uint8)
    map_ = build_environment_map(Image(grey), np.eye(4), 1.0, "envmap")
    linear = np.broadcast_to(Image(grey).linear(), (9, 16, 3))
    same = build_environment_map(Image(np.ascontiguousarray(linear)), np.eye(4), 1.0, "envmap")
    assert (map_.texels == same.texels).all()
    assert (map_.guide == same.guide).all()


@pytest.mark.parametrize(
    ("pixels", "to_world", "message"),
    [
        (np.ones((2, 8, 3), np.float32), np.eye(4), "at least 2 x 3 pixels, this one has 8 x 2"),
        (np.ones((3, 1, 3), np.float32), np.eye(4), "at least 2 x 3"),
        (np.ones((3, MAX_CELLS + 1, 3), np.float32), np.eye(4), "at most 65536 x 65537 pixels, .* resize it"),
        (np.full((3, 2, 3), np.inf, np.float32), np.eye(4), "not finite numbers"),
        (np.full((3, 2, 3), np.nan, np.float32), np.eye(4), "not finite numbers"),
        (np.ones((3, 2, 3), np.float32), np.diag([1.0, 2.0, 1.0, 1.0]), "rotate, mirror and scale uniformly"),
        (np.ones((3, 2, 3), np.float32), np.zeros((4, 4)), "rotate, mirror and scale uniformly"),
    ],
)
def test_invalid_maps(pixels, to_world, message):
    with pytest.raises(SceneError, match=f"envmap 'sky'.*{message}"):
        build_environment_map(Image(pixels), to_world, 1.0, "envmap 'sky'")


def test_negative_pixels_are_black():
    pixels = np.ones((3, 2, 3), np.float32)
    pixels[1] = -1e-3
    with pytest.warns(UserWarning, match="envmap 'sky'.*negative"):
        map_ = build_environment_map(Image(pixels), np.eye(4), 1.0, "envmap 'sky'")
    assert (map_.texels[1, :, :3] == 0).all()
    assert (map_.texels[[0, 2], :, :3] == 1).all()


def test_a_real_sky(kernels, public_scenes):
    """The sun of kloppenheim_05 is 83,000 in one texel, the mean 1.6: sampling follows the pdf, with little noise."""
    map_ = build_environment_map(read_image(public_scenes / "env" / "kloppenheim_05_1k.hdr"), np.eye(4), 1.0, "envmap")
    shape = map_.texels.shape[:2]
    texel, solid_angle = quadrature(shape, 2)
    probability = kernels.radiance(map_, to_directions(texel.reshape(-1, 2), np.eye(4), shape))[1].reshape(
        solid_angle.shape
    )
    probability = (probability * solid_angle).sum(axis=1)
    assert probability.sum() == pytest.approx(1, abs=2e-5)
    sampled, pdf, radiance = kernels.sample(map_)
    cells = to_texels(sampled, np.eye(4), shape).astype(int)
    observed = np.bincount(np.minimum(cells[:, 1], shape[0] - 2) * shape[1] + cells[:, 0], minlength=len(probability))
    assert abs(normal_deviate(observed, SAMPLES * probability)) < Z
    weight = radiance @ [0.2126, 0.7152, 0.0722] / pdf
    assert weight.std() < 0.02 * weight.mean()
