"""`isonoise selftest`: run all groups, print a table as they go, write the cases."""

import argparse
import json
import math
from collections.abc import Iterable

from isonoise.commands import EXIT_DONE
from isonoise.device.opencl import Device
from isonoise.film.files import check_writable, write_atomically
from isonoise.selftest.core import PASS, Bench, Case, Group, GroupResult, run_groups

EXIT_FAILED = 1
SCHEMA = {"schema": "isonoise-selftest", "schema_version": 1}
_ROW = "{:<76} {:>14} {:>14} {:>10}  {}"


def run(options: argparse.Namespace) -> int:
    """Run as the options say; returns the exit code. Raises UserError for what is the user's to mend."""
    if options.json:
        check_writable(options.json)
    device = Device(options.device)
    print(f"{device.name}, driver {device.device.driver_version}", flush=True)
    results: list[GroupResult] = []
    for outcome in run_groups(groups(), Bench(device, options.device, options.thorough), _head):
        if isinstance(outcome, Case):
            print(_line(outcome), flush=True)
        else:
            results.append(outcome)
    cases = [case for group in results for case in group.cases]
    failed = [case for case in cases if case.verdict != PASS]
    seconds, cpu_seconds = (sum(getattr(group, name) for group in results) for name in ("seconds", "cpu_seconds"))
    print(
        f"\n{len(cases)} cases, {len(failed)} failed; {seconds:.0f} s, of which {cpu_seconds:.0f} s of this processor"
    )
    if options.json:
        text = json.dumps(document(device, results), indent=1, allow_nan=False) + "\n"
        write_atomically(options.json, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return EXIT_FAILED if failed else EXIT_DONE


def groups() -> dict[str, Group]:
    """Name -> cases, in the order in which they run."""
    from isonoise.selftest.adaptive import adaptive_cases
    from isonoise.selftest.allocation import allocation_cases
    from isonoise.selftest.geometry import geometry_cases
    from isonoise.selftest.statistics import statistics_cases
    from isonoise.selftest.transport import transport_cases

    return {
        "statistics": statistics_cases,
        "allocation": allocation_cases,
        "geometry": geometry_cases,
        "transport": transport_cases,
        "adaptive": adaptive_cases,
    }


def document(device: Device, results: Iterable[GroupResult]) -> dict:
    """What --json writes: host/docs/numerics.md, Self-test."""
    results = list(results)
    cases = [case for group in results for case in group.cases]
    return SCHEMA | {
        "device": {
            "name": device.device.name.strip(),
            "platform": device.device.platform.name.strip(),
            "opencl_version": device.device.version.strip(),
            "driver_version": device.device.driver_version.strip(),
        },
        "cases": len(cases),
        "failed": sum(case.verdict != PASS for case in cases),
        "groups": [
            {
                "group": group.name,
                "seconds": group.seconds,
                "cpu_seconds": group.cpu_seconds,
                "cases": [
                    {
                        "case": case.name,
                        "measured": _number(case.measured),
                        "expected": _number(case.expected),
                        "tolerance": _number(case.tolerance),
                        "basis": case.basis,
                        "verdict": case.verdict,
                    }
                    for case in group.cases
                ],
            }
            for group in results
        ],
    }


def _number(value: float) -> float | None:
    """JSON has no NaN and no infinity."""
    return float(value) if math.isfinite(value) else None


def _head(group: str) -> None:
    print(f"\n{_ROW.format(group, 'measured', 'expected', 'tolerance', 'verdict')}", flush=True)


def _line(case: Case) -> str:
    numbers = (f"{case.measured:.9g}", f"{case.expected:.9g}", f"{case.tolerance:.2g}")
    return _ROW.format(case.name, *numbers, case.verdict)
