"""Features that are off leave no code in the programs.

Programs are preprocessed by the system's `cpp`; tests that need it are skipped without it.
"""

import re
import shutil
import subprocess
from collections import defaultdict
from functools import cache

import pytest
from feature_sets import all_but, only

from isonoise.device.form import FORMS
from isonoise.device.program import flatten, stage_source
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.feature_costs import cost, features_in, stages_with
from isonoise.integrator.features import FEATURES
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import (
    BRUTE_FORCE_KERNELS,
    KERNELS,
    LANE_KERNELS,
    STRUCTS,
)
from isonoise.layers import LAYERS, device_layers
from isonoise.statistics import Needs

STAGES = sorted({row.file for table in (KERNELS, BRUTE_FORCE_KERNELS) for row in table.values()})
LANE_STAGES = sorted({row.file for row in (*(KERNELS[name] for name in LANE_KERNELS), *BRUTE_FORCE_KERNELS.values())})
"""Stages with several lanes a work-item: kernels/path/path_state.h."""
EVERY_STATISTIC = Needs(median=True, batch=4, power=2.0, half=True, neighbours=5, layers=device_layers(LAYERS))


BASE_FEATURES = ("TRIANGLES", "DIFFUSE")
"""Features of the scene in which a feature is tested alone."""
GENERAL_HEADERS = {"util/vec.h", "util/math.h", "path/path_state.h", "util/random.h"}
"""Headers that belong to no feature: arithmetic and path state."""
RECORDS = set(STRUCTS) | {f"{name}_at" for name in STRUCTS}  # declared with their readers if a text names them
ONE_LANE_STAGES = {"stages/shadow_transmittance.cl", "stages/accumulate_layers.cl"}
"""Stages whose work-items always have one lane."""
SINGLE_LANE_FUNCTIONS = {"bsdf_eval", "bsdf_sample", "sample_light", "select_from_list", "null_bsdf_sample"}
"""Functions that only work-items with one lane call."""
PARAMETER_READERS = {"lookup_rgb", "lookup_float", "bsdf_rgb", "bsdf_float"}
PARAMETER_READERS |= {"texture_rgb", "texture_rgb_vec4", "texture_float"}
"""Functions that read a parameter of a material. No feature decides which of them a kind uses."""


def preprocessed(file: str, sets: list[dict[str, bool]], lanes: int) -> list[str]:
    """Returns the preprocessed text of a stage for every set of features, in one run of `cpp`, whose start is slow."""
    cpp = shutil.which("cpp")
    if cpp is None:
        pytest.skip("no C preprocessor 'cpp' on PATH")
    constants = build_constants(EVERY_STATISTIC, FORMS["lanes" if lanes > 1 else "cpu"])
    # the text is the same for all sets
    text, options = stage_source(file, STRUCTS, constants, all_but(), generated_headers())
    names = [option[len("-DFEATURE_") :].split("=")[0] for option in options if option.startswith("-DFEATURE_")]
    own = set(re.findall(r"^\s*#\s*define\s+(\w+)", text, re.MULTILINE))
    undefine = [f"#undef {name}" for name in sorted(own | {f"FEATURE_{name}" for name in names})]
    parts = []
    for features_ in sets:
        parts += [f"#define FEATURE_{name} {int(features_[name])}" for name in names]
        parts += [text, *undefine, "end_of_set"]
    done = subprocess.run([cpp, "-xc", "-Wundef", "-"], input="\n".join(parts), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not re.search("FEATURE_|LANES|redefined", done.stderr), done.stderr
    texts = done.stdout.split("end_of_set")
    assert len(texts) == len(sets) + 1
    return texts[:-1]


MARKERS = {  # names that belong to one feature
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
        "TEXTURED_SPOT_LIGHTS": "sample_textured_spot_light",
        "PROJECTOR_LIGHTS": "sample_projector_light",
        "INSTANCES": "instanced_surface_of_hit",
        "ENVIRONMENT_MAP": "envmap_radiance",
        "VOLPATH": "paths->null_bounces",
        "MEDIA": "sample_medium",
        "HETEROGENEOUS": "sample_heterogeneous_medium",
        "NEXT_EVENT": "direct_lighting",
        "LIGHT_LIST": "select_from_list",
        "RUSSIAN_ROULETTE": "survival",
    },
    "stages/intersect.cl": {
        "TRIANGLES": "intersect_triangles",
        "SPHERES": "sphere_distance",
        "DISKS": "disk_distance",
        "CYLINDERS": "cylinder_distance",
        "INSTANCES": "ray_to_object",
    },
    "stages/shadow.cl": {
        "TRIANGLES": "intersect_triangles",
        "SPHERES": "sphere_distance",
        "DISKS": "disk_distance",
        "CYLINDERS": "cylinder_distance",
        "INSTANCES": "ray_to_object",
    },
    "stages/shadow_transmittance.cl": {
        "TRIANGLES": "intersect_triangles",
        "SPHERES": "sphere_distance",
        "INSTANCES": "ray_to_object",
        "MEDIA": "medium_transmittance",
        "HETEROGENEOUS": "heterogeneous_transmittance",
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
    "stages/accumulate_layers.cl": {
        "ALBEDO_LAYER": "albedo_of",
        "ANALYTICS": "analytic_surface",
        "UVS": "triangle_uv",
        "INSTANCES": "instanced_surface_of_hit",
    },
    "stages/summarise.cl": {"CHUNK_MEDIANS": "medians", "POWER_MEAN": "powers", "HALF_BUFFER": "halves"},
}


@pytest.mark.parametrize(
    ("file", "lanes", "never"),
    [
        *(pytest.param(file, 1, (), id=file) for file in STAGES),
        *(pytest.param(file, 64, ("VOLPATH", "MEDIA", "HETEROGENEOUS"), id=f"{file}, many") for file in LANE_STAGES),
    ],
)
def test_every_feature_of_a_stage_changes_its_text(file, lanes, never):
    """With all other features on or off, because some share their code. A feature's markers are absent without it."""
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


analysed: dict[tuple, tuple[set, set]] = {}
"""What texts define, and what of that is in use: by stage, where it matters LANES, and the features that are on."""


@pytest.mark.parametrize("lanes", [1, 64])
def test_features_that_are_off_leave_no_code(lanes):
    """Functions, types and tables that are present without a feature are used without it in one of the programs.

    Tested with each feature off, and with each alone in a simple scene.
    """
    never = ("VOLPATH", "MEDIA", "HETEROGENEOUS") if lanes > 1 else ()
    names = [name for name in FEATURES if name not in never]
    sets = {"all": all_but(*never)}
    sets |= {f"all but {name}": all_but(*never, name) for name in names}
    sets |= {f"{name} alone": only(*BASE_FEATURES, name) for name in names}
    present: dict[str, set] = {label: set() for label in sets}
    used: dict[str, set] = {label: set() for label in sets}
    files = STAGES
    for file in files:
        if file in ONE_LANE_STAGES and lanes > 1:
            continue
        mentioned = features_in(file)
        labels = defaultdict(list)
        for label, set_ in sets.items():
            labels[frozenset(name for name in mentioned if set_[name])].append(label)
        kind = (file, lanes if re.search(r"\bLANES\b", flatten(file, generated_headers())) else None)
        new = {key: sets[of[0]] for key, of in labels.items() if (kind, key) not in analysed}
        for key, text in zip(new, preprocessed(file, list(new.values()), lanes), strict=True):
            found = definitions(text)
            analysed[kind, key] = set(found), reached(found)
        for key, of in labels.items():
            for label in of:
                present[label] |= analysed[kind, key][0]
                used[label] |= analysed[kind, key][1]
    ever = set().union(*used.values())
    of_features = {key for key in ever if key[0] not in GENERAL_HEADERS and key[1] not in PARAMETER_READERS | RECORDS}
    for label in sets:
        left = (present[label] - used[label]) & of_features
        assert not left, f"{label}: unused code: {sorted(left)}"
    dead = {key for key in present["all"] - ever if key[0] not in GENERAL_HEADERS and key[1] not in RECORDS}
    dead = {key for key in dead if lanes == 1 or key[1] not in SINGLE_LANE_FUNCTIONS}
    assert not dead, f"no program uses {sorted(dead)}"


def test_stages_named_for_a_feature_have_its_code():
    """`feature_costs` names the stages whose text contains the feature, at least one for each feature."""
    for feature in FEATURES:
        named = stages_with(feature)
        assert named
        for stage in named:
            assert feature in features_in(f"stages/{stage}.cl"), (feature, stage)
    assert cost("NEXT_EVENT", only("POINT_LIGHTS")).stages == ("shadow",)
    assert cost("VOLPATH", only("NEXT_EVENT")).stages == ("shadow_transmittance",)
    assert cost("VOLPATH", only("POINT_LIGHTS")).stages == ()
    assert cost("MEDIA", only("NEXT_EVENT", "VOLPATH")).path_bytes == 8
    assert cost("MEDIA", only("VOLPATH")).path_bytes == 4
    assert cost("HETEROGENEOUS", only("NEXT_EVENT", "MEDIA")).path_bytes == 8
    assert cost("HETEROGENEOUS", only("MEDIA")).path_bytes == 0
