"""A new kind of BSDF or light takes a kernel header, a row in the table of kinds, and a plugin in the vocabulary.

Each test adds a kind to a copy of the package by these three edits and renders with it in a process of its own.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isonoise.device.form import FORM_VARIABLE
from isonoise.errors import SceneError
from isonoise.scene.light.light_kinds import AREA
from isonoise.scene.light.light_kinds import KIND_OF_PLUGIN as LIGHT_OF_PLUGIN
from isonoise.scene.light.lights import emitted, emitter_light
from isonoise.scene.material.bsdf_kinds import KIND_OF_PLUGIN as BSDF_OF_PLUGIN
from isonoise.scene.material.bsdf_kinds import KINDS as BSDF_KINDS
from isonoise.scene.material.bsdf_kinds import select as select_bsdfs
from isonoise.scene.vocabulary import plugins_of

CHECKOUT = Path(__file__).resolve().parent.parent
MAX_EDITS, MAX_FILES = 5, 4
"""Limits for everything that a contributor touches, the test of the new kind included."""

CHALK = """// Diffuse reflection, for a test.
#pragma once
#include "bsdf/context.h"

#if FEATURE_CHALK
#if FEATURE_NEXT_EVENT
INLINE Vec3 chalk_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(ctx->normal, wo);
    *pdf = ctx->cos_i > 0.0f && cos_o > 0.0f ? cos_o * M_1_PI_F : 0.0f;
    return scale3(bsdf_rgb(ctx, SLOT_CHALK_COLOUR), *pdf * material(ctx).constants[CONSTANT_CHALK_BRIGHTNESS]);
}
#endif

INLINE BsdfSample chalk_sample(const BsdfContext* ctx, Vec3 u)
{
    const Vec3 about_z = square_to_hemisphere(vec2(u.y, u.z));
    BsdfSample sample = empty_bsdf_sample();
    if (!(ctx->cos_i > 0.0f && about_z.z > 0.0f)) return sample;
    sample.direction = rotate_to_normal(ctx->normal, about_z);
    sample.weight = scale3(bsdf_rgb(ctx, SLOT_CHALK_COLOUR), material(ctx).constants[CONSTANT_CHALK_BRIGHTNESS]);
    sample.pdf = about_z.z * M_1_PI_F;
    return sample;
}
#endif
"""
CHALK_ROW = """    BsdfKind(
        name="chalk",
        description="chalk",
        plugin="chalk",
        slots=(Slot("colour"),),
        constants={"brightness": lambda bsdf, tables: bsdf["brightness"]},
    ),
"""
CHALK_PLUGIN = """    Plugin(
        "bsdf",
        "chalk",
        (_colour("colour", 0.5, "colour"), P("brightness", "float", 1.0, "[0, 1]", meaning="factor on the colour")),
        meaning="like diffuse",
    ),
"""
TORCH = """// A point that emits a cosine around an axis, for a test.
#pragma once
#include "light/light_sample.h"

#if FEATURE_NEXT_EVENT && FEATURE_TORCH_LIGHTS
INLINE void sample_torch_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, LightSample* sample)
{
    sample->position = LOAD3(0, light->position);
    const Vec3 arm = sub3(sample->position, reference);
    sample->direction = normalize3(arm);
    const float cosine = MAX(-dot3(sample->direction, LOAD3(0, light->axis)), 0.0f);
    sample->radiance = scale3(sample->radiance, cosine / dot3(arm, arm));
    sample->is_delta = true;
}
#endif
"""
TORCH_ROW = """    LightKind(
        name="torch",
        feature="TORCH_LIGHTS",
        description="torches",
        plugin="torch",
        emission="intensity",
        power_factor=lambda lights, radius: np.pi,
        bounds=light_bounds.point_bounds,
        record=lambda emitter: {"position": _to_world(emitter)[:3, 3], "axis": _unit(_to_world(emitter)[:3, 2])},
    ),
"""
TORCH_PLUGIN = """    Plugin(
        "emitter",
        "torch",
        (P("intensity", "radiance", 1.0, meaning="radiant intensity along +z, W / sr"), *TO_WORLD),
        meaning="a point that emits a cosine around +z",
    ),
"""

# A sphere of reflectance 0.8 * 0.5 in an environment of radiance 1, over one bounce.
CHALK_SCENE = """
scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 2},
    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}},
    "ball": {"type": "sphere", "center": [0, 0, 4], "radius": 3.0,
             "bsdf": {"type": "chalk", "colour": 0.8, "brightness": 0.5}},
    "environment": {"type": "constant", "radiance": 1.0},
}
rgb = isonoise.render(scene, spp=256, strategy="uniform").statistics.rgb
assert abs(rgb - 0.4).max() < 0.02, rgb
"""

# A wall that faces the torch at a distance of 2: irradiance is intensity * cos^4 / 4, radiance that times 0.5 / pi.
TORCH_SCENE = """
to_wall = numpy.diag([-9.0, 9.0, -1.0, 1.0])
to_wall[2, 3] = 2.0
scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 2},
    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 5, "height": 5, "rfilter": {"type": "box"}}},
    "wall": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.5},
             "to_world": to_wall},
    "torch": {"type": "torch", "intensity": 8.0, "to_world": numpy.eye(4)},
}
centre = isonoise.render(scene, spp=256, strategy="uniform").statistics.rgb[2, 2]
assert abs(centre - 8.0 / 4 * 0.5 / numpy.pi).max() < 0.02, centre
"""


def add_kind(folder: Path, edits: list[tuple[str, str, str]]) -> None:
    """Copies the package to `folder` and applies edits: (file, line before which the text goes, '' to create; text)."""
    ignored = shutil.ignore_patterns("__pycache__", "gallery")
    shutil.copytree(CHECKOUT / "host" / "isonoise", folder / "isonoise", ignore=ignored)
    for name in ("kernels", "scenes"):
        shutil.copytree(CHECKOUT / name, folder / "isonoise" / name, ignore=ignored)
    for file, before, text in edits:
        path = folder / "isonoise" / file
        if before:
            content = path.read_text()
            assert content.count(before) == 1, f"{file}: {before}"
            text = content.replace(before, text + before)
        else:
            assert not path.exists()
        path.write_text(text)


def run(folder: Path, lines: str, form: str) -> None:
    """Runs Python with the copied package."""
    script = f"import isonoise, numpy\nassert isonoise.__file__.startswith({str(folder)!r})\n{lines}"
    environment = os.environ | {"PYTHONPATH": str(folder), FORM_VARIABLE: form}
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "form", [pytest.param("", id="default"), pytest.param("cpu", id="one path a work-item", marks=pytest.mark.long)]
)
@pytest.mark.parametrize(
    ("edits", "scene"),
    [
        pytest.param(
            [
                ("kernels/bsdf/chalk.h", "", CHALK),
                ("scene/material/bsdf_kinds.py", '    BsdfKind(\n        name="dielectric",', CHALK_ROW),
                ("scene/vocabulary/bsdfs.py", '    Plugin("bsdf", "dielectric",', CHALK_PLUGIN),
            ],
            CHALK_SCENE,
            id="bsdf",
        ),
        pytest.param(
            [
                ("kernels/light/torch_light.h", "", TORCH),
                ("scene/light/light_kinds.py", '    LightKind(\n        name="point",', TORCH_ROW),
                ("scene/vocabulary/emitters.py", '    Plugin(\n        "emitter",\n        "point",', TORCH_PLUGIN),
            ],
            TORCH_SCENE,
            id="delta light",
        ),
    ],
)
def test_a_new_kind_takes_a_header_a_row_and_a_plugin(tmp_path, edits, scene, form):
    assert len(edits) + 1 <= MAX_EDITS
    assert len({file for file, _, _ in edits}) + 1 <= MAX_FILES
    add_kind(tmp_path, edits)
    run(tmp_path, scene, form)


def test_plugins_and_rows_belong_together():
    assert set(BSDF_OF_PLUGIN) == set(plugins_of("bsdf"))
    assert {AREA, *LIGHT_OF_PLUGIN} == set(plugins_of("emitter"))


def test_rows_with_a_plastic_base_have_its_parameters_at_the_same_positions():
    """kernels/bsdf/plastic_base.h reads them by the numbers of the kind `plastic`."""
    base = BSDF_KINDS["plastic"].slots
    assert [slot.name for slot in base] == ["specular_reflectance", "diffuse_reflectance", "ior"]
    for kind in select_bsdfs(lambda kind: "PLASTIC_BASE" in kind.helpers):
        assert kind.slots[: len(base)] == base, kind.name
        assert next(iter(kind.constants)) == "inner_reflectance", kind.name


def test_an_emitter_without_a_row_is_an_error():
    for compile_emitter in (emitted, lambda emitter: emitter_light(emitter, np.ones(3))):
        with pytest.raises(SceneError, match="'torch' has no row in light_kinds"):
            compile_emitter({"type": "torch", "intensity": 1.0})
