"""`isonoise convert`: the written scene compiles to the arrays of the original one, and Mitsuba 3 reads it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import small_files
from plugin_cases import (
    PARAMETERS,
    SUPPORTED_PLUGINS,
    minimal_plugin,
    plugin_and_value,
    scene_with,
    write_files,
)
from scene_generator import write_scene

from isonoise.cli import main
from isonoise.convert.convert import convert
from isonoise.errors import SceneError, UserError
from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.image.image import Image, read_image
from isonoise.scene.transforms import rotate, scale, translate
from isonoise.scene.vocabulary.plugin import SUPPORTED

ROUNDING = 2.0**-20
"""Of numbers in files, 2^-24, and of sums with them, relative to the largest value of an array."""
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # scenes without lights, default materials
SENSOR = {"type": "perspective", "to_world": translate((0, 0, -5))}


def assert_same_scene(scene: CompiledScene, expected: CompiledScene) -> None:
    """Asserts that all fields are equal, those of numbers up to rounding."""
    for field in dataclasses.fields(CompiledScene):
        ours, theirs = getattr(scene, field.name), getattr(expected, field.name)
        if field.name == "environment":
            assert (ours is None) == (theirs is None)
        elif field.name == "light_cdf":  # a sum and its rest
            np.testing.assert_allclose(ours[:, 0], theirs[:, 0], atol=ROUNDING)
        elif isinstance(theirs, np.ndarray):
            assert ours.dtype == theirs.dtype, field.name
            for name in theirs.dtype.names or ("",):
                a, b = (array[name] if name else array for array in (ours, theirs))
                atol = ROUNDING * np.abs(b).max(initial=0) if b.dtype.kind == "f" else 0
                np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=f"{field.name} {name}")
        elif field.name not in ("hash", "exposure"):  # Mitsuba has no exposure
            assert ours == theirs, field.name


def convert_and_compare(source, folder: Path) -> str:
    """Converts a scene, and asserts that it stays the same; returns the written XML."""
    path = folder / "out.xml"
    convert(source, path)
    scene, expected = compile_scene(load_description(path)), compile_scene(load_description(source))
    if scene.hash != expected.hash:
        assert_same_scene(scene, expected)
    return path.read_text("utf-8")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


@pytest.mark.parametrize("name", builtin_scenes())
def test_builtin_scene(name, tmp_path):
    convert_and_compare(name, tmp_path)


@pytest.mark.parametrize("seed", [1, 7])
def test_random_scene(seed, tmp_path):
    text = convert_and_compare(write_scene(tmp_path, seed), tmp_path)
    (tmp_path / "again").mkdir()
    convert(tmp_path / "out.xml", tmp_path / "again" / "out.xml")
    again = (tmp_path / "again" / "out.xml").read_text("utf-8")
    assert again.split("-->")[1] == text.split("-->")[1]


def test_every_plugin(files, tmp_path, monkeypatch):
    monkeypatch.setattr("os.fsync", lambda descriptor: None)
    for plugin in SUPPORTED_PLUGINS:
        convert_and_compare(scene_with(plugin, minimal_plugin(plugin, files), files), tmp_path)


@pytest.mark.long
def test_every_parameter(files, tmp_path, mitsuba):
    """With a value that is not the default, too. Mitsuba reads the file."""
    for plugin, parameter in PARAMETERS:
        if parameter.status == SUPPORTED:
            description, value = plugin_and_value(plugin, parameter, files)
            convert_and_compare(scene_with(plugin, description | value, files), tmp_path)
            mitsuba.load_file(str(tmp_path / "out.xml"))


def mesh(**more) -> dict:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
    return {"type": "mesh", "vertices": corners, "faces": np.array([[0, 1, 2], [1, 3, 2]]), **more}


def scene_of_shapes(**shapes) -> dict:
    return {"type": "scene", "sensor": SENSOR, **shapes}


def colours(name: str) -> dict:
    return {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": name}}


def test_meshes_keep_their_attributes(tmp_path):
    """Names with and without the suffix of colours, per vertex and per face."""
    random = np.random.default_rng(1)
    sizes = {"vertex_color": (4, 3), "vertex_heat": (4, 1), "vertex_sky_color": (4, 3), "vertex_a_b": (4, 3)}
    sizes |= {"face_color": (2, 3), "face_id": (2, 1)}
    attributes = {name: random.random(size).astype(np.float32) for name, size in sizes.items()}
    shapes = {name: mesh(attributes=attributes, bsdf=colours(name)) for name in sizes}
    convert_and_compare(scene_of_shapes(**shapes), tmp_path)
    assert [path.name for path in (tmp_path / "out_files").iterdir()] == ["vertex_color.ply"]  # the mesh is shared


def test_attributes_that_ply_cannot_hold(tmp_path):
    attributes = {"vertex_a": np.ones((4, 3)), "vertex_a_color": np.ones((4, 3))}
    with pytest.raises(SceneError, match="PLY cannot hold the mesh attributes vertex_a, vertex_a_color together"):
        convert(scene_of_shapes(one=mesh(attributes=attributes)), tmp_path / "out.xml")
    assert not list(tmp_path.iterdir())


def test_meshes_keep_normals_and_texture_coordinates(tmp_path):
    """One vertex has no normal: Mitsuba computes none for it. The mesh is mirrored and sheared."""
    normals = np.array([[0, 0, 1.0], [0, 0.6, 0.8], [0, 0, 0], [0.6, 0, 0.8]])
    to_world = scale((2, -1, 0.5)) @ rotate((1, 2, 3), 40)
    bsdf = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
    texcoords = np.random.default_rng(1).random((4, 2))
    shapes = {
        "smooth": mesh(normals=normals, texcoords=texcoords, to_world=to_world, bsdf=bsdf),
        "flat": mesh(face_normals=True, flip_normals=True, bsdf=bsdf),
    }
    convert_and_compare(scene_of_shapes(**shapes), tmp_path)


def test_meshes_far_from_the_origin_stay_exact(tmp_path):
    far = np.array([2.0e7, -1e7, 3e6])
    moved = mesh()
    moved["vertices"] = moved["vertices"] + far
    scene = scene_of_shapes(one=moved)
    scene["sensor"] = SENSOR | {"to_world": translate(far - (0, 0, 5))}
    convert_and_compare(scene, tmp_path)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_images_in_memory(dtype, channels, tmp_path, mitsuba):
    """Integers become PNG, floats OpenEXR. Mitsuba reads the same values."""
    pixels = np.random.default_rng(1).random((5, 7, channels))
    pixels = (pixels if dtype == np.float32 else pixels * np.iinfo(dtype).max).astype(dtype)
    texture = {"type": "bitmap", "bitmap": Image(pixels), "raw": True, "id": "paint"}
    bsdf = {"type": "diffuse", "reflectance": texture}
    text = convert_and_compare(scene_of_shapes(one=mesh(bsdf=bsdf), two=mesh(bsdf=bsdf)), tmp_path)
    (file,) = (tmp_path / "out_files").glob("paint.*")
    assert f'value="out_files/{file.name}"' in text
    np.testing.assert_array_equal(read_image(file).pixels, pixels)
    np.testing.assert_array_equal(np.atleast_3d(np.array(mitsuba.Bitmap(str(file)))), pixels)


def test_shared_objects_are_written_once(tmp_path):
    glass = {"type": "dielectric", "id": "window glass"}
    fog = {"type": "homogeneous"}
    group = {"type": "shapegroup", "ball": {"type": "sphere", "bsdf": glass}}
    scene = scene_of_shapes(
        pane={"type": "rectangle", "bsdf": glass, "interior": fog, "exterior": fog},
        first={"type": "instance", "group": group},
        second={"type": "instance", "group": group, "to_world": translate((2, 0, 0))},
    )
    text = convert_and_compare(scene, tmp_path)
    assert text.count('<bsdf type="dielectric" id="window_glass"/>') == text.count("<bsdf") == 1
    assert text.count('<ref id="window_glass"/>') == 2
    assert text.count("<medium") == 1
    assert text.count('<shape type="shapegroup"') == 1
    assert not (tmp_path / "out_files").exists()


def test_defaults_are_left_out(tmp_path):
    text = convert_and_compare(
        scene_of_shapes(ball={"type": "sphere", "radius": 1.0, "bsdf": {"type": "diffuse"}}), tmp_path
    )
    assert "radius" not in text
    assert '<bsdf type="diffuse"/>' in text


def test_files_of_the_scene_are_copied(files, tmp_path):
    """Those of the same name get different ones; one that is used twice is copied once."""
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "A.ply").write_bytes(small_files.ply(shift=3))
    shapes = [{"type": "ply", "filename": str(path)} for path in (files / "a.ply", tmp_path / "other" / "A.ply") * 2]
    convert_and_compare(scene_of_shapes(**{f"shape_{i}": shape for i, shape in enumerate(shapes)}), tmp_path)
    assert {path.name for path in (tmp_path / "out_files").iterdir()} == {"a.ply", "A_2.ply"}


def test_small_models_are_scaled_up(write_file, tmp_path, capsys):
    """Mitsuba would miss surfaces of a model of a millimetre. The camera moves with it."""
    corners = "\n".join(f"v {x} {y} {z}" for x, y, z in 1e-3 * mesh()["vertices"])
    path = write_file("small.obj", f"{corners}\nf 1 2 3\nf 2 4 3\n")
    assert main(["convert", str(path), str(tmp_path / "out.xml")]) == 0
    assert "lengths times 10000" in capsys.readouterr().out
    assert "times 10000" in (tmp_path / "out.xml").read_text("utf-8")
    scene, expected = compile_scene(load_description(tmp_path / "out.xml")), compile_scene(load_description(path))
    np.testing.assert_allclose(scene.vertices, 1e4 * expected.vertices, rtol=1e-5, atol=1e-4)
    to_world, expected_to_world = (one.camera["to_world"].reshape(3, 4) for one in (scene, expected))
    np.testing.assert_allclose(to_world[:, :3], expected_to_world[:, :3], atol=1e-6)
    np.testing.assert_allclose(to_world[:, 3], 1e4 * expected_to_world[:, 3], rtol=1e-5)


@pytest.mark.parametrize("factors", [(1e-14, 1, 1), (1e-30, 1e-20, 1e-10), (1, 1, 1)])
def test_transforms_stay_invertible(factors, tmp_path):
    """Zeros of rotations are written as such, small factors are not lost."""
    plane = {"type": "rectangle", "to_world": translate((1, 2, 3)) @ rotate((1, 0, 0), 90) @ scale(factors)}
    sheared = {
        "type": "rectangle",
        "to_world": np.array([[1, 1, 0, 0], [1, 1 + 1e-9, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    }
    convert(scene_of_shapes(plane=plane, sheared=sheared), tmp_path / "out.xml")
    scene = load_description(tmp_path / "out.xml")
    np.testing.assert_allclose(scene["plane"]["to_world"], plane["to_world"], rtol=1e-7, atol=1e-16)
    assert np.linalg.matrix_rank(scene["sheared"]["to_world"]) == 4


def test_names_with_any_characters(write_file, tmp_path):
    """A comment cannot contain all that names of materials and files can."""
    path = write_file("a--b.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nusemtl \x01<&\xff--\nf 1 2 3\n")
    text = convert_and_compare(path, tmp_path)
    assert "Converted by isonoise" in text
    with pytest.raises(SceneError, match="has a character that XML does not allow"):
        convert(path, tmp_path / "\x02.xml")


def test_inputs_are_not_replaced(in_tmp_path, write_file, capsys):
    path = write_file("scene.xml", '<scene version="3.0.0"><sensor type="perspective"/></scene>')
    assert main(["convert", "scene.xml", "scene.xml"]) == 2
    assert "the scene was read from this file" in capsys.readouterr().err
    assert path.read_text() == '<scene version="3.0.0"><sensor type="perspective"/></scene>'
    folder = path.parent / "out_files"
    folder.mkdir()
    (folder / "ball.ply").write_bytes(small_files.ply())
    shape = '<shape type="ply" id="ball"><string name="filename" value="out_files/ball.ply"/></shape>'
    path.write_text(f'<scene version="3.0.0"><sensor type="perspective"/>{shape}</scene>')
    assert main(["convert", "scene.xml", "out.xml"]) == 2
    assert [file.name for file in folder.iterdir()] == ["ball.ply"]
    assert not (path.parent / "out.xml").exists()


def test_names_of_outputs_are_checked(tmp_path):
    with pytest.raises(UserError, match=r"ends in \.xml"):
        convert("cornell", tmp_path / "out.obj")
    (tmp_path / "out_files").touch()
    with pytest.raises(UserError, match="a file has this name"):
        convert("cornell", tmp_path / "out.xml")


def test_size_replaces_that_of_the_film(tmp_path):
    film = {"type": "hdrfilm", "width": 40, "height": 30, "crop_width": 10, "rfilter": {"type": "tent"}}
    scene = scene_of_shapes(ball={"type": "sphere"}) | {"sensor": SENSOR | {"film": film}}
    convert(scene, tmp_path / "out.xml", size=(17, 9))
    assert_same_scene(
        compile_scene(load_description(tmp_path / "out.xml")), compile_scene(load_description(scene), size=(17, 9))
    )


def test_command_replaces_its_output(in_tmp_path, write_file, capsys):
    write_file("ball.ply", small_files.ply())
    for _ in range(2):
        assert main(["convert", "ball.ply", "out.xml"]) == 0
        assert capsys.readouterr().out == "written: out.xml, 2 files in out_files/\n"
    assert sorted(path.name for path in Path().iterdir()) == ["ball.ply", "out.xml", "out_files"]
