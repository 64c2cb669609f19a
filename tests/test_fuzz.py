"""Damaged files: every loader loads them or refuses them, in bounded time and memory (tests/fuzzing.py says how)."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

fuzzing = pytest.importorskip("fuzzing", reason="needs limits of a process, which this system has not")

TESTS = Path(__file__).resolve().parent


def assert_all_pass(targets: list[str], first: int, count: int, folder: Path, timeout: float) -> None:
    """Inputs in a process of their own, which is killed by nothing but its own limits, or by what it reads."""
    result = folder / "outcome.json"
    path = os.pathsep.join([str(TESTS), str(TESTS.parent / "host"), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, str(TESTS / "fuzzing.py"), ",".join(targets), str(first), str(count), str(result)]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, timeout=timeout, capture_output=True)
    last = done.stderr.decode("utf-8", "replace")[-2000:]
    assert done.returncode == 0, f"died with {done.returncode} of the last input: {last}"
    failures = 0
    for target, found in json.loads(result.read_text()).items():
        for seed, problem in found["failures"][:3]:
            print(f"input {seed} of {target}:\n{problem}\n")
        failures += len(found["failures"])
        assert found["loaded"] + found["refused"] + len(found["failures"]) == count
        assert found["refused"] > 0  # damage is damage
    assert not failures, f"{failures} of {count * len(targets)} inputs"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory of a process as Linux does")
def test_damaged_files(tmp_path):
    assert_all_pass(list(fuzzing.TARGETS), 0, 30, tmp_path, 120)


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory of a process as Linux does")
@pytest.mark.parametrize("target", fuzzing.TARGETS)
def test_many_damaged_files(target, tmp_path):
    """ISONOISE_FUZZ inputs a target (4,000), from ISONOISE_FUZZ_FIRST on (100,000): other numbers are other inputs."""
    first, count = int(os.environ.get("ISONOISE_FUZZ_FIRST", "100000")), int(os.environ.get("ISONOISE_FUZZ", "4000"))
    assert_all_pass([target], first, count, tmp_path, 3600)


def test_the_same_number_is_the_same_input():
    for target in fuzzing.TARGETS:
        inputs = [fuzzing.damaged(target, seed) for seed in range(5)]
        assert inputs == [fuzzing.damaged(target, seed) for seed in range(5)]
        assert len(set(inputs)) > 3
