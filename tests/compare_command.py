"""Shared by the tests of `isonoise compare`: the command in this process, its options, files of runs and references.

Scenes are tiny and budgets are samples, so that results can be compared bit by bit.
"""

import json
from pathlib import Path

import numpy as np

from isonoise.cli import main
from isonoise.film.exr import read_exr, write_exr

WIDTH, HEIGHT = 16, 12
SIZE = ("--size", f"{WIDTH}x{HEIGHT}")
STRATEGIES = ("uniform", "relative-mean")
TIMES = {"elapsed_s", "device_s", "setup_s"}
"""Fields that differ between two equal runs."""


def compare(*arguments, scene="cornell"):
    """Exit code of `isonoise compare`, run in this process."""
    scenes = [scene] if scene else []
    try:
        return main(["compare", *scenes, *map(str, arguments)])
    except SystemExit as exit_:  # how argparse ends
        return exit_.code


def options(directory, strategies=STRATEGIES, seeds=2, spp=8):
    return (*SIZE, "--spp", spp, "--strategies", ",".join(strategies), "--seeds", seeds, "-o", directory)


def write_flat_reference(path, size=(WIDTH, HEIGHT)):
    rgb = np.random.default_rng(1).uniform(0.2, 1, (size[1], size[0], 3)).astype(np.float32)
    write_exr(path, {"": rgb, "stderr": 0.01 * rgb}, {})
    return rgb


def run_files(directory) -> dict[str, Path]:
    return {str(path.relative_to(directory)): path for path in sorted(Path(directory).glob("runs/*/*/[0-9]*.npz"))}


def read_run(path) -> dict[str, object]:
    """Content of a run's file without times."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name != "snapshot_s"}
    content["rows"] = [
        {name: value for name, value in row.items() if name not in TIMES} for row in json.loads(str(content["rows"]))
    ]
    content["facts"] = {name: value for name, value in json.loads(str(content["facts"])).items() if name not in TIMES}
    return content


def assert_same_runs(directory, other):
    """Both comparisons have the same runs and references, bit by bit."""
    files, others = run_files(directory), run_files(other)
    assert list(files) == list(others)
    for name, path in files.items():
        a, b = read_run(path), read_run(others[name])
        assert a.keys() == b.keys()
        for key, value in a.items():
            if isinstance(value, np.ndarray):
                assert value.tobytes() == b[key].tobytes(), (name, key)
            else:
                assert repr(value) == repr(b[key]), (name, key)  # repr: nan is nan
    for path in Path(directory).glob("references/*"):
        channels, same = (read_exr(folder / "references" / path.name)[0] for folder in (Path(directory), Path(other)))
        assert channels.keys() == same.keys()
        assert all(plane.tobytes() == same[name].tobytes() for name, plane in channels.items())
