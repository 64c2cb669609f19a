"""Materials of a scene description -> device records, in which nested materials are indices.

Called by `scene.compile`. The kinds and their parameters are in `bsdf_kinds`.
"""

from collections.abc import Callable

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.bsdf_kinds import (
    KIND_OF_PLUGIN,
    KINDS,
    MAX_NESTED_BLENDS,
    BsdfKind,
    bits_where,
    bsdf_bits,
    select,
)
from isonoise.scene.material.rough_transmittance import NODES
from isonoise.scene.spectra import colour_to_rgb

_FLAGS = {
    ("distribution", "beckmann"): structs.BSDF_BECKMANN,
    ("sample_visible", False): structs.BSDF_SAMPLE_ALL_NORMALS,
    ("nonlinear", True): structs.BSDF_NONLINEAR,
    ("flip_invalid_normals", False): structs.BSDF_KEEP_INVALID_NORMALS,
    ("use_shadowing_function", False): structs.BSDF_NO_BUMP_SHADOWING,
}
"""(parameter, value) -> flag of the record."""


class Bsdfs:
    """Collects material records; equal materials become one record.

    Parameters
    ----------
    texture : gives the index of a texture of the description, read as 'reflectance', 'unbounded', 'number' or 'raw'
    """

    def __init__(self, texture: Callable[[dict, str], int]):
        self._texture = texture
        self._records: list[np.ndarray] = []
        self._index_of_record: dict[bytes, int] = {}
        self._index_of_dict: dict[int, tuple[dict, int]] = {}  # by id(); holds the dict, so that its id stays in use
        self._tables: list[np.ndarray] = []

    @property
    def tables(self) -> np.ndarray:
        """(t, rough_transmittance.NODES) float32: transmittance of rough boundaries over the cosine."""
        return np.array(self._tables, np.float32).reshape(-1, NODES)

    @property
    def records(self) -> np.ndarray:
        """(b,) structs.BSDF. Nested materials come before those that hold them."""
        return np.concatenate(self._records) if self._records else np.zeros(0, structs.BSDF)

    def index(self, bsdf: dict) -> int:
        """The index of a material of the description; adds it and what it holds."""
        if id(bsdf) not in self._index_of_dict:  # references may name one object twice on every level
            self._index_of_dict[id(bsdf)] = (bsdf, self._add(bsdf))
        return self._index_of_dict[id(bsdf)][1]

    def phase(self, phase: dict, samples_lights: bool) -> int:
        """The index of a phase function: to a path it is like a material."""
        record = self._record(KINDS["hg"], phase)
        record["flags"] |= 0 if samples_lights else structs.BSDF_NO_LIGHT_SAMPLING
        return self._add_record(record)

    def _add(self, bsdf: dict) -> int:
        kind = KIND_OF_PLUGIN[bsdf["type"]]
        nested = [self.index(bsdf[key]) for key in ("bsdf", "bsdf_1") if key in bsdf]
        if bsdf["type"] == "twosided":
            nested = [nested[0], nested[-1]]
            inner = self._records[nested[0]].copy()
            if nested[0] == nested[1] and inner["kind"][0] & bits_where(lambda kind: kind.scatters):
                inner["flags"] |= structs.BSDF_TWOSIDED  # needs no wrapper: it turns to the viewer itself
                return self._add_record(inner)
        record = self._record(kind, bsdf)
        record["nested"][0, : len(nested)] = nested
        if kind.name == "blend" and _can_evaluate_both(self._records[nested[0]], self._records[nested[1]]):
            record["flags"] |= structs.BSDF_EVALUATE_BOTH
        return self._add_record(record)

    def _add_record(self, record: np.ndarray) -> int:
        key = record.tobytes()
        if key not in self._index_of_record:
            self._index_of_record[key] = len(self._records)
            self._records.append(record)
        return self._index_of_record[key]

    def _record(self, kind: BsdfKind, bsdf: dict) -> np.ndarray:
        """The record (1,) of a material, without what it holds."""
        record = np.zeros(1, structs.BSDF)
        record["kind"] = bsdf_bits(kind.name)
        record["nested"] = record["textures"] = structs.NONE
        for (parameter, value), flag in _FLAGS.items():
            record["flags"] |= flag if bsdf.get(parameter) == value else 0
        if kind.transmits and kind.transmits(bsdf):
            record["flags"] |= structs.BSDF_TRANSMITS
        values = record["values"].reshape(structs.BSDF_SLOTS, 3)
        for number, slot in enumerate(kind.slots):
            value = slot.value(bsdf) if slot.value else bsdf[slot.name]
            if isinstance(value, dict) and value["type"] not in ("rgb", "spectrum"):
                record["textures"][0, number] = self._texture(value, slot.type)
                record["number_slots"] |= (slot.type == "number") << number
            else:
                values[number] = value if isinstance(value, np.ndarray) else colour_to_rgb(value, slot.type)
        for number, compute in enumerate(kind.constants.values()):
            record["constants"][0, number] = compute(bsdf, self._tables)
        return record


def _can_evaluate_both(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether next-event estimation evaluates both parts of a blend: they scatter, and the same lights count."""
    scatters = bits_where(lambda kind: kind.scatters)
    same = structs.BSDF_TWOSIDED | structs.BSDF_TRANSMITS
    both_scatter = first["kind"][0] & scatters and second["kind"][0] & scatters
    return bool(both_scatter) and not (first["flags"][0] ^ second["flags"][0]) & same


def mark_pass_through(records: np.ndarray) -> np.ndarray:
    """Which materials (b,) let part of the light go straight on; they get BSDF_PASS_THROUGH.

    Raises
    ------
    SceneError
        If blends are nested deeper than the device can follow.
    """
    marked = records["kind"] & bits_where(lambda kind: kind.passes_through) != 0
    wrappers = bits_where(lambda kind: kind.is_wrapper)
    blends = np.zeros(len(records), int)
    for index, record in enumerate(records):  # nested materials come first
        inner = [int(nested) for nested in record["nested"] if nested != structs.NONE]
        if record["kind"] & wrappers:
            marked[index] |= marked[inner].any()
        blends[index] = max(blends[inner], default=0) + (record["kind"] == bsdf_bits("blend"))
    if (blends[marked] > MAX_NESTED_BLENDS).any():
        raise SceneError(f"blends of materials with opacity are nested more than {MAX_NESTED_BLENDS} deep")
    records["flags"][marked] |= structs.BSDF_PASS_THROUGH
    return marked


def textured_slots(records: np.ndarray) -> int:
    """Bits of the slots in which some material has a texture."""
    return int((np.any(records["textures"] != structs.NONE, axis=0) << np.arange(structs.BSDF_SLOTS)).sum())


def reads_uvs(records: np.ndarray) -> bool:
    """Whether some material depends on texture coordinates or on the direction in which they grow."""
    if (records["textures"] != structs.NONE).any():
        return True
    kinds = {bsdf_bits(kind.name): kind for kind in select(lambda kind: kind.is_anisotropic is not None)}
    for record in records:
        kind = kinds.get(int(record["kind"]))
        if kind:
            first = record["values"].reshape(structs.BSDF_SLOTS, 3)[:, 0]
            if kind.is_anisotropic({slot.name: first[number] for number, slot in enumerate(kind.slots)}):
                return True
    return False
