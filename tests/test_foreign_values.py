"""Scene dicts with values of other packages: Mitsuba's and Dr.Jit's, trimesh's, numpy's; none is imported for it."""

import subprocess
import sys

import numpy as np
import pytest
from small_scene import lamp_over_floor

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.parse.foreign_values import plain_value
from isonoise.scene.scene import load

CAMERA = {"type": "scene", "sensor": {"type": "perspective"}}
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def compiled(**objects):
    return compile_scene(load_description({**CAMERA, **objects}))


def mesh(**more) -> dict:
    return {"type": "mesh", "vertices": SQUARE, "faces": FACES, **more}


def test_mitsubas_cornell_box(mitsuba):
    """Equal to the same scene with plain numbers."""
    description = mitsuba.cornell_box()
    scene = load(description)
    assert scene["film.size"] == (256, 256)
    np.testing.assert_array_equal(scene["sensor.to_world"], np.array(description["sensor"]["to_world"].matrix))
    plain = {
        name: {k: np.array(v.matrix, float) if "Transform" in type(v).__name__ else v for k, v in part.items()}
        if isinstance(part, dict)
        else part
        for name, part in description.items()
    }
    assert scene.compile().hash == load(plain).compile().hash


@pytest.mark.parametrize(
    "variant", ["scalar_rgb", "scalar_spectral", pytest.param("llvm_ad_rgb", marks=pytest.mark.long)]
)
def test_values_of_a_variant(variant):
    """In a process of its own: a variant cannot be unloaded."""
    pytest.importorskip("mitsuba")
    program = """
import sys, numpy as np, mitsuba as mi
try:
    mi.set_variant(sys.argv[1])
    mi.Float(1.0)
except Exception:
    print("skipped"); raise SystemExit
from isonoise.scene.parse.foreign_values import plain_value
from isonoise.scene.parse.elements import SourceLocation
at = SourceLocation(element="x")
matrix = np.array([[1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1.0]])
for kind in (mi.ScalarTransform4f, mi.Transform4f):
    np.testing.assert_array_equal(plain_value(kind().translate([2, 3, 4]), at), matrix)
flat = plain_value(mi.ScalarTransform3f().translate([2, 3]).rotate(90), at)
np.testing.assert_allclose(flat, [[0, -1, 0, 2], [1, 0, 0, 3], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-7)
assert plain_value(mi.ScalarColor3f(1, 2, 3), at) == {"type": "rgb", "value": [1, 2, 3]}
for kind in (mi.ScalarPoint3f, mi.Point3f, mi.ScalarVector3f, mi.Vector3f, list, np.array):
    value = kind([1, 2, 3]) if kind in (list, np.array) else kind(1, 2, 3)
    assert plain_value(value, at) == (1, 2, 3), kind
for kind in (mi.Float, mi.ScalarFloat, mi.UInt32, np.float32, np.int64):
    assert plain_value(kind(2), at) == 2
values = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
np.testing.assert_array_equal(plain_value(mi.TensorXf(values), at), values)
np.testing.assert_array_equal(plain_value(mi.Bitmap(values), at).pixels, values)
grid = plain_value(mi.VolumeGrid(values[..., None]), at)
np.testing.assert_array_equal(grid.reshape(values.shape), values)
print("ok")
"""
    run = subprocess.run([sys.executable, "-c", program, variant], capture_output=True, text=True)
    assert run.stdout.strip() in ("ok", "skipped"), run.stderr


def test_bitmaps_of_mitsuba(mitsuba):
    """As Mitsuba reads them: gamma is decoded, alpha is left out."""
    grey = np.full((2, 3, 4), 128, np.uint8)
    encoded, linear = mitsuba.Bitmap(grey), mitsuba.Bitmap(grey)
    linear.set_srgb_gamma(False)
    floats = mitsuba.Bitmap(np.full((2, 3, 3), 0.5, np.float32))
    floats.set_srgb_gamma(True)
    images = [plain_value(bitmap, SourceLocation()) for bitmap in (encoded, linear, floats)]
    assert [image.linear().shape for image in images] == [(2, 3, 3)] * 3
    expected = (0.2158605, 128 / 255, 0.2140411)  # IEC 61966-2-1
    np.testing.assert_allclose([image.linear()[0, 0, 0] for image in images], expected, rtol=1e-5)


def test_a_loaded_object_is_refused(mitsuba):
    sphere = mitsuba.load_dict({"type": "sphere"})
    with pytest.raises(SceneError, match=r"ball: Mitsuba has loaded this .*; give the dict that it was made of"):
        load({**CAMERA, "ball": sphere})


def test_meshes_are_arrays():
    """Equal to the rectangle, which has the same triangles."""
    arrays = compiled(it=mesh(face_normals=True))
    rectangle = compiled(it={"type": "rectangle"})
    corners = [np.sort(scene.vertices[scene.faces].reshape(2, 9), axis=0) for scene in (arrays, rectangle)]
    assert np.array_equal(np.unique(corners[0]), np.unique(corners[1]))
    smooth = compiled(it=mesh(normals=np.tile((0, 0, 1), (4, 1)).tolist()))
    np.testing.assert_array_equal(smooth.vertex_normals, np.tile((0, 0, 1), (4, 1)))
    for integers in (np.uint8, np.int32, np.uint64):
        assert np.array_equal(compiled(it=mesh(faces=FACES.astype(integers))).faces, arrays.faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": SQUARE[:, :2]}, "it.vertices: 'vertices' has to be an array of n x 3 finite numbers"),
        ({"vertices": np.full((4, 3), np.nan)}, "an array of n x 3 finite numbers"),
        ({"faces": FACES + 0.5}, "it.faces: 'faces' has to be an array of n x 3 whole numbers"),
        ({"faces": FACES + 2}, "a face uses a vertex that does not exist (there are 4)"),
        ({"normals": np.ones((3, 3))}, "the number of normals has to equal the number of vertices"),
        ({"texcoords": np.ones((3, 2))}, "the number of texture coordinates has to equal"),
        ({"mesh": 3}, "'mesh' has to be a trimesh.Trimesh, got int"),
    ],
)
def test_errors_of_mesh_arrays(change, message):
    with pytest.raises(SceneError) as caught:
        compiled(it=mesh(**change))
    assert message in str(caught.value)


def test_images_are_arrays(tmp_path):
    """Bytes as in a PNG file, floats linear, one channel or three; a fourth is left out."""
    from PIL import Image

    pixels = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")

    def texels(**source) -> np.ndarray:
        texture = {"type": "bitmap", **source}
        scene = compiled(it={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}})
        return scene.texel_bytes if len(scene.texel_bytes) else scene.texel_floats

    expected = texels(filename=str(tmp_path / "a.png"))
    assert np.array_equal(texels(data=pixels), expected)
    assert np.array_equal(texels(bitmap=np.dstack([pixels, pixels[..., :1]])), expected)
    floats = np.linspace(0, 1, 60).reshape(4, 5, 3)
    np.testing.assert_array_equal(texels(data=floats)[:, :3], floats.reshape(-1, 3).astype(np.float32))
    np.testing.assert_array_equal(texels(data=floats[..., 0])[:, 2], floats[..., 0].ravel().astype(np.float32))
    for wrong, message in (
        ({"data": np.ones(3)}, "'data' has to be an array (height, width)"),
        ({"data": np.ones((2, 2, 5))}, "'data' has to be an array (height, width)"),
        ({"data": pixels, "filename": "a.png"}, "give 'filename' or 'data', not both"),
        ({}, "texture 'bitmap' needs a 'filename'"),
    ):
        with pytest.raises(SceneError) as caught:
            texels(**wrong)
        assert message in str(caught.value)
    sky = compiled(sky={"type": "envmap", "bitmap": np.ones((4, 8, 3), np.float32)})
    np.testing.assert_array_equal(sky.environment.texels[..., :3], 1)


def test_arrays_are_read_and_set_by_path():
    scene = load({**lamp_over_floor(), "it": mesh(), "picture": {"type": "bitmap", "data": np.zeros((2, 2, 3))}})
    before = scene.compile()
    scene["it.vertices"] = scene["it.vertices"] + (0, 0, 1)
    after = scene.compile()
    moved = after.vertices[: len(before.vertices)] != before.vertices
    assert moved[:, 2].sum() == 4
    assert not moved[:, :2].any()
    scene["picture.data"] = np.ones((1, 1), np.float32)
    assert scene["picture.data"].pixels.shape == (1, 1, 1)
    shape = {parameter.path: parameter.shape for parameter in scene.params().parameters}
    assert (shape["it.vertices"], shape["it.faces"], shape["picture.data"]) == ((4, 3), (2, 3), (1, 1, 1))


def test_trimesh_meshes():
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(2)
    arrays = compiled(it={"type": "mesh", "vertices": ball.vertices, "faces": ball.faces})
    assert compiled(it=ball).hash == compiled(it={"type": "mesh", "mesh": ball}).hash == arrays.hash
    uv = np.random.default_rng(1).random((4, 2))
    square = trimesh.Trimesh(SQUARE, FACES, process=False, visual=trimesh.visual.TextureVisuals(uv=uv))
    texture = {"type": "bitmap", "data": np.zeros((2, 2, 3))}
    bsdf = {"type": "diffuse", "reflectance": texture}
    scene = compiled(it={"type": "mesh", "mesh": square, "bsdf": bsdf})
    np.testing.assert_allclose(scene.uvs, uv * (1, -1) + (0, 1), rtol=1e-6)
    with pytest.raises(SceneError, match="give 'mesh' or 'vertices', not both"):
        compiled(it={"type": "mesh", "mesh": ball, "vertices": ball.vertices})


def test_nothing_is_imported():
    program = (
        "import sys; from isonoise import load; load('cornell'); print([n for n in sys.argv[1:] if n in sys.modules])"
    )
    names = ["mitsuba", "drjit", "trimesh", "PIL"]
    assert subprocess.check_output([sys.executable, "-c", program, *names], text=True).strip() == "[]"
