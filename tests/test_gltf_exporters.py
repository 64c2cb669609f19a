"""glTF: what exporters write beside the specification. Files are built in memory."""

import numpy as np
import pytest
from gltf_files import TRIANGLE, Gltf, corners_of, one_mesh, only_mesh, pack_glb, read, read_file, shapes_of
from gltf_material_files import COLOURS, MaterialFile, pbr

import isonoise
from isonoise.errors import SceneError


def test_null_is_taken_as_missing(tmp_path):
    file = one_mesh(indices=None, material=None, extensions=None)
    file.content["nodes"][0] |= {"name": None, "children": None, "matrix": None, "camera": None, "translation": None}
    file.content |= {"extensionsUsed": None, "scene": None, "cameras": None}
    np.testing.assert_array_equal(corners_of(only_mesh(file, tmp_path))[0], TRIANGLE)


def test_json_padded_with_zero_bytes(tmp_path):
    """The specification asks for blanks."""
    file = one_mesh()
    text = file._json(None)
    path = tmp_path / "a.glb"
    path.write_bytes(pack_glb(text + bytes(4 - len(text) % 4), bytes(file.data)))
    assert len(shapes_of(read(path)[0])) == 1


def test_names_of_files_with_backslashes(tmp_path):
    file = one_mesh()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.bin").write_bytes(file.data)
    path = tmp_path / "a.gltf"
    path.write_bytes(file._json("sub\\a.bin"))
    assert len(shapes_of(read(path)[0])) == 1


def test_rounded_matrices(tmp_path):
    file = one_mesh()
    matrix = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 0.99999994]
    file.content["nodes"][0]["matrix"] = matrix
    np.testing.assert_array_equal(corners_of(only_mesh(file, tmp_path))[0], TRIANGLE + np.array([5, 0, 0]))
    matrix[15] = 0.9
    with pytest.raises(SceneError, match=r"nodes\[0\].matrix: its last row"):
        read_file(file, tmp_path)


@pytest.mark.parametrize("has_fallback", [True, False])
def test_optional_draco_compression(has_fallback, tmp_path):
    """Some exporters do not list it as required, although the file has no other data."""
    file = one_mesh(extensions={"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}})
    file.content["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    if has_fallback:
        only_mesh(file, tmp_path)
        return
    del file.content["accessors"][0]["bufferView"]
    with pytest.raises(SceneError, match=r"meshes\[0\].primitives\[0\]: .*export the model without Draco compression"):
        read_file(file, tmp_path)


@pytest.mark.parametrize("has_fallback", [True, False])
def test_optional_images_of_other_formats(has_fallback, tmp_path):
    """The image of the texture itself is shown; without one, the warning names the format."""
    file = MaterialFile(pbr(baseColorTexture={"index": 0}), COLOURS)
    file.content["textures"][0]["extensions"] = {"KHR_texture_basisu": {"source": 7}}
    file.content["extensionsUsed"] = ["KHR_texture_basisu"]
    if not has_fallback:
        del file.content["textures"][0]["source"]
    scene, report = read_file(file, tmp_path)
    (shape,) = shapes_of(scene)
    (colour,) = (one["base_color"]["type"] for one in (shape["bsdf"].get("bsdf", shape["bsdf"]),))
    assert colour == ("bitmap" if has_fallback else "rgb")
    assert ("its image is KTX2" in "".join(report.warnings())) != has_fallback


def test_meshes_without_primitives_are_left_out(tmp_path):
    file = Gltf(meshes=[{"primitives": []}])
    file.node(mesh=0)
    file.node(mesh=file.mesh())
    only_mesh(file, tmp_path)


def test_cameras_are_chosen_by_their_names_in_the_file(tmp_path):
    """The name of the node, or else of the camera, or else a number."""
    file = one_mesh()
    for name in ("Front View.001", None, "Top"):
        file.add("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.1}, name=name)
    for camera, name in enumerate(("Kamera ü", None, None)):
        file.node(camera=camera, name=name, translation=[0, 0, camera + 1])
    path = file.write(tmp_path)
    for name, z in (("kamera ü", 1), ("camera_1", 2), ("Top", 3), ("1", 2)):
        scene = isonoise.load(path, view=isonoise.View(camera=name))
        (sensor,) = (one for name, one in scene.items() if name != "type" and one["type"] == "perspective")
        assert sensor["to_world"][2, 3] == z


def test_animated_nodes_are_at_rest(tmp_path):
    """Without a warning: `isonoise info` says it."""
    file = one_mesh()
    times, places = file.accessor(np.array([0, 1], "f4")), file.accessor(np.array([[5, 0, 0], [6, 0, 0]], "f4"))
    target = {"node": 0, "path": "translation"}
    samplers = [{"input": times, "output": places}]
    file.add("animations", channels=[{"sampler": 0, "target": target}], samplers=samplers)
    np.testing.assert_array_equal(corners_of(only_mesh(file, tmp_path))[0], TRIANGLE)
    rows = "\n".join(text for _, text in read_file(file, tmp_path)[1].rows())
    assert "1 animation" in rows
    assert "animations are not played" in rows
