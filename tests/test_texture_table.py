"""Textures as the scene compiler stores them: equal ones once, means, mesh attributes, missing images."""

import numpy as np
import pytest
from PIL import Image
from small_files import write_images

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.material.textures import Textures
from isonoise.scene.spectra import srgb_to_linear

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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder of images of 7 x 5 texels."""
    return write_images(tmp_path_factory.mktemp("images"))


def test_equal_textures_are_one(files):
    """An image is read and stored once, whether it is raw or not."""
    table = Textures()
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png"), "to_uv": np.eye(4)}
    first = table.index(bitmap, "reflectance")
    assert table.index(dict(bitmap), "number") == first
    assert table.index(bitmap | {"raw": True}, "number") != first
    assert table.index(bitmap | {"wrap_mode": "clamp"}, "number") != first
    checkerboard = {"type": "checkerboard", "color0": bitmap, "color1": 0.5}
    assert table.index(checkerboard, "reflectance") == table.index(dict(checkerboard), "reflectance")
    deep = {"type": "bitmap", "filename": str(files / "deep.png")}
    assert table.index(deep, "number") != table.index(deep | {"raw": True}, "number")
    arrays = table.arrays()
    assert arrays.bytes.shape == (35, 4)
    assert arrays.floats.shape == (70, 4)
    assert len(arrays.records) == 7
    assert Textures().arrays().records.shape == (0,)


def test_means(files):
    """The mean over one period, of linear values."""
    table = Textures()
    pixels = np.asarray(Image.open(files / "rgb.png")) / 255
    bitmap = {"type": "bitmap", "filename": str(files / "rgb.png")}
    plain, raw = (table.index(bitmap | {"raw": raw}, "radiance") for raw in (False, True))
    np.testing.assert_allclose(table.mean(plain), srgb_to_linear(pixels).mean(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(table.mean(raw), pixels.mean(axis=(0, 1)), rtol=1e-6)
    checkerboard = table.index({"type": "checkerboard", "color0": bitmap, "color1": 0.5}, "radiance")
    np.testing.assert_allclose(table.mean(checkerboard), 0.5 * (table.mean(plain) + 0.5))
    linear = table.index({"type": "bitmap", "filename": str(files / "linear.exr")}, "radiance")
    assert table.mean(linear) == pytest.approx(0.5, abs=0.15)


def test_missing_mesh_attributes(tmp_path):
    """The error names the shape, also for nested textures. A mesh with the attribute has no error."""
    (tmp_path / "mesh.ply").write_text(PLY)
    attribute = {"type": "mesh_attribute", "name": "vertex_heat"}
    checkerboard = {"type": "checkerboard", "color0": 0.1, "color1": attribute | {"name": "vertex_color"}}
    wrapped = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": checkerboard}}
    ply = {"type": "ply", "filename": str(tmp_path / "mesh.ply")}

    def compiled(**shape):
        return compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "thing": shape}))

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
