"""Memory: bounded by the image and the pool, not by the samples."""

import json
import subprocess
import sys
import tracemalloc

import pytest

from isonoise.scene import compile_scene, load_description

WIDTH, HEIGHT = 3000, 2000
LIMIT = 2 * 2**30

# The process prints its own peak: RUSAGE_CHILDREN would give the largest child of the whole test run.
PROGRAM = """
import json, resource, sys
from isonoise.cli import main
code = main(sys.argv[1:])
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps({"code": code, "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit}))
"""


@pytest.mark.long
def test_8k_fits_in_four_gibibytes(tmp_path):
    """33 million pixels with well-distributed samples: two waves and the image file, in a process of its own.

    With 9 samples per pixel all planes of the statistics have been written.
    """
    pytest.importorskip("resource", reason="no peak memory of a process on this system")
    arguments = ["render", "cornell", "--size", "7680x4320", "--spp", "9", "-o", str(tmp_path / "8k.exr")]
    arguments += ["--strategy", "uniform:warmup=8", "--memory", "4G", "--json"]
    done = subprocess.run([sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    outcome, process = (json.loads(line) for line in done.stdout.splitlines())
    assert process["code"] == 0
    assert outcome["samples"] == 9 * 7680 * 4320
    assert process["peak"] < 4 * 2**30, f"{process['peak'] / 2**30:.2f} GiB"


@pytest.mark.long
def test_a_large_image_fits_in_two_gibibytes(tmp_path):
    """6 million pixels with chunk medians: a uniform wave, an adaptive wave and the image file.

    On a CPU the device's memory is the process's own: 100 bytes a pixel, 0.6 GB here, for statistics and allocation.
    """
    pytest.importorskip("resource", reason="no peak memory of a process on this system")

    arguments = ["render", "cornell", "--size", f"{WIDTH}x{HEIGHT}", "--spp", "3", "-o", str(tmp_path / "large.exr")]
    arguments += ["--strategy", "relative-median:warmup=2", "--json"]
    done = subprocess.run([sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    outcome, process = (json.loads(line) for line in done.stdout.splitlines())
    assert process["code"] == 0
    assert outcome["samples"] == 3 * WIDTH * HEIGHT
    assert outcome["last_wave"]["kind"] == "adaptive"
    assert (tmp_path / "large.exr").stat().st_size > 0
    assert process["peak"] < LIMIT, f"{process['peak'] / 2**30:.2f} GiB"


MAX_BYTES_PER_SHAPE = 1200
"""Of a sphere: 140 in the compiled arrays, which are there twice for a moment, about 500 in the description, and a
thousand shapes of temporaries."""


def test_memory_of_many_shapes(tmp_path):
    count = 3000
    sphere = '<shape type="sphere"><point name="center" x="{}" y="0" z="9"/><float name="radius" value="0.1"/></shape>'
    scene = '<scene version="3.0.0"><sensor type="perspective"/>' + "".join(sphere.format(i) for i in range(count))
    path = tmp_path / "spheres.xml"
    path.write_text(scene + "</scene>")
    compile_scene(load_description("cornell"))  # what is imported and cached at the first scene
    tracemalloc.start()
    try:
        compiled = compile_scene(load_description(path))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(compiled.analytics) == count
    assert peak < MAX_BYTES_PER_SHAPE * count, f"{peak / count:.0f} bytes per shape"
