"""Maps from random numbers to points and directions: stratified numbers give stratified results.

Every map is run on a fine grid over the unit square, which is divided into STRATA x STRATA rectangles, the strata. Each
must receive its exact share of the density that the map states, and its image must be connected and compact. To add a
map, add a row to `WARPS`.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from kernel_build import build_kernels

from isonoise.device.opencl import Device
from isonoise.scene.image.image import Image
from isonoise.scene.light.envmap import build_environment_map
from isonoise.scene.material.bsdfs import Bsdfs

GRID = 512  # cells of the fine grid along each axis
STRATA = 16
LAST = 1 - 2.0**-24  # largest random number
KERNEL = """
__kernel void %(name)s(%(parameters)s __global const float* numbers, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Vec2 u = vec2(numbers[2 * i], numbers[2 * i + 1]);
    Vec3 p = splat3(0.0f);
    float pdf = 0.0f;
    %(code)s
    STORE3(p, 0, out + 4 * i);
    out[4 * i + 3] = pdf;
}
"""


class Warp(NamedTuple):
    """A map of the kernels.

    `code` maps Vec2 u to Vec3 p, a unit vector or a point of a plane, and its pdf in solid angle or area. It may read
    the `arrays` as buffers of floats array0, array1, ... `singular` strata may fail: those that touch a point of the
    square's edge whose neighbourhood has directions far apart.
    """

    features: str
    header: str
    code: str
    arrays: tuple[np.ndarray, ...] = ()
    is_direction: bool = True
    singular: int = 0


def microfacets(alpha_u: float, alpha_v: float, theta: float, flags: str = "0u", singular: int = 0) -> Warp:
    """Normals of a rough surface, seen from an angle."""
    w = np.sin(theta) * np.cos(0.7), np.sin(theta) * np.sin(0.7), np.cos(theta)
    code = f"""
    const MicrofacetDistribution d = make_microfacets(array0[0], array0[1], {flags});
    const Vec3 w = LOAD3(0, array0 + 2);
    p = sample_microfacet(&d, w, u);
    pdf = microfacet_pdf(&d, w, p, microfacet_d(&d, p));"""
    numbers = np.array([alpha_u, alpha_v, *w], np.float32)
    return Warp("ROUGH_CONDUCTOR BECKMANN SAMPLE_ALL_NORMALS", "bsdf/microfacet.h", code, (numbers,), singular=singular)


def phase_function(g: float) -> Warp:
    """Directions scattered from one along -z."""
    bsdfs = Bsdfs(lambda texture, kind: pytest.fail("no textures here"))
    bsdfs.phase({"type": "hg", "g": g}, True)
    code = """
    BsdfContext ctx;
    ctx.bsdfs = (__global const Bsdf*)array0;
    ctx.bsdf = 0u;
    ctx.wi = vec3(0.0f, 0.0f, 1.0f);
    const BsdfSample s = hg_sample(&ctx, vec3(0.0f, u.x, u.y));
    p = s.direction;
    pdf = s.pdf;"""
    return Warp("MEDIA VOLPATH NEXT_EVENT", "media/phase.h", code, (bsdfs.records,))


def environment_map() -> Warp:
    pixels = np.random.default_rng(1).uniform(0.5, 1.5, (9, 16, 3)).astype(np.float32)
    map_ = build_environment_map(Image(pixels), np.eye(4), 1.0, "envmap")
    code = """
    const Envmap map = {(__global const Environment*)array0, array1, array2, (__global const uint*)array3};
    envmap_sample(&map, envmap_position(&map, u), &p, &pdf);"""
    arrays = map_.record, map_.texels, map_.rows, map_.guide
    return Warp("ENVIRONMENT_MAP NEXT_EVENT", "light/envmap.h", code, arrays)


WARPS = {
    "disk": Warp("", "util/math.h", "p = vec3_from(square_to_disk(u), 0.0f); pdf = M_1_PI_F;", is_direction=False),
    "cosine hemisphere": Warp("", "util/math.h", "p = square_to_hemisphere(u); pdf = p.z * M_1_PI_F;"),
    "sphere": Warp("", "util/math.h", "p = square_to_sphere(u); pdf = 0.25f * M_1_PI_F;"),
    "environment map": environment_map(),
    "ggx": microfacets(0.5, 0.5, 0.8, singular=2),  # halfway vectors of v and -v
    "ggx stretched": microfacets(0.1, 0.6, 1.2, singular=3),  # halfway vectors of v and -v
    "ggx along the normal": microfacets(0.3, 0.3, 0.0),
    "ggx grazing": microfacets(0.3, 0.3, 1.5, singular=2),  # halfway vectors of v and -v
    "beckmann": microfacets(0.3, 0.3, 0.8, "BSDF_BECKMANN"),
    "beckmann stretched": microfacets(0.1, 0.5, 1.2, "BSDF_BECKMANN"),
    "all ggx": microfacets(0.2, 0.6, 0.0, "BSDF_SAMPLE_ALL_NORMALS"),
    "all beckmann": microfacets(0.2, 0.6, 0.0, "BSDF_BECKMANN | BSDF_SAMPLE_ALL_NORMALS"),
    "isotropic": phase_function(0.0),
    "forward": phase_function(0.8),
    "backward": phase_function(-0.5),
}


def build_warps(device: Device, warps: Sequence[Warp], **constants) -> list:
    """Kernels of these maps, in one program: to compile one for each takes much longer."""
    headers = dict.fromkeys(["path/path_state.h", *(warp.header for warp in warps)])
    kernels = []
    for number, warp in enumerate(warps):
        parameters = "".join(f"__global const float* array{i}, " for i in range(len(warp.arrays)))
        kernels.append(KERNEL % {"name": f"warp{number}", "parameters": parameters, "code": warp.code})
    text = "\n".join([*(f'#include "{header}"' for header in headers), *kernels])
    features = sorted({name for warp in warps for name in warp.features.split()})
    built = build_kernels(device, text, features, **constants)
    return [built[f"warp{number}"] for number in range(len(warps))]


class WarpKernel:
    """Runs a map, by a kernel of `build_warps` if one is given."""

    def __init__(self, warp: Warp, kernel=None):
        self.device, self.warp = Device(), warp
        self.kernel = kernel or build_warps(self.device, [warp])[0]
        self.buffers = [self.device.buffer(array, "an array") for array in warp.arrays]

    def run(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (..., 3) and pdfs (...,) of numbers (..., 2)."""
        numbers = u.astype(np.float32).reshape(-1, 2)
        out = self.device.buffer(16 * len(numbers), "results")
        numbers_buffer = self.device.buffer(numbers, "numbers")
        self.device.launch(self.kernel, len(numbers), (*self.buffers, numbers_buffer, out, np.uint32(len(numbers))))
        found = self.device.read(out, np.float32, 4 * len(numbers)).astype(np.float64).reshape(*u.shape[:-1], 4)
        return found[..., :3], found[..., 3]


@cache
def all_warps() -> dict:
    return dict(zip(WARPS, build_warps(Device(), list(WARPS.values())), strict=True))


@cache
def warp_kernel(name: str) -> WarpKernel:
    return WarpKernel(WARPS[name], all_warps()[name])


def grid(steps: np.ndarray) -> np.ndarray:
    """All pairs (n, n, 2) of numbers."""
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)


def areas(corners: np.ndarray, is_direction: bool) -> np.ndarray:
    """Area or solid angle (n, n) of the quadrilaterals between corners (n + 1, n + 1, 3), as two triangles each.

    Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983.
    """
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    total = np.zeros(a.shape[:2])
    for x, y, z in ((a, b, c), (a, c, d)):
        if is_direction:
            volume = np.abs((x * np.cross(y, z)).sum(axis=-1))
            cosines = 1 + (x * y).sum(axis=-1) + (y * z).sum(axis=-1) + (z * x).sum(axis=-1)
            total += 2 * np.arctan2(volume, cosines)
        else:
            total += 0.5 * np.linalg.norm(np.cross(y - x, z - x), axis=-1)
    return total


def diameters(corners: np.ndarray, strata: int) -> np.ndarray:
    """Diagonals (strata, strata) of the bounding boxes of the strata's images."""
    side, windows = GRID // strata, np.lib.stride_tricks.sliding_window_view
    blocks = windows(corners, (side + 1, side + 1), axis=(0, 1))[::side, ::side]
    return np.linalg.norm(np.ptp(blocks, axis=(3, 4)), axis=-1)


def by_stratum(cells: np.ndarray) -> np.ndarray:
    """Values (STRATA^2, cells of a stratum) of a (GRID, GRID) array."""
    side = GRID // STRATA
    return cells.reshape(STRATA, side, STRATA, side).swapaxes(1, 2).reshape(STRATA**2, side**2)


def longest_steps(corners: np.ndarray) -> np.ndarray:
    """Longest distance (STRATA^2,) between images of neighbours on the grid, over the diameter of the stratum."""
    along = np.linalg.norm(np.diff(corners, axis=0), axis=-1)[:, :-1]
    across = np.linalg.norm(np.diff(corners, axis=1), axis=-1)[:-1]
    return by_stratum(np.maximum(along, across)).max(axis=1) / diameters(corners, STRATA).ravel()


@pytest.mark.parametrize("name", WARPS)
def test_strata_get_their_share(name):
    """The pdf, integrated over a stratum's image, is the stratum's area, to 1 %.

    The grid is finer at the edges of the square, where many maps have infinite derivatives.
    """
    kernel = warp_kernel(name)
    steps = np.minimum(np.sin(np.pi / 2 * np.arange(GRID + 1) / GRID) ** 2, LAST).astype(np.float32).astype(float)
    corners, _ = kernel.run(grid(steps))
    _, pdf = kernel.run(grid(0.5 * (steps[1:] + steps[:-1])))
    found = by_stratum(areas(corners, kernel.warp.is_direction) * pdf).sum(axis=1)
    expected = by_stratum(np.outer(np.diff(steps), np.diff(steps))).sum(axis=1)
    assert (np.abs(found / expected - 1) > 0.01).sum() <= kernel.warp.singular


@pytest.mark.parametrize("name", WARPS)
def test_strata_are_connected_and_compact(name):
    """Where strata are halved, their mean diameter falls by 0.6 or less; within one, neighbours stay neighbours."""
    kernel = warp_kernel(name)
    corners, _ = kernel.run(grid(np.minimum(np.arange(GRID + 1) / GRID, LAST)))
    mean = np.array([diameters(corners, strata).mean() for strata in (4, 8, 16, 32)])
    assert (mean[1:] <= 0.6 * mean[:-1]).all()
    assert (longest_steps(corners) > 0.6).sum() <= kernel.warp.singular


def test_a_map_that_shuffles_is_found():
    """Two numbers in another order, as the alias method leaves them: the checks above fail."""
    code = "const uint bits = (uint)(64.0f * u.x), other = (bits * 37u) & 63u;"
    code += "p = vec3((float)other / 64.0f + u.x - (float)bits / 64.0f, u.y, 0.0f);"
    kernel = WarpKernel(Warp("", "util/math.h", code, is_direction=False))
    corners, _ = kernel.run(grid(np.minimum(np.arange(GRID + 1) / GRID, LAST)))
    mean = np.array([diameters(corners, strata).mean() for strata in (4, 8, 16, 32)])
    assert (mean[1:] > 0.6 * mean[:-1]).any()
    assert (longest_steps(corners) > 0.6).sum() > STRATA


@pytest.mark.parametrize("alpha", [1e-4, 1e-2, 0.5, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 1e-2, 1e-4, 1e-8])
def test_visible_ggx_normals_in_float64(alpha, cosine):
    """Normals of the stretched surface differ by 2^-21 from those in float64, over the length of v + c: v and the
    direction c in the cap are unit vectors, and their sum may be short. At the edge of the disk, where derivatives are
    infinite, 1 - r^2 is off by 2^-23 more. Normals are never below the surface.
    """
    kernel = warp_kernel("ggx")
    sine = np.sqrt(1 - cosine**2)
    w = np.array([0.8 * sine, -0.6 * sine, cosine], np.float32)
    alphas = np.array([alpha, 0.7 * alpha], np.float32)
    numbers = np.concatenate([alphas, w])
    kernel.device.write(kernel.buffers[0], numbers)
    u = np.random.default_rng(1).integers(0, 1 << 24, (100000, 2)) / 2.0**24
    u[:4] = np.array([[0, 0], [0, LAST], [LAST, 0], [0.5, 0.5]])
    m, _ = kernel.run(u)
    kernel.device.write(kernel.buffers[0], WARPS["ggx"].arrays[0])

    v = np.append(np.maximum(alphas, np.float32(1e-4)), 1.0).astype(float) * w
    v /= np.linalg.norm(v)
    x, y = 2 * u.T - 1
    larger = np.abs(x) > np.abs(y)
    radius, ratio = np.where(larger, (x, y), (y, x))
    angle = np.pi / 4 * ratio / np.where(radius == 0, 1, radius)
    p = radius * np.where(larger, (np.cos(angle), np.sin(angle)), (np.sin(angle), np.cos(angle)))
    r2 = (p**2).sum(axis=0)
    to_edge, sine2 = np.maximum(1 - r2, 0), v[0] ** 2 + v[1] ** 2
    c = [*(p * np.sqrt(sine2 + (1 + v[2]) ** 2 * to_edge)), 1 - (1 + v[2]) * r2]
    half = np.stack(c, axis=1) + v
    length = np.linalg.norm(half, axis=1)

    stretched = m / np.append(np.maximum(alphas, np.float32(1e-4)), 1.0)
    stretched /= np.linalg.norm(stretched, axis=1, keepdims=True)
    assert (m[:, 2] > 0).all()
    assert np.linalg.norm(m, axis=1) == pytest.approx(1, abs=1e-6)
    off = np.linalg.norm(stretched - half / np.maximum(length, 1e-9)[:, None], axis=1)
    assert (off * length <= 2.0**-21 + 2.0**-23 / np.sqrt(to_edge + 2.0**-22)).all()


@pytest.mark.parametrize("sun", [1.0, 1e7])
def test_environment_map_in_float64(sun):
    """The distribution functions of map, row and cell in float64, at the sampled position, give the numbers back.

    A position has 16 bits within a cell; the CDFs have 32 bits, as the numbers with their hashes.
    """
    height, width = 33, 64
    pixels = np.random.default_rng(2).uniform(0.5, 1.5, (height, width, 3)).astype(np.float32)
    pixels[10, 20] *= sun
    map_ = build_environment_map(Image(pixels), np.eye(4), 1.0, "envmap")
    code = "p = vec3_from(envmap_position(&map, u), 0.0f);"
    warp = environment_map()
    arrays = map_.record, map_.texels, map_.rows, map_.guide
    kernel = WarpKernel(warp._replace(arrays=arrays, code=warp.code.split("envmap_sample")[0] + code))
    u = np.random.default_rng(3).integers(0, 1 << 24, (100000, 2)) / 2.0**24
    u[:3] = [0, 0], [LAST, LAST], [0.5, 0.5]
    (column, s), (row, t) = (np.divmod(b.view(np.uint32), 1 << 16) for b in kernel.run(u)[0].astype(np.float32).T[:2])

    weights = (map_.texels[..., :3].astype(float) @ [0.2126, 0.7152, 0.0722]) * map_.rows["sine"][:, None]
    pairs = weights + np.roll(weights, -1, axis=1)
    cells = pairs[:-1] + pairs[1:]
    below_row, below_column = np.cumsum(cells.sum(axis=1)), np.cumsum(cells, axis=1)
    shares = cells.sum(axis=1)[row] / below_row[-1], cells[row, column] / below_column[row, -1]
    ends = below_row[row] / below_row[-1], below_column[row, column] / below_column[row, -1]
    for number, share, end, rest in ((u[:, 1], shares[0], ends[0], t), (u[:, 0], shares[1], ends[1], s)):
        found = end - share + share * (rest + 0.5) / (1 << 16)
        assert (np.abs(found - number) <= 2.0**-24 + 2.0**-16 * share).all()


def test_lanes_find_the_same_positions():
    """Many searches at once, as `shade` makes them, against one by one: the same bits."""
    lanes = 32
    code = """
    if (i % LANES != 0u) return;
    float x[LANES], y[LANES];
    for (uint k = 0u; k < LANES; ++k) { x[k] = numbers[2u * (i + k)]; y[k] = numbers[2u * (i + k) + 1u]; }
    envmap_positions(&map, x, y, LANES);
    for (uint k = 0u; k < LANES; ++k) {
        const Vec2 alone = envmap_position(&map, vec2(numbers[2u * (i + k)], numbers[2u * (i + k) + 1u]));
        out[4u * (i + k)] = as_uint(x[k]) == as_uint(alone.x) && as_uint(y[k]) == as_uint(alone.y) ? 1.0f : 0.0f;
    }
    return;"""
    warp = environment_map()
    warp = warp._replace(code=warp.code.split("envmap_sample")[0] + code)
    device, n = Device(), 1 << 12
    (kernel,) = build_warps(device, [warp], LANES=lanes)
    numbers = np.random.default_rng(4).random((n, 2), dtype=np.float32)
    buffers = [device.buffer(array, "an array") for array in (*warp.arrays, numbers)]
    out = device.buffer(16 * n, "results")
    device.launch(kernel, n, (*buffers, out, np.uint32(n)))
    assert (device.read(out, np.float32, 4 * n)[::4] == 1).all()
