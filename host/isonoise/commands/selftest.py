"""`isonoise selftest`: runs all groups of checks, prints a table of cases, writes them to the file of `--json`."""

import argparse
import json
import math
from collections.abc import Iterable

from isonoise.command_output import STANDARD_OUTPUT, print_json
from isonoise.commands import EXIT_DONE
from isonoise.device.drivers import describe_driver, driver_fields
from isonoise.device.opencl import Device
from isonoise.film.files import check_writable, write_atomically
from isonoise.selftest.cases import Case, Context
from isonoise.selftest.runner import GROUPS, GroupResult, run_groups
from isonoise.tables import LEFT, RIGHT, Column, Table, text_table

EXIT_FAILED = 1
SCHEMA = {"schema": "isonoise-selftest", "schema_version": 2}


def run(options: argparse.Namespace) -> int:
    """Runs the self-test; returns the exit code. Raises UserError if the options are wrong."""
    if options.json and options.json != STANDARD_OUTPUT:
        check_writable(options.json)
    device = Device(options.device)
    print(f"{device.name}, {describe_driver(device.device)}", flush=True)
    results: list[GroupResult] = []
    for outcome in run_groups(GROUPS, Context(device, options.device, options.thorough), _print_head):
        if isinstance(outcome, Case):
            _print_case(outcome)
        else:
            results.append(outcome)
    case_count, failed_count = _counts(results)
    elapsed_s, cpu_s = (sum(getattr(group, name) for group in results) for name in ("elapsed_s", "cpu_s"))
    print(f"\n{case_count} cases, {failed_count} failed; {elapsed_s:.0f} s, {cpu_s:.0f} s of CPU time")
    if options.json == STANDARD_OUTPUT:
        print_json(to_json(device, results))
    elif options.json:
        text = json.dumps(to_json(device, results), indent=1, allow_nan=False) + "\n"
        write_atomically(options.json, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return EXIT_FAILED if failed_count else EXIT_DONE


def to_json(device: Device, results: Iterable[GroupResult]) -> dict:
    """Returns the object that `--json` writes. The fields are documented in host/docs/numerics.md."""
    results = list(results)
    case_count, failed_count = _counts(results)
    return SCHEMA | {
        "device": driver_fields(device.device),
        "case_count": case_count,
        "failed_count": failed_count,
        "groups": [
            {
                "name": group.name,
                "elapsed_s": group.elapsed_s,
                "cpu_s": group.cpu_s,
                "cases": [
                    {
                        "name": case.name,
                        "measured": _finite_or_none(case.measured),
                        "expected": _finite_or_none(case.expected),
                        "tolerance": _finite_or_none(case.tolerance),
                        "tolerance_basis": case.tolerance_basis,
                        "passed": bool(case.passed),
                    }
                    for case in group.cases
                ],
            }
            for group in results
        ],
    }


def _counts(results: Iterable[GroupResult]) -> tuple[int, int]:
    """Returns the number of cases and of failed cases."""
    passed = [bool(case.passed) for group in results for case in group.cases]
    return len(passed), passed.count(False)


def _finite_or_none(value: float) -> float | None:
    """JSON has no NaN and no infinity."""
    return float(value) if math.isfinite(value) else None


def _columns(group: str) -> list[Column]:
    """Columns of a fixed width, because the cases are printed one by one."""
    numbers = [Column("measured", RIGHT, 14), Column("expected", RIGHT, 14), Column("tolerance", RIGHT, 10)]
    return [Column(group, LEFT, 76), *numbers, Column("verdict", LEFT)]


def _print_head(group: str) -> None:
    print(f"\n{text_table(Table(_columns(group), []), indent='')}", flush=True)


def _print_case(case: Case) -> None:
    numbers = (f"{case.measured:.9g}", f"{case.expected:.9g}", f"{case.tolerance:.2g}")
    row = (case.name, *numbers, "pass" if case.passed else "FAIL")
    print(text_table(Table(_columns(""), [row]), heads=False, indent=""), flush=True)
