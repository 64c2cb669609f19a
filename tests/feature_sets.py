"""Valid sets of features, a small list of sets that covers every pair of features, and a small scene for each set."""

import random
from functools import cache
from pathlib import Path

import numpy as np
import small_files

from isonoise.integrator.features import FEATURES
from isonoise.layers import LAYERS, device_layers
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.material.bsdf_kinds import KINDS as BSDF_KINDS
from isonoise.scene.material.bsdf_kinds import feature_of
from isonoise.scene.vocabulary import plugins_of
from isonoise.statistics import Needs

NEEDS = {  # feature -> features that a scene with it always has
    "VERTEX_NORMALS": {"TRIANGLES"},
    "SPHERES": {"ANALYTICS"},
    "DISKS": {"ANALYTICS"},
    "CYLINDERS": {"ANALYTICS"},
    "TRIANGLE_LIGHTS": {"AREA_LIGHTS", "TRIANGLES"},
    "PARALLELOGRAM_LIGHTS": {"AREA_LIGHTS", "TRIANGLES"},
    "SPHERE_LIGHTS": {"AREA_LIGHTS", "ANALYTICS", "SPHERES"},
    "DISK_LIGHTS": {"AREA_LIGHTS", "ANALYTICS", "DISKS"},
    "CYLINDER_LIGHTS": {"AREA_LIGHTS", "ANALYTICS", "CYLINDERS"},
    "TEXTURES": {"UVS"},
    "BITMAPS": {"TEXTURES", "UVS"},
    "CHECKERBOARDS": {"TEXTURES", "UVS"},
    "MESH_ATTRIBUTES": {"TEXTURES", "UVS"},
    "BUMP": {"TEXTURES", "UVS"},
    "NORMAL_MAP": {"UVS"},
    "TEXTURED_LIGHTS": {"TEXTURES", "UVS", "AREA_LIGHTS", "PARALLELOGRAM_LIGHTS", "TRIANGLES"},
    "TEXTURED_SPOT_LIGHTS": {"TEXTURES", "UVS"},
    "PROJECTOR_LIGHTS": {"TEXTURES", "UVS"},
    "MEDIA": {"VOLPATH"},
    "HETEROGENEOUS": {"MEDIA", "VOLPATH"},
    "LIGHT_TREE": {"NEXT_EVENT", "MANY_LIGHTS"},
    "LIGHT_LIST": {"NEXT_EVENT", "MANY_LIGHTS"},
    "BATCH_MEANS": {"CHUNK_MEDIANS"},
    "ALBEDO_LAYER": {"LAYERS"},
}
PARTS = 8
LAYER_FEATURES = {"albedo": "ALBEDO_LAYER", "uv": "UVS"}
AREA_LIGHTS = tuple(kind.feature for kind in LIGHT_KINDS.values() if kind.is_area)
LIGHTS = (*(kind.feature for kind in LIGHT_KINDS.values() if not kind.is_area), *AREA_LIGHTS)
NON_DELTA = tuple(feature_of(kind) for kind in BSDF_KINDS.values() if kind.scatters and not kind.is_delta)
ROUGH = tuple(
    feature_of(kind)
    for kind in BSDF_KINDS.values()
    if kind.plugin and plugins_of("bsdf")[kind.plugin].parameter("distribution")
)
ANY_OF = {  # feature -> groups of which a scene with it has at least one; the first of a group is the default
    "ANALYTICS": [("SPHERES", "DISKS", "CYLINDERS")],
    "AREA_LIGHTS": [AREA_LIGHTS],
    "NEXT_EVENT": [LIGHTS, NON_DELTA],
    "TEXTURES": [("BITMAPS", "CHECKERBOARDS", "MESH_ATTRIBUTES")],
    "BECKMANN": [ROUGH],
    "SAMPLE_ALL_NORMALS": [ROUGH],
}


def closed(names: set[str]) -> set[str]:
    """Returns these features and all that they need."""
    on, before = set(names), None
    while on != before:
        before = set(on)
        on |= {needed for name in before for needed in NEEDS.get(name, ())}
        on |= {group[0] for name in before for group in ANY_OF.get(name, ()) if on.isdisjoint(group)}
        if len(on & set(LIGHTS)) > 1:
            on.add("MANY_LIGHTS")
    return on


def is_closed(on: set[str]) -> bool:
    return closed(on) == on


def only(*names: str) -> dict[str, bool]:
    """Returns a set with these features and all that they need."""
    on = closed(set(names))
    return {name: name in on for name in FEATURES}


def all_but(*names: str) -> dict[str, bool]:
    """Returns a set without these features and those that need them."""
    on = set(FEATURES) - set(names)
    if "MANY_LIGHTS" in names:
        on -= set(LIGHTS[1:])
    while not is_closed(on):
        on -= {name for name in on if not closed({name}) - _alternatives(name) <= on or _lacks_a_group(name, on)}
    return {name: name in on for name in FEATURES}


def _alternatives(name: str) -> set[str]:
    return {each for group in ANY_OF.get(name, ()) for each in group}


def _lacks_a_group(name: str, on: set[str]) -> bool:
    return any(on.isdisjoint(group) for group in ANY_OF.get(name, ()))


def pairs_of(features: dict[str, bool]) -> set[tuple[str, bool, str, bool]]:
    """Returns every pair of features with their values, the names in order."""
    items = sorted(features.items())
    return {(a, x, b, y) for place, (a, x) in enumerate(items) for b, y in items[place + 1 :]}


def possible_pairs() -> set[tuple[str, bool, str, bool]]:
    """Returns the pairs that some scene has."""
    found = pairs_of(only())
    for a in FEATURES:
        for b in FEATURES:
            if a < b:
                found.add((a, True, b, True))
            if a != b and _without(only(a), b):
                found.add((a, True, b, False) if a < b else (b, False, a, True))
    return found


def _without(features: dict[str, bool], name: str) -> dict[str, bool] | None:
    """Returns the set with `name` off, replaced by an alternative if one is needed, or None if that is impossible."""
    on = {each for each, is_on in features.items() if is_on}
    if name not in on:
        return features
    if any(name in NEEDS.get(each, ()) for each in on):
        return None
    on.discard(name)
    for owner in list(on):
        for group in ANY_OF.get(owner, ()):
            if on.isdisjoint(group):
                others = [each for each in group if each != name and name not in closed({each})]
                if not others:
                    return None
                on |= closed({others[0]})
    return {each: each in on for each in FEATURES} if name not in closed(on) else None


@cache
def covering_rows(seed: int = 1) -> list[dict[str, bool]]:
    """Returns a small list of sets in which every possible pair of values of two features occurs.

    Greedy: each set is the best of 40 random ones.
    """
    rng = random.Random(seed)
    names, missing, rows = list(FEATURES), possible_pairs(), []
    while missing:
        best, gain = None, set()
        for _ in range(40):
            a, x, b, y = rng.choice(sorted(missing))
            row = _random_row({a: x, b: y}, names, rng)
            covered = pairs_of(row) & missing if row else set()
            if len(covered) > len(gain):
                best, gain = row, covered
        if best:
            rows.append(best)
            missing -= gain
    return rows


def _random_row(fixed: dict[str, bool], names: list[str], rng: random.Random) -> dict[str, bool] | None:
    """Returns a random set with the values of `fixed`, or None if that is impossible."""
    off = {name for name, value in fixed.items() if not value}
    start: dict[str, bool] | None = only(*(name for name, value in fixed.items() if value))
    for name in off:
        start = start and _without(start, name)
    if not start:
        return None
    on = {name for name, value in start.items() if value}
    for name in rng.sample(names, len(names)):
        more = closed(on | {name})
        if rng.random() < 0.45 and not more & off:
            on = more
    return {name: name in on for name in FEATURES}


def part_of_rows(number: int) -> list[dict[str, bool]]:
    """One of `PARTS` lists of covering rows, which take a second to find: too long for the collection of the tests."""
    return covering_rows()[number::PARTS]


def needs_of(features: dict[str, bool]) -> Needs:
    """Returns the statistics that a set contains."""
    return Needs(
        median=features["CHUNK_MEDIANS"],
        batch=4 if features["BATCH_MEANS"] else 1,
        power=2.0 if features["POWER_MEAN"] else None,
        half=features["HALF_BUFFER"],
        nets=features["NET_MEANS"],
        neighbours=5 if features["NEIGHBOURS"] else None,
        layers=tuple(
            name
            for name in device_layers(LAYERS)
            if features["LAYERS"] and features[LAYER_FEATURES.get(name, "LAYERS")]
        ),
    )


def scene_with(on: dict[str, bool], folder: Path) -> dict:
    """Returns a small scene with as many features of a set as possible, and no others; its files are in `folder`."""
    (folder / "image.png").write_bytes(small_files.image_file("PNG"))
    (folder / "sky.hdr").write_bytes(small_files.hdr())
    image = {"type": "bitmap", "filename": str(folder / "image.png")}
    materials = _materials(on, image)
    scene = {"type": "scene", "integrator": _integrator(on), "sensor": _sensor(on)}
    return {**scene, **_shapes(on, materials, folder), **_lights(on, materials, image, folder)}


def _materials(on: dict[str, bool], image: dict) -> list[dict]:
    rough = {
        "distribution": "beckmann" if on["BECKMANN"] else "ggx",
        "alpha": 0.2,
        "sample_visible": not on["SAMPLE_ALL_NORMALS"],
    }
    simple = {
        feature_of(kind): {"type": kind.plugin} for kind in BSDF_KINDS.values() if kind.plugin and not kind.is_wrapper
    }
    for name in ROUGH:
        simple[name] |= rough
    simple["DIFFUSE"]["reflectance"] = 0.6
    simple["PRINCIPLED"]["roughness"] = 0.4
    materials = [material for name, material in simple.items() if on[name]]
    if materials:
        plain = materials[0]
        paint = {"type": "diffuse", "reflectance": 0.3}
        more = {
            "MASK": {"type": "mask", "opacity": 0.5, "bsdf": plain},
            "BLEND": {"type": "blendbsdf", "weight": 0.4, "bsdf": plain, "bsdf_1": materials[-1]},
            "BUMP": {"type": "bumpmap", "height": image, "bsdf": plain},
            "NORMAL_MAP": {"type": "normalmap", "normalmap": {**image, "raw": True}, "bsdf": plain},
            "FRONT_BACK": {"type": "twosided", "bsdf": plain, "bsdf_1": paint},
            "TWOSIDED": {"type": "twosided", "bsdf": plain},
            "CHECKERBOARDS": {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
            "BITMAPS": {"type": "diffuse", "reflectance": image},
        }
        wanted = {name: on[name] for name in more}
        for name in ("BUMP", "NORMAL_MAP"):
            wanted[name] &= on["BITMAPS"] and plain["type"] == "diffuse"
        for name in ("FRONT_BACK", "TWOSIDED", "CHECKERBOARDS", "BITMAPS"):
            wanted[name] &= on["DIFFUSE"]
        materials += [material for name, material in more.items() if wanted[name]]
    return materials


def _integrator(on: dict[str, bool]) -> dict:
    smooth = any(on[name] for name in NON_DELTA)
    lit = any(on[name] for name in LIGHTS)
    return {
        "type": "volpath" if on["VOLPATH"] else "path",
        "max_depth": 6 if on["NEXT_EVENT"] or not (lit and smooth) else 1,
        "rr_depth": 2 if on["RUSSIAN_ROULETTE"] else 99,
        "hide_emitters": on["HIDE_EMITTERS"],
    }


def _sensor(on: dict[str, bool]) -> dict:
    sensor: dict = {"type": "perspective", "fov": 60.0}
    if on["ORTHOGRAPHIC"]:
        sensor = {"type": "orthographic"}
    if on["THIN_LENS"]:
        sensor = {"type": "thinlens", "fov": 60.0, "aperture_radius": 0.1, "focus_distance": 5.0}
    rfilter = {"type": "gaussian" if on["FILTER_TABLE"] else "box"}
    sensor["film"] = {"type": "hdrfilm", "width": 9, "height": 7, "rfilter": rfilter}
    sensor["sampler"] = {"type": "multijitter" if on["SOBOL"] else "independent"}
    return sensor


def _shapes(on: dict[str, bool], materials: list[dict], folder: Path) -> dict[str, dict]:
    scene: dict = {}
    shapes = [
        shape
        for name, shape in zip(
            ("TRIANGLES", "SPHERES", "DISKS", "CYLINDERS"), ("rectangle", "sphere", "disk", "cylinder"), strict=True
        )
        if on[name]
    ]
    number = max(len(shapes), len(materials)) if shapes and materials else 0
    for k in range(number):
        place = (0.9 * (k % 5) - 1.8, 0.8 * (k // 5) - 1.0, 4.0 + 0.3 * k)
        shape = {"type": shapes[k % len(shapes)], "bsdf": materials[k % len(materials)]}
        scene[f"shape{k}"] = {**shape, "to_world": placed(place, 0.5)}
    if materials and on["TRIANGLES"] and (on["VERTEX_NORMALS"] or on["MESH_ATTRIBUTES"]):
        (folder / "mesh.ply").write_bytes(small_files.ply())
        colours = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
        mesh = {"type": "ply", "filename": str(folder / "mesh.ply"), "face_normals": not on["VERTEX_NORMALS"]}
        paint = colours if on["MESH_ATTRIBUTES"] and on["DIFFUSE"] else materials[0]
        scene["mesh"] = {**mesh, "bsdf": paint, "to_world": placed((1.5, 1.5, 4.0), 0.5)}
    if number and on["INSTANCES"]:
        scene["group"] = {"type": "shapegroup", "in": {"type": shapes[0], "bsdf": materials[0]}}
        for k in range(2):
            ref = {"type": "ref", "id": "group"}
            scene[f"instance{k}"] = {"type": "instance", "group": ref, "to_world": placed((k - 0.5, 1.5, 5.0), 0.4)}
    if on["MEDIA"] and on["SPHERES"] and on["NULL"]:
        fog = {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.7}
        if on["HETEROGENEOUS"]:
            values = np.linspace(0, 4, 4 * 5 * 6, dtype=np.float32).reshape(4, 5, 6)
            grid = {"type": "gridvolume", "data": values, "to_world": placed((1.2, -1.2, 5.7), 2.4)}
            fog |= {"type": "heterogeneous", "sigma_t": grid}
        ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
        scene["cloud"] = {**ball, "to_world": placed((0.0, 0.0, 4.5), 1.2)}
    return scene


def _lights(on: dict[str, bool], materials: list[dict], image: dict, folder: Path) -> dict[str, dict]:
    scene: dict = {}
    radiance = {"type": "rgb", "value": [2.0, 1.5, 1.0]}
    triangle = {"type": "mesh", "vertices": np.eye(3), "faces": np.array([[0, 1, 2]]), "face_normals": True}
    lamps = zip(AREA_LIGHTS, ("triangle", "rectangle", "sphere", "disk", "cylinder"), strict=True)
    for k, (name, shape) in enumerate(lamps):
        if on[name] and materials:
            emission = image if on["TEXTURED_LIGHTS"] and on["BITMAPS"] and shape == "rectangle" else radiance
            lamp = {"type": shape, "to_world": placed((k - 1.5, 2.0, 4.0), 0.3)}
            lamp = triangle if shape == "triangle" else lamp
            scene[name] = {**lamp, "bsdf": materials[0], "emitter": {"type": "area", "radiance": emission}}
    placing = {
        "point": {"position": [0.0, 1.0, 2.0]},
        "spot": {"cutoff_angle": 40.0},
        "directional": {"direction": [0.1, -0.4, 1.0]},
    }
    projected = image if on["BITMAPS"] else {"type": "checkerboard"} if on["CHECKERBOARDS"] else None
    for name, kind in LIGHT_KINDS.items():
        if not on[kind.feature] or kind.is_area or kind.is_environment or (kind.texture and not projected):
            continue
        scene[name] = {"type": kind.plugin, **placing.get(name, {})}
        scene[name] |= {kind.texture: projected} if kind.texture else {kind.emission: radiance}
    if on["ENVIRONMENT_MAP"]:
        scene["sky"] = {"type": "envmap", "filename": str(folder / "sky.hdr")}
    elif on["CONSTANT_LIGHT"]:
        scene["sky"] = {"type": "constant", "radiance": radiance}
    return scene


def placed(at: tuple[float, float, float], size: float) -> np.ndarray:
    """Returns the transform of a shape of this size at a position, facing a camera that looks along +z."""
    matrix = np.diag([-size, size, -size, 1.0])
    matrix[:3, 3] = at
    return matrix
