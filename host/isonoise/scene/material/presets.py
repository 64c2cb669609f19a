"""Named materials: refractive indices of dielectrics, complex refractive indices of conductors as RGB."""

from functools import lru_cache
from importlib.resources import files

import numpy as np

MIRROR = "none"
"""Name of the perfect mirror."""


def _rows(name: str):
    for line in files("isonoise.scene").joinpath(f"data/{name}").read_text("utf-8").splitlines():
        if line and not line.startswith("#"):
            key, *values = line.split(",")
            yield key, np.array(values, dtype=np.float64)


@lru_cache(maxsize=1)
def refractive_indices() -> dict[str, float]:
    """Index of refraction by lower-case name."""
    return {name: float(values[0]) for name, values in _rows("indices.csv")}


@lru_cache(maxsize=1)
def conductors() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(eta, k) as RGB (3,) by name; 'none' is a perfect mirror."""
    named = {name: (values[:3], values[3:]) for name, values in _rows("conductors.csv")}
    return {MIRROR: (np.zeros(3), np.ones(3)), **named}
