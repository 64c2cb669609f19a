"""Finds the properties of a PLY element that are mesh attributes; names and rules are Mitsuba 3's (3.9.1)."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from isonoise.scene.spectra import srgb_to_linear

_SUFFIXES = ("xyzw", "rgba", "0123", "1234")  # last letters of the components of one attribute
_COMPONENT_COUNTS = (1, 3)
_COLOUR_NAMES = (("r", "g", "b", "a"), ("red", "green", "blue", "alpha"))


def find_attributes(names: Sequence[str], element: str) -> dict[str, list[int]]:
    """Map attribute names to the positions in `names` of their components.

    `names` are an element's properties in their order ('' for lists), `element` is 'vertex' or 'face'. A colour is
    r, g, b (a) or red, green, blue (alpha) in any order. Other consecutive properties with a common prefix, such as
    heat_x, heat_y, heat_z, form 'vertex_heat'; with suffixes _r, _g, _b they form 'vertex_heat_color'. The first of a
    prefix wins.
    """
    attributes = {}
    for colour in _COLOUR_NAMES:
        if all(name in names for name in colour[:3]):
            attributes[f"{element}_color"] = [names.index(name) for name in colour if name in names]
            break
    prefixes = set()
    for prefix, run in groupby(range(len(names)), lambda i: names[i].rpartition("_")[0]):
        positions = list(run)
        endings = [names[i].rpartition("_")[2] for i in positions]
        suffixes = next((s for s in _SUFFIXES if endings == list(s[: len(endings)])), None)
        if prefix and prefix not in prefixes and suffixes and len(endings) in _COMPONENT_COUNTS:
            prefixes.add(prefix)
            attributes.setdefault(f"{element}_{prefix}" + ("_color" if suffixes == "rgba" else ""), positions)
    return attributes


def attribute_values(columns: Sequence[np.ndarray], types: Sequence[str]) -> np.ndarray:
    """(n, c) float32 of columns (n,) whose numpy types in the file's header were `types`.

    Integers are sRGB colours: the largest value is 1, and the transfer function is removed, as in Mitsuba 3. (3.9.1
    does not do so for unsigned bytes, by mistake: 255 would be a reflectance. Earlier versions do.)
    """
    result = np.empty((len(columns[0]), len(columns)), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for i, (column, type_) in enumerate(zip(columns, types, strict=True)):
            if np.dtype(type_).kind == "f":
                result[:, i] = column
            elif column.dtype == np.uint8:  # nearly all colours; a table is ten times as fast
                result[:, i] = _decode_integers(np.arange(256), type_)[column]
            else:
                result[:, i] = _decode_integers(column, type_)
    return result


def _decode_integers(values: np.ndarray, type_: str) -> np.ndarray:
    return srgb_to_linear(np.asarray(values, np.float64) / np.iinfo(type_).max)
