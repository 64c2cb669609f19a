"""Whether the content of a checkpoint is what a render can have written; called when one is read.

Checksums show damage. This shows files that another program has made or changed: nothing that is wrong here reaches the
device.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from isonoise.film.log import columns
from isonoise.layers import HOST, LAYERS
from isonoise.samplers import SAMPLERS
from isonoise.state.state import State
from isonoise.strategies.uniform_allocation import MAX_COUNT

_MAX_UNLOGGED_WAVES = 1000
"""Waves that an exception has ended before their row was in the log, over all parts of a render."""


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_seed(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**64


def _is_depth(value: object) -> bool:
    return type(value) is int and -1 <= value < 2**31


def _is_float(value: object) -> bool:
    """A number, nan and infinity included."""
    return type(value) in (int, float)


def _is_number(value: object) -> bool:
    return _is_float(value) and math.isfinite(value)


def _is_not_negative(value: object) -> bool:
    return _is_number(value) and value >= 0


def _is_positive(value: object) -> bool:
    return _is_number(value) and value > 0


def _is_size(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(_is_count(side) and 0 < side < 2**31 for side in value)


def _is_window(value: object) -> bool:
    """Size of a film, an offset in it, and the size of an image that is inside the film from there on."""
    if not isinstance(value, list) or len(value) != 3:
        return False
    film, offset, size = value
    is_offset = isinstance(offset, list) and len(offset) == 2 and all(map(_is_count, offset))
    if not (_is_size(film) and is_offset and _is_size(size)):
        return False
    return all(begin + side <= whole for whole, begin, side in zip(film, offset, size, strict=True))


def _is_layers(value: object) -> bool:
    return isinstance(value, list) and all(_is_text(name) and name in LAYERS for name in value)


def _is_object(value: object) -> bool:
    return isinstance(value, dict)


def _is_sampler(value: object) -> bool:
    return _is_text(value) and value in SAMPLERS


def _is_kind(value: object) -> bool:
    return _is_text(value) and value in ("uniform", "adaptive")


def _is_text_table(value: object) -> bool:
    return _is_object(value) and all(map(_is_text, value.values()))


def _or_none(is_valid: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or is_valid(value)


_OF_A_RENDER = {"seed": _is_seed, "strategy": _is_text, "sampler": _is_sampler, "device": _is_text}
_SETTINGS = {
    "version": _is_text,
    "scene": _is_text,
    "size": _is_size,
    "film_window": _is_window,
    "max_depth": _is_depth,
    "parameters": _is_text_table,
    "scene_hash": _is_text,
    "scene_parts": _is_text_table,
    "files": _is_text_table,
    "radiance_scale": _is_positive,
    "exposure": _or_none(_is_positive),
    "overrides": _is_object,
    "needs": _is_object,
    "layers": _is_layers,
}
_OVERRIDES = {
    "size": _or_none(_is_size),
    "max_depth": _or_none(_is_depth),
    "sampler": _or_none(_is_sampler),
    "parameters": _is_text_table,
    "view": _is_object,
}
_VIEW = {  # `View` checks the numbers
    "camera": _or_none(_is_text),
    "fov": _or_none(_is_positive),
    "look_at": _or_none(lambda value: isinstance(value, list)),
    "up": _or_none(lambda value: isinstance(value, list)),
    "env": _or_none(_is_text),
    "crop": _or_none(lambda value: isinstance(value, list)),
}
_NEEDS = {
    "median": _is_flag,
    "chunk": _is_count,
    "batch": _is_count,
    "power": _or_none(_is_positive),
    "half": _is_flag,
    "neighbours": _or_none(_is_count),
    "nets": _is_flag,
    "uniform": _is_flag,
    "layers": _is_layers,
}
_RENDERER = {"samples": _is_count, "planner": _is_object, "wave": _or_none(_is_object)}
_PLANNER = {
    "waves_taken": _is_count,
    "unfinished_spp": _or_none(_is_positive),
    "wave_index": _is_count,
    "max_pixel_samples": _is_count,
}
_WAVE = {"kind": _is_kind, "planned": _is_count, "traced": _is_count}
_WAVE |= {"seconds": _is_not_negative}
_LOOP = {
    "rows": lambda value: isinstance(value, list),
    "elapsed_s": _is_not_negative,
    "samples_per_s": _or_none(_is_positive),
    "error": _or_none(_is_float),
    "error_stop": _or_none(_is_object),
    "energy_loss_control": _is_float,
    "reference_floor": _or_none(_is_not_negative),
    "stops": _is_object,
}
_LIMITS = {name: _or_none(_is_positive) for name in ("spp", "time", "error")}
_LIMITS |= {"quantile": _is_positive, "confidence": _is_positive}
_ERROR_STOP = {
    "limit": _is_positive,
    "quantile": _is_positive,
    "confidence": _is_positive,
    "looks": _is_count,
    "stated": _or_none(_is_float),
    "bound": _or_none(_is_float),
    "passed": _is_flag,
}
_ROW = dict.fromkeys(columns(true_errors=False), _is_float)
_ROW |= {"kind": _WAVE["kind"], "wave": _is_count, "samples": _is_count, "rejected": _is_count}
_ROW |= {"workers": _is_count, "elapsed_s": _is_not_negative, "spp": _is_not_negative}
_REQUIRED_STATISTICS = {"count", "rejected", "rgb", "mean", "variance"}
_STATISTICS = {
    "count": ("<u4", ()),
    "rejected": ("<u4", ()),
    "rgb": ("<f4", (3,)),
    "mean": ("<f8", ()),
    "variance": ("<f8", ()),
    "median": ("<f8", ()),
    "design_effect": ("<f4", ()),
}
"""Statistics of merged renders -> type, and shape beyond that of the image."""


def check_consistency(state: State) -> None:
    """Raise ValueError, which says what is wrong, unless values and arrays fit together."""
    settings, values = state.settings, state.values
    is_merged = "merged" in values
    _check_members("settings", settings, _SETTINGS if is_merged else _SETTINGS | _OF_A_RENDER)
    _check_members("overrides", settings["overrides"], _OVERRIDES)
    _check_members("view", settings["overrides"]["view"], _VIEW)
    _check_object("needs", settings["needs"], _NEEDS)
    shape = tuple(reversed(settings["size"]))
    if is_merged:
        _check_merged(state, shape)
        return
    _check_members("values", values, {"renderer": _is_object, "strategy": _is_object})
    _check_renderer(state, shape)
    if "loop" in values:
        _check_loop(values, shape)
    if "energy_loss/uniform" in state.arrays:
        _check_array(state, "energy_loss/uniform", "<f8", (2, *shape))


def _check_renderer(state: State, shape: tuple[int, int]) -> None:
    values = state.values["renderer"]
    _check_object("renderer", values, _RENDERER)
    planner, samples = values["planner"], values["samples"]
    _check_object("planner", planner, _PLANNER)
    if not planner["waves_taken"] <= planner["wave_index"] <= planner["max_pixel_samples"] <= MAX_COUNT:
        raise ValueError("its counts of waves contradict each other")  # every wave has a sample
    for name in ("count", "rejected"):
        _check_array(state, f"reduction/{name}", "<u4", (1, *shape))
    for name, array in state.group("reduction").items():
        if array.shape[1:] != shape:
            raise ValueError(f"'reduction/{name}' has the shape {array.shape}")
    counts = [state.arrays[f"reduction/{name}"].astype(np.int64) for name in ("count", "rejected")]
    counts = counts[0] + counts[1]
    if int(counts.sum()) != samples:
        raise ValueError(f"its pixels have {int(counts.sum())} samples, not {samples}")
    if int(counts.max()) > planner["max_pixel_samples"]:
        raise ValueError("a pixel has more samples than all waves together")
    if state.settings["needs"]["uniform"]:
        _check_array(state, "uniform/sums", "<f8", (3, *shape))
    if values["wave"] is not None:
        _check_wave(state, values["wave"], samples, shape)


def _check_wave(state: State, wave: Mapping[str, object], samples: int, shape: tuple[int, int]) -> None:
    _check_object("wave", wave, _WAVE)
    _check_array(state, "wave/remaining", "<u4", shape)
    planned, traced = wave["planned"], wave["traced"]
    remaining = int(state.arrays["wave/remaining"].sum(dtype=np.int64))
    if traced + remaining != planned or traced > samples:
        raise ValueError(f"of its wave of {planned} samples {traced} are traced, and {remaining} remain")


def _check_loop(values: Mapping[str, dict], shape: tuple[int, int]) -> None:
    loop, planner = values["loop"], values["renderer"]["planner"]
    _check_object("loop", loop, _LOOP)
    _check_object("stops", loop["stops"], _LIMITS)
    if loop["error_stop"] is not None:
        _check_object("error_stop", loop["error_stop"], _ERROR_STOP)
    true = {name: _is_float for name in columns(true_errors=True) if name.startswith("true_")}
    for number, row in enumerate(loop["rows"], 1):
        has_true = _is_object(row) and not true.keys().isdisjoint(row)
        _check_object(f"row {number}", row, _ROW | true if has_true else _ROW)
        if row["wave"] != number or row["samples"] > values["renderer"]["samples"]:
            raise ValueError(f"row {number} contradicts the others")
    if not 0 <= planner["wave_index"] - len(loop["rows"]) <= _MAX_UNLOGGED_WAVES:
        raise ValueError(f"its log has {len(loop['rows'])} rows of {planner['wave_index']} waves")


def _check_merged(state: State, shape: tuple[int, int]) -> None:
    merged = state.values["merged"]
    if not (_is_object(merged) and isinstance(merged.get("renders"), list) and merged["renders"]):
        raise ValueError("its list of renders is missing")
    for number, render in enumerate(merged["renders"], 1):
        _check_object(f"render {number}", render, _OF_A_RENDER | {"samples": _is_count, "elapsed_s": _is_not_negative})
    names = state.group("statistics").keys()
    if not _REQUIRED_STATISTICS <= names <= _STATISTICS.keys():
        raise ValueError(f"its statistics are {', '.join(sorted(names))}")
    for name in names:
        dtype, channels = _STATISTICS[name]
        _check_array(state, f"statistics/{name}", dtype, (*shape, *channels))
    for name in state.group("layers"):
        if name not in LAYERS or LAYERS[name].made == HOST:
            raise ValueError(f"it has the layer '{name}'")
        channels = len(LAYERS[name].channels)
        _check_array(state, f"layers/{name}", "<f4", (*shape, channels) if channels > 1 else shape)
    counts = (int(state.arrays[f"statistics/{name}"].sum(dtype=np.int64)) for name in ("count", "rejected"))
    if sum(counts) != sum(render["samples"] for render in merged["renders"]):
        raise ValueError("its pixels and its renders have different numbers of samples")


def _check_object(name: str, value: object, members: Mapping[str, Callable[[object], bool]]) -> None:
    """Check that an object has exactly these members."""
    _check_members(name, value, members)
    if len(value) > len(members):
        raise ValueError(f"'{name}' has '{next(key for key in value if key not in members)}'")


def _check_members(name: str, value: object, members: Mapping[str, Callable[[object], bool]]) -> None:
    """Check that an object has these members, and that the values are valid."""
    if not _is_object(value):
        raise ValueError(f"'{name}' is no object")
    for key, is_valid in members.items():
        if key not in value:
            raise ValueError(f"'{name}' lacks '{key}'")
        if not is_valid(value[key]):
            raise ValueError(f"'{key}' of '{name}' is {str(value[key])[:60]}")


def _check_array(state: State, name: str, dtype: str, shape: tuple[int, ...]) -> None:
    array = state.arrays.get(name)
    if array is None:
        raise ValueError(f"'{name}' is missing")
    if array.dtype.str != dtype or array.shape != shape:
        raise ValueError(f"'{name}' has the type {array.dtype} and the shape {array.shape}")
