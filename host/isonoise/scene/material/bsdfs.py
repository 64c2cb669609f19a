"""Materials of the description -> records for the device: a flat table in which wrapped materials are indices.

| kind | slots |
|---|---|
| diffuse | 0 reflectance |
| dielectric, thindielectric | 0 specular_reflectance, 1 specular_transmittance, 2 int_ior / ext_ior |
| roughdielectric | the same, 4 alpha_u, 5 alpha_v |
| conductor | 0 specular_reflectance, 2 eta, 3 k |
| roughconductor | the same, 4 alpha_u, 5 alpha_v |
| plastic | 0 specular_reflectance, 1 diffuse_reflectance, 2 int_ior / ext_ior, 3 (mean inner reflectance, -, -) |
| roughplastic | the same, 3 (mean inner reflectance, index of its table in `tables`, -), 4 alpha |
| principled | 0 base_color, 1 (roughness, diffuse sampling rate, -), 2 anisotropic, 3 metallic, 4 spec_trans, |
| | 5 (eta, specular, clearcoat sampling rate), 6 spec_tint, 7 sheen, 8 sheen_tint, 9 flatness, 10 clearcoat, |
| | 11 clearcoat_gloss |
| mask, blendbsdf, bumpmap, normalmap | 0 opacity; weight; height times scale (1 its scale); normal |
| hg, isotropic (phase functions) | 0 g |
"""

from collections.abc import Callable

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.presets import MIRROR, conductors
from isonoise.scene.material.rough_transmittance import NODES, inner_reflectance, rough_boundary
from isonoise.scene.spectra import colour_to_rgb

KINDS = {
    "diffuse": structs.BSDF_DIFFUSE,
    "dielectric": structs.BSDF_DIELECTRIC,
    "thindielectric": structs.BSDF_THIN_DIELECTRIC,
    "conductor": structs.BSDF_CONDUCTOR,
    "roughconductor": structs.BSDF_ROUGH_CONDUCTOR,
    "roughdielectric": structs.BSDF_ROUGH_DIELECTRIC,
    "plastic": structs.BSDF_PLASTIC,
    "roughplastic": structs.BSDF_ROUGH_PLASTIC,
    "principled": structs.BSDF_PRINCIPLED,
    "null": structs.BSDF_NULL,
    "mask": structs.BSDF_MASK,
    "blendbsdf": structs.BSDF_BLEND,
    "bumpmap": structs.BSDF_BUMP,
    "normalmap": structs.BSDF_NORMAL_MAP,
}
_LARGEST_G = 1.0 - 2.0**-24  # below 1 as a 32-bit float too
_PASS_THROUGH = (structs.BSDF_NULL, structs.BSDF_MASK, structs.BSDF_THIN_DIELECTRIC)
_WRAPPERS = (structs.BSDF_BLEND, structs.BSDF_BUMP, structs.BSDF_NORMAL_MAP)
_MOST_BLENDS = 8  # within one another; kernels/bsdf/pass_through.h keeps their other halves
_ROUGHNESS = 0.1  # Mitsuba 3's alpha where none is given


class Bsdfs:
    """Collects material records, equal ones once. `texture` gives the index of a texture of the description."""

    def __init__(self, texture: Callable[[dict, str], int]):
        self._texture = texture
        self._records: list[np.ndarray] = []
        self._known: dict[bytes, int] = {}
        self._met: dict[int, tuple[dict, int]] = {}  # by identity; the dict itself, so that it lives
        self._tables: list[np.ndarray] = []

    @property
    def tables(self) -> np.ndarray:
        """(t, boundaries.NODES) float32: transmittances of rough boundaries over the cosine."""
        return np.array(self._tables, np.float32).reshape(-1, NODES)

    @property
    def records(self) -> np.ndarray:
        """(b,) structs.BSDF."""
        return np.concatenate(self._records) if self._records else np.zeros(0, structs.BSDF)

    def index(self, bsdf: dict) -> int:
        """The index of a material of the description; what it wraps is entered before it."""
        if id(bsdf) not in self._met:  # once: references may name one object twice on every level
            self._met[id(bsdf)] = (bsdf, self._make(bsdf))
        return self._met[id(bsdf)][1]

    def _make(self, bsdf: dict) -> int:
        record = np.zeros(1, structs.BSDF)
        record["nested"] = structs.NONE
        record["textures"] = structs.NONE
        if bsdf["type"] == "twosided":
            return self._sides(bsdf, record)
        self._fill(record, bsdf)
        return self._enter(record)

    def phase(self, phase: dict, lit: bool) -> int:
        """The index of a phase function, from which lights are sampled or not: to a path it is like a material."""
        record = np.zeros(1, structs.BSDF)
        record["nested"] = record["textures"] = structs.NONE
        record["kind"] = structs.BSDF_HG
        record["flags"] = 0 if lit else structs.BSDF_NO_LIGHT_SAMPLING
        record["values"][0, :3] = np.clip(phase.get("g", 0.0), -_LARGEST_G, _LARGEST_G)
        return self._enter(record)

    def _enter(self, record: np.ndarray) -> int:
        key = record.tobytes()
        if key not in self._known:
            self._known[key] = len(self._records)
            self._records.append(record)
        return self._known[key]

    def _sides(self, bsdf: dict, record: np.ndarray) -> int:
        front, back = bsdf["bsdf"], bsdf.get("bsdf_1", bsdf["bsdf"])
        nested = [self.index(front), self.index(back)]
        same = self._records[nested[0]].copy()
        if nested[0] == nested[1] and same["kind"][0] < structs.BSDF_NULL:  # no wrapper: it turns to the viewer itself
            same["flags"] |= structs.BSDF_TWOSIDED
            return self._enter(same)
        record["kind"], record["nested"] = structs.BSDF_FRONT_BACK, nested
        return self._enter(record)

    def _fill(self, record: np.ndarray, bsdf: dict) -> None:
        type_ = bsdf["type"]
        record["kind"] = KINDS[type_]
        values = record["values"].reshape(structs.BSDF_SLOTS, 3)

        def slot(number: int, value, kind: str = "reflectance") -> None:
            if isinstance(value, dict) and value["type"] not in ("rgb", "spectrum"):
                record["textures"][0, number] = self._texture(value, kind)
                record["numbers"] |= (kind == "number") << number
            else:
                values[number] = colour_to_rgb(value, kind)

        if bsdf.get("distribution") == "ggx":
            record["flags"] |= structs.BSDF_GGX
        if bsdf.get("sample_visible") is False:
            record["flags"] |= structs.BSDF_SAMPLE_ALL_NORMALS
        if bsdf.get("nonlinear"):
            record["flags"] |= structs.BSDF_NONLINEAR
        if bsdf.get("flip_invalid_normals") is False:
            record["flags"] |= structs.BSDF_KEEP_INVALID_NORMALS
        if bsdf.get("use_shadowing_function") is False:
            record["flags"] |= structs.BSDF_NO_BUMP_SHADOWING
        if "int_ior" in bsdf:
            slot(2, bsdf["int_ior"] / bsdf["ext_ior"], "number")
        for name in _COLOURS.get(type_, {}):
            slot(_COLOURS[type_][name], bsdf[name])
        if type_ in ("roughconductor", "roughdielectric"):
            alpha = bsdf.get("alpha", _ROUGHNESS)
            slot(4, bsdf.get("alpha_u", alpha), "number")
            slot(5, bsdf.get("alpha_v", alpha), "number")
        if type_ in ("conductor", "roughconductor"):
            eta, k = conductors()[bsdf.get("material", MIRROR)]
            slot(2, bsdf["eta"], "unbounded") if "eta" in bsdf else values.__setitem__(2, eta)
            slot(3, bsdf["k"], "unbounded") if "k" in bsdf else values.__setitem__(3, k)
        if type_ == "plastic":
            values[3, 0] = inner_reflectance(bsdf["int_ior"] / bsdf["ext_ior"])
        if type_ == "roughplastic":
            slot(4, bsdf["alpha"], "number")
            values[3, :2] = self._boundary(bsdf)
        if type_ == "principled":
            slot(5, _principled_eta(bsdf), "number")
            for number, name in enumerate(_PRINCIPLED, start=1):
                if name != "eta":
                    slot(number, bsdf[name], "number")
            values[1, 1] = bsdf["diffuse_reflectance_sampling_rate"]
            values[5, 1:] = bsdf["main_specular_sampling_rate"], bsdf["clearcoat_sampling_rate"]
        if type_ in ("mask", "blendbsdf"):
            slot(0, bsdf["opacity" if type_ == "mask" else "weight"], "number")
        if type_ == "bumpmap":
            slot(0, bsdf["texture"], "number")
            slot(1, bsdf["scale"], "number")
        if type_ == "normalmap":
            slot(0, bsdf["normalmap"], "raw")
        nested = [self.index(bsdf[key]) for key in ("bsdf", "bsdf_1") if key in bsdf]
        record["nested"][0, : len(nested)] = nested

    def _boundary(self, bsdf: dict) -> tuple[float, int]:
        """(mean inner reflectance, index of the table of transmittance) of a rough plastic's boundary."""
        eta = bsdf["int_ior"] / bsdf["ext_ior"]
        table, inner = rough_boundary(bsdf["alpha"], eta, bsdf["distribution"] == "ggx")
        for index, known in enumerate(self._tables):
            if known is table:
                return inner, index
        self._tables.append(table)
        return inner, len(self._tables) - 1


def mark_pass_through(records: np.ndarray) -> np.ndarray:
    """Which materials (b,) let light through unturned, in part or in full; they get BSDF_PASS_THROUGH.

    Raises SceneError where blends are nested deeper than the device can follow.
    """
    marked = np.isin(records["kind"], _PASS_THROUGH)
    blends = np.zeros(len(records), int)
    for index, record in enumerate(records):  # what is wrapped comes before what wraps it
        inner = [int(nested) for nested in record["nested"] if nested != structs.NONE]
        if record["kind"] in _WRAPPERS:
            marked[index] = marked[inner].any()
        blends[index] = max(blends[inner], default=0) + (record["kind"] == structs.BSDF_BLEND)
    if (blends[marked] > _MOST_BLENDS).any():
        raise SceneError(f"blends of materials with opacity are nested more than {_MOST_BLENDS} deep")
    records["flags"][marked] |= structs.BSDF_PASS_THROUGH
    return marked


def textured_slots(records: np.ndarray) -> int:
    """Bits of the slots in which some material has a texture."""
    return int((np.any(records["textures"] != structs.NONE, axis=0) << np.arange(structs.BSDF_SLOTS)).sum())


def reads_uvs(records: np.ndarray) -> bool:
    """Whether some material depends on texture coordinates or on the direction in which they grow."""
    if (records["textures"] != structs.NONE).any():
        return True
    values = records["values"].reshape(-1, structs.BSDF_SLOTS, 3)
    rough = np.isin(records["kind"], (structs.BSDF_ROUGH_CONDUCTOR, structs.BSDF_ROUGH_DIELECTRIC))
    stretched = rough & (values[:, 4, 0] != values[:, 5, 0])
    stretched |= (records["kind"] == structs.BSDF_PRINCIPLED) & (values[:, 2, 0] != 0)
    return bool(stretched.any())


_COLOURS = {
    "diffuse": {"reflectance": 0},
    "dielectric": {"specular_reflectance": 0, "specular_transmittance": 1},
    "thindielectric": {"specular_reflectance": 0, "specular_transmittance": 1},
    "roughdielectric": {"specular_reflectance": 0, "specular_transmittance": 1},
    "conductor": {"specular_reflectance": 0},
    "roughconductor": {"specular_reflectance": 0},
    "plastic": {"specular_reflectance": 0, "diffuse_reflectance": 1},
    "roughplastic": {"specular_reflectance": 0, "diffuse_reflectance": 1},
    "principled": {"base_color": 0},
}
_PRINCIPLED = (
    "roughness",
    "anisotropic",
    "metallic",
    "spec_trans",
    "eta",
    "spec_tint",
    "sheen",
    "sheen_tint",
    "flatness",
    "clearcoat",
    "clearcoat_gloss",
)


def _principled_eta(bsdf: dict) -> float:
    """The index that `eta` gives, or `specular` s: 2 / (1 - sqrt(0.08 s)) - 1, s = 0.5 where neither is given.

    Mitsuba 3, principled.cpp: where light may be transmitted, an eta of 1 is 1.001 and an s of 0 is 0.001.
    """
    passes = bsdf["spec_trans"] != 0.0
    if "eta" in bsdf:
        return 1.001 if passes and bsdf["eta"] == 1.0 else bsdf["eta"]
    specular = bsdf.get("specular", 0.5)
    return 2.0 / (1.0 - (0.08 * (1e-3 if passes and specular == 0.0 else specular)) ** 0.5) - 1.0
