"""Every reader loads or rejects mutated files in bounded time and memory. See tests/fuzzing.py."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

fuzzing = pytest.importorskip("fuzzing", reason="this system has no process limits")

TESTS = Path(__file__).resolve().parent


def assert_all_pass(targets: list[str], first: int, count: int, folder: Path, timeout: float) -> None:
    """Run the inputs in a process of its own, with its own limits."""
    result = folder / "outcome.json"
    path = os.pathsep.join([str(TESTS), str(TESTS.parent / "host"), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, str(TESTS / "fuzzing.py"), ",".join(targets), str(first), str(count), str(result)]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, timeout=timeout, capture_output=True)
    last = done.stderr.decode("utf-8", "replace")[-2000:]
    assert done.returncode == 0, f"exit code {done.returncode} at the last input: {last}"
    failures = 0
    for target, outcome in json.loads(result.read_text()).items():
        for seed, problem in outcome["failures"][:3]:
            print(f"input {seed} of {target}:\n{problem}\n")
        failures += len(outcome["failures"])
        assert outcome["loaded"] + outcome["rejected"] + len(outcome["failures"]) == count
        assert outcome["rejected"] > 0  # mutations have an effect
    assert not failures, f"{failures} of {count * len(targets)} inputs"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits process memory in the way of Linux")
def test_mutated_files(tmp_path):
    assert_all_pass(list(fuzzing.TARGETS), 0, 15, tmp_path, 120)


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits process memory in the way of Linux")
@pytest.mark.parametrize("target", fuzzing.TARGETS)
def test_many_mutated_files(target, tmp_path):
    """ISONOISE_FUZZ inputs per target (default 5,000), from number ISONOISE_FUZZ_FIRST (default 100,000)."""
    first, count = int(os.environ.get("ISONOISE_FUZZ_FIRST", "100000")), int(os.environ.get("ISONOISE_FUZZ", "5000"))
    assert_all_pass([target], first, count, tmp_path, 3600)


def test_inputs_are_reproducible():
    for target in fuzzing.TARGETS:
        inputs = [fuzzing.make_input(target, seed) for seed in range(5)]
        assert inputs == [fuzzing.make_input(target, seed) for seed in range(5)]
        assert len(set(inputs)) > 3
