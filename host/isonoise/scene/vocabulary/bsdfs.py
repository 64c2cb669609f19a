"""BSDFs of the vocabulary. Names, defaults and which parameters may be textures are Mitsuba 3's.

Their kinds on the device are in `scene/material/bsdf_kinds.py`.
"""

from isonoise.scene.vocabulary.plugin import UNSUPPORTED, Child, Parameter, Plugin

P = Parameter


def _colour(name: str, default: float, meaning: str) -> Parameter:
    return P(name, "reflectance", default, texture=True, meaning=meaning)


def _number(name: str, default: float, meaning: str) -> Parameter:
    return P(name, "float", default, "[0, 1]", texture=True, meaning=meaning)


def _alpha(name: str, meaning: str) -> Parameter:
    return P(name, "float", interval="(0, inf)", texture=True, meaning=meaning, unset="0.1")


_SPECULAR = _colour("specular_reflectance", 1.0, "factor on the reflection; 1 is physical")
_TRANSMITTED = _colour("specular_transmittance", 1.0, "factor on the transmission; 1 is physical")
_DISTRIBUTION = P(
    "distribution", "string", "beckmann", choices=("beckmann", "ggx"), meaning="distribution of microfacet normals"
)
_VISIBLE = P("sample_visible", "boolean", True, meaning="sample only visible normals: less noise")
_ROUGH = (
    _DISTRIBUTION,
    _alpha("alpha", "roughness: RMS slope of the microfacets"),
    _alpha("alpha_u", "roughness along the tangent"),
    _alpha("alpha_v", "roughness along the bitangent"),
    _VISIBLE,
)
_METAL = (
    P("material", "string", meaning="preset of eta and k, such as Au, or none: a perfect mirror", unset="none"),
    P("eta", "unbounded", texture=True, meaning="real part of the index of refraction", unset="0"),
    P("k", "unbounded", texture=True, meaning="imaginary part of the index of refraction", unset="1"),
    _SPECULAR,
)


def _indices(interior: str, exterior: str = "air") -> tuple[Parameter, ...]:
    return (
        P("int_ior", "index", interior, meaning="index of refraction inside, a number or a name"),
        P("ext_ior", "index", exterior, meaning="index of refraction outside, a number or a name"),
    )


_PLASTIC = (
    *_indices("polypropylene"),
    _colour("diffuse_reflectance", 0.5, "colour of the base below the coat"),
    _SPECULAR,
    P("nonlinear", "boolean", False, meaning="colours shift with scattering inside"),
)

_SAMPLING_RATES = "diffuse_reflectance diffuse_transmittance specular_reflectance specular_transmittance"

_RELIEF = (
    P("flip_invalid_normals", "boolean", True, meaning="flip normals that point away from the viewer"),
    P("use_shadowing_function", "boolean", True, meaning="soften shadow terminators"),
)

BSDFS = (
    Plugin("bsdf", "diffuse", (_colour("reflectance", 0.5, "share of light that is reflected"),), meaning="matt"),
    Plugin("bsdf", "dielectric", (*_indices("bk7"), _SPECULAR, _TRANSMITTED), meaning="smooth glass, water"),
    Plugin(
        "bsdf",
        "thindielectric",
        (*_indices("bk7"), _SPECULAR, _TRANSMITTED),
        meaning="a thin pane of smooth glass as one surface",
    ),
    Plugin("bsdf", "roughdielectric", (*_indices("bk7"), _SPECULAR, _TRANSMITTED, *_ROUGH), meaning="rough glass"),
    Plugin("bsdf", "conductor", _METAL, meaning="smooth metal"),
    Plugin("bsdf", "roughconductor", (*_METAL, *_ROUGH), meaning="rough metal"),
    Plugin("bsdf", "plastic", _PLASTIC, meaning="a diffuse base below a smooth coat"),
    Plugin(
        "bsdf",
        "roughplastic",
        (
            *_PLASTIC,
            _DISTRIBUTION,
            P("alpha", "float", 0.1, "(0, inf)", meaning="roughness: RMS slope of the microfacets"),
            _VISIBLE,
        ),
        meaning="a diffuse base below a rough coat",
    ),
    Plugin(
        "bsdf",
        "principled",
        (
            _colour("base_color", 0.5, "colour"),
            _number("roughness", 0.5, "the square root of alpha"),
            _number("anisotropic", 0.0, "elongation of highlights along the tangent"),
            _number("metallic", 0.0, "0 dielectric, 1 metal"),
            _number("spec_trans", 0.0, "0 opaque, 1 glass"),
            P(
                "eta",
                "float",
                interval="(0, inf)",
                meaning="index of refraction, inside over outside",
                unset="by specular",
            ),
            P(
                "specular",
                "float",
                interval="[0, 1]",
                meaning="reflection at normal incidence, in place of eta",
                unset="0.5, which is eta 1.5",
            ),
            _number("spec_tint", 0.0, "tint of highlights by base_color"),
            _number("sheen", 0.0, "reflection at grazing angles, as of cloth"),
            _number("sheen_tint", 0.0, "tint of the sheen by base_color"),
            _number("flatness", 0.0, "blend from diffuse to approximate subsurface scattering"),
            _number("clearcoat", 0.0, "strength of a second, clear coat"),
            _number("clearcoat_gloss", 0.0, "glossiness of the clearcoat"),
            P("diffuse_reflectance_sampling_rate", "float", 1.0, "[0, inf)", meaning="share of samples"),
            P("main_specular_sampling_rate", "float", 1.0, "[0, inf)", meaning="share of samples"),
            P("clearcoat_sampling_rate", "float", 1.0, "[0, inf)", meaning="share of samples"),
        ),
        meaning="Disney's BSDF: metal, plastic, glass, cloth, car paint",
    ),
    Plugin(
        "bsdf",
        "principledthin",
        (
            _colour("base_color", 0.5, "colour"),
            _number("roughness", 0.5, "the square root of alpha"),
            _number("anisotropic", 0.0, "elongation of highlights along the tangent"),
            _number("spec_trans", 0.0, "0 diffuse, 1 clear: reflects and transmits specularly"),
            P("eta", "float", 1.5, "(0, inf)", texture=True, meaning="index of refraction, inside over outside"),
            _number("spec_tint", 0.0, "tint of highlights by base_color"),
            _number("sheen", 0.0, "reflection at grazing angles, as of cloth"),
            _number("sheen_tint", 0.0, "tint of the sheen by base_color"),
            _number("flatness", 0.0, "blend from diffuse to approximate subsurface scattering"),
            P(
                "diff_trans",
                "float",
                0.0,
                "[0, 2]",
                texture=True,
                meaning="diffuse light that is transmitted: 0 none, 2 all",
            ),
            *(
                P(f"{lobe}_sampling_rate", "float", 1.0, "[0, inf)", meaning="share of samples")
                for lobe in _SAMPLING_RATES.split()
            ),
        ),
        meaning="the principled BSDF of a thin sheet that light passes without refraction: paper, leaves, thin glass",
    ),
    Plugin(
        "bsdf",
        "twosided",
        (P("allow_transmission", "boolean", status=UNSUPPORTED, meaning="two-sided materials transmit no light"),),
        (Child("bsdf", max_count=2, min_count=1),),
        meaning="one material for both sides, or one for each; they must not transmit light",
    ),
    Plugin(
        "bsdf",
        "mask",
        (_number("opacity", 0.5, "0 is fully transparent"),),
        (Child("bsdf", min_count=1),),
        meaning="a material with holes",
    ),
    Plugin(
        "bsdf",
        "blendbsdf",
        (
            P(
                "weight",
                "float",
                required=True,
                interval="[0, 1]",
                texture=True,
                meaning="0 is the first material, 1 the second",
            ),
        ),
        (Child("bsdf", max_count=2, min_count=2),),
        meaning="a blend of two materials",
    ),
    Plugin(
        "bsdf",
        "bumpmap",
        (P("scale", "float", 1.0, meaning="factor on the heights"), *_RELIEF),
        (Child("texture", min_count=1), Child("bsdf", min_count=1)),
        meaning="a material with a bump map: a texture of heights",
    ),
    Plugin(
        "bsdf",
        "normalmap",
        (
            P("normalmap", "texture", required=True, texture=True, meaning="normals, as (n + 1) / 2; read with raw"),
            *_RELIEF,
        ),
        (Child("bsdf", min_count=1),),
        meaning="a material with a normal map",
    ),
    Plugin("bsdf", "null", meaning="no surface: for medium interfaces and holes"),
)
