"""The list of all checks, and the loop that runs them. Used by `isonoise selftest` and by tests/test_selftest.py."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from isonoise.errors import DeviceError
from isonoise.selftest import (
    adaptive,
    allocation,
    errors,
    geometry,
    optics,
    sampler,
    statistics,
    surface_rays,
    transport,
)
from isonoise.selftest.cases import Case, Check, Context

GROUPS: dict[str, tuple[Check, ...]] = {
    "sampler": sampler.CHECKS,
    "statistics": statistics.CHECKS,
    "errors": errors.CHECKS,
    "allocation": allocation.CHECKS,
    "geometry": geometry.CHECKS + surface_rays.CHECKS,
    "transport": transport.CHECKS + optics.CHECKS,
    "adaptive": adaptive.CHECKS,
}


@dataclass(frozen=True)
class GroupResult:
    """The cases of a group, in their order, and the time they took."""

    name: str
    cases: list[Case]
    elapsed_s: float  # wall time
    cpu_s: float  # CPU time of this process, all threads: does not depend on the load of the machine


def run_groups(
    groups: Mapping[str, tuple[Check, ...]], context: Context, on_group: Callable[[str], None] = lambda name: None
) -> Iterator[Case | GroupResult]:
    """Yields every case when it is decided, and after the last case of a group the group's result.

    `on_group` is called before the first case of a group. A DeviceError in a check is a failed case; the other checks
    still run.
    """
    for name, checks in groups.items():
        on_group(name)
        cases: list[Case] = []
        start_s, cpu_start_s = time.perf_counter(), time.process_time()
        for check in checks:
            try:
                for case in check(context):
                    cases.append(case)
                    yield case
            except DeviceError as error:
                message = str(error).splitlines()[0]
                cases.append(Case(f"{check.__name__}: device error: {message}", 1, 0, 0, "no error is allowed"))
                yield cases[-1]
        yield GroupResult(name, cases, time.perf_counter() - start_s, time.process_time() - cpu_start_s)
