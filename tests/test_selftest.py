"""isonoise selftest: cases pass, broken kernels fail them, and what is written is what is documented."""

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
from isonoise.selftest import optics, rays, statistics, surfaces
from isonoise.selftest.core import FAIL, PASS, Bench, Case, count, run_groups, worst

CHECKOUT = Path(__file__).resolve().parent.parent


def verdicts(cases) -> dict[str, str]:
    return {case.name: case.verdict for case in cases}


def use(monkeypatch, *cases, error: Exception | None = None) -> None:
    """Has the command run one group of these cases, and an error at its end."""

    def group(bench):
        yield from cases
        if error:
            raise error

    monkeypatch.setattr(selftest, "groups", lambda: {"made": group})


GOOD, BAD = Case("good", 1.0, 1.5, 0.5, "a half"), Case("bad", 1.0, 1.6, 0.5, "a half")
NOTHING = Case("nothing", float("nan"), 0.0, 1.0, "one")


def test_a_case_is_judged_by_its_tolerance():
    assert [case.verdict for case in (GOOD, BAD, NOTHING)] == [PASS, FAIL, FAIL]
    assert worst("w", [1.0, 2.0, 3.0], [1.1, 2.0, 3.3], 0.5, "").measured == 3.0
    assert worst("w", [1.0, np.nan], 1.0, 0.5, "").verdict == FAIL
    assert worst("w", [np.inf, 1.0], 1.0, 0.5, "").verdict == FAIL
    assert worst("w", [1.0, 1.1], 1.0, 0.0, "").measured == 1.1
    assert count("c", np.array([True, False, True]), "").measured == 2
    assert count("c", 3, "", 3).verdict == PASS


def test_exit_codes(monkeypatch, capsys):
    use(monkeypatch, GOOD)
    assert main(["selftest"]) == 0
    assert "1 cases, 0 failed" in capsys.readouterr().out
    for cases in ((GOOD, BAD), (NOTHING,)):
        use(monkeypatch, *cases)
        assert main(["selftest"]) == 1
        assert FAIL in capsys.readouterr().out
    use(monkeypatch, GOOD, error=DeviceError("the compiler gave up\nfor reasons"))
    assert main(["selftest"]) == 1
    assert "the compiler gave up" in capsys.readouterr().out
    assert main(["selftest", "--device", "no such device"]) == 2


def test_a_case_that_goes_on_has_its_whole_name(capsys):
    def group(bench):
        yield Case("subject: mean", 0, 0, 0, "")
        yield Case("... variance", 0, 0, 0, "")

    names = [outcome.name for outcome in run_groups({"g": group}, Bench(Device()))]
    assert names == ["subject: mean", "subject: variance", "g"]


def fields(value, path: str = "") -> set[str]:
    if isinstance(value, dict):
        return set().union(*(fields(item, f"{path}.{name}" if path else name) for name, item in value.items()))
    if isinstance(value, list):
        return set().union(*(fields(item, f"{path}[]") for item in value))
    return {path}


def test_the_json_is_what_is_documented(monkeypatch, tmp_path):
    use(monkeypatch, GOOD, BAD, NOTHING)
    assert main(["selftest", "--json", str(tmp_path / "a.json")]) == 1
    written = json.loads((tmp_path / "a.json").read_text())
    text = (CHECKOUT / "host" / "docs" / "numerics.md").read_text()
    table = text.split("| field | what it is |")[1]
    documented = set(re.findall(r"`([^`]+)`", " ".join(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE))))
    assert fields(written) == documented
    assert (written["cases"], written["failed"]) == (3, 2)
    cases = written["groups"][0]["cases"]
    assert [case["verdict"] for case in cases] == [PASS, FAIL, FAIL]
    assert cases[2]["measured"] is None


def test_json_that_cannot_be_written_is_found_out_before_the_work(monkeypatch, tmp_path, capsys):
    use(monkeypatch, error=AssertionError("it began"))
    assert main(["selftest", "--json", str(tmp_path / "nowhere" / "a.json")]) == 2
    assert "no folder" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["statistics", "allocation"])
def test_the_quick_groups_pass(name):
    cases = list(selftest.groups()[name](Bench(Device())))
    assert len(cases) > 20
    assert [case for case in cases if case.verdict != PASS] == []
    assert all(case.basis for case in cases)


@pytest.mark.long
def test_all_groups_pass_in_two_minutes():
    cases, seconds = [], 0.0
    for outcome in run_groups(selftest.groups(), Bench(Device())):
        if isinstance(outcome, Case):
            cases.append(outcome)
        else:
            seconds += outcome.cpu_seconds
    assert [case for case in cases if case.verdict != PASS] == []
    assert seconds < 2 * 120


@pytest.fixture
def broken(monkeypatch):
    """Has a kernel file read with one text in place of another."""
    kernel_source = program.kernel_source

    def break_it(file: str, text: str, by: str) -> None:
        assert text in kernel_source(file)

        def changed(name):
            return kernel_source(name).replace(text, by) if name == file else kernel_source(name)

        monkeypatch.setattr(program, "kernel_source", changed)

    return break_it


def test_plain_sums_fail(broken):
    broken(
        "util/compensated.h",
        "    return quick_two_sum(sum.high, sum.low + a.low);\n",
        "    const Compensated plain = {sum.high, 0.0f};\n    return plain;\n",
    )
    failed = [name for name, verdict in verdicts(statistics._large_mean(Bench(Device()))).items() if verdict == FAIL]
    assert failed


def test_a_dropped_check_for_finite_numbers_fails(broken):
    broken(
        "stages/reduce.cl",
        "!(is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && x < LUMINANCE_LIMIT)",
        "x >= LUMINANCE_LIMIT",
    )
    failed = [name for name, verdict in verdicts(statistics._rejected(Bench(Device()))).items() if verdict == FAIL]
    assert any("NaN" in name for name in failed)


def test_a_wrong_sign_of_the_offset_fails(broken):
    broken(
        "util/math.h", "with_sign(distance, dot3(direction, normal))", "with_sign(distance, -dot3(direction, normal))"
    )
    cases = verdicts(surfaces._convex(Bench(Device()), *surfaces.SIZES[0]))
    assert list(cases.values()).count(FAIL) >= 2


def test_references_of_the_cases():
    vertices, faces = rays.icosphere(2)
    edges = rays.edges_of(faces)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler: closed
    assert (np.linalg.det(vertices[faces]) > 0).all()  # wound outwards
    origins, directions = np.zeros((3, 3)), np.eye(3)
    triangle = np.array([[[1.0, -1, -1], [1, 2, -1], [1, -1, 2]]])
    assert rays.closest(triangle, origins, directions).tolist() == [1.0, np.inf, np.inf]
    assert optics.metal_albedo(0.7, 1e-4) == pytest.approx(1, abs=1e-6)
    # straight from above Smith's G1(w) is 1: 2 / (1 + sqrt(1 + tan^2)) over half vectors, alpha 1, by quadrature
    theta = (np.arange(100_000) + 0.5) / 100_000 * np.pi / 4  # of h; o is below the surface beyond
    d_cos = 2 * np.cos(theta) * np.sin(theta)  # alpha 1: D is 1 / pi everywhere
    seen = 2 / (1 + 1 / np.cos(2 * theta))
    expected = (d_cos * seen).sum() * np.pi / 4 / 100_000
    assert optics.metal_albedo(1.0, 1.0) == pytest.approx(expected, rel=1e-4)
