"""Which properties of a PLY element are attributes, and their values; names and rules are Mitsuba 3's (3.9.1)."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from isonoise.scene.spectra import srgb_to_linear

_SCHEMES = ("xyzw", "rgba", "0123", "1234")  # last letters of the components of one attribute
_SIZES = (1, 3)  # numbers of components that an attribute may have
_RED = ("red", "green", "blue", "alpha")


def attributes_of(names: Sequence[str], element: str) -> dict[str, list[int]]:
    """Attribute name -> positions in `names` of its components.

    `names` are an element's properties in their order ('' for lists), `element` is 'vertex' or 'face'. A colour is
    r, g, b (a) or red, green, blue (alpha) in any order; else neighbours with a common prefix such as heat_x,
    heat_y, heat_z form 'vertex_heat', those that end in _r, _g, _b 'vertex_heat_color'. The first of a prefix counts.
    """
    found = {}
    for colour in ("rgba", _RED):
        if all(name in names for name in colour[:3]):
            found[f"{element}_color"] = [names.index(name) for name in colour if name in names]
            break
    prefixes = set()
    for prefix, run in groupby(range(len(names)), lambda i: names[i].rpartition("_")[0]):
        positions = list(run)
        endings = [names[i].rpartition("_")[2] for i in positions]
        scheme = next((s for s in _SCHEMES if endings == list(s[: len(endings)])), None)
        if prefix and prefix not in prefixes and scheme and len(endings) in _SIZES:
            prefixes.add(prefix)
            found.setdefault(f"{element}_{prefix}" + ("_color" if scheme == "rgba" else ""), positions)
    return found


def attribute_values(columns: Sequence[np.ndarray], types: Sequence[str]) -> np.ndarray:
    """(n, c) float32 of columns (n,) whose numpy types in the file's header were `types`.

    Whole numbers are colours: their largest stands for 1 and sRGB's curve is taken off, as Mitsuba 3
    does. (3.9.1 leaves out unsigned bytes, by a slip that would make 255 a reflectance; those before it do not.)
    """
    result = np.empty((len(columns[0]), len(columns)), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for i, (column, type_) in enumerate(zip(columns, types, strict=True)):
            if np.dtype(type_).kind == "f":
                result[:, i] = column
            elif column.dtype == np.uint8:  # nearly all colours, and a table is ten times as fast
                result[:, i] = _linear(np.arange(256), type_)[column]
            else:
                result[:, i] = _linear(column, type_)
    return result


def _linear(numbers: np.ndarray, type_: str) -> np.ndarray:
    return srgb_to_linear(np.asarray(numbers, np.float64) / np.iinfo(type_).max)
