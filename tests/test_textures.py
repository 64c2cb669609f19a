"""Textures on the device against Mitsuba 3's, and against float64."""

import itertools

import numpy as np
import pytest
from PIL import Image

from isonoise.device.opencl import Device
from isonoise.device.program import declare_struct, flatten
from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load, structs
from isonoise.scene.material import textures
from isonoise.scene.material.textures import MeshAttributes, Textures
from isonoise.scene.spectra import srgb_to_linear

KERNEL = """
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
KINDS = ("BITMAPS", "CHECKERBOARDS", "MESH_ATTRIBUTES")
ROUNDING = 1e-5
"""Absolute, of values up to 1 at |uv| up to 4: a place is off by 4 x 7 texels x 2^-24 of itself, and the slope is at
most 1 a texel; a few such errors add up."""
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
property float r
property float g
property float b
element face 1
property list uchar int vertex_indices
end_header
0 0 0 1 0 0
1 0 0 0 1 0
0 1 0 0 0 1
3 0 1 2
"""
NUMBER = np.array([0.212671, 0.715160, 0.072169])


@pytest.fixture(scope="module")
def device():
    return Device()


def kernel_of(device, *on: str):
    constants = textures.CONSTANTS | {"NONE": structs.NONE}
    text = [f"#define {name} {value}u" for name, value in constants.items()]
    text += [
        "#pragma OPENCL FP_CONTRACT OFF",
        declare_struct("Texture", textures.TEXTURE),
        flatten("texture/texture.h"),
        KERNEL,
    ]
    flags = ["-DFEATURE_TEXTURES=1", "-DFEATURE_BUMP=1", *(f"-DFEATURE_{kind}={int(kind in on)}" for kind in KINDS)]
    return device.build("\n".join(text), ("-cl-std=CL1.2", "-Werror", *flags))["lookup"]


@pytest.fixture(scope="module")
def look(device):
    """Colour (n, 3), number (n,) and gradient (n, 2) of a texture of the description at uv (n, 2), in float64."""
    kernel = kernel_of(device, *KINDS)

    def run(texture, uv, kind="reflectance", meshes=(), faces=None, triangles=None, barycentric=None, kernel=kernel):
        collected = Textures()
        index = collected.index(texture, kind)
        arrays, n = collected.arrays(meshes), len(uv)
        points = np.zeros((n, 4), np.float32)
        points[:, :2] = uv
        points[:, 2:] = 0 if barycentric is None else barycentric
        triangles = np.full(n, structs.NONE) if triangles is None else triangles
        faces = np.zeros((0, 3)) if faces is None else faces
        stores = (arrays.records, arrays.bytes, arrays.floats, textures.SRGB, arrays.attributes)
        b = [device.buffer(array, "a store") if array.size else None for array in (*stores, faces.astype(np.uint32))]
        out = device.buffer(24 * n, "values")
        given = (device.buffer(points, "points"), device.buffer(triangles.astype(np.uint32), "triangles"))
        device.launch(kernel, n, (*b, np.uint32(index), *given, out, np.uint32(n)))
        values = device.read(out, np.float32, 6 * n).reshape(n, 6).astype(np.float64)
        return values[:, :3], values[:, 3], values[:, 4:]

    return run


@pytest.fixture(scope="module")
def mi():
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Images by name, 7 x 5 texels, and what they hold as linear values."""
    folder, random = tmp_path_factory.mktemp("images"), np.random.default_rng(4)
    rgb = random.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(folder / "rgb.png")
    Image.fromarray(rgb[..., 0]).save(folder / "grey.png")
    Image.fromarray(random.integers(0, 65536, (5, 7), dtype=np.uint16)).save(folder / "deep.png")
    linear = random.random((5, 7, 3), dtype=np.float32)
    from isonoise.film.exr import write_exr

    write_exr(folder / "linear.exr", {"": linear}, {})
    return folder


def random_uv(count: int, seed: int, size=(7, 5), margin: float = 0.0) -> np.ndarray:
    """Places within and outside the unit square, away from the borders of the texels by `margin` of one."""
    uv = np.random.default_rng(seed).uniform(-2.5, 3.5, (count, 2)).astype(np.float32)
    place = uv * np.array(size)
    return uv[(np.abs(place - np.round(place)) > margin).all(axis=1)]


def in_mitsuba(mi, texture: dict, uv: np.ndarray, gradient: bool = True):
    """Colour, number and gradient by Mitsuba 3; textures of bytes in full precision, not in half."""
    loaded, rows = mi.load_dict(texture), []
    for u, v in uv:
        si = mi.SurfaceInteraction3f()
        si.uv = mi.Point2f(float(u), float(v))
        slope = np.array(loaded.eval_1_grad(si)) if gradient else np.zeros(2)
        rows.append([*np.array(loaded.eval(si)), loaded.eval_1(si), *slope])
    rows = np.array(rows, np.float64)
    return rows[:, :3], rows[:, 3], rows[:, 4:]


def assert_close(found, expected, tolerance: float = ROUNDING):
    for ours, theirs, scale in zip(
        found, expected, (1.0, 1.0, 20.0), strict=True
    ):  # slopes: 7 texels, and as many to_uv
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=scale * tolerance)


def in_float64(pixels: np.ndarray, uv: np.ndarray, wrap: str, nearest: bool) -> np.ndarray:
    """Values of linear pixels (height, width, 3) at uv (n, 2)."""
    height, width, _ = pixels.shape

    def wrapped(i, size):
        if wrap == "repeat":
            return i % size
        if wrap == "mirror":
            return np.where(i % (2 * size) < size, i % (2 * size), 2 * size - 1 - i % (2 * size))
        return np.clip(i, 0, size - 1)

    place = uv.astype(np.float64) * (width, height) - (0.0 if nearest else 0.5)
    corner = np.floor(place).astype(int)
    share = np.zeros_like(place) if nearest else place - corner
    value = 0.0
    for dx, dy in itertools.product((0, 1), (0, 1)):
        weight = (share[:, 0] if dx else 1 - share[:, 0]) * (share[:, 1] if dy else 1 - share[:, 1])
        value = value + weight[:, None] * pixels[wrapped(corner[:, 1] + dy, height), wrapped(corner[:, 0] + dx, width)]
    return value


MODES = list(itertools.product(("repeat", "mirror", "clamp"), ("bilinear", "nearest")))


@pytest.mark.parametrize(("wrap_mode", "filter_type"), MODES)
@pytest.mark.parametrize("raw", [False, True])
def test_bitmaps_are_mitsubas(look, mi, files, wrap_mode, filter_type, raw):
    for name in ("rgb.png", "grey.png", "deep.png", "linear.exr"):
        texture = {"type": "bitmap", "filename": str(files / name), "raw": raw}
        texture |= {"wrap_mode": wrap_mode, "filter_type": filter_type}
        uv = random_uv(60, 5, margin=1e-3)
        assert_close(look(texture, uv), in_mitsuba(mi, texture | {"format": "variant"}, uv))


@pytest.mark.parametrize(("wrap_mode", "filter_type"), MODES)
@pytest.mark.parametrize("size", [(7, 5), (1, 1), (1, 4), (3, 1), (2, 2)])
def test_bitmaps_in_float64(look, tmp_path, wrap_mode, filter_type, size):
    width, height = size
    pixels = np.random.default_rng(6).integers(0, 256, (height, width, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "image.png")
    texture = {"type": "bitmap", "filename": str(tmp_path / "image.png"), "wrap_mode": wrap_mode}
    texture |= {"filter_type": filter_type}
    uv = random_uv(2000, 7, size, margin=1e-4)
    linear = srgb_to_linear(pixels / 255)
    rgb, number, _ = look(texture, uv)
    expected = in_float64(linear, uv, wrap_mode, filter_type == "nearest")
    np.testing.assert_allclose(rgb, expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(number, expected @ NUMBER, rtol=0, atol=ROUNDING)


def test_half_textures_of_mitsuba_are_ours_within_their_rounding(look, mi, files):
    """By default Mitsuba keeps images of 8 and 16 bits as half floats, 2^-11 off at most; here they are not rounded."""
    texture = {"type": "bitmap", "filename": str(files / "rgb.png")}
    uv = random_uv(100, 8)
    np.testing.assert_allclose(look(texture, uv)[0], in_mitsuba(mi, texture, uv)[0], rtol=2**-11, atol=ROUNDING)


def turned(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0.0, 0.3], [s, c, 0.0, -0.2], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("matrix", [np.diag([2.0, -1.5, 7.0, 1.0]), turned(25.0) @ np.diag([2.0, 1.5, 1.0, 1.0])])
def test_to_uv(look, mi, files, matrix):
    """Of a 4x4 matrix the third row and column do not count; a 3x3 matrix is that without them."""
    uv = random_uv(100, 9)
    texture = {"type": "bitmap", "filename": str(files / "rgb.png")}
    flat = matrix[np.ix_([0, 1, 3], [0, 1, 3])]
    expected = in_mitsuba(
        mi, texture | {"format": "variant", "to_uv": mi.ScalarTransform4f(matrix)}, uv, gradient=False
    )
    for given in (matrix, flat):
        found = look(texture | {"to_uv": given}, uv)
        for ours, theirs in zip(found[:2], expected[:2], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=3 * ROUNDING)


def test_gradients(look, mi, files):
    """As Mitsuba's eval_1_grad has them where uv is stretched alone; where it is turned, as differences in float64 do.

    (Its eval_1_grad, 3.9.1, multiplies by the image's size after the turn instead of before it, which is not the slope
    unless images are square.)
    """
    uv = random_uv(200, 10, margin=0.02)
    texture = {"type": "bitmap", "filename": str(files / "rgb.png"), "wrap_mode": "mirror"}
    stretched = np.diag([2.0, -1.5, 1.0, 1.0])
    found = look(texture | {"to_uv": stretched}, uv)
    assert_close(found, in_mitsuba(mi, texture | {"format": "variant", "to_uv": mi.ScalarTransform4f(stretched)}, uv))

    matrix = turned(25.0) @ stretched
    linear = srgb_to_linear(np.asarray(Image.open(files / "rgb.png")) / 255)
    step, corners = 1e-4, uv.astype(np.float64) @ matrix[:2, :2].T + matrix[:2, 3]
    inside = np.abs((corners * (7, 5) - 0.5) % 1 - 0.5).max(axis=1) < 0.48  # no corner of the surface within a step
    gradient = look(texture | {"to_uv": matrix}, uv)[2]
    for axis in (0, 1):
        ahead, behind = (
            in_float64(linear, corners + sign * step * matrix[:2, axis], "mirror", False) @ NUMBER for sign in (1, -1)
        )
        slope = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(gradient[inside, axis], slope[inside], rtol=0, atol=40 * ROUNDING)
    assert inside.sum() > 100


def test_coordinates_without_meaning(look, files):
    """No uv, however far or not a number, reads beside the image."""
    odd = [np.nan, np.inf, -np.inf, 1e38, -1e38, 1e9, -1e9, 2.0**24, -1e-30, 1.0, np.float32(1) - np.float32(2**-24)]
    uv = np.array(list(itertools.product(odd, odd)))
    for wrap_mode, filter_type in MODES:
        texture = {"type": "bitmap", "filename": str(files / "rgb.png"), "wrap_mode": wrap_mode}
        rgb, number, gradient = look(texture | {"filter_type": filter_type}, uv)
        assert ((rgb >= 0) & (rgb <= 1)).all()
        assert ((number >= 0) & (number <= 1.000001)).all()
        assert np.isfinite(gradient).all()


def test_checkerboards(look, mi, files):
    """Colours and numbers are Mitsuba's, with a texture for a colour. As numbers the two change places."""
    board = {"type": "checkerboard", "to_uv": turned(10.0) @ np.diag([3.0, 2.0, 1.0, 1.0])}
    board |= {"color0": {"type": "rgb", "value": [0.1, 0.2, 0.9]}}
    board |= {"color1": {"type": "bitmap", "filename": str(files / "rgb.png")}}
    theirs = board | {"to_uv": mi.ScalarTransform4f(board["to_uv"]), "color1": board["color1"] | {"format": "variant"}}
    uv = random_uv(300, 11)
    found, expected = look(board, uv), in_mitsuba(mi, theirs, uv, gradient=False)
    place = uv @ board["to_uv"][:2, :2].T + board["to_uv"][:2, 3]
    clear = (np.abs(2 * place - np.round(2 * place)) > 1e-4).all(axis=1)
    assert clear.sum() > 250
    for ours, theirs in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_allclose(ours[clear], theirs[clear], rtol=0, atol=ROUNDING)
    assert (found[2] != 0).any()  # within the patches of the bitmap


def test_plain_colours(look, mi):
    uv = np.zeros((1, 2))
    for texture in (
        {"type": "rgb", "value": [0.1, 0.2, 0.6]},
        {"type": "uniform", "value": 0.3},
        {"type": "srgb", "color": {"type": "rgb", "value": [0.5, 0.25, 0.125]}},
    ):
        loaded = mi.load_dict(texture if texture["type"] != "srgb" else texture["color"])
        si = mi.SurfaceInteraction3f()
        rgb, number, gradient = look(texture, uv)
        np.testing.assert_allclose(rgb[0], np.array(loaded.eval(si)), rtol=1e-6)
        np.testing.assert_allclose(number[0], loaded.eval_1(si), rtol=1e-6)
        assert (gradient == 0).all()


def test_mesh_attributes(look, mi):
    """Of vertices and of faces, of one channel and of three; the mesh before it and one after it have none."""
    random = np.random.default_rng(12)
    values = {
        "vertex_tint": random.random((4, 3)),
        "face_tint": random.random((2, 3)),
        "vertex_wear": random.random((4, 1)),
    }
    mesh = mi.Mesh("mesh", 4, 2)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0]
    parameters["faces"] = [0, 1, 2, 2, 3, 0]
    parameters.update()
    for name, table in values.items():
        mesh.add_attribute(name, table.shape[1], table.ravel())
    scene = mi.load_dict({"type": "scene", "mesh": mesh})

    hits = [scene.ray_intersect(mi.Ray3f([*place, 1.0], [0, 0, -1])) for place in random.uniform(0.1, 0.9, (20, 2))]
    triangles = np.array([hit.prim_index for hit in hits])
    faces = np.array([[0, 1, 2], [2, 3, 0]])
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces[triangles]]
    place = np.array([np.array(hit.p)[:2] for hit in hits])
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    barycentric = np.linalg.solve(edges, (place - corners[:, 0])[..., None])[..., 0]

    none = MeshAttributes(3, 1, {})
    meshes = [none, MeshAttributes(4, 2, values), none]
    scene_faces = np.array([[0, 1, 2], *(faces + 3), [7, 8, 9]])
    for name in values:
        texture = {"type": "mesh_attribute", "name": name, "scale": 2.0}
        given = {"meshes": meshes, "faces": scene_faces, "triangles": triangles + 1, "barycentric": barycentric}
        rgb, number, _ = look(texture, np.zeros((20, 2)), **given)
        loaded = mi.load_dict(texture)
        np.testing.assert_allclose(rgb, [np.array(loaded.eval(hit)) for hit in hits], rtol=1e-5)
        if name == "vertex_wear":
            np.testing.assert_allclose(number, [loaded.eval_1(hit) for hit in hits], rtol=1e-5)
    rgb, _, _ = look(texture, np.zeros((2, 2)), meshes=meshes, faces=scene_faces)
    assert (rgb == 0).all()  # not a triangle


def test_each_kind_alone_builds_and_reads(device, look, files):
    uv = random_uv(50, 13)
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png")}
    board = {"type": "checkerboard", "color0": 0.9, "color1": 0.1}
    for kinds, texture in ((("BITMAPS",), bitmap), (("CHECKERBOARDS",), board), ((), 0.25)):
        alone = look(texture, uv, kernel=kernel_of(device, *kinds))
        for ours, together in zip(alone, look(texture, uv), strict=True):
            assert (ours == together).all()
    kernel_of(device, "MESH_ATTRIBUTES")


def test_equal_textures_are_one(files):
    """An image is read once; bytes are in their store once, whether they are raw or not."""
    collected = Textures()
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png"), "to_uv": np.eye(4)}
    first = collected.index(bitmap, "reflectance")
    assert collected.index(dict(bitmap), "number") == first
    assert collected.index(bitmap | {"raw": True}, "number") != first
    assert collected.index(bitmap | {"wrap_mode": "clamp"}, "number") != first
    board = {"type": "checkerboard", "color0": bitmap, "color1": 0.5}
    assert collected.index(board, "reflectance") == collected.index(dict(board), "reflectance")
    deep = {"type": "bitmap", "filename": str(files / "deep.png")}
    assert collected.index(deep, "number") != collected.index(deep | {"raw": True}, "number")
    arrays = collected.arrays()
    assert arrays.bytes.shape == (35, 4)
    assert arrays.floats.shape == (70, 4)
    assert len(arrays.records) == 7
    assert Textures().arrays().records.shape == (0,)


def test_means(files):
    """Over one period, in linear values."""
    collected = Textures()
    pixels = np.asarray(Image.open(files / "rgb.png")) / 255
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png")}
    plain, raw = (collected.index(bitmap | {"raw": raw}, "radiance") for raw in (False, True))
    np.testing.assert_allclose(collected.mean(plain), srgb_to_linear(pixels).mean(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(collected.mean(raw), pixels.mean(axis=(0, 1)), rtol=1e-6)
    board = collected.index({"type": "checkerboard", "color0": bitmap, "color1": 0.5}, "radiance")
    np.testing.assert_allclose(collected.mean(board), 0.5 * (collected.mean(plain) + 0.5))
    linear = collected.index({"type": "bitmap", "filename": str(files / "linear.exr")}, "radiance")
    assert collected.mean(linear) == pytest.approx(0.5, abs=0.15)


def test_attributes_that_a_mesh_lacks(tmp_path):
    """The error names the shape, whatever holds the texture; a mesh that has the attribute is none the wiser."""
    (tmp_path / "mesh.ply").write_text(PLY)
    attribute = {"type": "mesh_attribute", "name": "vertex_heat"}
    board = {"type": "checkerboard", "color0": 0.1, "color1": attribute | {"name": "vertex_color"}}
    wrapped = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": board}}
    ply = {"type": "ply", "filename": str(tmp_path / "mesh.ply")}

    def compiled(**shape):
        return compile_scene(load({"type": "scene", "sensor": {"type": "perspective"}, "thing": shape}))

    assert len(compiled(**ply, bsdf=wrapped).attributes) == 3
    for shape, message in (
        (ply | {"bsdf": {"type": "diffuse", "reflectance": attribute}}, "'vertex_heat'.*it has: vertex_color"),
        (ply | {"emitter": {"type": "area", "radiance": attribute}}, "'vertex_heat', which its area uses"),
        ({"type": "sphere", "bsdf": wrapped}, "'vertex_color', which its twosided uses .it has: none"),
    ):
        with pytest.raises(SceneError, match=f"thing.*has no attribute {message}"):
            compiled(**shape)
    with pytest.raises(SceneError, match="begin with 'vertex_' or 'face_'"):
        Textures().index(attribute | {"name": "color"}, "reflectance")


def test_missing_image(tmp_path):
    with pytest.raises(SceneError, match=r"nothing\.png"):
        Textures().index({"type": "bitmap", "filename": str(tmp_path / "nothing.png")}, "reflectance")
