"""Scenes for tests/fuzzing.py: XML texts, and a dict whose values are replaced by odd ones."""

import math
import random
from pathlib import Path

import numpy as np
from fuzz_mutations import NAMES

from isonoise.scene import compile_scene, load_description

SCENE_HEAD = '<scene version="{version}"><default name="n" value="4"/>'
SENSOR = """<integrator type="volpath"><integer name="max_depth" value="$n"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0, 1, 5" target="0 0 0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="9"/><integer name="height" value="7"/><rfilter type="tent"/></film>
<sampler type="independent"><integer name="sample_count" value="8"/></sampler></sensor>"""
SCENES = (
    SCENE_HEAD.format(version="3.0.0")
    + SENSOR
    + """<bsdf type="twosided" id="a"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.2, 0.1"/></bsdf></bsdf>
<bsdf type="blendbsdf" id="b"><float name="weight" value="0.3"/><ref id="a"/><bsdf type="roughconductor">
<string name="material" value="Au"/><float name="alpha" value="0.2"/><string name="distribution" value="ggx"/>
</bsdf></bsdf>
<texture type="bitmap" id="t"><string name="filename" value="a.png"/><string name="wrap_mode" value="mirror"/>
<transform name="to_uv"><scale x="2" y="3"/><rotate z="1" angle="30"/></transform></texture>
<bsdf type="mask" id="m"><ref name="opacity" id="t"/><bsdf type="bumpmap"><ref id="t"/><float name="scale" value="2"/>
<bsdf type="plastic"><string name="int_ior" value="water"/><ref name="diffuse_reflectance" id="t"/></bsdf></bsdf>
</bsdf>
<shape type="ply"><string name="filename" value="a.ply"/><ref id="m"/></shape>
<shape type="obj"><string name="filename" value="a.obj"/><bsdf type="principled">
<texture type="checkerboard" name="base_color">
<ref name="color0" id="t"/></texture><float name="spec_trans" value="0.5"/></bsdf></shape>
<shape type="serialized"><string name="filename" value="a.serialized"/><integer name="shape_index" value="1"/>
<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/>
</texture>
</bsdf></shape><emitter type="envmap"><string name="filename" value="a.hdr"/><float name="scale" value="2"/>
</emitter></scene>""",
    SCENE_HEAD.format(version="2.1.0")
    + SENSOR
    + """<include filename="part.xml"/><alias id="g" as="h"/><shape type="shapegroup" id="g"><shape type="sphere">
<point name="center" value="0 1 0"/><float name="radius" value="0.5"/></shape><shape type="cube"/></shape>
<shape type="instance"><ref id="h"/><transform name="to_world"><translate x="1"/><scale value="2 -1 1"/></transform>
</shape>
<shape type="cylinder"><point name="p1" x="0" y="0" z="2"/><bsdf type="null"/>
<medium type="homogeneous" name="interior">
<float name="sigma_t" value="2"/><rgb name="albedo" value="0.5 0.6 0.7"/><phase type="hg">
<float name="g" value="0.3"/></phase>
</medium></shape><shape type="rectangle"><emitter type="area">
<spectrum name="radiance" value="400:1, 500:2, 700:3"/></emitter>
<transform name="to_world"><matrix value="1 0 0 0 0 1 0 0 0 0 1 3 0 0 0 1"/></transform></shape>
<emitter type="spot"><float name="cutoff_angle" value="30"/></emitter><emitter type="point">
<point name="position" value="1"/>
</emitter><emitter type="directional"><vector name="direction" x="1" y="0" z="0"/>
<spectrum name="irradiance" value="2"/>
</emitter></scene>""",
    SCENE_HEAD.format(version="0.5.0")
    + """<integrator type="path"><integer name="maxDepth" value="$n"/></integrator><sensor type="thinlens">
<float name="apertureRadius" value="0.1"/><float name="focusDistance" value="5"/>
<string name="fovAxis" value="smaller"/>
<transform name="toWorld"><lookAt origin="0 1 5" target="0 0 0" up="0 1 0"/></transform></sensor>
<bsdf type="roughplastic" id="p"><float name="intIOR" value="1.5"/><texture type="bitmap" name="diffuseReflectance">
<string name="filename" value="a.jpg"/><float name="uscale" value="2"/><float name="voffset" value="0.5"/></texture>
</bsdf>
<shape type="disk"><ref id="p"/><boolean name="flipNormals" value="true"/></shape>
<emitter type="constant"><rgb name="radiance" value="1"/></emitter></scene>""",
)
PART = '<scene version="3.0.0"><shape type="sphere"><bsdf type="dielectric"/></shape></scene>'

_NUMBERS = (None, True, -1, 0, 1, 10**400, 2**63, math.nan, -math.inf, 1e39, 1e30, 1e-40)
_OBJECTS = ("", "x", "rgb", "nan", b"bytes", 1j, (), (1,), (1, 2, 3), (math.nan, 0, 0), np.float32(0.5), np.int64(3))
_SHAPES = ((), (0,), (3,), (4,), (3, 3), (4, 4), (0, 3), (5, 3), (2, 2, 2))
_RGB_VALUES = (None, [], [[1, 2, 3]], np.ones(3), "1 2 3", {}, 1e39)
ODD_VALUES = [
    *(lambda value=value: value for value in (*_NUMBERS, *_OBJECTS, Path("a.png"))),
    *(lambda shape=shape: np.full(shape, 0.5) for shape in _SHAPES),
    *(lambda type_=type_: np.ones((3, 3), type_) for type_ in ("i8", "f2", "u1", "c8", "U1", "O", "M8[s]", "?")),
    *(lambda value=value: np.full((4, 4), value) for value in (math.nan, 1e300, -1e38, 1e-300)),
    *(list, dict, object, set, lambda: [None], lambda: iter(())),
    *(lambda: {"type": None}, lambda: {"type": "sphere"}),
    *(lambda t=t: {"type": t, "value": [1, "x"]} for t in ("rgb", "spectrum", "ref", "scene", "diffuse")),
    *(lambda value=value: {"type": "rgb", "value": value} for value in _RGB_VALUES),
    lambda: {"type": "spectrum", "value": [(1,), (2, 3)]},
]
"""Functions that make the values."""


def compile_damaged_dict(path: Path) -> None:
    """Compile a scene dict in which some values are replaced; the file contains the random seed."""
    rng = random.Random(path.read_text())
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 5},
        "sensor": {
            "type": "thinlens",
            "aperture_radius": 0.1,
            "to_world": np.eye(4),
            "film": {"type": "hdrfilm", "width": 9},
        },
        "mesh": {
            "type": "mesh",
            "vertices": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]),
            "faces": np.array([[0, 1, 2]]),
            "bsdf": {"type": "diffuse", "id": "matt", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
        },
        "ball": {"type": "sphere", "center": [0, 1, 2], "radius": 2.0, "paint": {"type": "ref", "id": "matt"}},
        "fog": {"type": "cube", "interior": {"type": "homogeneous", "sigma_t": 0.5, "phase": {"type": "hg", "g": 0.1}}},
        "smoke": {
            "type": "cube",
            "interior": {
                "type": "heterogeneous",
                "sigma_t": {"type": "gridvolume", "data": np.ones((2, 3, 4)), "to_world": np.eye(4)},
                "albedo": {"type": "gridvolume", "data": np.ones((2, 1, 1, 3)), "wrap_mode": "mirror"},
            },
        },
        "lamp": {"type": "spot", "intensity": {"type": "spectrum", "value": [(400, 1.0), (700, 2.0)]}},
    }
    for _ in range(0 if path.read_text() == "sound" else rng.choice((1, 1, 2, 4))):
        containers = [scene]
        for container in containers:
            containers += (
                [value for value in container.values() if isinstance(value, dict)] if len(containers) < 40 else []
            )
        container = rng.choice(containers)
        key = rng.choice([*map(str, container), rng.choice(NAMES)])
        container[key] = rng.choice(ODD_VALUES)() if rng.random() < 0.9 else rng.choice(containers)
    compile_scene(load_description(scene))
