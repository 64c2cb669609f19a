"""The built-in scenes must not change, because published measurements of strategies refer to them."""

import hashlib
import subprocess
import sys

import pytest

from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.scene.builtin import find_scene

SHA256 = {
    "bright-spots": "6f9ef43a3c1e3de5621910c3efc54e00e934fad71d48dd579039e511cec3ecb3",
    "cornell": "169a51f4e51b358c5dc15f9e2ed10e83ede77dbce878cc67d5ef7a5e095906fc",
    "glass-roof": "eb3ae40204ab66049db16cddcc1e5ba2b28300c85e7f21c79211fe0d8c83bc5f",
    "penumbra": "41a919ce1ff7b7643b2e30ce72e788ca9bb03c69f0e2b6beee323aeaa2702c5f",
}
"""sha256 of each file with \\n line ends. An improved scene needs a new name."""

DEPTHS = {"bright-spots": (12, 8), "cornell": (8, 5), "glass-roof": (12, 8), "penumbra": (6, 5)}
"""max_depth and rr_depth, as scenes/README.md states them."""


def test_every_scene_has_a_hash():
    assert builtin_scenes() == sorted(SHA256)


@pytest.mark.parametrize("name", SHA256)
def test_scene_is_unchanged(name):
    text = find_scene(name).read_text(encoding="utf-8")
    assert hashlib.sha256(text.encode("utf-8")).hexdigest() == SHA256[name]


@pytest.mark.parametrize("name", SHA256)
def test_scene_has_the_documented_settings(name):
    scene = compile_scene(load_description(name))
    assert (scene.width, scene.height, scene.filter) == (256, 256, "box")
    assert (scene.max_depth, scene.rr_depth) == DEPTHS[name]
    assert scene.sample_count == 256
    assert compile_scene(load_description(name, {"spp": "7"})).sample_count == 7


@pytest.mark.parametrize("name", SHA256)
def test_scene_loads_in_mitsuba(name):
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    # In a separate process, because the libraries of Mitsuba and of the OpenCL driver may conflict.
    # Mitsuba raises an error for an unknown parameter.
    program = "import sys, mitsuba; mitsuba.set_variant('scalar_rgb'); mitsuba.load_file(sys.argv[1], spp='7')"
    subprocess.run([sys.executable, "-c", program, str(find_scene(name))], check=True)
