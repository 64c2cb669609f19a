"""Materials of the vocabulary; names, defaults and what may be a texture are Mitsuba 3's."""

from isonoise.scene.registry import Child, Parameter, Plugin

P = Parameter


def _colour(name: str, default: float) -> Parameter:
    return P(name, "reflectance", default, texture=True)


def _number(name: str, default: float, interval: str = "[0, 1]") -> Parameter:
    return P(name, "float", default, interval, texture=True)


_SPECULAR = _colour("specular_reflectance", 1.0)
_TRANSMITTED = _colour("specular_transmittance", 1.0)
_ROUGH = (
    P("distribution", "string", "beckmann", choices=("beckmann", "ggx")),
    P("alpha", "float", interval="(0, inf)", texture=True),
    P("alpha_u", "float", interval="(0, inf)", texture=True),
    P("alpha_v", "float", interval="(0, inf)", texture=True),
    P("sample_visible", "boolean", True),
)
_METAL = (P("material", "string"), P("eta", "unbounded", texture=True), P("k", "unbounded", texture=True), _SPECULAR)


def _indices(interior: str, exterior: str = "air") -> tuple[Parameter, ...]:
    return P("int_ior", "index", interior), P("ext_ior", "index", exterior)


_PLASTIC = (
    *_indices("polypropylene"),
    _colour("diffuse_reflectance", 0.5),
    _SPECULAR,
    P("nonlinear", "boolean", False),
)

BSDFS = (
    Plugin("bsdf", "diffuse", (_colour("reflectance", 0.5),)),
    Plugin("bsdf", "dielectric", (*_indices("bk7"), _SPECULAR, _TRANSMITTED)),
    Plugin("bsdf", "thindielectric", (*_indices("bk7"), _SPECULAR, _TRANSMITTED)),
    Plugin("bsdf", "roughdielectric", (*_indices("bk7"), _SPECULAR, _TRANSMITTED, *_ROUGH)),
    Plugin("bsdf", "conductor", _METAL),
    Plugin("bsdf", "roughconductor", (*_METAL, *_ROUGH)),
    Plugin("bsdf", "plastic", _PLASTIC),
    Plugin(
        "bsdf",
        "roughplastic",
        (
            *_PLASTIC,
            P("distribution", "string", "beckmann", choices=("beckmann", "ggx")),
            P("alpha", "float", 0.1, "(0, inf)"),
            P("sample_visible", "boolean", True),
        ),
    ),
    Plugin(
        "bsdf",
        "principled",
        (
            _colour("base_color", 0.5),
            _number("roughness", 0.5),
            _number("anisotropic", 0.0),
            _number("metallic", 0.0),
            _number("spec_trans", 0.0),
            P("eta", "float", interval="(0, inf)"),
            P("specular", "float", interval="[0, 1]"),
            _number("spec_tint", 0.0),
            _number("sheen", 0.0),
            _number("sheen_tint", 0.0),
            _number("flatness", 0.0),
            _number("clearcoat", 0.0),
            _number("clearcoat_gloss", 0.0),
            P("diffuse_reflectance_sampling_rate", "float", 1.0, "[0, inf)"),
            P("main_specular_sampling_rate", "float", 1.0, "[0, inf)"),
            P("clearcoat_sampling_rate", "float", 1.0, "[0, inf)"),
        ),
    ),
    Plugin("bsdf", "twosided", (), (Child("bsdf", most=2, least=1),)),
    Plugin("bsdf", "mask", (_number("opacity", 0.5),), (Child("bsdf", least=1),)),
    Plugin(
        "bsdf",
        "blendbsdf",
        (P("weight", "float", required=True, interval="[0, 1]", texture=True),),
        (Child("bsdf", most=2, least=2),),
    ),
    Plugin("bsdf", "bumpmap", (P("scale", "float", 1.0),), (Child("texture", least=1), Child("bsdf", least=1))),
    Plugin(
        "bsdf",
        "normalmap",
        (P("normalmap", "texture", required=True, texture=True),),
        (Child("bsdf", least=1),),
    ),
    Plugin("bsdf", "null"),
)
