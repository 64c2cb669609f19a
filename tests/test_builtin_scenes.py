"""The built-in scenes are frozen: strategies are measured on them, and a changed scene makes old figures worthless."""

import hashlib
import subprocess
import sys

import pytest

from isonoise.scene import builtin_scenes, compile_scene, load
from isonoise.scene.builtin import find_scene

FROZEN = {
    "bright-spots": "17312415919057caeeba8cd0a160195c68feaff9a56403ce5a0fa40ffbd4ac07",
    "cornell": "8124ccf32de76a9589230f95a4481363a6cf25d675748b88ec8787c15a2be882",
    "penumbra": "161b82133df269f5f8582bab460a4733fb6fed6a0e68ca8c33380acc13e3d723",
}
"""sha256 of each file with line ends as \\n. A better scene gets a new name; these stay."""

DEPTHS = {"bright-spots": (12, 8), "cornell": (8, 5), "penumbra": (6, 5)}
"""max_depth and rr_depth, as scenes/README.md states them."""


def test_every_scene_is_frozen():
    assert builtin_scenes() == sorted(FROZEN)


@pytest.mark.parametrize("name", FROZEN)
def test_scene_is_as_it_was(name):
    text = find_scene(name).read_text(encoding="utf-8")
    assert hashlib.sha256(text.encode("utf-8")).hexdigest() == FROZEN[name]


@pytest.mark.parametrize("name", FROZEN)
def test_scene_is_ready_for_measurements(name):
    scene = compile_scene(load(name))
    assert (scene.width, scene.height, scene.filter) == (256, 256, "box")
    assert (scene.max_depth, scene.rr_depth) == DEPTHS[name]
    assert scene.sample_count == 256
    assert compile_scene(load(name, {"spp": "7"})).sample_count == 7


@pytest.mark.parametrize("name", FROZEN)
def test_scene_opens_in_mitsuba(name):
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    # In a process of its own: Mitsuba and the OpenCL driver each bring libraries that the other need not meet.
    # Mitsuba raises an error on a parameter that it does not know.
    program = "import sys, mitsuba; mitsuba.set_variant('scalar_rgb'); mitsuba.load_file(sys.argv[1], spp='7')"
    subprocess.run([sys.executable, "-c", program, str(find_scene(name))], check=True)
