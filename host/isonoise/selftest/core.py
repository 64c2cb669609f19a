"""A case, how one is made of arrays, and the run of all groups."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from isonoise.device.opencl import Device
from isonoise.errors import DeviceError

PASS, FAIL = "pass", "FAIL"


@dataclass(frozen=True)
class Case:
    """One number that a device or a rule arrived at, and the one that it should be."""

    name: str
    measured: float
    expected: float  # from a closed form, or from float64 on the host
    tolerance: float  # the largest |measured - expected| that passes
    basis: str  # where the tolerance is from

    @property
    def verdict(self) -> str:
        """`pass` or `FAIL`; what is not a number fails."""
        return PASS if abs(self.measured - self.expected) <= self.tolerance else FAIL


@dataclass(frozen=True)
class Bench:
    """What the groups run on."""

    device: Device
    choice: str | int | None = None  # as the user named the device
    thorough: bool = False  # 10^8 rays against leaks: minutes


@dataclass(frozen=True)
class GroupResult:
    """The cases of a group, in their order, and what they took."""

    name: str
    cases: list[Case]
    seconds: float  # by the clock
    cpu_seconds: float  # of this process, all threads: what the load of the machine does not change


Group = Callable[[Bench], Iterable[Case]]


def run_groups(
    groups: Mapping[str, Group], bench: Bench, on_group: Callable[[str], None] = lambda name: None
) -> Iterator[Case | GroupResult]:
    """Every case as it is decided, and after the last of a group its result; `on_group` is called before the first.

    A case that goes on where the last one was ('... variance') gets its whole name.
    A driver that gives up within a group is a failed case; the other groups still run.
    """
    for name, group in groups.items():
        on_group(name)
        cases: list[Case] = []
        subject = ""
        begun, cpu_begun = time.perf_counter(), time.process_time()
        try:
            for case in group(bench):
                if case.name.startswith("..."):
                    case = replace(case, name=f"{subject}:{case.name[3:]}")
                else:
                    subject = case.name.rpartition(": ")[0] or case.name
                cases.append(case)
                yield case
        except DeviceError as error:
            cases.append(Case(f"cases that the device could not do: {error}".splitlines()[0], 1, 0, 0, "none may fail"))
            yield cases[-1]
        yield GroupResult(name, cases, time.perf_counter() - begun, time.process_time() - cpu_begun)


def worst(name: str, measured, expected, tolerance, basis: str) -> Case:
    """The case of the entry that is farthest out of its tolerance, or nearest to that; arrays that broadcast."""
    arrays = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (measured, expected, tolerance)))
    measured, expected, tolerance = (a.ravel() for a in arrays)
    off = np.abs(measured - expected)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(off <= tolerance, np.where(tolerance > 0, off / tolerance, 0), 1 + off)
    at = int(np.argmax(np.where(np.isnan(share), np.inf, share)))
    return Case(name, float(measured[at]), float(expected[at]), float(tolerance[at]), basis)


def count(name: str, wrong, basis: str, expected: int = 0) -> Case:
    """The case of a number of things, exact; of a mask the number of those that are set."""
    number = np.count_nonzero(wrong) if isinstance(wrong, np.ndarray) else wrong
    return Case(name, float(number), float(expected), 0.0, basis)
