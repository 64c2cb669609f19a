"""Scene files and dicts: parameters, references, includes, transforms and defaults."""

import numpy as np
import pytest
from records import slot

from isonoise.errors import SceneError
from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.scene.load import load_scene
from isonoise.scene.material.bsdf_kinds import bsdf_bits

SHAPE = '<shape type="sphere" id="ball">{}</shape>'


def transform_of(scene_of, inside: str) -> np.ndarray:
    return scene_of(SHAPE.format(f'<transform name="to_world">{inside}</transform>'))["ball"]["to_world"]


def test_operations_multiply_from_the_left(scene_of):
    # Mitsuba 3.9.1: traverse(load_string(...))['...to_world'].matrix
    expected = [[0, -1, 0, -2], [2, 0, 0, 1], [0, 0, 1, 3], [0, 0, 0, 1]]
    result = transform_of(scene_of, '<scale x="2"/><translate value="1 2 3"/><rotate z="1" angle="90"/>')
    np.testing.assert_allclose(result, expected, atol=1e-15)


def test_look_at(scene_of):
    # Mitsuba 3.9.1: ScalarTransform4f().look_at([1, 2, 3], [4, 6, 5], [0, 1, 0])
    expected = [
        [0.5547, -0.618031, 0.557086, 1],
        [0, 0.669534, 0.742781, 2],
        [-0.83205, -0.412021, 0.371391, 3],
        [0, 0, 0, 1],
    ]
    result = transform_of(scene_of, '<lookat origin="1, 2, 3" target="4 6 5" up="0,1,0"/>')
    np.testing.assert_allclose(result, expected, atol=5e-7)
    # Without up, Mitsuba uses the first axis of Duff et al.'s basis (result of load_string).
    expected = [
        [0.0934435, 0.252452, 0.963087, 1],
        [-0.98832, -0.0934435, 0.120386, 2],
        [0.120386, -0.963087, 0.240772, 3],
        [0, 0, 0, 1],
    ]
    result = transform_of(scene_of, '<lookat origin="1,2,3" target="5,2.5,4"/>')
    np.testing.assert_allclose(result, expected, atol=5e-6)


def test_matrices_are_row_major_with_16_or_9_numbers(scene_of):
    full = transform_of(scene_of, '<matrix value="1 0 0 5  0 1 0 6  0 0 1 7  0 0 0 1"/>')
    assert full[:3, 3].tolist() == [5, 6, 7]
    small = transform_of(scene_of, '<matrix value="1 2 3 4 5 6 7 8 10"/>')
    assert small.tolist() == [[1, 2, 3, 0], [4, 5, 6, 0], [7, 8, 10, 0], [0, 0, 0, 1]]


def test_rotation_axes_are_not_normalised(scene_of):
    # Mitsuba 3.9.1 does not normalise the axis either; this is its matrix.
    expected = [[1, -1.46045, 1.98744], [2.39627, 1.70187, 0.760946], [-0.583708, 2.04652, 2.87164]]
    result = transform_of(scene_of, '<rotate x="1" y="2" z="3" angle="40"/>')
    np.testing.assert_allclose(result[:3, :3], expected, atol=5e-6)


def test_parameters_replace_names_in_attributes(scene_of):
    inside = """
        <default name="r" value="2"/> <default name="r2" value="3"/> <default name="kind" value="sphere"/>
        <default name="both" value="$r$r2"/>
        <shape type="$kind" id="a"><float name="radius" value="$r"/></shape>
        <shape type="$kind" id="b"><float name="radius" value="$r2"/></shape>
        <shape type="$kind" id="c"><float name="radius" value="$both.5"/></shape>"""
    scene = scene_of(inside)
    assert [scene[name]["radius"] for name in "abc"] == [2, 3, 23.5]
    scene = scene_of(inside, r="7")
    assert [scene[name]["radius"] for name in "abc"] == [7, 3, 73.5]
    with pytest.raises(SceneError, match=r"no parameter 'radius' \(it has: both, kind, r, r2\)"):
        scene_of(inside, radius="7")


def test_parameters_may_be_numbers(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><default name="n" value="1"/><sensor type="perspective">'
        '<sampler type="independent"><integer name="sample_count" value="$n"/></sampler></sensor></scene>'
    )
    assert compile_scene(load_description(path, {"n": 12})).sample_count == 12


def test_references_share_one_object_before_and_after_its_definition(scene_of):
    scene = scene_of(
        '<shape type="sphere" id="a"><ref id="paint"/></shape>'
        '<bsdf type="diffuse" id="paint"><rgb name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>'
        '<alias id="paint" as="colour"/>'
        '<shape type="disk" id="b"><ref id="colour"/></shape>'
        '<shape type="disk" id="c"><bsdf type="twosided"><ref id="paint"/></bsdf></shape>'
    )
    assert scene["a"]["bsdf"] is scene["paint"]
    assert scene["b"]["bsdf"] is scene["paint"]
    assert scene["c"]["bsdf"]["bsdf"] is scene["paint"]
    compiled = compile_scene(scene)
    assert compiled.shapes["bsdf"].tolist() == [0, 0, 1]
    assert compiled.bsdfs["flags"].tolist() == [0, 1]


TOP_LEVEL = (
    '<sampler type="independent" id="s"><integer name="sample_count" value="7"/></sampler>',
    '<film type="hdrfilm" id="f"><integer name="width" value="9"/><integer name="height" value="5"/>'
    '<ref id="r"/></film>',
    '<rfilter type="box" id="r"/>',
    '<emitter type="area" id="e"><rgb name="radiance" value="3 2 1"/></emitter>',
    '<emitter type="area" id="unused"/>',
)


@pytest.mark.parametrize("order", [1, -1])
def test_objects_of_the_scene_that_take_effect_where_they_are_referenced(scene_of, order):
    """As in Mitsuba 3; an area emitter that no shape refers to is no light."""
    users = '<sensor type="perspective"><ref id="s"/><ref id="f"/></sensor><shape type="sphere"><ref id="e"/></shape>'
    scene = scene_of("".join((*TOP_LEVEL, users)[::order]))
    assert set(scene) == {"type", "sensor", "shape"}
    compiled = compile_scene(scene)
    assert (compiled.width, compiled.height, compiled.sample_count, compiled.filter) == (9, 5, 7, "box")
    assert len(compiled.lights) == 1
    inline = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "film": {"type": "hdrfilm", "width": 9, "height": 5, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 7},
        },
        "ball": {"type": "sphere", "light": {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}},
    }
    assert compile_scene(load_description(inline)).hash == compiled.hash
    top = {"smp": inline["sensor"].pop("sampler"), "lamp": inline["ball"].pop("light")}
    inline["sensor"]["sampler"], inline["ball"]["light"] = ({"type": "ref", "id": name} for name in top)
    assert compile_scene(load_description(inline | top)).hash == compiled.hash


def test_includes_and_paths(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "sub" / "paint.xml").write_text('<bsdf version="3.0.0" type="diffuse" id="paint"/>')
    (tmp_path / "sub" / "part.xml").write_text(
        '<scene version="3.0.0"><default name="r" value="1"/><include filename="paint.xml"/>'
        '<shape type="sphere" id="ball"><float name="radius" value="$r"/><ref id="paint"/></shape>'
        '<shape type="obj" id="mesh"><string name="filename" value="t.obj"/></shape></scene>'
    )
    main = tmp_path / "main.xml"
    main.write_text(
        '<scene version="3.0.0"><path value="meshes"/><default name="r" value="4"/>'
        '<include filename="sub/part.xml"/><sensor type="perspective"/></scene>'
    )
    scene = load_description(main)
    assert scene["ball"]["radius"] == 4
    assert scene["ball"]["bsdf"] is scene["paint"]
    assert scene["mesh"]["filename"] == str(tmp_path / "meshes" / "t.obj")
    assert len(compile_scene(scene).faces) == 1


def test_defaults_are_those_of_mitsuba(scene_of):
    scene = compile_scene(scene_of('<shape type="sphere"/>'))
    assert (scene.width, scene.height) == (768, 576)
    assert (scene.filter, scene.max_depth, scene.rr_depth, scene.hide_emitters) == ("gaussian", -1, 5, False)
    assert scene.sample_count == 4
    camera = scene.camera[0]
    assert (camera["filter_stddev"], camera["filter_radius"]) == (0.5, 2.0)
    assert (camera["near_clip"], camera["far_clip"]) == (np.float32(0.01), 10_000)
    assert slot(scene.bsdfs, "reflectance").tolist() == [[0.5, 0.5, 0.5]]


@pytest.mark.parametrize(
    ("integrator", "depth", "rr_depth"),
    [
        ('<integrator type="path"><integer name="max_depth" value="7"/><integer name="rr_depth" value="3"/>', 7, 3),
        ('<integrator type="direct"><integer name="shading_samples" value="2"/>', 2, 5),
        ('<integrator type="moment"><integrator type="path"><integer name="max_depth" value="4"/></integrator>', 4, 5),
        ('<integrator type="aov"><string name="aovs" value="dd:depth"/><integrator type="direct"/>', 2, 5),
        ('<integrator type="moment"><integrator type="aov"><integrator type="path"/></integrator>', -1, 5),
    ],
)
def test_integrators(integrator, depth, rr_depth, scene_of):
    description = scene_of(f"{integrator}</integrator>")
    scene = compile_scene(description)
    assert (scene.max_depth, scene.rr_depth) == (depth, rr_depth)
    assert compile_scene(description, max_depth=9).max_depth == 9


@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"])
def test_every_sampler_is_accepted(sampler, scene_of):
    inside = f'<sampler type="{sampler}"><integer name="sample_count" value="36"/><boolean name="jitter" value="true"/>'
    scene = scene_of(f'<sensor type="perspective">{inside}<integer name="seed" value="3"/></sampler></sensor>')
    assert compile_scene(scene).sample_count == 36


def test_film_parameters_that_do_not_change_the_image_are_ignored(scene_of):
    keys = '<string name="pixel_format" value="rgba"/><string name="component_format" value="float32"/>'
    keys += '<boolean name="sample_border" value="true"/><boolean name="compensate" value="true"/>'
    film = f'<film type="hdrfilm">{keys}<integer name="width" value="8"/><integer name="height" value="4"/></film>'
    scene = compile_scene(scene_of(f'<sensor type="perspective">{film}</sensor>'))
    assert (scene.width, scene.height) == (8, 4)


def test_dicts_and_files_give_the_same_scene(scene_of):
    from_file = scene_of(
        '<integrator type="path"><integer name="max_depth" value="6"/></integrator>'
        '<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">'
        '<lookat origin="0 1 5" target="0 1 0" up="0 1 0"/></transform><film type="hdrfilm">'
        '<integer name="width" value="32"/><integer name="height" value="16"/><rfilter type="tent"/></film></sensor>'
        '<bsdf type="twosided" id="red"><bsdf type="diffuse"><rgb name="reflectance" value=".6 .1 .1"/></bsdf></bsdf>'
        '<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><ref id="red"/></shape>'
        '<shape type="sphere"><point name="center" x="1" y="2" z="3"/><emitter type="area">'
        '<spectrum name="radiance" value="400:1, 700:2"/></emitter></shape>'
        '<emitter type="point"><point name="position" value="1 2 3"/></emitter>'
    )
    from_dict = load_description(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 6},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": [[-1, 0, 0, 0], [0, 1, 0, 1], [0, 0, -1, 5], [0, 0, 0, 1]],
                "film": {"type": "hdrfilm", "width": 32, "height": np.int64(16), "rfilter": {"type": "tent"}},
            },
            "red": {
                "type": "twosided",
                "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": np.array([0.6, 0.1, 0.1])}},
            },
            "floor": {"type": "rectangle", "to_world": np.diag([2, 2, 2, 1]), "paint": {"type": "ref", "id": "red"}},
            "lamp": {
                "type": "sphere",
                "center": np.array([1, 2, 3]),
                "emitter": {"type": "area", "radiance": {"type": "spectrum", "value": [(400, 1), (700, 2)]}},
            },
            "spot": {"type": "point", "position": [1, 2, 3]},
        }
    )
    assert compile_scene(from_file).hash == compile_scene(from_dict).hash


def test_dict_references_by_id_and_by_keys():
    ball = {"type": "sphere", "paint": {"type": "diffuse", "reflectance": 0.2}}
    for name in ("mine", "ball.paint"):
        scene = load_description(
            {
                "type": "scene",
                "sensor": {"type": "perspective"},
                "ball": ball,
                "grey": {"type": "diffuse", "id": "mine", "reflectance": 0.2},
                "disk": {"type": "disk", "bsdf": {"type": "ref", "id": name}},
            }
        )
        assert scene["disk"]["bsdf"]["reflectance"] == 0.2


def test_a_dict_in_several_places_is_one_object():
    matt = {"type": "diffuse", "id": "matt", "reflectance": {"type": "checkerboard"}}
    shapes = {f"ball_{i}": {"type": "sphere", "bsdf": {"type": "twosided", "bsdf": matt}} for i in range(2)}
    scene = load_scene({"type": "scene", "sensor": {"type": "perspective"}, **shapes})
    first, second = (scene.description[name]["bsdf"]["bsdf"] for name in shapes)
    assert first is second
    assert scene.ids[id(first)] == "matt"
    assert scene.ids[id(scene.description["ball_0"])] == "ball_0"


def test_hash_changes_with_the_image_but_not_with_names(scene_of):
    hashes = [
        compile_scene(
            scene_of(f'<shape type="sphere" id="{name}"><float name="radius" value="{radius}"/></shape>')
        ).hash
        for name, radius in (("a", 1), ("b", 1), ("a", 1.001))
    ]
    assert hashes[0] == hashes[1] != hashes[2]


def test_size_replaces_the_film(scene_of):
    film = '<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="32"/>'
    film += '<integer name="crop_offset_x" value="8"/><integer name="crop_width" value="16"/>'
    film += '<integer name="crop_height" value="9"/><rfilter type="box"/></film>'
    description = scene_of(f'<sensor type="perspective">{film}</sensor>')
    scene = compile_scene(description)
    assert (scene.width, scene.height) == (16, 9)
    assert scene.camera["crop_offset"].tolist() == [[8, 0]]
    scene = compile_scene(description, size=(7, 5))
    assert (scene.width, scene.height, scene.filter) == (7, 5, "box")
    assert scene.camera["crop_offset"].tolist() == [[0, 0]]


def test_built_in_scenes_by_name():
    assert {"bright-spots", "cornell", "penumbra"} <= set(builtin_scenes())
    for name in builtin_scenes():
        assert len(compile_scene(load_description(name)).lights)
    with pytest.raises(SceneError, match=r"did you mean 'cornell'\? \(built-in: .*cornell.*penumbra"):
        load_description("cornel")


def test_public_scenes(public_scenes):
    scene = compile_scene(load_description(public_scenes / "cornell-box" / "scene.xml", {"spp": "5"}))
    assert (len(scene.faces), len(scene.lights), scene.max_depth, scene.sample_count) == (36, 1, 16, 5)
    np.testing.assert_allclose(scene.lights["radiance"][0] / scene.radiance_scale, (17, 12, 4), rtol=1e-6)
    folder = public_scenes / "mitsuba-tests" / "tests" / "scenes"
    scene = compile_scene(
        load_description(folder / "floating_sphere" / "test_directional_direct.xml", allow_outside=True)
    )
    assert (len(scene.faces), scene.max_depth) == (32514, 2)
    scene = compile_scene(load_description(public_scenes / "cbox-spheres" / "scene.xml"))
    assert {bsdf_bits("diffuse"), bsdf_bits("thin_dielectric")} <= set(scene.bsdfs["kind"])


SIMILAR = """
<shape type="sphere" id="first"><point name="center" x="1" y="2" z="3"/><float name="radius" value="{}"/>
    <boolean name="flip_normals" value="true"/><ref id="{}"/></shape>
<shape type="sphere" id="second"><point name="center" x="4" y="5" z="6"/><float name="radius" value="{}"/>
    <boolean name="flip_normals" value="true"/><ref id="{}"/></shape>"""


def test_objects_that_differ_only_in_numbers(scene_of):
    """They are checked as the first one of them was, and get its other values."""
    materials = '<bsdf type="diffuse" id="a"/><bsdf type="plastic" id="b"/>'
    for before, after in ((materials, ""), ("", materials)):  # references forwards, too
        scene = scene_of(before + SIMILAR.format(0.5, "a", 0.25, "a") + after)
        assert [scene[name]["radius"] for name in ("first", "second")] == [0.5, 0.25]
        assert scene["second"] == scene["first"] | {"center": (4, 5, 6), "radius": 0.25}
        assert scene["second"]["bsdf"] is scene["first"]["bsdf"] is scene["a"]
        scene = scene_of(before + SIMILAR.format(0.5, "a", 0.25, "b") + after)
        assert scene["second"]["bsdf"] is scene["b"]
    for value, message in ((-1, r"radius.*has to be in \(0, inf\)"), ("1m", "'1m' is not a finite number")):
        with pytest.raises(SceneError, match=r'\.xml:[0-9]+: <float name="radius">.*' + message):
            scene_of(materials + SIMILAR.format(1, "a", value, "a"))
    with pytest.raises(
        SceneError, match=r'scene.xml:[0-9]+: <shape type="sphere" id="first">.*already used by .*:[0-9]'
    ):
        scene_of(materials + 2 * SIMILAR.format(1, "a", 1, "a"))
    scene = scene_of('<default name="r" value="3"/>' + materials + SIMILAR.format("$r", "a", "$r", "a"))
    assert scene["second"]["radius"] == 3
    matrix = '<shape type="rectangle" id="{}"><transform name="to_world"><scale x="{}"/></transform></shape>'
    with pytest.raises(SceneError, match="to_world cannot be inverted"):
        scene_of(matrix.format("a", 1) + matrix.format("b", 0))
