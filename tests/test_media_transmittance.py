"""Shadow rays through media and pass-through surfaces: transmittance is exact up to rounding."""

import math

import numpy as np
import pytest
from media_scenes import (
    FLOOR,
    HALF,
    LAMBERT,
    NULL,
    OUT_OF_SIGHT,
    PLAIN,
    lit_floor,
    medium,
    one_ray,
    radiance,
    rgb,
    sheets,
    slab,
    transform,
)
from shared_programs import share_programs

from isonoise.integrator.features import features
from isonoise.scene import compile_scene, load_description, structs

SHEETS_AND_LAMP = (
    *("TRIANGLES", "UVS", "TEXTURES", "CHECKERBOARDS", "ORTHOGRAPHIC", "VOLPATH"),
    *("DIFFUSE", "NULL", "DIELECTRIC", "THIN_DIELECTRIC", "MASK", "BLEND", "BUMP"),
    *("POINT_LIGHTS", "AREA_LIGHTS", "PARALLELOGRAM_LIGHTS", "MANY_LIGHTS", "NEXT_EVENT"),
)
shared_programs = share_programs(SHEETS_AND_LAMP, PLAIN)

THIN, FOG = 2.0**-20, medium(0.25)
LAYERS = {  # (shapes, optical depth)
    "one": ({"a": slab(1, 2, rgb(0.0, 0.5, 1.0))}, [0.0, 0.5, 1.0]),
    "scaled": ({"a": slab(1, 2, interior=medium(2.0, scale=1.5))}, [3.0] * 3),
    "hardly any": ({"a": slab(1, 2, 1e-6)}, [1e-6] * 3),
    "none": ({"a": slab(1, 2, 0.0)}, [0.0] * 3),
    "dense": ({"a": slab(1, 2, 12.0)}, [12.0] * 3),
    "denser than 32-bit exponentials": ({"a": slab(1, 2, rgb(1.0, 300.0, 1e30))}, [1.0, np.inf, np.inf]),
    "a thin layer of a dense one": ({"a": slab(1e-3, 1e-3 + THIN, 1e6)}, [1e6 * THIN] * 3),
    "apart": ({"a": slab(1, 1.5), "b": slab(2, 2.5, rgb(0.1, 0.2, 0.3))}, [0.55, 0.6, 0.65]),
    "within one another": ({"a": slab(0.5, 2.5, 0.25), "b": slab(1, 2, 0.75, exterior=FOG)}, [1.0] * 3),
    "within, its outside not named": ({"a": slab(0.5, 2.5, 0.25), "b": slab(1, 2, 0.75)}, [0.75 + 0.125] * 3),
    "many slabs": (
        {f"slab {i}": slab(0.2 + 0.2 * i, 0.3 + 0.2 * i, 0.1 * (1 + i)) for i in range(13)},
        [0.1 * 0.1 * 91] * 3,
    ),
    "light within": ({"a": slab(2.0, 4.0, 0.7)}, [0.7] * 3),
    "floor within": ({"a": slab(-1.0, 2.0, 0.7), "floor": FLOOR | {"exterior": medium(0.7)}}, [1.4] * 3),
    "floor within, not named": (
        {
            "a": slab(-1.0, 2.0, 0.7),
            "sensor": one_ray((0, 0, 4e-4), (0, 0, 0), medium=medium(0.7)) | {"near_clip": 1e-5},
        },
        [1.4] * 3,
    ),
}
FAR_SPHERE = {"far_sphere": {"type": "sphere", "center": [50.0, 0.0, 0.0], "bsdf": NULL}}


@pytest.mark.parametrize("name", LAYERS)
def test_light_through_layers(name):
    """exp(-depth) to 2e-5, the rounding of the shadow ray; distances in the thin layer round by 1e-3. If the camera is
    in a medium, 3e-4 of the samples scatter before its ray reaches the floor."""
    shapes, depth = LAYERS[name]
    seen, _ = radiance(lit_floor(**shapes, **FAR_SPHERE), spp=1024 if "not named" in name else 16)
    within = 5 * math.sqrt(3e-4 / 1024) + 3e-4 if name == "floor within, not named" else 2e-5
    assert seen == pytest.approx(np.exp(-np.array(depth)), rel=1e-3 if "thin" in name else within, abs=1e-30)


def test_light_through_balls_and_pipes():
    """A shadow ray enters and leaves analytic shapes; flip_normals swaps interior and exterior."""
    sphere = {"type": "sphere", "center": [0.0, 0.0, 1.5], "radius": 0.5, "bsdf": NULL, "interior": medium(0.8)}
    pipe = {"type": "cylinder", "p0": [-1.0, 0.0, 0.5], "p1": [1.0, 0.0, 0.5], "radius": 0.25, "bsdf": NULL}
    objects = {"a": sphere, "b": pipe | {"interior": medium(0.4)}}
    assert radiance(lit_floor(**objects))[0] == pytest.approx([math.exp(-1.0)] * 3, rel=2e-5)
    turned = {"flip_normals": True, "exterior": sphere["interior"]}
    objects["a"] = {key: value for key, value in sphere.items() if key != "interior"} | turned
    assert radiance(lit_floor(**objects))[0] == pytest.approx([math.exp(-1.0)] * 3, rel=2e-5)


def test_instances_have_the_media_of_their_group():
    """Distances are measured in world space, also if the group is scaled."""
    group = {"type": "shapegroup", "shape": slab(-1, 1, 0.3), "hole": {"type": "sphere", "radius": 0.1, "bsdf": NULL}}
    at = transform(z=1.5, scale=(0.5, -0.7, 0.25))
    scene = lit_floor(group=group, one={"type": "instance", "to_world": at, "shape": {"type": "ref", "id": "group"}})
    assert radiance(scene)[0] == pytest.approx([math.exp(-0.15)] * 3, rel=3e-5)


@pytest.mark.usefixtures("one_lane")
def test_path_sees_no_media_and_is_blocked_by_boundaries():
    shapes = LAYERS["one"][0]
    assert (radiance(lit_floor("path", **shapes))[0] == 0).all()
    compiled = compile_scene(load_description(lit_floor("path", **shapes)))
    assert len(compiled.media) == 0
    assert compiled.sensor_medium == structs.MEDIUM_NONE
    assert not features(compiled)["VOLPATH"]


# Light through masks and panes.


def pane_share(eta: float) -> float:
    once = ((eta - 1) / (eta + 1)) ** 2
    return 1 - 2 * once / (1 + once)


SHEETS = {  # (materials from below, transmittance)
    "half": ([HALF], [0.5] * 3),
    "two": ([HALF, HALF | {"opacity": 0.25}], [0.375] * 3),
    "twelve": ([HALF | {"opacity": 0.1}] * 12, [0.9**12] * 3),
    "opaque": ([HALF | {"opacity": 1.0}], [0.0] * 3),
    "clear": ([HALF | {"opacity": 0.0}], [1.0] * 3),
    "beyond 1": ([HALF | {"opacity": {"type": "checkerboard", "color0": 1.0, "color1": 1.0}}], [0.0] * 3),
    "checks": ([OUT_OF_SIGHT["mask"]], [0.3] * 3),
    "mask of a mask": ([{"type": "mask", "opacity": 0.8, "inner": HALF}], [0.6] * 3),
    "mask of nothing": ([{"type": "mask", "opacity": 0.8, "inner": NULL}], [1.0] * 3),
    "blend": ([OUT_OF_SIGHT["blend"]], [0.75] * 3),
    "blend the other way": ([{"type": "blendbsdf", "weight": 0.25, "a": LAMBERT, "b": HALF}], [0.125] * 3),
    "blend of two": ([{"type": "blendbsdf", "weight": 0.25, "a": HALF, "b": OUT_OF_SIGHT["blend"]}], [0.5625] * 3),
    "mask of a blend": ([{"type": "mask", "opacity": 0.5, "inner": OUT_OF_SIGHT["blend"]}], [0.875] * 3),
    "bump of a mask": ([OUT_OF_SIGHT["bump"]], [0.5] * 3),
    "pane": ([OUT_OF_SIGHT["pane"]], [pane_share(1.5)] * 3),
    "tinted pane": (
        [OUT_OF_SIGHT["pane"] | {"specular_transmittance": rgb(1.0, 0.5, 0.0)}],
        [pane_share(1.5), pane_share(1.5) / 2, 0.0],
    ),
    "glass stops it": ([{"type": "dielectric"}], [0.0] * 3),
}


@pytest.mark.parametrize("name", SHEETS)
def test_light_through_sheets(name):
    materials, share = SHEETS[name]
    assert radiance(sheets(materials))[0] == pytest.approx(share, rel=2e-5, abs=1e-7)


@pytest.mark.usefixtures("one_lane")
def test_path_casts_full_shadows_of_masks():
    assert (radiance(sheets([HALF], "path"))[0] == 0).all()


def lamp_behind_a_sheet(integrator: str) -> dict:
    """A lamp behind a mask of opacity 1/4, which is black because it is lit from behind; max_depth 1."""
    lamp = {"type": "rectangle", "to_world": transform(z=2.0) @ np.diag([1, 1, -1, 1]), "emitter": {"type": "area"}}
    scene = sheets([HALF | {"opacity": 0.25}]) | {"lamp": lamp}
    del scene["floor"]
    sensor = one_ray((0.21, 0.12, 0.1), (0.21, 0.12, 1.0))
    return scene | {"sensor": sensor, "integrator": {"type": integrator, "max_depth": 1}}


def test_what_is_seen_through_sheets_is_seen_in_full():
    """Passing through is no bounce in `volpath`."""
    seen, error = radiance(lamp_behind_a_sheet("volpath"), spp=4096)
    assert seen == pytest.approx([0.75] * 3, rel=5 * error)


@pytest.mark.usefixtures("one_lane")
def test_path_counts_sheets_as_bounces():
    assert radiance(lamp_behind_a_sheet("path"), spp=64)[0].max() == 0
