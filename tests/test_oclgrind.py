"""Kernels under a checker of memory, races and uninitialised values (checked_render.py): none is found, faults are."""

import os
import shutil
import subprocess

import checked_render
import pytest
from checked_render import CASES, FAULTS

from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.integrator.brute_force import use_brute_force
from isonoise.integrator.features import FEATURES, features, statistics_features
from isonoise.scene import compile_scene, load
from isonoise.statistics import BASIC_NEEDS
from isonoise.strategies import make_strategy


@pytest.fixture(scope="module")
def oclgrind() -> None:
    if not shutil.which("oclgrind"):
        pytest.skip("there is no oclgrind: apt install oclgrind")


def run(*arguments: str) -> list[str]:
    """What Oclgrind finds in a render."""
    environment = os.environ | {FOLDER_VARIABLE: "off"}
    done = subprocess.run(checked_render.under_oclgrind(*arguments), env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    assert f"rendered {arguments[0]}" in done.stdout
    return checked_render.findings(done.stderr)


@pytest.mark.parametrize("many", [False, True])
def test_the_cases_have_every_feature(many, tmp_path):
    without = {"COUNT_TESTS"}
    if many:  # there are no such kernels
        without |= {"VOLPATH", "MEDIA", "NULL", *statistics_features(BASIC_NEEDS)}
    seen, kinds = set(), set()
    for number, case in enumerate(case for case in CASES.values() if case.many == many):
        scene = compile_scene(load(case.source(tmp_path / str(number))))
        on = features(scene, make_strategy(case.strategy).needs)
        if many and on["VOLPATH"]:
            continue
        seen |= {name for name, value in on.items() if value}
        kinds.add(use_brute_force(scene))
    assert set(FEATURES) - seen <= without
    assert kinds == {False, True}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_nothing_is_found(oclgrind, case):
    assert not run(case)


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_found(oclgrind, fault):
    found = run("lamp", fault)
    assert any(FAULTS[fault][-1] in report for report in found)
