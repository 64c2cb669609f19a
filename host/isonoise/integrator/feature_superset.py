"""Kernels with more features than a scene uses.

`bench --specialisation` measures what they cost, and tests check that they change no image.
"""

from collections.abc import Mapping

import numpy as np

from isonoise.device.opencl import Device
from isonoise.integrator.features import FEATURES
from isonoise.integrator.kernel_table import kernel_table
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.envmap import ENVIRONMENT
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.material.media import uniform_records

DUMMY_BYTES = 4096
"""Size of a dummy buffer: room for any record."""

ALTERNATIVES = ("LIGHT_TREE", "LIGHT_LIST", "HIDE_EMITTERS", "FILTER_TABLE", "LAYERS", "ALBEDO_LAYER", "COUNT_TESTS")
"""Features that select another algorithm or other images. They stay as they are."""


def feature_superset(used: Mapping[str, bool], volpath: bool) -> dict[str, bool]:
    """All features on, except `ALTERNATIVES`, which stay as in `used`.

    Unless `volpath`, the features of the integrator `volpath` stay as they are too: with them a work-item shades one
    path.
    """
    unchanged = {*ALTERNATIVES, *(() if volpath else ("VOLPATH", "MEDIA", "HETEROGENEOUS"))}
    return {name: used[name] if name in unchanged else True for name in FEATURES}


def dummy_buffers(
    device: Device,
    scene: CompiledScene,
    features: Mapping[str, bool],
    arguments: Mapping[str, object],
    brute_force: bool,
) -> dict[str, object]:
    """Arguments that kernels built with `features` need and the scene does not have.

    Parameters
    ----------
    arguments : the arguments that the scene has, by name
    brute_force : whether rays are tested against all primitives, without the BVH

    Returns
    -------
    Argument name -> dummy buffer. Kernels with an environment feature read the environment light without a check, so
    a black one that is never selected is added.
    """
    used = {name for row in kernel_table(features, brute_force).values() for name in row.arguments}
    needed = used & {name for feature, on in features.items() if on for name in FEATURES[feature].buffers}
    missing = sorted(name for name in needed if arguments.get(name) is None)
    added: dict[str, object] = {name: device.buffer(DUMMY_BYTES, "dummy buffers") for name in missing}
    if "environment" in missing:  # many paths a work-item look up the map together, whatever light they selected
        record = np.zeros(1, ENVIRONMENT)
        record["size"] = 1, 2
        added["environment"] = device.buffer(record, "the environment map")
    if "heterogeneous_media" in missing:
        added["heterogeneous_media"] = device.buffer(uniform_records(max(len(scene.media), 1)), "the media")
    if (features["CONSTANT_LIGHT"] or features["ENVIRONMENT_MAP"]) and scene.environment_light < 0:
        light = np.zeros(1, structs.LIGHT)
        light["kind"] = light_bits("constant" if features["CONSTANT_LIGHT"] else "environment_map")
        added["lights"] = device.buffer(np.concatenate([scene.lights, light]), "the lights")
        added["environment_light"] = np.uint32(len(scene.lights))
    return added
