"""Programs with more features than a scene uses: to test that they change no picture, and to measure their cost."""

from collections.abc import Mapping

import numpy as np

from isonoise.device.opencl import Device
from isonoise.integrator.features import FEATURES
from isonoise.integrator.kernel_table import kernel_table
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.envmap import ENVIRONMENT

DUMMY_BYTES = 4096
"""Bytes of a buffer in place of one that a feature asks for and the scene has nothing for: room for any record."""

CHOICES = ("LIGHT_TREE", "LIGHT_LIST", "HIDE_EMITTERS", "FILTER_TABLE", "COUNT_TESTS")
"""Features that stand for another way to compute, not for something that a scene may hold beside others."""


def feature_superset(used: Mapping[str, bool], volpath: bool) -> dict[str, bool]:
    """All features that may be on without a use for them in a scene that uses `used`.

    That is all but `CHOICES`, which stay as they are; and, unless `volpath`, the features of that integrator, with
    which a work-item takes one path.
    """
    left = {*CHOICES, *(() if volpath else ("VOLPATH", "MEDIA"))}
    return {name: used[name] if name in left else True for name in FEATURES}


def dummy_buffers(
    device: Device,
    scene: CompiledScene,
    features: Mapping[str, bool],
    arguments: Mapping[str, object],
    brute_force: bool,
) -> dict[str, object]:
    """The arguments of kernels that `features` ask for and `arguments`, of the scene, have not.

    `brute_force`: whether it has so few primitives that there is no hierarchy.

    Kernels look for no other sky once the feature is on: one stands in that is black and never picked.
    """
    taken = {name for row in kernel_table(features, brute_force).values() for name in row.arguments}
    names = taken & {name for feature, on in features.items() if on for name in FEATURES[feature].buffers}
    missing = sorted(name for name in names if arguments.get(name) is None)
    added: dict[str, object] = {name: device.buffer(DUMMY_BYTES, "what the scene does not use") for name in missing}
    if (features["CONSTANT_LIGHT"] or features["ENVIRONMENT_MAP"]) and scene.environment_light < 0:
        sky = np.zeros(1, structs.LIGHT)
        sky["kind"] = structs.LIGHT_CONSTANT if features["CONSTANT_LIGHT"] else structs.LIGHT_ENVIRONMENT_MAP
        added["lights"] = device.buffer(np.concatenate([scene.lights, sky]), "the lights")
        added["environment_light"] = np.uint32(len(scene.lights))
        if features["ENVIRONMENT_MAP"]:
            map_ = np.zeros(1, ENVIRONMENT)
            map_["size"] = 1, 2
            added["environment"] = device.buffer(map_, "the environment map")
    return added
