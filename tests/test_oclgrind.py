"""Renders under Oclgrind (checked_render.py): none has a fault, and deliberate faults are found."""

import os
import shutil
import subprocess

import checked_render
import pytest
from checked_render import CASES, FAULTS, WRITTEN_BY_KERNELS
from small_scene import lamp_over_floor

from isonoise.device.opencl import Device
from isonoise.device.program import kernel_source
from isonoise.device.program_cache import FOLDER_VARIABLE
from isonoise.integrator.brute_force import use_brute_force
from isonoise.integrator.features import FEATURES, features, statistics_features
from isonoise.renderer import Renderer
from isonoise.scene import compile_scene, load_description
from isonoise.statistics import BASIC_NEEDS
from isonoise.strategies import make_strategy


@pytest.fixture(scope="module")
def oclgrind() -> None:
    if not shutil.which("oclgrind"):
        pytest.skip("oclgrind is not installed: apt install oclgrind")


def run(*arguments: str) -> list[str]:
    """Oclgrind's reports about a render."""
    environment = os.environ | {FOLDER_VARIABLE: "off"}
    done = subprocess.run(checked_render.oclgrind_command(*arguments), env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    assert f"rendered {arguments[0]}" in done.stdout
    return checked_render.fault_reports(done.stderr)


@pytest.mark.parametrize("many", [False, True])
def test_the_cases_cover_every_feature(many, tmp_path):
    without = {"COUNT_TESTS"}
    if many:  # no kernels with many paths per work-item have these
        without |= {"VOLPATH", "MEDIA", "HETEROGENEOUS", "NULL", *statistics_features(BASIC_NEEDS)}
    seen, kinds = set(), set()
    for number, case in enumerate(case for case in CASES.values() if case.many == many):
        scene = compile_scene(load_description(case.source(tmp_path / str(number))))
        needs = make_strategy(case.strategy).needs.with_sampler(scene.sampler).with_layers(case.layers)
        on = features(scene, needs)
        if many and on["VOLPATH"]:
            continue
        seen |= {name for name, value in on.items() if value}
        kinds.add(use_brute_force(scene))
    assert set(FEATURES) - seen <= without
    assert kinds == {False, True}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_change_a_kernel(fault):
    file, before, _, _ = FAULTS[fault]
    assert before in kernel_source(file)


def test_buffers_written_by_kernels_are_allocated(monkeypatch):
    labels = set()
    buffer = Device.buffer

    def note_label(self, content, label):
        labels.add(label)
        return buffer(self, content, label)

    monkeypatch.setattr(Device, "buffer", note_label)
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})
    Renderer(lamp_over_floor())
    assert set(WRITTEN_BY_KERNELS) <= labels


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_renders_have_no_faults(oclgrind, case):
    assert not run(case)


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_deliberate_faults_are_found(oclgrind, fault):
    found = run("lamp", fault)
    assert any(FAULTS[fault][-1] in report for report in found)
