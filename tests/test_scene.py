"""Scene: values by path, new objects, copies, errors."""

import pickle

import numpy as np
import pytest
from PIL import Image
from small_scene import lamp_over_floor

import isonoise
from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.scene import load


def error_of(action, *arguments) -> str:
    """The message of the SceneError that a call raises."""
    with pytest.raises(SceneError) as caught:
        action(*arguments)
    return str(caught.value)


def test_values_by_path():
    scene = load("cornell")
    assert scene["lamp.radiance"] == scene["lamp.emitter.radiance"] == scene["lamp"]["radiance"] == (21, 18.5, 15.5)
    assert scene["film.size"] == (scene["sensor.film.width"], scene["film.height"]) == (256, 256)
    assert scene["floor.bsdf"] == scene["plaster"] != scene["teal"]
    assert scene["sensor.to_world"].shape == (4, 4)
    assert "film.width" in scene
    assert "film.exposure" not in scene
    assert scene.get("film.exposure", 1.0) == 1.0
    assert (scene["tall"].kind, scene["tall"].type) == (scene["tall"].kind, scene["tall.type"]) == ("shape", "cube")
    assert list(scene) == list(load_description("cornell"))
    with pytest.raises(ValueError, match="read-only"):
        scene["sensor.to_world"][0, 0] = 2


def test_set_values_take_effect():
    scene = load("cornell")
    scene["film.size"] = (32, 24)
    scene["integrator.max_depth"] = np.int64(3)
    scene["lamp.radiance"] = np.array([1.0, 2.0, 3.0])
    scene["plaster.reflectance"] = 0.25
    scene["sampler.sample_count"] = 9
    compiled = scene.compile()
    assert (compiled.width, compiled.height, compiled.max_depth, compiled.sample_count) == (32, 24, 3, 9)
    radiance = compiled.lights["radiance"][0] / compiled.radiance_scale
    np.testing.assert_allclose(radiance, (1, 2, 3))
    assert scene["floor.bsdf.reflectance"] == 0.25
    del scene["integrator.max_depth"]
    assert scene["integrator.max_depth"] == -1


def test_a_new_material_takes_effect():
    """It is that of the shape alone; a new material under its own name is that of all shapes that use it."""
    scene = load("cornell")
    scene["floor.bsdf"] = {"type": "conductor", "material": "Au"}
    assert scene["floor.bsdf.material"] == "Au"
    assert scene["back.bsdf"].type == "diffuse"
    scene["plaster"] = {"type": "twosided", "bsdf": scene["plaster"]}
    assert (scene["back.bsdf"].type, scene["back.bsdf.bsdf"].type, scene["floor.bsdf"].type) == (
        "twosided",
        "diffuse",
        "conductor",
    )
    scene["floor.bsdf"] = scene["back.bsdf"]
    assert scene["floor.bsdf"] == scene["plaster"]
    scene["floor.bsdf"] = {"type": "ref", "id": "teal"}
    assert scene["floor.bsdf"] == scene["teal"]
    source = load_description("cornell")
    source["floor"]["bsdf"] = source["teal"]
    expected = load("cornell")
    expected["floor.bsdf"] = expected["teal"]
    assert expected.compile().hash == compile_scene(source).hash


def test_objects_are_added_and_removed():
    scene = load("cornell")
    scene["ball"] = {"type": "sphere", "radius": 0.2, "bsdf": {"type": "twosided", "inner": scene["ochre"]}}
    assert scene["ball.bsdf.bsdf"] == scene["ochre"]
    assert len(scene.compile().analytics) == 1
    scene["ball.emitter"] = {"type": "area", "radiance": 2.0}
    assert len(scene.compile().lights) == 2
    del scene["ball.emitter"], scene["lamp"]
    assert len(scene.compile().lights) == 0
    del scene["ball"]
    assert "ball" not in scene


def test_a_copy_changes_on_its_own():
    scene = load("cornell")
    copied = scene.copy()
    copied["teal.reflectance"], copied["film.width"] = 0.5, 7
    assert copied["left.bsdf.reflectance"] == 0.5
    assert scene["left.bsdf.reflectance"] == (0.06, 0.3, 0.36)
    assert scene.compile().hash == compile_scene(load_description("cornell")).hash
    copied["teal"] = scene["ochre"]
    copied["teal.reflectance"] = 0.125
    assert scene["ochre.reflectance"] == (0.66, 0.3, 0.06)


def test_only_what_changed_is_compiled_again(tmp_path, monkeypatch):
    """Files are read once, and every result equals that of a new scene with the same values."""
    from isonoise.scene import files

    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(tmp_path / "a.png")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    picture = {"type": "bitmap", "filename": str(tmp_path / "a.png")}
    source = {
        **lamp_over_floor(),
        "sky": {"type": "envmap", "filename": str(tmp_path / "a.png")},
        "paint": {"type": "diffuse", "reflectance": picture},
        "mesh": {"type": "obj", "filename": str(tmp_path / "a.obj"), "bsdf": {"type": "ref", "id": "paint"}},
    }
    scene, read = load(source), []
    for module, name in (("image.image", "open_regular_file"), ("mesh.obj", "read_bytes")):
        original = getattr(files, name)
        monkeypatch.setattr(
            f"isonoise.scene.{module}.{name}", lambda path, original=original: read.append(path) or original(path)
        )
    changes = {
        "film.size": (9, 7),
        "sensor.fov": 33.0,
        "lamp.radiance": (1, 2, 3),
        "mesh.bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": picture}},
        "sky.scale": 2.0,
        "mesh.flip_normals": True,
        "mesh": {"type": "rectangle"},
    }
    expected_reads = {"film.size": 3, "sky.scale": 1, "mesh.flip_normals": 1}
    fresh, bvh = dict(changes), None
    for number, (path, value) in enumerate(changes.items()):
        read.clear()
        scene[path] = value
        compiled = scene.compile()
        assert len(read) == expected_reads.get(path, 0), path
        other = load(source)
        for name in list(fresh)[: number + 1]:
            other[name] = fresh[name]
        assert compiled.hash == other.compile().hash, path
        previous, bvh = bvh, scene.build_bvh(compiled)
        assert (bvh is previous) == (path not in ("film.size", "mesh.flip_normals", "mesh")), path
        assert bvh.nodes.tobytes() == build_scene_bvh(compiled).nodes.tobytes()
    copied = scene.copy()
    copied["sensor.fov"] = 20.0
    assert copied.build_bvh(copied.compile()) is bvh
    copied["mesh.to_world"] = np.diag([2.0, 2.0, 2.0, 1.0])
    assert copied.build_bvh(copied.compile()) is not bvh
    assert scene.build_bvh(scene.compile()) is bvh
    assert pickle.loads(pickle.dumps(scene)).compile().hash == scene.compile().hash


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_placed_scenes_are_compiled_again(offset):
    """Instances and shapes far from the origin, whose descriptions are moved to it."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    camera = matrix + np.eye(4)[:, [3, 3, 3, 2]] * (0, 0, 0, -4)
    source = {
        "type": "scene",
        "sensor": {"type": "perspective", "to_world": camera},
        "group": {"type": "shapegroup", "ball": {"type": "sphere"}, "box": {"type": "cube"}},
        "one": {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": matrix},
        "light": {"type": "point", "to_world": matrix + np.eye(4)[:, [3, 3, 3, 1]] * (0, 0, 0, 3)},
    }
    scene = load(source)
    scene.compile()
    scene["group.box.bsdf"] = {"type": "conductor"}
    other = load(source)
    other["group.box.bsdf"] = {"type": "conductor"}
    assert scene.compile().hash == other.compile().hash


def test_params_lists_what_can_be_read():
    scene = load("cornell")
    params = scene.params()
    assert len(params) == len(params.parameters) > 30
    for parameter in params.parameters:
        np.testing.assert_equal(scene[parameter.path], parameter.value)
        if parameter.path != "sensor.film.crop":  # sets what is not set
            scene[parameter.path] = parameter.value
    assert scene.compile().hash == load("cornell").compile().hash
    assert params["lamp.emitter.radiance"] == (21, 18.5, 15.5)
    shape = {parameter.path: parameter.shape for parameter in params.parameters}
    assert (shape["sensor.to_world"], shape["plaster.reflectance"], shape["sensor.fov"]) == ((4, 4), (3,), ())
    line = next(line for line in repr(params).splitlines() if line.startswith("lamp.emitter.radiance"))
    assert line.split() == ["lamp.emitter.radiance", "colour", "3", "21,", "18.5,", "15.5"]
    assert set(scene["lamp"].params()) == {path for path in params if path.startswith("lamp.")}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("film.sise", "the scene has no 'film.sise'; did you mean 'film.size'?"),
        ("lamp.radance", "shape 'lamp' has no 'radance'; did you mean 'radiance'?"),
        ("flor", "the scene has no 'flor'; did you mean 'floor'?"),
        ("floor.bsdf.alpha", "bsdf 'floor.bsdf' has no 'alpha' (it has: reflectance)"),
        ("reflectance", "'reflectance' is ambiguous: it may be 'plaster.reflectance', 'teal.reflectance'"),
        ("film.exposure", "'sensor.film.exposure' is not set (its default: by the image's brightness)"),
        ("", "the scene has no ''"),
        (3, "a path is a text such as 'film.width', got 3"),
    ],
)
def test_errors_of_paths(path, message):
    scene = load("cornell")
    assert message in error_of(scene.__getitem__, path)
    with pytest.raises(KeyError):
        scene[path]


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("film.size", (0, 3), "sensor.film.width: 'width' has to be in [1, 65536], got 0"),
        ("film.size", "8", "it is a tuple of whole numbers, width and height, pixels; got '8'"),
        ("film.width", 2.5, "'width' has to be a whole number, got 2.5"),
        ("lamp.radiance", -1, "lamp.emitter.radiance: a radiance cannot be negative"),
        ("plaster.reflectance", (0.5, 0.5, 2), "a reflectance is at most 1"),
        ("floor.bsdf", {"type": "difuse"}, "floor.bsdf: unknown type 'difuse'; did you mean 'diffuse'?"),
        ("floor.bsdf", {"type": "sphere"}, "cannot contain a shape"),
        ("floor.bsdf", {"type": "twosided", "in": {"type": "dielectric"}}, "twosided cannot contain the transmissive"),
        ("floor.bsdf", 0.5, "'bsdf' is an object: give a dict"),
        ("plaster", {"type": "sphere"}, "uses it, which cannot contain a 'sphere'"),
        ("sensor.focal_length", "50mm", "give 'fov' or 'focal_length', not both"),
        ("floor.type", "cube", "floor.type: a type cannot be changed; assign a new object"),
        ("more", {"type": "path"}, "a scene can have only one integrator"),
        ("more", 3, "the scene has no 'more'"),
        ("more.bsdf", {"type": "diffuse"}, "the scene has no 'more.bsdf'"),
    ],
)
def test_a_refused_change_changes_nothing(path, value, message):
    scene = load("cornell")
    before = scene.compile().hash, repr(scene.params())
    assert message in error_of(scene.__setitem__, path, value)
    assert (scene.compile().hash, repr(scene.params())) == before


def test_objects_cannot_contain_themselves():
    scene = load("cornell")
    scene["floor.bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    assert "refers to itself" in error_of(scene.__setitem__, "floor.bsdf.bsdf", scene["floor.bsdf"])
    for _ in range(60):
        scene["floor.bsdf"] = {"type": "twosided", "bsdf": scene["floor.bsdf"]}
    message = error_of(scene.__setitem__, "floor.bsdf", {"type": "twosided", "bsdf": scene["floor.bsdf"]})
    assert "nested more than 64 levels deep" in message


def test_required_values_cannot_be_removed():
    scene = load({**lamp_over_floor(), "mesh": {"type": "mesh", "vertices": np.eye(3), "faces": np.array([[0, 1, 2]])}})
    assert "shape 'mesh' needs a 'faces'" in error_of(scene.__delitem__, "mesh.faces")
    assert "needs a" in error_of(scene.__delitem__, "sensor") or "no sensor" in error_of(scene.__delitem__, "sensor")


def test_defaults_of_mitsuba_have_paths():
    scene = load({"type": "scene", "camera": {"type": "perspective"}, "light": {"type": "constant"}})
    assert scene["film.size"] == (768, 576)
    assert (scene["integrator.max_depth"], scene["sampler.sample_count"]) == (-1, 4)
    assert scene["sensor"] == scene["camera"]
    assert scene["light.radiance"] == scene["emitter.radiance"] == 1.0
    description = load_description({"type": "scene", "camera": {"type": "perspective"}, "light": {"type": "constant"}})
    assert scene.compile().hash == compile_scene(description).hash


def test_a_renderer_takes_a_scene():
    scene = load(lamp_over_floor())
    scene["film.size"] = (8, 6)
    with isonoise.Renderer(scene, size=(5, 4)) as renderer:
        assert (renderer.scene.width, renderer.scene.height) == (5, 4)
        assert renderer.source_name == "a scene in Python"
    assert "parameters belong to XML files" in error_of(lambda: isonoise.Renderer(scene, parameters={"a": "b"}))
