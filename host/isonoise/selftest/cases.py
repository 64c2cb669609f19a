"""A test case: a measured number, the expected one and a tolerance. Every check yields cases."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from isonoise.device.opencl import Device


@dataclass(frozen=True)
class Case:
    """A number that a device or an allocation rule computed, and the expected one."""

    name: str
    measured: float
    expected: float  # from a closed form, or computed in float64 on the host
    tolerance: float  # the largest |measured - expected| that passes
    tolerance_basis: str  # the reason for the tolerance

    @property
    def passed(self) -> bool:
        """False also if `measured` is NaN."""
        return abs(self.measured - self.expected) <= self.tolerance


@dataclass(frozen=True)
class Context:
    """What the checks run on."""

    device: Device
    device_choice: str | int | None = None  # the device as the user named it
    thorough: bool = False  # 10^8 rays against leaks: takes minutes


Check = Callable[[Context], Iterable[Case]]


def array_case(name: str, measured, expected, tolerance, tolerance_basis: str) -> Case:
    """Returns the case of one entry of arrays that broadcast: the entry that fails by most, or passes by least."""
    arrays = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (measured, expected, tolerance)))
    measured, expected, tolerance = (a.ravel() for a in arrays)
    deviation = np.abs(measured - expected)
    with np.errstate(divide="ignore", invalid="ignore"):
        passing = np.where(tolerance > 0, deviation / tolerance, 0)
        severity = np.where(deviation <= tolerance, passing, 1 + deviation)
    worst = int(np.argmax(np.where(np.isnan(severity), np.inf, severity)))
    return Case(name, float(measured[worst]), float(expected[worst]), float(tolerance[worst]), tolerance_basis)


def count_case(name: str, counted, tolerance_basis: str, expected: int = 0) -> Case:
    """Returns the case of a number that must be exact. Of an array the non-zero entries are counted."""
    number = np.count_nonzero(counted) if isinstance(counted, np.ndarray) else counted
    return Case(name, float(number), float(expected), 0.0, tolerance_basis)
