"""What a scene does not use is not there: no code in its programs, no bytes on the device.

Programs are looked at as the system's `cpp` preprocesses them; tests that need it are skipped where there is none.
"""

import re
import shutil
import subprocess
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest
from feature_sets import all_but, needs_of, only, scene_with

from isonoise.device.opencl import Device
from isonoise.device.program import flatten, stage_source
from isonoise.integrator import stages
from isonoise.integrator.accumulator import build_constants
from isonoise.integrator.brute_force import MAX_CORNERS
from isonoise.integrator.feature_costs import cost, features_in, stages_with
from isonoise.integrator.feature_superset import DUMMY_BYTES
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import (
    BRUTE_FORCE_KERNELS,
    CONSTANTS,
    KERNELS,
    LANE_KERNELS,
    PATH_STATE,
    STRUCTS,
    path_bytes,
)
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import builtin_scenes, compile_scene, load, structs
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.light import light_list
from isonoise.scene.light.envmap import ENVIRONMENT
from isonoise.statistics import BASIC_NEEDS, Needs

STAGES = sorted({row.file for table in (KERNELS, BRUTE_FORCE_KERNELS) for row in table.values()})
TAKE_MANY = sorted({row.file for row in (*(KERNELS[name] for name in LANE_KERNELS), *BRUTE_FORCE_KERNELS.values())})
"""Stages of which a work-item may take many paths: kernels/path/path_state.h."""
CHECKOUT = Path(__file__).resolve().parent.parent
EVERY_STATISTIC = Needs(median=True, batch=4, power=2.0, half=True)


# What is off leaves no code.

ORDINARY = ("TRIANGLES", "DIFFUSE")
"""What a feature that is looked at alone stands beside: a scene that there is something to see in."""
GENERAL = {"util/vec.h", "util/math.h", "path/path_state.h", "util/random.h"}
"""Arithmetic, and access to what all programs have: headers that belong to no feature."""
RECORDS = set(STRUCTS) | {f"{name}_at" for name in STRUCTS}  # declared with their readers where a text names them
ONE_BY_ONE = {"bsdf_eval", "bsdf_sample", "sample_light", "select_from_list", "null_bsdf_sample"}
"""What only work-items that take one path call."""
READERS = {"lookup_rgb", "lookup_float", "bsdf_rgb", "bsdf_float"}
READERS |= {"texture_rgb", "texture_rgb_vec4", "texture_float"}
"""Read a material's parameter; which of them its kind asks for is nobody's feature."""


def preprocessed(file: str, sets: list[dict[str, bool]], lanes: int) -> list[str]:
    """The text of a stage for every set of features, in one run of `cpp`, which takes longest to start."""
    cpp = shutil.which("cpp")
    if cpp is None:
        pytest.skip("no C preprocessor 'cpp' on PATH")
    constants = CONSTANTS | build_constants(EVERY_STATISTIC)
    constants |= {"LANES": lanes, "PATHS_PER_BLOCK": 64}
    constants |= {"MAX_CORNERS": MAX_CORNERS, "MAX_LISTED_LIGHTS": light_list.MAX_LISTED_LIGHTS}
    # the text is the same for all sets
    text, options = stage_source(file, STRUCTS, constants, all_but(), generated_headers())
    names = [option[len("-DFEATURE_") :].split("=")[0] for option in options if option.startswith("-DFEATURE_")]
    own = set(re.findall(r"^\s*#\s*define\s+(\w+)", text, re.MULTILINE))
    undefine = [f"#undef {name}" for name in sorted(own | {f"FEATURE_{name}" for name in names})]
    parts = []
    for features_ in sets:
        parts += [f"#define FEATURE_{name} {int(features_[name])}" for name in names]
        parts += [text, *undefine, "the_set_ends"]
    done = subprocess.run([cpp, "-xc", "-Wundef", "-"], input="\n".join(parts), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not re.search("FEATURE_|LANES|redefined", done.stderr), done.stderr
    texts = done.stdout.split("the_set_ends")
    assert len(texts) == len(sets) + 1
    return texts[:-1]


MARKERS = {  # functions and variables that belong to one feature
    "stages/shade.cl": {
        "TRIANGLES": "triangle_surface",
        "VERTEX_NORMALS": "interpolated",
        "ANALYTICS": "analytic_surface",
        "SPHERES": "sphere_surface",
        "DIFFUSE": "diffuse_sample",
        "DIELECTRIC": "dielectric_sample",
        "CONDUCTOR": "conductor_sample",
        "AREA_LIGHTS": "sample_surface",
        "SPHERE_LIGHTS": "sample_sphere_light",
        "INSTANCES": "instanced_surface_of_hit",
        "ENVIRONMENT_MAP": "envmap_radiance",
        "VOLPATH": "paths->null_bounces",
        "MEDIA": "sample_medium",
        "NEXT_EVENT": "direct_lighting",
        "LIGHT_LIST": "select_from_list",
        "RUSSIAN_ROULETTE": "survival",
    },
    "stages/intersect.cl": {
        "TRIANGLES": "intersect_triangle_block",
        "SPHERES": "sphere_distance",
        "DISKS": "disk_distance",
        "CYLINDERS": "cylinder_distance",
        "INSTANCES": "ray_to_object",
    },
    "stages/shadow.cl": {
        "TRIANGLES": "intersect_triangle_block",
        "SPHERES": "sphere_distance",
        "DISKS": "disk_distance",
        "CYLINDERS": "cylinder_distance",
        "INSTANCES": "ray_to_object",
    },
    "stages/shadow_transmittance.cl": {
        "TRIANGLES": "intersect_triangle_block",
        "SPHERES": "sphere_distance",
        "INSTANCES": "ray_to_object",
        "MEDIA": "medium_transmittance",
        "THIN_DIELECTRIC": "thin_dielectric_reflectance",
    },
    "stages/generate.cl": {
        "THIN_LENS": "lens",
        "INSTANCES": "instance",
        "VOLPATH": "null_bounces",
        "MEDIA": "sensor_medium",
    },
    "stages/compact.cl": {"INSTANCES": "instance", "VOLPATH": "null_bounces", "MEDIA": "medium"},
    "stages/reduce.cl": {
        "CHUNK_MEDIANS": "medians",
        "BATCH_MEANS": "batch_sum",
        "POWER_MEAN": "powers",
        "HALF_BUFFER": "halves",
    },
    "stages/summarise.cl": {"CHUNK_MEDIANS": "medians", "POWER_MEAN": "powers", "HALF_BUFFER": "halves"},
}


@pytest.mark.parametrize(
    ("file", "lanes", "never"),
    [
        *(pytest.param(file, 1, (), id=file) for file in STAGES),
        *(pytest.param(file, 64, ("VOLPATH", "MEDIA"), id=f"{file}, many") for file in TAKE_MANY),
    ],
)
def test_every_feature_of_a_stage_makes_a_difference_there(file, lanes, never):
    """Among all others or alone: some share their code. And what marks a feature's own code is gone without it."""
    names = sorted(features_in(file) - set(never))
    sets = [all_but(*never), only()]
    sets += [set_ for name in names for set_ in (all_but(*never, name), only(name))]
    full, nothing, *each = preprocessed(file, sets, lanes)
    for name, without, alone in zip(names, each[::2], each[1::2], strict=True):
        used = len(without.split()) < len(full.split()) or len(alone.split()) > len(nothing.split())
        assert used, f"{file} mentions {name} and does not use it"
        if marker := MARKERS.get(file, {}).get(name):
            assert re.search(rf"\b{marker}\b", full), f"{marker} is no longer in {file}: mend this test"
            assert not re.search(rf"\b{marker}\b", without), f"{marker} without {name}"


@cache
def definition(tokens: str) -> tuple[str, frozenset[str]]:
    """The name that a piece of the outermost level defines, and all that it names."""
    words = re.findall(r"\w+|[^\w\s]", tokens)
    if words[0] in ("typedef", "enum"):  # an enum goes by its last member
        name = [word for word in words if word.isidentifier()][-1]
    else:
        head = words[: words.index("=")] if "=" in words and "(" not in words[: words.index("=")] else words
        last = head.index("(") if "(" in head else len(head)
        name = [word for word in head[:last] if word.isidentifier()][-1]
    return name, frozenset(word for word in words if word.isidentifier())


def definitions(text: str) -> dict[tuple[str, str], frozenset[str]]:
    """What a preprocessed text defines: (file, name) -> what it names. Kernels have '' as their file."""
    found, file, piece, depth = {}, "", [], 0
    for line in text.splitlines():
        if line.startswith("#"):
            marker = re.match(r'# \d+ "(.*?)"', line)
            file = marker[1] if marker else file
            continue
        line = re.sub(r"__attribute__\s*\(\(.*?\)\)|\"[^\"]*\"", "", line)
        if not line.strip():
            continue
        piece.append(line)
        depth += line.count("{") - line.count("}")
        if depth == 0 and line.rstrip().endswith(("}", ";")):
            tokens = " ".join(piece)
            piece = []
            name, words = definition(tokens)
            key = ("" if "__kernel" in words else file, name)
            found[key] = found.get(key, frozenset()) | words
    assert not piece
    return found


def reached(found: dict[tuple[str, str], frozenset[str]]) -> set[tuple[str, str]]:
    """What the kernels use, and what that uses."""
    by_name = defaultdict(list)
    for key in found:
        by_name[key[1]].append(key)
    todo = [key for key in found if not key[0]]
    seen = set(todo)
    while todo:
        for word in found[todo.pop()]:
            for key in by_name.get(word, ()):
                if key not in seen:
                    seen.add(key)
                    todo.append(key)
    return seen


looked_at: dict[tuple, tuple[set, set]] = {}
"""What texts define, and what of that is in use: by stage, where it matters LANES, and the features that are on."""


@pytest.mark.parametrize("lanes", [1, 64])
def test_what_is_off_leaves_no_code(lanes):
    """Functions, types and tables that are there without a feature are used without it, in one of the programs: those
    which only the feature uses went with it. So it is with each feature off, and with each alone in an ordinary scene.
    """
    never = ("VOLPATH", "MEDIA") if lanes > 1 else ()
    names = [name for name in FEATURES if name not in never]
    sets = {"all": all_but(*never)}
    sets |= {f"all but {name}": all_but(*never, name) for name in names}
    sets |= {f"{name} alone": only(*ORDINARY, name) for name in names}
    there: dict[str, set] = {label: set() for label in sets}
    used: dict[str, set] = {label: set() for label in sets}
    files = STAGES
    for file in files:
        if file == "stages/shadow_transmittance.cl" and lanes > 1:
            continue  # with VOLPATH alone
        mentioned = features_in(file)
        labels = defaultdict(list)
        for label, set_ in sets.items():
            labels[frozenset(name for name in mentioned if set_[name])].append(label)
        kind = (file, lanes if re.search(r"\bLANES\b", flatten(file, generated_headers())) else None)
        new = {key: sets[of[0]] for key, of in labels.items() if (kind, key) not in looked_at}
        for key, text in zip(new, preprocessed(file, list(new.values()), lanes), strict=True):
            found = definitions(text)
            looked_at[kind, key] = set(found), reached(found)
        for key, of in labels.items():
            for label in of:
                there[label] |= looked_at[kind, key][0]
                used[label] |= looked_at[kind, key][1]
    ever = set().union(*used.values())
    of_features = {key for key in ever if key[0] not in GENERAL and key[1] not in READERS | RECORDS}
    for label in sets:
        left = (there[label] - used[label]) & of_features
        assert not left, f"{label}: left over are {sorted(left)}"
    dead = {key for key in there["all"] - ever if key[0] not in GENERAL and key[1] not in RECORDS}
    dead = {key for key in dead if lanes == 1 or key[1] not in ONE_BY_ONE}
    assert not dead, f"no program uses {sorted(dead)}"


# What is off takes no memory.


def allocated(
    monkeypatch, scene, needs: Needs = BASIC_NEEDS, feature_override=None
) -> tuple[dict[str, int], Wavefront]:
    """Bytes of every buffer that a scene's kernels get, by the names of the arguments; nothing is compiled for it."""
    with monkeypatch.context() as patch:
        patch.setattr(stages, "stage_source", lambda *arguments: ("", ()))
        patch.setattr(Device, "build", lambda self, text, options: {})
        wavefront = Wavefront(
            Device(), scene, build_scene_bvh(scene), needs, pool_size=256, feature_override=feature_override
        )
    arguments = wavefront.stages.arguments
    return {name: value.size for name, value in arguments.items() if hasattr(value, "get_info")}, wavefront


@pytest.mark.parametrize("name", builtin_scenes())
def test_no_buffer_without_a_feature_that_reads_it(monkeypatch, name):
    scene = compile_scene(load(name))
    sizes, wavefront = allocated(monkeypatch, scene)
    used = wavefront.features
    for_features = {buffer for feature in FEATURES.values() for buffer in feature.buffers}
    for_used = {buffer for feature, on in used.items() if on for buffer in FEATURES[feature].buffers}
    paths = path_bytes(used)
    assert not (for_features - for_used) & set(sizes)
    assert {each for each in path_bytes(dict.fromkeys(FEATURES, True)) if each not in paths}.isdisjoint(sizes)
    # and what no feature has claimed is there in every scene: nothing else is ever absent
    buffers = {argument for row in KERNELS.values() for argument in row.arguments}
    never = {each for each, value in wavefront.stages.arguments.items() if value is None}
    assert never & buffers <= (for_features - for_used) | set(path_bytes(dict.fromkeys(FEATURES, True)))


@pytest.mark.parametrize("name", builtin_scenes())
def test_the_state_of_a_path_is_the_sum_of_what_its_features_state(monkeypatch, name):
    scene = compile_scene(load(name))
    sizes, wavefront = allocated(monkeypatch, scene)
    planes = int(wavefront.stages.arguments["plane_stride"])
    assert {each: sizes[each] for each in path_bytes(wavefront.features)} == {
        each: size * planes for each, size in path_bytes(wavefront.features).items()
    }
    bare = sum(path_bytes(only()).values())
    assert bare == 2 * sum(4 * field.planes for field in PATH_STATE.values() if not field.features) + 16 + 4
    stated = sum(cost(each, wavefront.features).path_bytes for each, on in wavefront.features.items() if on)
    assert sum(path_bytes(wavefront.features).values()) == bare + stated


@pytest.mark.parametrize("name", builtin_scenes())
def test_a_feature_more_takes_the_bytes_that_it_states(monkeypatch, name):
    """Those of the paths to the byte, and a stand-in for each of its buffers; all others stay as they are."""
    scene = compile_scene(load(name))
    without, wavefront = allocated(monkeypatch, scene)
    used = wavefront.features
    planes = int(wavefront.stages.arguments["plane_stride"])
    records = {
        "faces": 12 * len(scene.faces),
        "shapes": scene.shapes.nbytes,
        "srgb": stated("srgb"),
        "light_bounds": stated("light_bounds") * len(scene.lights),
    }
    if scene.environment_light < 0:
        records["environment"] = ENVIRONMENT.itemsize  # of a map that is black
    of_statistics = {"CHUNK_MEDIANS", "BATCH_MEANS", "POWER_MEAN", "HALF_BUFFER"}
    for feature in (each for each, on in used.items() if not on and each not in of_statistics | {"FILTER_TABLE"}):
        more, of_more = allocated(monkeypatch, scene, feature_override=used | {feature: True})
        gone = () if of_more.brute_force else ("corners", "corner_indices")  # it does not do without a hierarchy
        bare = {each: size for each, size in without.items() if each not in gone}
        new = {each: size for each, size in more.items() if each not in bare}
        grown = {each: more[each] - size for each, size in bare.items() if more[each] != size}
        paths = {each: size for each, size in (new | grown).items() if each in path_bytes(of_more.features)}
        sky = feature in ("CONSTANT_LIGHT", "ENVIRONMENT_MAP") and scene.environment_light < 0
        lights = {"lights": structs.LIGHT.itemsize} if sky else {}
        assert {each: size for each, size in grown.items() if each not in paths} == lights, feature
        assert sum(paths.values()) == cost(feature, used).path_bytes * planes, feature
        assert set(new) - set(paths) == set(FEATURES[feature].buffers) - set(bare), feature
        for each in set(new) - set(paths) - {"light_nodes", "light_parents"}:  # made of the lights there are
            assert new[each] == records.get(each, DUMMY_BYTES), (feature, each)


def test_statistics_take_the_bytes_that_they_state(monkeypatch):
    scene = compile_scene(load("cornell"), size=(16, 8))
    bare, wavefront = allocated(monkeypatch, scene)
    for needs, features_, bytes_a_pixel in (
        (Needs(median=True, chunk=7), {"CHUNK_MEDIANS"}, 4 * 7 + 4),
        (Needs(median=True, chunk=7, batch=4), {"CHUNK_MEDIANS", "BATCH_MEANS"}, 4 * 7 + 4 + 8),
        (Needs(power=2.0), {"POWER_MEAN"}, 8),
        (Needs(half=True), {"HALF_BUFFER"}, 24),
    ):
        more, of_more = allocated(monkeypatch, scene, needs)
        assert {each for each, on in of_more.features.items() if on and not wavefront.features[each]} == features_
        new = {each: size for each, size in more.items() if each not in bare}
        assert set(new) == {each for feature in features_ for each in FEATURES[feature].buffers}
        assert sum(new.values()) == bytes_a_pixel * 16 * 8
        assert {each for each in bare if more[each] != bare[each]} == {"summary"}


def test_a_filter_takes_the_bytes_that_it_states(monkeypatch, tmp_path):
    box, table = (
        allocated(monkeypatch, compile_scene(load(scene_with(only(*names), tmp_path))))[0]
        for names in ((), ("FILTER_TABLE",))
    )
    assert {each: table[each] for each in table if each not in box} == {"inverse_cdf": stated("inverse_cdf")}


def stated(buffer: str) -> int:
    """The number that the table of features begins with for a buffer."""
    (text,) = {feature.buffers[buffer] for feature in FEATURES.values() if buffer in feature.buffers}
    return int(text.split()[0].replace(",", ""))


def test_records_have_the_bytes_that_are_stated(monkeypatch, tmp_path):
    """Of a scene that uses all features."""
    row = all_but()
    scene = compile_scene(load(scene_with(row, tmp_path)))
    used = features(scene, needs_of(row))
    assert {each for each in row if not used[each]} <= {
        "COUNT_TESTS",
        "CONSTANT_LIGHT",
        "ORTHOGRAPHIC",
        "LIGHT_LIST",
        "LIGHT_TREE",
    }
    sizes, _ = allocated(monkeypatch, scene, needs_of(row))
    triangles, lights, sky = len(scene.faces), len(scene.lights), scene.environment
    number = {
        "triangles": triangles,
        "faces": triangles,
        "corner_normals": triangles,
        "uvs": len(scene.vertices),
        "textures": len(scene.textures),
        "texel_bytes": len(scene.texel_bytes),
        "srgb": 1,
        "attributes": len(scene.attributes),
        "analytics": len(scene.analytics),
        "shapes": len(scene.shapes),
        "instances": len(scene.instances),
        "rough_transmittances": len(scene.rough_transmittances),
        "media": len(scene.media),
        "lights": lights,
        "light_alias": lights,
        "environment": 1,
        "environment_texels": sky.texels.shape[0] * sky.texels.shape[1],
        "environment_rows": len(sky.rows),
        "environment_aliases": sky.aliases.size,
        "blocks": sizes["blocks"] // stated("blocks"),
        "light_nodes": sizes["light_nodes"] // stated("light_nodes"),
        "inverse_cdf": 1,
    }
    number["light_parents"] = lights + number["light_nodes"]
    assert {each: sizes[each] for each in number} == {each: stated(each) * count for each, count in number.items()}
    pixels = {"medians": 4 * 5 + 4 + 8, "powers": 8, "halves": 24}
    assert {each: sizes[each] for each in pixels} == {each: size * 9 * 7 for each, size in pixels.items()}
    unchecked = {each for feature in FEATURES.values() for each in feature.buffers} - set(number) - set(pixels)
    assert unchecked == {"texel_floats", "corners", "corner_indices", "light_bounds"}


def test_bytes_of_a_path_are_those_of_the_kernels_readme():
    table = (CHECKOUT / "kernels" / "README.md").read_text()
    rows = [int(size) for size in re.findall(r"^\| (?!sample).*?(\d+) a path\b", table, re.MULTILINE)]
    everything = dict.fromkeys(FEATURES, True)
    assert sum(rows) == sum(path_bytes(everything).values()) - path_bytes(everything)["tests"]


def test_stages_named_for_a_feature_have_its_code():
    """As the texts that are built say; and every feature is in some."""
    for feature in FEATURES:
        named = stages_with(feature)
        assert named
        for stage in named:
            assert feature in features_in(f"stages/{stage}.cl"), (feature, stage)
    assert cost("NEXT_EVENT", only("POINT_LIGHTS")).stages == ("shadow",)
    assert cost("VOLPATH", only("NEXT_EVENT")).stages == ("shadow_transmittance",)
    assert cost("VOLPATH", only("POINT_LIGHTS")).stages == ()
    assert cost("MEDIA", only("NEXT_EVENT", "VOLPATH")).path_bytes == 12
    assert cost("MEDIA", only("VOLPATH")).path_bytes == 8
