"""Texture lookups on the device, against Mitsuba 3 and against float64."""

import itertools

import numpy as np
import pytest
from kernel_build import build_kernels
from PIL import Image
from small_files import write_images

from isonoise.device.opencl import Device
from isonoise.scene import structs
from isonoise.scene.material import textures
from isonoise.scene.material.textures import MeshAttributes, Textures
from isonoise.scene.spectra import srgb_to_linear

LOOKUP_KERNEL = """
#include "texture/texture.h"
__kernel void lookup(__global const Texture* records, __global const uchar* bytes,
                   __global const float* floats, __global const float* srgb, __global const float* attributes,
                   __global const uint* faces, uint texture, __global const float* points,
                   __global const uint* triangles, __global float* out, uint n)
{
    const uint i = get_global_id(0);
    if (i >= n) return;
    const Textures all = {records, bytes, floats, srgb, attributes, faces};
    const Vec2 uv = vec2(points[4 * i], points[4 * i + 1]), weights = vec2(points[4 * i + 2], points[4 * i + 3]);
    const TexturePoint at = {uv, triangles[i], weights};
    const Vec2 gradient = texture_gradient(&all, texture, &at);
    STORE3(texture_rgb(&all, texture, &at), 2 * i, out);
    STORE3(vec3(texture_float(&all, texture, &at), gradient.x, gradient.y), 2 * i + 1, out);
}
"""
TEXTURE_FEATURES = ("BITMAPS", "CHECKERBOARDS", "MESH_ATTRIBUTES")
MAX_ERROR = 1e-5
"""Absolute error of values up to 1 at |uv| up to 4: a position is off by 4 x 7 texels x 2^-24, and the gradient is at
most 1 per texel; a few such errors add up."""
LUMINANCE_WEIGHTS = np.array([0.212671, 0.715160, 0.072169])


@pytest.fixture(scope="module")
def device():
    return Device()


def build_lookup(device, *on: str):
    return build_kernels(device, LOOKUP_KERNEL, ("TEXTURES", "BUMP", *on))["lookup"]


@pytest.fixture(scope="module")
def lookup(device):
    """A function: colour (n, 3), number (n,) and gradient (n, 2), float64, of a texture at uv (n, 2)."""
    kernel = build_lookup(device, *TEXTURE_FEATURES)

    def run(texture, uv, kind="reflectance", meshes=(), faces=None, triangles=None, barycentric=None, kernel=kernel):
        table = Textures()
        index = table.index(texture, kind)
        arrays, n = table.arrays(meshes), len(uv)
        points = np.zeros((n, 4), np.float32)
        points[:, :2] = uv
        points[:, 2:] = 0 if barycentric is None else barycentric
        triangles = np.full(n, structs.NONE) if triangles is None else triangles
        faces = np.zeros((0, 3)) if faces is None else faces
        stores = (arrays.records, arrays.bytes, arrays.floats, textures.SRGB, arrays.attributes)
        b = [device.buffer(array, "a store") if array.size else None for array in (*stores, faces.astype(np.uint32))]
        out = device.buffer(24 * n, "values")
        inputs = (device.buffer(points, "points"), device.buffer(triangles.astype(np.uint32), "triangles"))
        device.launch(kernel, n, (*b, np.uint32(index), *inputs, out, np.uint32(n)))
        values = device.read(out, np.float32, 6 * n).reshape(n, 6).astype(np.float64)
        return values[:, :3], values[:, 3], values[:, 4:]

    return run


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder of images of 7 x 5 texels."""
    return write_images(tmp_path_factory.mktemp("images"))


def random_uv(count: int, seed: int, size=(7, 5), margin: float = 0.0) -> np.ndarray:
    """uv inside and outside the unit square, at least `margin` texels away from the borders of texels."""
    uv = np.random.default_rng(seed).uniform(-2.5, 3.5, (count, 2)).astype(np.float32)
    position = uv * np.array(size)
    return uv[(np.abs(position - np.round(position)) > margin).all(axis=1)]


def evaluate_in_mitsuba(mitsuba, texture: dict, uv: np.ndarray, gradient: bool = True):
    """Colour, number and gradient by Mitsuba 3."""
    loaded, rows = mitsuba.load_dict(texture), []
    for u, v in uv:
        si = mitsuba.SurfaceInteraction3f()
        si.uv = mitsuba.Point2f(float(u), float(v))
        slope = np.array(loaded.eval_1_grad(si)) if gradient else np.zeros(2)
        rows.append([*np.array(loaded.eval(si)), loaded.eval_1(si), *slope])
    rows = np.array(rows, np.float64)
    return rows[:, :3], rows[:, 3], rows[:, 4:]


def assert_close(ours, expected, tolerance: float = MAX_ERROR):
    for values, theirs, scale in zip(
        ours, expected, (1.0, 1.0, 20.0), strict=True
    ):  # slopes: 7 texels, and as many to_uv
        np.testing.assert_allclose(values, theirs, rtol=0, atol=scale * tolerance)


def evaluate_in_float64(pixels: np.ndarray, uv: np.ndarray, wrap: str, nearest: bool) -> np.ndarray:
    """Values of linear pixels (height, width, 3) at uv (n, 2)."""
    height, width, _ = pixels.shape

    def wrapped(i, size):
        if wrap == "repeat":
            return i % size
        if wrap == "mirror":
            return np.where(i % (2 * size) < size, i % (2 * size), 2 * size - 1 - i % (2 * size))
        return np.clip(i, 0, size - 1)

    position = uv.astype(np.float64) * (width, height) - (0.0 if nearest else 0.5)
    corner = np.floor(position).astype(int)
    fraction = np.zeros_like(position) if nearest else position - corner
    value = 0.0
    for dx, dy in itertools.product((0, 1), (0, 1)):
        weight = (fraction[:, 0] if dx else 1 - fraction[:, 0]) * (fraction[:, 1] if dy else 1 - fraction[:, 1])
        value = value + weight[:, None] * pixels[wrapped(corner[:, 1] + dy, height), wrapped(corner[:, 0] + dx, width)]
    return value


WRAP_AND_FILTER_MODES = list(itertools.product(("repeat", "mirror", "clamp"), ("bilinear", "nearest")))


@pytest.mark.parametrize(("wrap_mode", "filter_type"), WRAP_AND_FILTER_MODES)
@pytest.mark.parametrize("raw", [False, True])
def test_bitmaps_equal_mitsubas(lookup, mitsuba, files, wrap_mode, filter_type, raw):
    for name in ("rgb.png", "grey.png", "deep.png", "linear.exr"):
        texture = {"type": "bitmap", "filename": str(files / name), "raw": raw}
        texture |= {"wrap_mode": wrap_mode, "filter_type": filter_type}
        uv = random_uv(60, 5, margin=1e-3)
        assert_close(lookup(texture, uv), evaluate_in_mitsuba(mitsuba, texture | {"format": "variant"}, uv))


@pytest.mark.parametrize(("wrap_mode", "filter_type"), WRAP_AND_FILTER_MODES)
@pytest.mark.parametrize("size", [(7, 5), (1, 1), (1, 4), (3, 1), (2, 2)])
def test_bitmaps_in_float64(lookup, tmp_path, wrap_mode, filter_type, size):
    width, height = size
    pixels = np.random.default_rng(6).integers(0, 256, (height, width, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "image.png")
    texture = {"type": "bitmap", "filename": str(tmp_path / "image.png"), "wrap_mode": wrap_mode}
    texture |= {"filter_type": filter_type}
    uv = random_uv(2000, 7, size, margin=1e-4)
    linear = srgb_to_linear(pixels / 255)
    rgb, number, _ = lookup(texture, uv)
    expected = evaluate_in_float64(linear, uv, wrap_mode, filter_type == "nearest")
    np.testing.assert_allclose(rgb, expected, rtol=0, atol=MAX_ERROR)
    np.testing.assert_allclose(number, expected @ LUMINANCE_WEIGHTS, rtol=0, atol=MAX_ERROR)


def test_half_precision_bitmaps_of_mitsuba(lookup, mitsuba, files):
    """By default Mitsuba rounds images of 8 and 16 bits to half floats, with errors up to 2^-11; isonoise does not."""
    texture = {"type": "bitmap", "filename": str(files / "rgb.png")}
    uv = random_uv(100, 8)
    np.testing.assert_allclose(
        lookup(texture, uv)[0], evaluate_in_mitsuba(mitsuba, texture, uv)[0], rtol=2**-11, atol=MAX_ERROR
    )


def rotation_and_shift(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0.0, 0.3], [s, c, 0.0, -0.2], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    "matrix", [np.diag([2.0, -1.5, 7.0, 1.0]), rotation_and_shift(25.0) @ np.diag([2.0, 1.5, 1.0, 1.0])]
)
def test_to_uv(lookup, mitsuba, files, matrix):
    """The third row and column of a 4x4 matrix are ignored; a 3x3 matrix lacks them."""
    uv = random_uv(100, 9)
    texture = {"type": "bitmap", "filename": str(files / "rgb.png")}
    flat = matrix[np.ix_([0, 1, 3], [0, 1, 3])]
    expected = evaluate_in_mitsuba(
        mitsuba, texture | {"format": "variant", "to_uv": mitsuba.ScalarTransform4f(matrix)}, uv, gradient=False
    )
    for inputs in (matrix, flat):
        ours = lookup(texture | {"to_uv": inputs}, uv)
        for values, theirs in zip(ours[:2], expected[:2], strict=True):
            np.testing.assert_allclose(values, theirs, rtol=0, atol=3 * MAX_ERROR)


def test_gradients(lookup, mitsuba, files):
    """Without rotation, equal to Mitsuba's eval_1_grad; with rotation, equal to differences in float64.

    Mitsuba's eval_1_grad (3.9.1) multiplies by the image's size after the rotation instead of before it, which is wrong
    unless the image is square.
    """
    uv = random_uv(200, 10, margin=0.02)
    texture = {"type": "bitmap", "filename": str(files / "rgb.png"), "wrap_mode": "mirror"}
    scaling = np.diag([2.0, -1.5, 1.0, 1.0])
    ours = lookup(texture | {"to_uv": scaling}, uv)
    assert_close(
        ours,
        evaluate_in_mitsuba(mitsuba, texture | {"format": "variant", "to_uv": mitsuba.ScalarTransform4f(scaling)}, uv),
    )

    matrix = rotation_and_shift(25.0) @ scaling
    linear = srgb_to_linear(np.asarray(Image.open(files / "rgb.png")) / 255)
    step, corners = 1e-4, uv.astype(np.float64) @ matrix[:2, :2].T + matrix[:2, 3]
    is_inside_texel = np.abs((corners * (7, 5) - 0.5) % 1 - 0.5).max(axis=1) < 0.48  # no border of texels within a step
    gradient = lookup(texture | {"to_uv": matrix}, uv)[2]
    for axis in (0, 1):
        ahead, behind = (
            evaluate_in_float64(linear, corners + sign * step * matrix[:2, axis], "mirror", False) @ LUMINANCE_WEIGHTS
            for sign in (1, -1)
        )
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(gradient[is_inside_texel, axis], slope[is_inside_texel], rtol=0, atol=40 * MAX_ERROR)
    assert is_inside_texel.sum() > 100


def test_invalid_uvs(lookup, files):
    """No uv, however large or not a number, reads outside the image."""
    odd = [np.nan, np.inf, -np.inf, 1e38, -1e38, 1e9, -1e9, 2.0**24, -1e-30, 1.0, np.float32(1) - np.float32(2**-24)]
    uv = np.array(list(itertools.product(odd, odd)))
    for wrap_mode, filter_type in WRAP_AND_FILTER_MODES:
        texture = {"type": "bitmap", "filename": str(files / "rgb.png"), "wrap_mode": wrap_mode}
        rgb, number, gradient = lookup(texture | {"filter_type": filter_type}, uv)
        assert ((rgb >= 0) & (rgb <= 1)).all()
        assert ((number >= 0) & (number <= 1.000001)).all()
        assert np.isfinite(gradient).all()


def test_checkerboards(lookup, mitsuba, files):
    """Colours and numbers equal Mitsuba's, also with a nested texture."""
    checkerboard = {"type": "checkerboard", "to_uv": rotation_and_shift(10.0) @ np.diag([3.0, 2.0, 1.0, 1.0])}
    checkerboard |= {"color0": {"type": "rgb", "value": [0.1, 0.2, 0.9]}}
    checkerboard |= {"color1": {"type": "bitmap", "filename": str(files / "rgb.png")}}
    theirs = checkerboard | {
        "to_uv": mitsuba.ScalarTransform4f(checkerboard["to_uv"]),
        "color1": checkerboard["color1"] | {"format": "variant"},
    }
    uv = random_uv(300, 11)
    ours, expected = lookup(checkerboard, uv), evaluate_in_mitsuba(mitsuba, theirs, uv, gradient=False)
    position = uv @ checkerboard["to_uv"][:2, :2].T + checkerboard["to_uv"][:2, 3]
    is_inside_square = (np.abs(2 * position - np.round(2 * position)) > 1e-4).all(axis=1)
    assert is_inside_square.sum() > 250
    for values, theirs in zip(ours[:2], expected[:2], strict=True):
        np.testing.assert_allclose(values[is_inside_square], theirs[is_inside_square], rtol=0, atol=MAX_ERROR)
    assert (ours[2] != 0).any()  # in the squares of the bitmap


def test_constant_colours(lookup, mitsuba):
    texture = {"type": "rgb", "value": [0.1, 0.2, 0.6]}
    loaded, si = mitsuba.load_dict(texture), mitsuba.SurfaceInteraction3f()
    rgb, number, gradient = lookup(texture, np.zeros((1, 2)))
    np.testing.assert_allclose(rgb[0], np.array(loaded.eval(si)), rtol=1e-6)
    np.testing.assert_allclose(number[0], loaded.eval_1(si), rtol=1e-6)
    assert (gradient == 0).all()


def test_mesh_attributes(lookup, mitsuba):
    """Vertex and face attributes with one and three channels; the meshes before and after have none."""
    random = np.random.default_rng(12)
    values = {
        "vertex_tint": random.random((4, 3)),
        "face_tint": random.random((2, 3)),
        "vertex_wear": random.random((4, 1)),
    }
    mesh = mitsuba.Mesh("mesh", 4, 2)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0]
    parameters["faces"] = [0, 1, 2, 2, 3, 0]
    parameters.update()
    for name, table in values.items():
        mesh.add_attribute(name, table.shape[1], table.ravel())
    scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})

    hits = [
        scene.ray_intersect(mitsuba.Ray3f([*position, 1.0], [0, 0, -1]))
        for position in random.uniform(0.1, 0.9, (20, 2))
    ]
    triangles = np.array([hit.prim_index for hit in hits])
    faces = np.array([[0, 1, 2], [2, 3, 0]])
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces[triangles]]
    position = np.array([np.array(hit.p)[:2] for hit in hits])
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    barycentric = np.linalg.solve(edges, (position - corners[:, 0])[..., None])[..., 0]

    none = MeshAttributes(3, 1, {})
    meshes = [none, MeshAttributes(4, 2, values), none]
    scene_faces = np.array([[0, 1, 2], *(faces + 3), [7, 8, 9]])
    for name in values:
        texture = {"type": "mesh_attribute", "name": name, "scale": 2.0}
        inputs = {"meshes": meshes, "faces": scene_faces, "triangles": triangles + 1, "barycentric": barycentric}
        rgb, number, _ = lookup(texture, np.zeros((20, 2)), **inputs)
        loaded = mitsuba.load_dict(texture)
        np.testing.assert_allclose(rgb, [np.array(loaded.eval(hit)) for hit in hits], rtol=1e-5)
        if name == "vertex_wear":
            np.testing.assert_allclose(number, [loaded.eval_1(hit) for hit in hits], rtol=1e-5)
    rgb, _, _ = lookup(texture, np.zeros((2, 2)), meshes=meshes, faces=scene_faces)
    assert (rgb == 0).all()  # the hit is not a triangle


def test_each_texture_feature_alone(device, lookup, files):
    uv = random_uv(50, 13)
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png")}
    checkerboard = {"type": "checkerboard", "color0": 0.9, "color1": 0.1}
    for kinds, texture in ((("BITMAPS",), bitmap), (("CHECKERBOARDS",), checkerboard), ((), 0.25)):
        alone = lookup(texture, uv, kernel=build_lookup(device, *kinds))
        for values, together in zip(alone, lookup(texture, uv), strict=True):
            assert (values == together).all()
    build_lookup(device, "MESH_ATTRIBUTES")
