"""Environment maps on the device: radiance against Mitsuba 3's and float64, sampling against its density.

Chi-square statistics are compared as standard normal deviates at Z = 5, two-sided: 6e-7 for each of about 20, so false
alarms are 1e-5 for the file under other seeds. What is a mean of samples may be off by Z standard errors.
"""

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.device.program import declare_struct, flatten
from isonoise.errors import SceneError
from isonoise.scene.image.image import Image, read_image
from isonoise.scene.light import envmap
from isonoise.scene.light.envmap import EnvironmentMap, build_environment_map

Z = 5.0
SAMPLES = 1 << 19
KERNEL = """
__kernel void sample(__global const Environment* record, __global const float* texels,
                     __global const float* rows, __global const uint* aliases, __global const float* u,
                     __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Envmap map = {record, texels, rows, aliases};
    Vec3 direction;
    float pdf;
    const Vec3 radiance = envmap_sample(&map, vec2(u[2 * i], u[2 * i + 1]), &direction, &pdf);
    STORE3(direction, 0, out + 8 * i);
    out[8 * i + 3] = pdf;
    STORE3(radiance, 0, out + 8 * i + 4);
}

__kernel void radiance(__global const Environment* record, __global const float* texels,
                   __global const float* rows, __global const uint* aliases,
                   __global const float* directions, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Envmap map = {record, texels, rows, aliases};
    float pdf;
    const Vec3 direction = LOAD3(i, directions), radiance = envmap_radiance(&map, direction, &pdf);
    STORE3(radiance, 0, out + 4 * i);
    out[4 * i + 3] = pdf;
}
"""


class OnDevice:
    """The kernels, and maps to run them on."""

    def __init__(self):
        self.device = Device()
        record = declare_struct("Environment", envmap.ENVIRONMENT)
        text = ["#pragma OPENCL FP_CONTRACT OFF", record, flatten("light/envmap.h"), KERNEL]
        self._text = "\n".join(text)

    def _run(self, kernel: str, made: EnvironmentMap, given: np.ndarray, rows: int) -> np.ndarray:
        n = len(given)
        on = ("-DFEATURE_ENVIRONMENT_MAP=1", "-DFEATURE_NEXT_EVENT=1")
        kernels = self.device.build(self._text, ("-cl-std=CL1.2", "-Werror", *on))
        arrays = (made.record, made.texels, made.rows, made.aliases, given)
        out = self.device.buffer(16 * rows * n, "results")
        buffers = [self.device.buffer(array, "a map") for array in arrays]
        self.device.launch(kernels[kernel], n, (*buffers, out, np.uint32(n)))
        return self.device.read(out, np.float32, 4 * rows * n).reshape(n, rows, 4).astype(np.float64)

    def sample(self, made: EnvironmentMap, count: int = SAMPLES, seed: int = 1):
        """Directions (n, 3), pdf (n,) and radiance (n, 3)."""
        u = np.random.default_rng(seed).integers(0, 1 << 24, (count, 2)).astype(np.float32) / (1 << 24)
        out = self._run("sample", made, u, 2)
        return out[:, 0, :3], out[:, 0, 3], out[:, 1, :3]

    def radiance(self, made: EnvironmentMap, directions: np.ndarray):
        """Radiance (n, 3) and pdf (n,)."""
        out = self._run("radiance", made, np.ascontiguousarray(directions, np.float32), 1)
        return out[:, 0, :3], out[:, 0, 3]


@pytest.fixture(scope="module")
def on_device():
    return OnDevice()


def turned(seed: int, mirrored: bool = False, size: float = 1.0) -> np.ndarray:
    """A random orthogonal to_world, scaled."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q)) * (-1 if mirrored else 1) * size
    return np.block([[q, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])


def pixels_of(name: str) -> np.ndarray:
    """Linear RGB (height, width, 3) float32."""
    random = np.random.default_rng(2)
    if name == "smallest":
        return random.random((3, 2, 3), dtype=np.float32)
    if name == "noise":
        return random.random((9, 16, 3), dtype=np.float32)
    if name == "plain":
        return np.full((17, 32, 3), (0.5, 0.25, 1.0), np.float32)
    if name == "sun":  # 98,000 times the mean: nearly all the light there is
        pixels = random.uniform(0.5, 1.5, (257, 512, 3)).astype(np.float32)
        pixels[70, 130] = 5e6
        return pixels
    if name == "zenith":  # the sun in the row that is one point, and one beside the seam on the other pole
        pixels = random.uniform(0.5, 1.5, (17, 32, 3)).astype(np.float32)
        pixels[0] = 1e5
        pixels[15, 31] = 1e4
        return pixels
    if name == "lamps":  # black but for a few texels: most rows and cells are never picked
        pixels = np.zeros((33, 64, 3), np.float32)
        pixels[4, 63], pixels[20, 5:7], pixels[32, 10], pixels[11, 0] = 3.0, 1.0, 7.0, (0.0, 0.0, 1e-3)
        return pixels
    assert name == "steep"  # 10^12 between neighbours, in values that are small themselves
    return (1e-20 * 10.0 ** random.uniform(0, 12, (9, 16, 3))).astype(np.float32)


MAPS = ("smallest", "noise", "plain", "sun", "zenith", "lamps", "steep")


def make(name: str, to_world=None, scale: float = 1.0) -> EnvironmentMap:
    return build_environment_map(Image(pixels_of(name)), turned(3) if to_world is None else to_world, scale, "envmap")


def directions_of(place: np.ndarray, to_world: np.ndarray, shape) -> np.ndarray:
    """World directions of places (n, 2) = (column, row) of the map, texel centres at whole numbers."""
    phi = (place[:, 0] + 0.5) / shape[1] * 2 * np.pi
    theta = place[:, 1] / (shape[0] - 1) * np.pi
    sine = np.sin(theta)
    local = np.stack([np.sin(phi) * sine, np.cos(theta), -np.cos(phi) * sine], axis=1)
    return local @ to_world[:3, :3].T


def places_of(directions: np.ndarray, to_world: np.ndarray, shape) -> np.ndarray:
    """The inverse, columns in [0, width)."""
    x, y, z = (directions @ to_world[:3, :3]).T
    column = np.arctan2(x, -z) / (2 * np.pi) * shape[1] - 0.5
    return np.stack([column % shape[1], np.arctan2(np.hypot(x, z), y) / np.pi * (shape[0] - 1)], axis=1)


def in_float64(pixels: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Bilinear radiance at places (n, 2)."""
    height, width, _ = pixels.shape
    left, top = np.floor(place[:, 0]).astype(int), np.minimum(place[:, 1].astype(int), height - 2)
    s, t = (place[:, 0] - left)[:, None], (place[:, 1] - top)[:, None]
    a, b = left % width, (left + 1) % width
    upper = (1 - s) * pixels[top, a] + s * pixels[top, b]
    lower = (1 - s) * pixels[top + 1, a] + s * pixels[top + 1, b]
    return (1 - t) * upper + t * lower


def quadrature(shape, nodes: int, parts: int = 1):
    """Gauss-Legendre nodes in parts x parts of every cell: places (cells, nodes^2, 2) and solid angles alike."""
    height, width = shape
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2 / parts, w / 2 / parts
    columns, rows = np.meshgrid(np.arange(width * parts) / parts, np.arange((height - 1) * parts) / parts)
    corners = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    inside = np.stack(np.meshgrid(x, x), axis=-1).reshape(1, -1, 2)
    place = corners + inside
    theta = place[..., 1] / (height - 1) * np.pi
    solid = np.outer(w, w).ravel() * np.sin(theta) * (2 * np.pi / width) * (np.pi / (height - 1))
    return place, solid


def normal_deviate(observed: np.ndarray, expected: np.ndarray) -> float:
    """Of the chi-square statistic (Wilson and Hilferty 1931), bins with less than 10 expected put together."""
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    few = min(int(np.searchsorted(np.cumsum(expected) > 10, True)) + 1, len(expected))
    few = max(few, int(np.searchsorted(expected, 10)))
    observed = np.concatenate([[observed[:few].sum()], observed[few:]])
    expected = np.concatenate([[expected[:few].sum()], expected[few:]])
    freedom = len(observed) - 1
    chi = ((observed - expected) ** 2 / expected).sum()
    return ((chi / freedom) ** (1 / 3) - 1 + 2 / (9 * freedom)) / np.sqrt(2 / (9 * freedom))


@pytest.mark.parametrize("name", MAPS)
def test_sampling_has_its_density(on_device, name):
    """The chi-square of sampled directions in quarters of cells, against the device's own pdf integrated over them.

    pdf * sin(theta) is bilinear within a cell, so that two nodes a side integrate it exactly. It sums to 1 within 1e-5:
    the pdf is rounded, and a place in the map is off by 2^-24 of its size.
    """
    made, to_world = make(name), turned(3)
    shape = made.texels.shape[:2]
    place, solid = quadrature(shape, 2, parts=2)
    directions = directions_of(place.reshape(-1, 2), to_world, shape)
    probability = (on_device.radiance(made, directions)[1].reshape(solid.shape) * solid).sum(axis=1)
    assert probability.sum() == pytest.approx(1, abs=2e-5)

    sampled, pdf, _ = on_device.sample(made)
    assert (pdf > 0).all()
    bins = (2 * places_of(sampled, to_world, shape)).astype(int)
    width = 2 * shape[1]
    index = np.minimum(bins[:, 1], 2 * shape[0] - 3) * width + bins[:, 0] % width
    observed = np.bincount(index, minlength=len(probability))
    assert observed[probability == 0].sum() <= 1e-5 * SAMPLES  # rounded over an edge
    assert abs(normal_deviate(observed, SAMPLES * probability)) < Z


@pytest.mark.parametrize("name", MAPS)
def test_radiance_and_density_of_a_sample(on_device, name):
    """What a sample is said to have is what is found when looking there, and that is the map in float64.

    The components of a direction are off by a few times 2^-24, the angle around the pole by as much over its sine: so
    is the place in the map, which moves radiance by the difference between neighbours, at most the largest of them,
    and the density likewise; the sine that it is divided by is off itself.
    """
    made, to_world, pixels = make(name, scale=2.5), turned(3), 2.5 * pixels_of(name).astype(np.float64)
    height, width = shape = made.texels.shape[:2]
    sampled, pdf, radiance = on_device.sample(made, 1 << 16, seed=4)
    np.testing.assert_allclose(np.linalg.norm(sampled, axis=1), 1, atol=1e-6)
    seen, density = on_device.radiance(made, sampled)
    place, step = places_of(sampled, to_world, shape), np.pi / (height - 1)
    theta = place[:, 1] * step
    off = 2.0**-21 * (width / (2 * np.pi * np.sin(theta)) + 1 / step)
    columns, rows = np.floor(place).astype(int).T
    around = [
        pixels[np.clip(rows + j, 0, height - 1), (columns + i) % width] for i in (-1, 0, 1, 2) for j in (-1, 0, 1, 2)
    ]
    largest = np.max(around, axis=(0, 2))
    expected = in_float64(pixels, place)
    for found in (radiance, seen):
        assert (np.abs(found - expected).max(axis=1) <= (off + 1e-6) * largest).all()
    peak = made.record["density"][0] / made.record["scale"][0] * largest * np.minimum(np.sin(theta) + step, 1)
    assert (np.abs(pdf - density) <= (off * peak + 2.0**-21 * pdf) / np.sin(theta) + 1e-5 * pdf).all()


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_irradiance(on_device, name, axis):
    """Of planes that face along the axes, from samples, against quadrature in float64.

    The edge of the visible half cuts cells: with 8 x 8 nodes a cell its error is below 3e-4 for the coarsest maps. How
    the samples vary is the cosine and little else: a sun changes nothing about it.
    """
    made, to_world, pixels = make(name), turned(3), pixels_of(name).astype(np.float64)
    shape = made.texels.shape[:2]
    place, solid = quadrature(shape, 2 if name == "sun" else 8)
    cosine = np.maximum(directions_of(place.reshape(-1, 2), to_world, shape)[:, axis], 0)
    expected = (in_float64(pixels, place.reshape(-1, 2)) * (cosine * solid.ravel())[:, None]).sum(axis=0)
    sampled, pdf, radiance = on_device.sample(made, seed=5 + axis)
    estimate = radiance * (np.maximum(sampled[:, axis], 0) / pdf)[:, None]
    se = estimate.std(axis=0) / np.sqrt(SAMPLES)
    assert (np.abs(estimate.mean(axis=0) - expected) <= Z * se + 3e-4 * expected).all()


def test_the_mean_is_that_of_the_sphere(on_device):
    for name in MAPS:
        made, pixels = make(name, scale=3.0), pixels_of(name).astype(np.float64)
        place, solid = quadrature(pixels.shape[:2], 2 if name == "sun" else 5)
        expected = 3 * (in_float64(pixels, place.reshape(-1, 2)) * solid.reshape(-1, 1)).sum(axis=0) / (4 * np.pi)
        np.testing.assert_allclose(made.mean, expected, rtol=1e-6)
        assert made.largest == pytest.approx(3 * (pixels @ [0.2126, 0.7152, 0.0722]).max(), rel=1e-6)


@pytest.mark.parametrize(("name", "most"), [("plain", 0.06), ("sun", 0.02), ("noise", 0.2), ("zenith", 0.75)])
def test_a_sun_makes_no_noise(on_device, name, most):
    """Luminance over pdf is nearly the same for all samples; its relative standard deviation is at most what is given.

    What is left is the difference between interpolated sines and the sine itself, in maps of few and so of wide rows.
    It is largest where all light comes from one pole: from a density of 1 - t samples weigh t, which makes sqrt(1 / 2).
    """
    _, pdf, radiance = on_device.sample(make(name))
    weight = radiance @ [0.2126, 0.7152, 0.0722] / pdf
    assert weight.std() < most * weight.mean()


@pytest.mark.parametrize("mirrored", [False, True])
def test_radiance_is_mitsubas(on_device, mirrored):
    """Directions near a pole aside, where its acos(y) is coarse."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    pixels, to_world = pixels_of("noise"), turned(7, mirrored)
    made = build_environment_map(Image(pixels), to_world, 1.7, "envmap")
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
    np.testing.assert_allclose(on_device.radiance(made, directions)[0], expected, rtol=0, atol=2e-5)


def test_poles_and_seam(on_device):
    """Exactly along the axes of the map, and a little beside them: numbers, and the radiance that belongs there."""
    pixels, made = pixels_of("noise"), make("noise", np.eye(4))
    step = 1e-7
    beside = [[0, 1, 0], [0, -1, 0], [step, 1, 0], [0, -1, -step], [0, 0, -1], [0, 0, 1], [-step, 0, -1], [1e-30, 0, 1]]
    directions = np.array(beside, np.float32)
    radiance, pdf = on_device.radiance(made, directions)
    assert np.isfinite(radiance).all()
    assert (pdf > 0).all()
    assert np.isfinite(pdf).all()
    expected = in_float64(pixels.astype(np.float64), places_of(directions.astype(np.float64), np.eye(4), (9, 16)))
    np.testing.assert_allclose(radiance[2:], expected[2:], atol=1e-5)
    for row, found in ((0, radiance[0]), (-1, radiance[1])):  # along an axis every column is as good as any other
        assert (found >= pixels[row].min(axis=0) - 1e-6).all()
        assert (found <= pixels[row].max(axis=0) + 1e-6).all()


def test_directions_that_are_none(on_device):
    """They read nothing beside the map."""
    values = np.array([np.nan, np.inf, -np.inf, 0.0, 1e38])
    directions = np.stack(np.meshgrid(values, values, values), axis=-1).reshape(-1, 3)
    on_device.radiance(make("sun"), directions)
    radiance, _ = on_device.radiance(make("noise"), np.zeros((1, 3)))
    assert np.isfinite(radiance).all()


def test_all_dark(on_device):
    made = build_environment_map(Image(np.zeros((5, 8, 3), np.float32)), np.eye(4), 1.0, "envmap")
    _, pdf, radiance = on_device.sample(made, 1000)
    assert (pdf == 0).all()
    assert (radiance == 0).all()
    assert made.largest == 0


def test_an_even_scale_does_not_matter(on_device):
    directions = np.random.default_rng(9).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    plain, scaled = make("noise", turned(3)), make("noise", turned(3, size=4.0))
    assert (on_device.radiance(plain, directions)[0] == on_device.radiance(scaled, directions)[0]).all()


def test_images_of_bytes_and_of_one_channel(on_device):
    grey = np.random.default_rng(10).integers(0, 256, (9, 16, 1), dtype=np.uint8)
    made = build_environment_map(Image(grey), np.eye(4), 1.0, "envmap")
    linear = np.broadcast_to(Image(grey).linear(), (9, 16, 3))
    same = build_environment_map(Image(np.ascontiguousarray(linear)), np.eye(4), 1.0, "envmap")
    assert (made.texels == same.texels).all()
    assert (made.aliases == same.aliases).all()


@pytest.mark.parametrize(
    ("pixels", "to_world", "message"),
    [
        (np.ones((2, 8, 3), np.float32), np.eye(4), "at least 2 x 3 pixels, this one has 8 x 2"),
        (np.ones((3, 1, 3), np.float32), np.eye(4), "at least 2 x 3"),
        (np.full((3, 2, 3), np.inf, np.float32), np.eye(4), "not finite numbers"),
        (np.full((3, 2, 3), np.nan, np.float32), np.eye(4), "not finite numbers"),
        (np.ones((3, 2, 3), np.float32), np.diag([1.0, 2.0, 1.0, 1.0]), "rotate, mirror and scale uniformly"),
        (np.ones((3, 2, 3), np.float32), np.zeros((4, 4)), "rotate, mirror and scale uniformly"),
    ],
)
def test_maps_that_cannot_be(pixels, to_world, message):
    with pytest.raises(SceneError, match=f"envmap 'sky'.*{message}"):
        build_environment_map(Image(pixels), to_world, 1.0, "envmap 'sky'")


def test_negative_pixels_are_black():
    pixels = np.ones((3, 2, 3), np.float32)
    pixels[1] = -1e-3
    with pytest.warns(UserWarning, match="envmap 'sky'.*negative"):
        made = build_environment_map(Image(pixels), np.eye(4), 1.0, "envmap 'sky'")
    assert (made.texels[1, :, :3] == 0).all()
    assert (made.texels[[0, 2], :, :3] == 1).all()


def test_a_real_sky(on_device, public_scenes):
    """The sun of kloppenheim_05 is 83,000 in one texel for a mean of 1.6: sampling has its density, and no noise."""
    made = build_environment_map(read_image(public_scenes / "env" / "kloppenheim_05_1k.hdr"), np.eye(4), 1.0, "envmap")
    shape = made.texels.shape[:2]
    place, solid = quadrature(shape, 2)
    probability = on_device.radiance(made, directions_of(place.reshape(-1, 2), np.eye(4), shape))[1].reshape(
        solid.shape
    )
    probability = (probability * solid).sum(axis=1)
    assert probability.sum() == pytest.approx(1, abs=2e-5)
    sampled, pdf, radiance = on_device.sample(made)
    cells = places_of(sampled, np.eye(4), shape).astype(int)
    observed = np.bincount(np.minimum(cells[:, 1], shape[0] - 2) * shape[1] + cells[:, 0], minlength=len(probability))
    assert abs(normal_deviate(observed, SAMPLES * probability)) < Z
    weight = radiance @ [0.2126, 0.7152, 0.0722] / pdf
    assert weight.std() < 0.02 * weight.mean()
