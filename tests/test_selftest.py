"""isonoise selftest: its checks pass, broken kernels fail them, and its JSON file has the documented fields."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from isonoise.cli import main
from isonoise.commands import selftest
from isonoise.device import program
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError
from isonoise.scene.structs import NONE
from isonoise.selftest import optics, statistics, surface_rays, tracer
from isonoise.selftest.cases import Case, Context, array_case, count_case
from isonoise.selftest.runner import GROUPS, run_groups

CHECKOUT = Path(__file__).resolve().parent.parent


QUICK_CHECKS = [
    pytest.param(check, id=f"{group}-{check.__name__}")
    for group in ("statistics", "allocation", "geometry")
    for check in GROUPS[group]
    if check not in (surface_rays.convex_bodies, surface_rays.closed_bodies, surface_rays.instances)
]
"""The checks that compile few kernels."""


@pytest.fixture
def context() -> Context:
    return Context(Device())


def failed(cases) -> list[str]:
    """The names of the failed cases."""
    return [case.name for case in cases if not case.passed]


@pytest.mark.parametrize("check", QUICK_CHECKS)
def test_quick_checks_pass(check, context):
    cases = list(check(context))
    assert cases
    assert [case for case in cases if not case.passed] == []
    assert all(case.tolerance_basis for case in cases)


@pytest.mark.long
def test_all_checks_pass_in_two_minutes(context):
    cases, cpu_s = [], 0.0
    for outcome in run_groups(GROUPS, context):
        if isinstance(outcome, Case):
            cases.append(outcome)
        else:
            cpu_s += outcome.cpu_s
    assert [case for case in cases if not case.passed] == []
    assert cpu_s < 2 * 120


def use_cases(monkeypatch, *cases, error: Exception | None = None) -> None:
    """Replaces the checks of the command by one that yields these cases, then raises the error."""

    def check(context):
        yield from cases
        if error:
            raise error

    monkeypatch.setattr(selftest, "GROUPS", {"group": (check,)})


GOOD, BAD = Case("good", 1.0, 1.5, 0.5, "a half"), Case("bad", 1.0, 1.6, 0.5, "a half")
NOT_A_NUMBER = Case("not a number", float("nan"), 0.0, 1.0, "one")


def test_a_case_passes_within_its_tolerance():
    assert [case.passed for case in (GOOD, BAD, NOT_A_NUMBER)] == [True, False, False]
    assert array_case("a", [1.0, 2.0, 3.0], [1.1, 2.0, 3.3], 0.5, "").measured == 3.0
    assert not array_case("a", [1.0, np.nan], 1.0, 0.5, "").passed
    assert not array_case("a", [np.inf, 1.0], 1.0, 0.5, "").passed
    assert array_case("a", [1.0, 1.1], 1.0, 0.0, "").measured == 1.1
    assert count_case("c", np.array([True, False, True]), "").measured == 2
    assert count_case("c", 3, "", 3).passed


def test_exit_codes(monkeypatch, capsys):
    use_cases(monkeypatch, GOOD)
    assert main(["selftest"]) == 0
    assert "1 cases, 0 failed" in capsys.readouterr().out
    for cases in ((GOOD, BAD), (NOT_A_NUMBER,)):
        use_cases(monkeypatch, *cases)
        assert main(["selftest"]) == 1
        assert "FAIL" in capsys.readouterr().out
    use_cases(monkeypatch, GOOD, error=DeviceError("the compiler gave up\nfor reasons"))
    assert main(["selftest"]) == 1
    assert "the compiler gave up" in capsys.readouterr().out
    assert main(["selftest", "--device", "no such device"]) == 2


def fields(value, path: str = "") -> set[str]:
    if isinstance(value, dict):
        return set().union(*(fields(item, f"{path}.{name}" if path else name) for name, item in value.items()))
    if isinstance(value, list):
        return set().union(*(fields(item, f"{path}[]") for item in value))
    return {path}


def test_json_has_the_documented_fields(monkeypatch, tmp_path):
    use_cases(monkeypatch, GOOD, BAD, NOT_A_NUMBER)
    assert main(["selftest", "--json", str(tmp_path / "a.json")]) == 1
    written = json.loads((tmp_path / "a.json").read_text())
    text = (CHECKOUT / "host" / "docs" / "numerics.md").read_text()
    table = text.split("| field | what it is |")[1]
    documented = set(re.findall(r"`([^`]+)`", " ".join(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE))))
    assert fields(written) == documented
    assert (written["case_count"], written["failed_count"]) == (3, 2)
    cases = written["groups"][0]["cases"]
    assert [case["passed"] for case in cases] == [True, False, False]
    assert cases[2]["measured"] is None


def test_json_that_cannot_be_written_fails_before_the_checks(monkeypatch, tmp_path, capsys):
    use_cases(monkeypatch, error=AssertionError("it began"))
    assert main(["selftest", "--json", str(tmp_path / "nowhere" / "a.json")]) == 2
    assert "no folder" in capsys.readouterr().err


@pytest.fixture
def break_kernel(monkeypatch):
    """Replaces a text in a kernel file."""
    kernel_source = program.kernel_source

    def replace(file: str, text: str, replacement: str) -> None:
        assert text in kernel_source(file)

        def changed(name):
            return kernel_source(name).replace(text, replacement) if name == file else kernel_source(name)

        monkeypatch.setattr(program, "kernel_source", changed)

    return replace


def test_plain_sums_fail(break_kernel, context):
    break_kernel(
        "util/compensated.h",
        "    return quick_two_sum(sum.high, sum.low + a.low);\n",
        "    const Compensated plain = {sum.high, 0.0f};\n    return plain;\n",
    )
    assert failed(statistics.large_mean(context))


def test_a_dropped_check_for_finite_numbers_fails(break_kernel, context):
    break_kernel(
        "stages/reduce.cl",
        "!(is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && x < LUMINANCE_LIMIT)",
        "x >= LUMINANCE_LIMIT",
    )
    assert any("NaN" in name for name in failed(statistics.rejected_samples(context)))


@pytest.mark.long
@pytest.mark.usefixtures("one_lane")
def test_a_wrong_sign_of_the_offset_fails(break_kernel, context):
    break_kernel(
        "util/math.h", "copy_sign(distance, dot3(direction, normal))", "copy_sign(distance, -dot3(direction, normal))"
    )
    bodies = ("sphere", "cylinder, its ends out of sight")
    cases = [surface_rays.convex_body(context, body, *surface_rays.SIZES[0]) for body in bodies]
    assert len(failed(cases)) == 2


def test_reference_functions():
    vertices, faces = tracer.icosphere(2)
    edges = tracer.unique_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler: closed
    assert (np.linalg.det(vertices[faces]) > 0).all()  # wound outwards
    origins, directions = np.zeros((3, 3)), np.eye(3)
    triangle = np.array([[[1.0, -1, -1], [1, 2, -1], [1, -1, 2]]])
    t, index = tracer.closest_hits(triangle, origins, directions)
    assert t.tolist() == [1.0, np.inf, np.inf]
    assert index.tolist() == [0, NONE, NONE]
    assert optics.metal_albedo(0.7, 1e-4) == pytest.approx(1, abs=1e-6)
    # straight from above Smith's G1(w) is 1: 2 / (1 + sqrt(1 + tan^2)) over half vectors, alpha 1, by quadrature
    theta = (np.arange(100_000) + 0.5) / 100_000 * np.pi / 4  # of h; o is below the surface beyond
    d_cos = 2 * np.cos(theta) * np.sin(theta)  # alpha 1: D is 1 / pi everywhere
    seen = 2 / (1 + 1 / np.cos(2 * theta))
    expected = (d_cos * seen).sum() * np.pi / 4 / 100_000
    assert optics.metal_albedo(1.0, 1.0) == pytest.approx(expected, rel=1e-4)
