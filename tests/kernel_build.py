"""Builds kernels that a test writes on top of the headers in kernels/, as stages are built."""

from collections.abc import Collection

import pytest

from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.integrator.features import FEATURES
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import CONSTANTS, STRUCTS


def build_kernels(device: Device, text: str, features: Collection[str], **constants: int) -> dict:
    """The kernels of a text, by name, with these features on and all others off; warnings are errors."""
    source = program.kernel_source
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "kernel_source", lambda name: text if name == "test.cl" else source(name))
        source_text, options = program.stage_source(
            "test.cl",
            STRUCTS,
            CONSTANTS | {"LANES": 1} | constants,
            {name: name in features for name in FEATURES},
            generated_headers(),
        )
    return device.build(source_text, (*options, "-Werror"))
