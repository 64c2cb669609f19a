"""Scenes with shape groups and instances: images, compiled arrays and errors."""

import numpy as np
import pytest
import references
from instance_scenes import FLAT_SHAPES, ROUND_SHAPES, flattened, icosphere, make_transform, with_instances
from scalar_mitsuba import assert_same_picture
from shared_programs import share_programs

from isonoise.device.opencl import Device
from isonoise.errors import SceneError
from isonoise.integrator.features import features
from isonoise.integrator.wavefront import Wavefront
from isonoise.render_scene import render
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.accel.build import build_scene_bvh

shared_programs = share_programs(
    (
        *("TRIANGLES", "ANALYTICS", "DISKS", "INSTANCES", "UVS", "TEXTURES", "CHECKERBOARDS"),
        *("DIFFUSE", "ROUGH_CONDUCTOR", "BECKMANN", "TWOSIDED"),
        *("AREA_LIGHTS", "PARALLELOGRAM_LIGHTS", "CONSTANT_LIGHT", "MANY_LIGHTS", "NEXT_EVENT"),
    )
)


def lamp_and_floor(**more) -> dict:
    """Integrator, sensor and emitters of a scene: a lamp above a floor, seen from the front."""
    floor = make_transform(3, (0, -1, -3)) @ np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    lamp = make_transform(0.7, (0, 2.5, -2.5)) @ np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    radiance = {"type": "rgb", "value": [6.0, 5.0, 4.0]}
    return {
        "integrator": {"type": "path", "max_depth": 5, "rr_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 55.0,
            "to_world": np.diag([-1.0, 1.0, -1.0, 1.0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": floor},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": radiance}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.4]}},
        **more,
    }


def with_materials(group: dict) -> dict:
    """The shapes with different materials; two of these depend on the surface's tangent."""
    brushed = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.5, "specular_reflectance": 0.9}
    materials = [
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}},
        brushed,
        {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": 0.1, "color1": 0.8}},
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.3, 0.8]}},
        brushed,
    ]
    return {
        name: {**shape, "bsdf": {"type": "twosided", "bsdf": bsdf}}
        for (name, shape), bsdf in zip(group.items(), materials, strict=False)
    }


VISIBLE_TRANSFORMS = (
    make_transform(0.6, (-0.9, -0.2, -3.5), seed=20),
    make_transform((0.5, 0.8, -0.4), (0.9, 0.1, -4.0), seed=21),
    make_transform((0.1, 0.1, 0.5), (0.0, -0.7, -2.5), seed=22),
)


@pytest.mark.long
@pytest.mark.usefixtures("one_lane")
def test_image_equals_that_of_the_flattened_scene(tmp_path):
    """False alarms: below 1 % for the pixels, at most 0.8 % for the means."""
    group = with_materials(FLAT_SHAPES)
    estimates = []
    for seed, make in enumerate((with_instances, flattened)):
        batches = [
            render(
                make(group, *VISIBLE_TRANSFORMS, **lamp_and_floor()),
                spp=16,
                strategy="uniform:wave_spp=16",
                seed=50 * seed + batch,
            )
            for batch in range(16)
        ]
        assert not any(batch.statistics.rejected.any() for batch in batches)
        estimates.append(references.from_batches(np.stack([batch.statistics.rgb for batch in batches])))
    references.assert_agree(*estimates, tmp_path)
    references.assert_means_agree(*estimates)


def test_image_equals_mitsubas(tmp_path):
    """False alarms: below 1 % for the pixels, at most 0.8 % for the means."""
    group = with_materials({**{key: shape for key, shape in FLAT_SHAPES.items() if key != "ball"}, **ROUND_SHAPES})
    assert_same_picture(with_instances(group, *VISIBLE_TRANSFORMS, **lamp_and_floor()), tmp_path, spp=32)


@pytest.mark.usefixtures("one_lane")
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_white_furnace_with_an_instance(scale):
    """Reflectance 1 under constant radiance 1 gives 1 in every pixel, at any scale."""
    matrix = make_transform((scale, -0.5 * scale, 0.7 * scale), (0.3 * scale, 0.1 * scale, -4 * scale), seed=30)
    group = {
        "globe": {**icosphere(smooth=False), "bsdf": {"type": "diffuse", "reflectance": 1.0}},
        "box": {
            "type": "cube",
            "to_world": make_transform(0.8, (0.5, 0, 0)),
            "bsdf": {"type": "diffuse", "reflectance": 1.0},
        },
    }
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    sensor = {**lamp_and_floor()["sensor"], "near_clip": 0.01 * scale, "far_clip": 1e4 * scale}
    sensor["film"] = {**sensor["film"], "width": 16, "height": 16}
    integrator = {"type": "path", "max_depth": 200, "rr_depth": 300}
    scene = with_instances(group, matrix, sensor=sensor, integrator=integrator, sky=sky)
    statistics = render(scene, spp=64, strategy="uniform:wave_spp=64").statistics
    # the MIS weights of light and BSDF samples sum to 1 only in expectation
    noise = np.sqrt(statistics.variance_of_mean())
    assert (np.abs(statistics.mean - 1) <= 5 * noise + 1e-4).all()
    assert statistics.mean.mean() == pytest.approx(1, abs=2e-3)


def test_scene_bounds_include_instances_but_not_groups():
    group = {"box": {"type": "cube", "to_world": make_transform(1, (10, 0, 0))}}
    scene = compile_scene(load_description(with_instances(group, make_transform(2, (0, 0, 5)))))
    np.testing.assert_allclose(scene.bounds, [[18, -2, 3], [22, 2, 7]])
    scene = compile_scene(load_description(with_instances(group, make_transform(), wall={"type": "rectangle"})))
    np.testing.assert_allclose(scene.bounds, [[-1, -1, -1], [11, 1, 1]])


def test_a_group_without_instances_is_left_out():
    wall = {"wall": {"type": "rectangle"}}
    with_group = compile_scene(load_description({**with_instances({"ball": icosphere()}), **wall}))
    without = compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, **wall}))
    assert with_group.hash == without.hash
    assert not features(with_group)["INSTANCES"]


def test_groups_share_primitives_in_the_order_of_their_first_instance():
    """A group may also be nested in its instance."""
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "late": {"type": "shapegroup", "a": {"type": "sphere"}, "b": {"type": "cube"}},
        "first": {"type": "instance", "own": {"type": "shapegroup", "a": {"type": "rectangle"}}},
        "second": {"type": "instance", "it": {"type": "ref", "id": "late"}},
        "third": {"type": "instance", "it": {"type": "ref", "id": "late"}},
        "disk": {"type": "disk"},
    }
    compiled = compile_scene(load_description(scene))
    assert compiled.group_offsets.tolist() == [[0, 1], [2, 1], [14, 2]]
    assert compiled.instances["root"].tolist() == [1, 2, 2]
    assert compiled.shapes["first_primitive"].tolist() == [0, 0, 1, 2]
    assert compiled.analytics["kind"].tolist() == [structs.ANALYTIC_DISK, structs.ANALYTIC_SPHERE]


def test_deep_bvhs_fit_the_stack(monkeypatch):
    """A thousand nested triangles in a thousand instances of decreasing size."""
    random = np.random.default_rng(9)
    corners = (random.uniform(-1, 1, (1, 3, 3)) * np.geomspace(1e-6, 1e3, 1000)[:, None, None]).reshape(-1, 3)
    nested = {"type": "mesh", "vertices": corners, "faces": np.arange(3000).reshape(-1, 3), "face_normals": True}
    matrices = [make_transform(scale) for scale in np.geomspace(1e-3, 1e3, 1000)]
    scene = compile_scene(load_description(with_instances({"nested": nested}, *matrices)))
    assert build_scene_bvh(scene).stack <= 256


MALFORMED = [
    ('<shape type="instance"/>', "shape 'instance' needs a nested shapegroup"),
    ('<shape type="instance"><ref id="nobody"/></shape>', "there is no object with the id 'nobody'"),
    ('<shape type="shapegroup"/>', "shape 'shapegroup' needs a nested shape"),
    ('<shape type="instance"><shape type="sphere"/></shape>', "instance cannot contain a shape 'sphere' .*shapegroup"),
    (
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape><shape type="instance"><ref id="g"/>'
        '<ref id="g"/></shape>',
        "instance can contain only one shape",
    ),
    (
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape>'
        '<shape type="shapegroup"><shape type="instance"><ref id="g"/></shape></shape>',
        "shapegroup cannot contain a shape 'instance'",
    ),
    (
        '<shape type="shapegroup"><shape type="shapegroup"><shape type="sphere"/></shape></shape>',
        "shapegroup cannot contain a shape 'shapegroup'",
    ),
    (
        '<shape type="shapegroup"><shape type="sphere"><emitter type="area"/></shape></shape>',
        "a shape of a shapegroup cannot have an emitter",
    ),
    ('<shape type="shapegroup"><bsdf type="diffuse"/></shape>', "'shapegroup' cannot contain a bsdf"),
    ('<shape type="instance"><bsdf type="diffuse"/></shape>', "'instance' cannot contain a bsdf"),
    ('<shape type="shapegroup" id="g"><ref id="g"/></shape>', "refers to itself"),
]
GROUP = '<shape type="shapegroup" id="g"><shape type="{}"/></shape>'
INSTANCE = '<shape type="instance"><transform name="to_world">{}</transform><ref id="g"/></shape>'
MALFORMED += [
    (GROUP.format("sphere") + INSTANCE.format('<scale x="0"/>'), "to_world cannot be inverted"),
    (GROUP.format("sphere") + INSTANCE.format('<scale value="1e-42"/>'), "exceeds the range of 32-bit floats"),
    (
        GROUP.format("sphere") + 2 * INSTANCE.format("") + INSTANCE.format('<translate x="1e30"/>'),
        "instance .* extends beyond 1e.18",
    ),
    (
        GROUP.format("sphere")
        + INSTANCE.format('<rotate z="1" angle="3"/><scale x="1e-8" y="1e8"/><rotate z="1" angle="9"/>'),
        "instance .* exceeds the range of 32-bit floats",
    ),
]


@pytest.mark.parametrize(("inside", "message"), MALFORMED)
def test_malformed_groups_and_instances(inside, message, scene_of):
    with pytest.raises(SceneError, match=message):
        compile_scene(scene_of(inside))


def test_a_file_with_instances(scene_of):
    """The example in Mitsuba's documentation."""
    scene = scene_of(
        '<shape type="shapegroup" id="trees"><shape type="cube"><bsdf type="diffuse"/></shape>'
        '<shape type="sphere"><transform name="to_world"><translate y="20"/></transform></shape></shape>'
        '<shape type="instance"><ref id="trees"/></shape>'
        '<shape type="instance"><ref id="trees"/><transform name="to_world"><translate z="10"/></transform></shape>'
    )
    compiled = compile_scene(scene)
    assert len(compiled.instances) == 2
    assert compiled.bounds.tolist() == [[-1, -1, -1], [1, 21, 11]]


def test_no_buffer_without_instances(monkeypatch):
    """tests/test_program.py checks that there is no code either."""
    buffer_names = []
    buffer = Device.buffer
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})
    monkeypatch.setattr(
        Device, "buffer", lambda self, size, name: (buffer_names.append(name), buffer(self, size, name))[1]
    )
    for description, present in (
        ({"type": "scene", "sensor": {"type": "perspective"}, "ball": {"type": "sphere"}}, False),
        (with_instances({"ball": {"type": "sphere"}}, make_transform()), True),
    ):
        buffer_names.clear()
        scene = compile_scene(load_description(description), size=(4, 4))
        Wavefront(Device(), scene, build_scene_bvh(scene), pool_size=64)
        assert ("the instances" in buffer_names) == present
