"""The kinds of BSDF, one row each: `KINDS`.

From these rows come the device records (`bsdfs`), the feature of every kind (`integrator.features`) and, for the
kernels, the macros and the header of `bsdf_macros` and `bsdf_header`. The parameters of a plugin are in
`vocabulary.bsdfs`. How to add a kind: host/docs/extending.md.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from isonoise.scene.kind_macros import any_feature, define_lists
from isonoise.scene.material.presets import MIRROR, conductors
from isonoise.scene.material.rough_transmittance import NODES, inner_reflectance, rough_boundary

DEFAULT_ALPHA = 0.1
"""Mitsuba 3's roughness if none is given."""

MAX_NESTED_BLENDS = 8
"""Blends within one another for which kernels/bsdf/pass_through.h has room."""


class Slot(NamedTuple):
    """A parameter that may be a texture. Kernels read it as `bsdf_rgb(ctx, SLOT_<KIND>_<NAME>)` or `bsdf_float`."""

    name: str
    type: str = "reflectance"  # 'reflectance', 'unbounded', 'raw': colours, see `spectra`; 'number'
    value: Callable[[dict], object] | None = None  # from the description; None: the parameter `name`


class BsdfKind(NamedTuple):
    """A kind of BSDF. `name` gives the names of everything else that belongs to it.

    In the kernels: the file kernels/bsdf/<name>.h with `<name>_sample(ctx, u)` and, unless `is_delta`,
    `<name>_eval(ctx, wo, pdf)`; the macro BSDF_<NAME>, a bit; FEATURE_<NAME>, whether a scene has the kind.
    """

    name: str
    description: str  # what the feature is, for `isonoise info`
    plugin: str = ""  # Mitsuba 3's name; '' if it is not a plugin of the kind 'bsdf'
    slots: tuple[Slot, ...] = ()
    constants: Mapping[str, Callable[[dict, list], float]] = MappingProxyType({})
    """Numbers that the host computes: `material(ctx).constants[CONSTANT_<KIND>_<NAME>]`. The functions get the
    description and the list of tables of rough transmittance, to which they may append."""
    helpers: tuple[str, ...] = ()  # shared kernel code: a name X sets HAS_X
    is_delta: bool = False  # all lobes are delta functions: next-event estimation finds nothing
    is_wrapper: bool = False  # holds other BSDFs; kernels/bsdf/nested.h resolves it
    is_null: bool = False  # no surface
    passes_through: bool = False  # part of the light goes on in its direction
    is_phase_function: bool = False  # scatters in a medium
    transmits: Callable[[dict], bool] | None = None  # whether light gets to the other side; None: never
    is_anisotropic: Callable[[Mapping[str, float]], bool] | None = None  # for these values of the slots; None: never
    skips_compaction: bool = False  # so cheap that it is computed for all lanes: compacting would cost more
    buffers: Mapping[str, str] = MappingProxyType({})  # as in `features.Feature`
    feature: str = ""  # '': its own, FEATURE_<NAME>
    header: str = ""  # '': bsdf/<name>.h

    @property
    def scatters(self) -> bool:
        """Whether it has lobes of its own, to evaluate and to sample."""
        return not (self.is_wrapper or self.is_null)


def _always(bsdf: dict) -> bool:
    return True


def _relative_ior(bsdf: dict) -> float:
    return bsdf["int_ior"] / bsdf["ext_ior"]


def _metal(part: int) -> Callable[[dict], object]:
    name = ("eta", "k")[part]
    return lambda bsdf: bsdf[name] if name in bsdf else conductors()[bsdf.get("material", MIRROR)][part]


def _boundary(bsdf: dict) -> tuple[np.ndarray, float]:
    return rough_boundary(bsdf["alpha"], _relative_ior(bsdf), bsdf["distribution"] == "ggx")


def _table_index(bsdf: dict, tables: list) -> int:
    """Index of the table of transmittance of a rough plastic's boundary."""
    table = _boundary(bsdf)[0]
    for index, known in enumerate(tables):
        if known is table:
            return index
    tables.append(table)
    return len(tables) - 1


def _is_stretched(values: Mapping[str, float]) -> bool:
    return values["alpha_u"] != values["alpha_v"]


def _principled_eta(bsdf: dict) -> float:
    """The index that `eta` gives, or `specular` s: 2 / (1 - sqrt(0.08 s)) - 1, s = 0.5 if neither is given.

    Mitsuba 3, principled.cpp: if light may be transmitted, an eta of 1 is 1.001 and an s of 0 is 0.001.
    """
    transmits = bsdf["spec_trans"] != 0.0
    if "eta" in bsdf:
        return 1.001 if transmits and bsdf["eta"] == 1.0 else bsdf["eta"]
    specular = bsdf.get("specular", 0.5)
    return 2.0 / (1.0 - (0.08 * (1e-3 if transmits and specular == 0.0 else specular)) ** 0.5) - 1.0


def _rates(*parameters: str) -> dict[str, Callable[[dict, list], float]]:
    return {name: lambda bsdf, tables, name=name: bsdf[name] for name in parameters}


_IOR = Slot("ior", "number", _relative_ior)
_GLASS = (Slot("specular_reflectance"), Slot("specular_transmittance"), _IOR)
_METAL = (Slot("specular_reflectance"), Slot("eta", "unbounded", _metal(0)), Slot("k", "unbounded", _metal(1)))
_PLASTIC = (Slot("specular_reflectance"), Slot("diffuse_reflectance"), _IOR)
_ALPHAS = tuple(
    Slot(name, "number", lambda bsdf, name=name: bsdf.get(name, bsdf.get("alpha", DEFAULT_ALPHA)))
    for name in ("alpha_u", "alpha_v")
)
_NUMBERS = "anisotropic metallic spec_trans spec_tint sheen sheen_tint flatness clearcoat clearcoat_gloss"

_THIN_NUMBERS = "roughness anisotropic spec_trans eta spec_tint sheen sheen_tint flatness diff_trans"

_MAX_G = 1.0 - 2.0**-24  # below 1 as a 32-bit float too

_ROWS = (
    BsdfKind("diffuse", "diffuse reflection", "diffuse", (Slot("reflectance"),), skips_compaction=True),
    BsdfKind(
        name="dielectric",
        description="smooth glass",
        plugin="dielectric",
        slots=_GLASS,
        helpers=("DIELECTRIC_FRESNEL",),
        is_delta=True,
        transmits=_always,
    ),
    BsdfKind(
        name="thin_dielectric",
        description="thin smooth glass",
        plugin="thindielectric",
        slots=_GLASS,
        helpers=("DIELECTRIC_FRESNEL",),
        is_delta=True,
        transmits=_always,
        passes_through=True,
    ),
    BsdfKind(
        name="conductor",
        description="smooth metal",
        plugin="conductor",
        slots=_METAL,
        helpers=("CONDUCTOR_FRESNEL",),
        is_delta=True,
    ),
    BsdfKind(
        name="rough_conductor",
        description="rough metal",
        plugin="roughconductor",
        slots=(*_METAL, *_ALPHAS),
        helpers=("CONDUCTOR_FRESNEL", "MICROFACETS", "SHADING_FRAME"),
        is_anisotropic=_is_stretched,
    ),
    BsdfKind(
        name="rough_dielectric",
        description="rough glass",
        plugin="roughdielectric",
        slots=(*_GLASS, *_ALPHAS),
        helpers=("DIELECTRIC_FRESNEL", "MICROFACETS", "SHADING_FRAME"),
        transmits=_always,
        is_anisotropic=_is_stretched,
    ),
    BsdfKind(
        name="plastic",
        description="smooth plastic",
        plugin="plastic",
        slots=_PLASTIC,
        constants={"inner_reflectance": lambda bsdf, tables: inner_reflectance(_relative_ior(bsdf))},
        helpers=("DIELECTRIC_FRESNEL", "PLASTIC_BASE"),
    ),
    BsdfKind(
        name="rough_plastic",
        description="rough plastic",
        plugin="roughplastic",
        slots=(*_PLASTIC, Slot("alpha", "number")),
        constants={
            "inner_reflectance": lambda bsdf, tables: _boundary(bsdf)[1],
            "transmittance_table": _table_index,
        },
        helpers=("DIELECTRIC_FRESNEL", "MICROFACETS", "PLASTIC_BASE", "ROUGH_TRANSMITTANCE", "SHADING_FRAME"),
        buffers={"rough_transmittances": f"{4 * NODES} bytes a kind of plastic"},
    ),
    BsdfKind(
        name="principled",
        description="the principled BSDF",
        plugin="principled",
        slots=(
            Slot("base_color"),
            Slot("roughness", "number"),
            Slot("eta", "number", _principled_eta),
            *(Slot(name, "number") for name in _NUMBERS.split()),
        ),
        constants=_rates("diffuse_reflectance_sampling_rate", "main_specular_sampling_rate", "clearcoat_sampling_rate"),
        helpers=("DIELECTRIC_FRESNEL", "EXP_APPROX", "MICROFACETS", "PRINCIPLED_LOBES", "SHADING_FRAME"),
        transmits=lambda bsdf: bsdf["spec_trans"] != 0.0,
        is_anisotropic=lambda values: values["anisotropic"] != 0,
    ),
    BsdfKind("null", "surfaces that are not there", "null", is_null=True, passes_through=True, transmits=_always),
    BsdfKind("front_back", "different BSDFs on the two sides", "twosided", is_wrapper=True),
    BsdfKind(
        name="mask",
        description="opacity",
        plugin="mask",
        slots=(Slot("opacity", "number"),),
        is_wrapper=True,
        passes_through=True,
        transmits=_always,
    ),
    BsdfKind("blend", "blends of two BSDFs", "blendbsdf", (Slot("weight", "number"),), is_wrapper=True),
    BsdfKind(
        name="bump",
        description="bump maps",
        plugin="bumpmap",
        slots=(Slot("height", "number", lambda bsdf: bsdf["texture"]),),
        constants={"scale": lambda bsdf, tables: bsdf["scale"]},
        helpers=("SHADING_FRAME",),
        is_wrapper=True,
    ),
    BsdfKind(
        name="normal_map",
        description="normal maps",
        plugin="normalmap",
        slots=(Slot("normalmap", "raw"),),
        helpers=("SHADING_FRAME",),
        is_anisotropic=lambda values: True,
        is_wrapper=True,
    ),
    BsdfKind(
        name="principled_thin",
        description="the principled BSDF of thin sheets",
        plugin="principledthin",
        slots=(Slot("base_color"), *(Slot(name, "number") for name in _THIN_NUMBERS.split())),
        constants=_rates(
            "diffuse_reflectance_sampling_rate",
            "diffuse_transmittance_sampling_rate",
            "specular_reflectance_sampling_rate",
            "specular_transmittance_sampling_rate",
        ),
        helpers=("DIELECTRIC_FRESNEL", "MICROFACETS", "PRINCIPLED_LOBES", "SHADING_FRAME"),
        transmits=_always,
        is_anisotropic=lambda values: values["anisotropic"] != 0,
    ),
    BsdfKind(
        name="hg",
        description="phase functions",
        constants={"g": lambda phase, tables: min(max(phase.get("g", 0.0), -_MAX_G), _MAX_G)},
        is_phase_function=True,
        transmits=_always,
        feature="MEDIA",
        header="media/phase.h",
    ),
)

KINDS = {kind.name: kind for kind in _ROWS}
"""Kinds by name. Their order gives each its bit and has no other meaning."""

KIND_OF_PLUGIN = {kind.plugin: kind for kind in _ROWS if kind.plugin}
SLOT_COUNT = max(len(kind.slots) for kind in _ROWS)
CONSTANT_COUNT = max(len(kind.constants) for kind in _ROWS)


def bsdf_bits(*names: str) -> int:
    """The bits of kinds, as in the member `kind` of the records.

    Kernels test them with `&`: a `switch` would become a jump table, and loops that have one are not vectorised.
    """
    return sum(1 << list(KINDS).index(name) for name in names)


def bits_where(condition: Callable[[BsdfKind], bool]) -> int:
    """The bits of the kinds for which a condition holds."""
    return bsdf_bits(*(kind.name for kind in select(condition)))


def feature_of(kind: BsdfKind) -> str:
    """The name of the feature that compiles the kind's code."""
    return kind.feature or kind.name.upper()


def select(condition: Callable[[BsdfKind], bool]) -> tuple[BsdfKind, ...]:
    """The kinds for which a condition holds."""
    return tuple(kind for kind in KINDS.values() if condition(kind))


def _any_feature(kinds: Iterable[BsdfKind]) -> str:
    return any_feature(map(feature_of, kinds))


def _any_bit(kinds: Iterable[BsdfKind]) -> str:
    return " | ".join(f"BSDF_{kind.name.upper()}" for kind in kinds) or "0u"


@lru_cache(maxsize=1)
def bsdf_macros() -> dict[str, int | str]:
    """Macros for the kernels: bits, slots, constants, sets of kinds, and what the kinds of a scene have in common."""
    macros: dict[str, int | str] = {"BSDF_SLOTS": SLOT_COUNT, "MAX_NESTED_BLENDS": MAX_NESTED_BLENDS}
    for kind in KINDS.values():
        name = kind.name.upper()
        macros[f"BSDF_{name}"] = bsdf_bits(kind.name)
        macros |= {f"SLOT_{name}_{slot.name.upper()}": number for number, slot in enumerate(kind.slots)}
        macros |= {f"CONSTANT_{name}_{constant.upper()}": number for number, constant in enumerate(kind.constants)}
    for helper in sorted({helper for kind in KINDS.values() for helper in kind.helpers}):
        macros[f"HAS_{helper}"] = _any_feature(select(lambda kind, helper=helper: helper in kind.helpers))
    delta = select(lambda kind: kind.scatters and kind.is_delta)
    non_delta = select(lambda kind: kind.scatters and not kind.is_delta)
    return macros | {
        "HAS_DELTA_BSDFS": _any_feature(delta),
        "HAS_NON_DELTA_BSDFS": _any_feature(non_delta),
        "HAS_ROUGH_TRANSMISSION": _any_feature(
            kind for kind in non_delta if kind.transmits and not kind.is_phase_function
        ),
        "HAS_NESTED_BSDFS": _any_feature(select(lambda kind: kind.is_wrapper)),
        "HAS_NULL_BSDFS": _any_feature(select(lambda kind: kind.passes_through and not kind.scatters)),
        "DELTA_BSDFS": _any_bit(delta),
        "PHASE_FUNCTIONS": _any_bit(select(lambda kind: kind.is_phase_function)),
        "FRAMED_BSDFS": _any_bit(select(lambda kind: kind.scatters and "SHADING_FRAME" in kind.helpers)),
        "UNCOMPACTED_BSDFS": _any_bit(select(lambda kind: kind.skips_compaction)),
    }


@lru_cache(maxsize=1)
def bsdf_header() -> str:
    """generated/bsdf_kinds.h: lists of the kinds that the scene has, and the headers of all kinds.

    FOR_BSDFS(DO) is DO(BSDF_<NAME>, <name>) for every kind that scatters, FOR_NON_DELTA_BSDFS(DO) the same for those
    that next-event estimation evaluates.
    """
    kinds = select(lambda kind: kind.scatters)
    bits = {kind.name: f"BSDF_{kind.name.upper()}" for kind in kinds}
    entries = {bits[kind.name]: (feature_of(kind), f"{bits[kind.name]}, {kind.name}") for kind in kinds}
    non_delta = [bits[kind.name] for kind in kinds if not kind.is_delta]
    lines = define_lists(entries, {"FOR_BSDFS": entries, "FOR_NON_DELTA_BSDFS": non_delta})
    lines += [f'#include "{kind.header or f"bsdf/{kind.name}.h"}"' for kind in kinds]
    return "\n".join(lines)
