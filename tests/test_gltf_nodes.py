"""glTF: nodes, copies of meshes, cameras and lights. Files are built in memory; values are exact."""

import math

import numpy as np
import pytest
from gltf_files import QUAD, TRIANGLE, Gltf, corners_of, one_mesh, only_mesh, read_file, shapes_of
from PIL import Image

import isonoise
from isonoise.convert.convert import convert
from isonoise.errors import SceneError


def test_node_transforms(tmp_path):
    """Parents before children; T R S; matrices by columns. JSON may write indices with a fraction of zero."""
    file = Gltf(scenes=[{"nodes": [0]}])
    file.node(children=[1, 2.0], translation=[1, 2, 3], scale=[2, 3, 4])
    half_turn = {"rotation": [0, 0, 1, 0], "translation": [10, 0, 0], "scale": [1, 5, 1]}
    file.node(mesh=file.mesh(), **half_turn)
    file.node(mesh=0, matrix=[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1])
    (mesh,) = shapes_of(read_file(file, tmp_path)[0])
    outer, offset = np.array([2, 3, 4.0]), np.array([1, 2, 3.0])
    turned = TRIANGLE * [1, 5, 1] * [-1, -1, 1] + [10, 0, 0]
    swapped = TRIANGLE[:, [1, 0, 2]] + [7, 8, 9]
    np.testing.assert_allclose(mesh["vertices"], np.concatenate([turned, swapped]) * outer + offset, atol=1e-12)
    normal = np.cross(*(corners_of(mesh)[:, i] - corners_of(mesh)[:, 0] for i in (1, 2)))
    assert (normal[:, 2] > 0).tolist() == [True, True]  # also the mirrored triangle: the front is the mirrored front


@pytest.mark.parametrize("scale", [[-1, 1, 1], [-2, 1, -3], [-1, -4, -1], [1, 1, 5]])
def test_normals_under_scale(scale, tmp_path):
    """The normals of a tilted plane stay perpendicular and on the front."""
    tilted = np.array([[0, 0, 0], [1, 0, 1], [0, 1, 2]], "f4")
    normal = np.cross(tilted[1], tilted[2])
    file = Gltf()
    file.node(mesh=file.mesh(tilted, attributes={"NORMAL": np.tile(normal, (3, 1)).astype("f4")}), scale=scale)
    mesh = only_mesh(file, tmp_path)
    (corners,) = corners_of(mesh)
    edges = corners[1:] - corners[0]
    geometric = np.cross(*edges)
    np.testing.assert_allclose(mesh["normals"] @ edges.T, 0, atol=1e-9)
    assert np.dot(geometric, mesh["normals"][0]) > 0
    front = np.array(normal) / np.array(scale)  # inverse transpose
    assert np.dot(front, geometric) > 0


def test_flattened_and_vanished_nodes(tmp_path):
    file = Gltf()
    file.node(mesh=file.mesh(np.array([[0, 0, 0], [1, 0, 5], [0, 1, 2]], "f4")), scale=[1, 1, 0])
    file.node(mesh=file.mesh(), scale=[0, 0, 0])
    mesh = only_mesh(file, tmp_path)
    np.testing.assert_array_equal(mesh["vertices"], TRIANGLE)


@pytest.mark.parametrize(
    ("children", "message"),
    [([[1], [0]], "its own ancestor"), ([[1, 2], [2], []], "is a child twice"), ([[9]], "no nod")],
)
def test_nodes_form_trees(children, message, tmp_path):
    file = Gltf(nodes=[{"children": one} if one else {} for one in children])
    with pytest.raises(SceneError, match=message):
        read_file(file, tmp_path)


def test_only_the_default_scene_is_read(tmp_path):
    file = Gltf(scene=1, scenes=[{"nodes": [0]}, {"nodes": [1], "name": "second"}])
    file.node(mesh=file.mesh())
    file.node(mesh=0, translation=[5, 0, 0])
    scene, report = read_file(file, tmp_path)
    (mesh,) = shapes_of(scene)
    np.testing.assert_array_equal(mesh["vertices"], TRIANGLE + np.array([5, 0, 0]))
    assert report.warnings() == ["a.glb: transforms: the file has 2 scenes; only the default one, 'second', is read"]


def test_hidden_nodes(tmp_path):
    """KHR_node_visibility hides meshes and lights of a node and of those below it."""
    light = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    file = Gltf(scenes=[{"nodes": [0, 1]}], extensions=light)
    file.node(mesh=file.mesh())
    file.node(children=[2], extensions={"KHR_node_visibility": {"visible": False}})
    file.node(mesh=0, extensions={"KHR_lights_punctual": {"light": 0}})
    scene, _ = read_file(file, tmp_path)
    assert len(shapes_of(scene)) == len(scene) - 1 == 1


def test_deep_hierarchies(tmp_path):
    """No recursion: exporters write chains of joints."""
    file = Gltf(nodes=[{"children": [i + 1], "translation": [1, 0, 0]} for i in range(3000)], scenes=[{"nodes": [0]}])
    file.node(mesh=file.mesh())
    np.testing.assert_array_equal(only_mesh(file, tmp_path)["vertices"], TRIANGLE + np.array([3000, 0, 0]))


def test_names_are_unique(tmp_path):
    file = Gltf()
    for name in ("a b", "a_b", "a_b__2", "ä", "a b"):
        file.content["meshes"] = [*file.content.get("meshes", []), {"name": name, "primitives": []}]
        file.content["meshes"][-1]["primitives"] = [{"attributes": {"POSITION": file.accessor(TRIANGLE)}}]
        file.node(mesh=len(file.content["meshes"]) - 1)
    scene, _ = read_file(file, tmp_path)
    assert list(scene) == ["type", "mesh_a_b", "mesh_a_b__2", "mesh_a_b__2__2", "mesh__", "mesh_a_b__3"]


# Copies of a mesh


def instanced_file(count: int, grid: int, **primitive) -> Gltf:
    """`count` copies along x, every second one mirrored, of a grid of 2 * grid² triangles."""
    x, y = np.meshgrid(np.arange(grid + 1) / grid, np.arange(grid + 1) / grid)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype("f4")
    first = (np.arange(grid)[:, None] * (grid + 1) + np.arange(grid)).ravel()
    faces = np.stack([first, first + 1, first + grid + 2, first, first + grid + 2, first + grid + 1], axis=1)
    file = Gltf(extensionsRequired=["EXT_mesh_gpu_instancing"])
    offsets, scales = np.zeros((count, 3), "f4"), np.ones((count, 3), "f4")
    offsets[:, 0], scales[1::2, 0] = 2 * np.arange(count), -1
    attributes = {"TRANSLATION": file.accessor(offsets), "SCALE": file.accessor(scales)}
    mesh = file.mesh(points, faces.ravel(), **primitive)
    file.node(mesh=mesh, scale=[2, 1, 1], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    return file


def test_few_triangles_are_copied(tmp_path):
    mesh = only_mesh(instanced_file(3, 1), tmp_path)
    assert len(mesh["faces"]) == 6
    low, high = mesh["vertices"].reshape(3, 4, 3).min(axis=1), mesh["vertices"].reshape(3, 4, 3).max(axis=1)
    np.testing.assert_array_equal(low[:, 0], [0, 2, 8])
    np.testing.assert_array_equal(high[:, 0], [2, 4, 10])


def test_many_triangles_become_instances(tmp_path):
    """The same points either way; emissive meshes are copied, because a shapegroup has no emitters."""
    scene, report = read_file(instanced_file(5, 120), tmp_path)
    (group,), instances = shapes_of(scene, "shapegroup"), shapes_of(scene, "instance")
    assert not shapes_of(scene)
    assert report.warnings() == []
    assert report.counts["triangles"] == 5 * 2 * 120**2
    assert [one["to_world"][0, 3] for one in instances] == [0, 4, 8, 12, 16]
    assert [one["to_world"][0, 0] for one in instances] == [2, -2, 2, -2, 2]
    assert len(group["shape_0"]["faces"]) == 2 * 120**2
    isonoise.load(scene | {"sensor": {"type": "perspective"}})
    file = instanced_file(5, 120, material=0)
    file.add("materials", emissiveFactor=[1, 1, 1])
    scene, _ = read_file(file, tmp_path)
    (mesh,) = shapes_of(scene)
    assert len(mesh["faces"]) == 5 * 2 * 120**2
    assert not shapes_of(scene, "instance")


# Cameras and lights


def test_cameras(tmp_path):
    """A point on an axis of the camera node is where glTF has it: x right, y up, looking along -z."""
    file = one_mesh()
    file.add("cameras", type="perspective", perspective={"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1, "zfar": 50})
    file.add("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.1})
    file.add("cameras", type="orthographic", orthographic={"xmag": 4, "ymag": 2, "znear": 0.5, "zfar": 9})
    for camera in range(3):
        file.node(camera=camera, name="eye", translation=[1, 2, 3], rotation=[0, 0.6, 0, 0.8], scale=[3, 3, 3])
    scene, report = read_file(file, tmp_path)
    assert report.warnings() == []
    first, endless, orthographic = (scene[name] for name in ("camera_eye", "camera_eye__2", "camera_eye__3"))
    assert first["fov_axis"] == "y"
    assert math.radians(first["fov"]) == pytest.approx(0.8)
    assert (first["near_clip"], first["far_clip"]) == (0.1, 50)
    assert (first["film"]["width"], first["film"]["height"]) == (768, 512)
    assert "film" not in endless
    assert endless["far_clip"] >= 1e9
    assert (orthographic["film"]["width"], orthographic["film"]["height"]) == (1024, 512)
    cosine, sine = 0.8**2 - 0.6**2, 2 * 0.6 * 0.8
    rotation = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    left, up, forward = rotation @ [-1, 0, 0], rotation @ [0, 1, 0], rotation @ [0, 0, -1]
    np.testing.assert_allclose(first["to_world"][:3], np.stack([left, up, forward, [1, 2, 3]], axis=1), atol=1e-12)
    expected = np.stack([4 * left, 4 * up, forward, [1, 2, 3]], axis=1)
    np.testing.assert_allclose(orthographic["to_world"][:3], expected, atol=1e-12)


def test_lights(tmp_path):
    """Candela become W/sr and lux W/m²; lights shine along -z of their node."""
    cone = {"innerConeAngle": 0.3, "outerConeAngle": 0.3}
    lights = [
        {"type": "point", "color": [1, 0.5, 0.25], "intensity": 40},
        {"type": "spot", "intensity": 3, "spot": cone},
        {"type": "directional", "intensity": 100},
        {"type": "point", "color": [0, 0, 0]},
        {"type": "spot", "range": 5},
    ]
    file = one_mesh()
    file.content["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for number in range(5):
        place = {"translation": [1, 2, 3], "rotation": [math.sqrt(0.5), 0, 0, math.sqrt(0.5)], "scale": [2, 2, 2]}
        file.node(name=f"lamp {number}", extensions={"KHR_lights_punctual": {"light": number}}, **place)
    scene, report = read_file(file, tmp_path)
    point, spot, directional = (scene[f"light_lamp_{number}"] for number in range(3))
    assert point == {"type": "point", "intensity": {"type": "rgb", "value": [40, 20, 10]}, "position": [1, 2, 3]}
    assert spot["intensity"]["value"] == [3, 3, 3]
    assert math.radians(spot["cutoff_angle"]) == pytest.approx(0.3) == math.radians(spot["beam_width"])
    np.testing.assert_allclose(spot["to_world"][:3, 2:].T, [[0, 1, 0], [1, 2, 3]], atol=1e-12)  # -z turned about x
    assert directional["irradiance"]["value"] == [100, 100, 100]
    np.testing.assert_allclose(directional["to_world"][:3, 2], [0, 1, 0], atol=1e-12)
    assert "light_lamp_3" not in scene
    assert len(report.warnings()) == 2  # of the last one: its range and its soft edge


@pytest.mark.parametrize(("inner", "outer"), [(0.0, math.pi / 4), (0.3, 0.4), (0.0, math.pi / 2), (0.6, 0.60001)])
def test_spots_keep_their_power(inner, outer, tmp_path):
    """The integral over directions of the intensity, by KHR_lights_punctual and by Mitsuba 3, with 10^5 angles."""
    file = one_mesh()
    light = {"type": "spot", "spot": {"innerConeAngle": inner, "outerConeAngle": outer}}
    file.content["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    file.node(extensions={"KHR_lights_punctual": {"light": 0}})
    (spot,) = shapes_of(read_file(file, tmp_path)[0], "spot")
    angles = (np.arange(10**5) + 0.5) * (math.pi / 2e5)
    ramp = (np.cos(angles) - math.cos(outer)) / (math.cos(inner) - math.cos(outer))
    beam, cutoff = math.radians(spot["beam_width"]), math.radians(spot["cutoff_angle"])
    linear = (cutoff - angles) / (cutoff - beam)
    powers = [np.sum(np.clip(values, 0, 1) * np.sin(angles)) for values in (np.clip(ramp, 0, 1) ** 2, linear)]
    assert powers[1] == pytest.approx(powers[0], rel=1e-4)
    assert inner - 1e-9 <= beam <= cutoff <= outer + 1e-9


# Normal maps


def test_normal_maps_keep_their_directions_on_mirrored_surfaces(tmp_path, mitsuba):
    """The tilt of the shading normal follows the picture: mirrored texture coordinates, a mirrored node, both.

    The normal map tilts by 20 degrees to the right and up in the image. A rough surface reflects most towards a light
    on the side to which its shading normal tilts (Mitsuba evaluates the converted scene).
    """
    file = Gltf(images=[{"uri": "tilt.png"}], textures=[{"source": 0}])
    Image.fromarray(np.full((2, 2, 3), (158, 158, 247), np.uint8)).save(tmp_path / "tilt.png")
    pbr = {"metallicFactor": 0, "roughnessFactor": 1}
    file.add("materials", normalTexture={"index": 0}, pbrMetallicRoughness=pbr)
    normals, uvs = np.tile(np.float32([0, 0, 1]), (4, 1)), np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    faces, mirrored = [0, 1, 2, 0, 2, 3], uvs * np.float32([-1, 1])
    for coordinates in (uvs, mirrored):
        file.mesh(QUAD, faces, attributes={"NORMAL": normals, "TEXCOORD_0": coordinates}, material=0)
    cases = [(0, 1, 1), (1, 1, -1), (0, -1, -1), (1, -1, 1)]  # mesh, scale along x, tilt along x
    for number, (mesh, scale, _) in enumerate(cases):
        file.node(mesh=mesh, scale=[scale, 1, 1], translation=[3.0 * number - 0.5 * scale, -0.5, 0])
    convert(file.write(tmp_path), tmp_path / "a.xml")
    scene = mitsuba.load_file(str(tmp_path / "a.xml"))
    for number, (_, _, tilt) in enumerate(cases):
        ray = mitsuba.Ray3f([3.0 * number, 0.1, 5], [0, 0, -1])
        hit = scene.ray_intersect(ray)
        assert hit.is_valid()
        values = {}
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            light = mitsuba.Vector3f(0.5 * x, 0.5 * y, math.sqrt(0.5))
            values[x, y] = hit.bsdf().eval(mitsuba.BSDFContext(), hit, hit.to_local(light))[0]
        assert max(values, key=values.get) == (tilt, 1), f"case {number}: {values}"
