"""Media, phase functions and volumes of the vocabulary."""

from isonoise.scene.vocabulary.common import TO_WORLD, ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter

_CONSTANT, _ANY_VOLUME = ("constvolume",), ("constvolume", "gridvolume")
_ALBEDO = "fraction of collisions that scatter"
_SIGMA_T = "extinction coefficient, collisions per unit length"
_COMMON = (
    P("scale", "float", 1.0, "[0, inf)", meaning="factor on sigma_t"),
    P(
        "sample_emitters",
        "boolean",
        True,
        meaning="sample emitters at scattering events; false saves time inside glass",
    ),
    *ignored("boolean", "has_spectral_extinction", why="isonoise detects spectral extinction"),
)

MEDIA = (
    Plugin(
        "medium",
        "homogeneous",
        (
            P("albedo", "reflectance", 0.75, volume=_CONSTANT, meaning=_ALBEDO),
            P("sigma_t", "unbounded", 1.0, volume=_CONSTANT, meaning=_SIGMA_T),
            *_COMMON,
        ),
        (Child("phase"),),
        meaning="a uniform medium such as fog, milk or wax; needs volpath or volpathmis",
    ),
    Plugin(
        "medium",
        "heterogeneous",
        (
            P("albedo", "reflectance", 0.75, volume=_ANY_VOLUME, meaning=_ALBEDO),
            P(
                "sigma_t",
                "unbounded",
                1.0,
                volume=_ANY_VOLUME,
                meaning=_SIGMA_T + "; none outside the world-aligned box around the volume",
            ),
            *_COMMON,
        ),
        (Child("phase"),),
        meaning="a medium that varies in space, such as smoke or clouds; needs volpath or volpathmis",
    ),
    Plugin("phase", "isotropic", meaning="scatters equally in all directions; the default"),
    Plugin(
        "phase",
        "hg",
        (P("g", "float", 0.8, "(-1, 1)", meaning="mean cosine of the scattering angle: 1 is forward, -1 is backward"),),
        meaning="Henyey-Greenstein phase function",
    ),
    Plugin(
        "volume",
        "constvolume",
        (
            P("value", "unbounded", 1.0, meaning="the constant value; rgb may exceed 1"),
            *TO_WORLD,
        ),
        meaning="a constant, for a parameter of a medium; a heterogeneous one fills the unit cube with it",
    ),
    Plugin(
        "volume",
        "gridvolume",
        (
            P("filename", "file", meaning="Mitsuba's .vol file, version 3, of 32-bit floats", unset="required"),
            P("grid", "grid", meaning="a VolumeGrid in memory instead of a file, in dicts only", unset="by filename"),
            P(
                "data",
                "grid",
                meaning="an array (nz, ny, nx) or (nz, ny, nx, channels) instead of a file, in dicts only",
                unset="by filename",
            ),
            P(
                "filter_type",
                "string",
                "trilinear",
                choices=("trilinear", "nearest"),
                meaning="interpolation between cells",
            ),
            P(
                "wrap_mode",
                "string",
                "clamp",
                choices=("clamp", "repeat", "mirror"),
                meaning="values outside the volume",
            ),
            P("use_grid_bbox", "boolean", False, meaning="the volume fills the file's box, not the unit cube"),
            *TO_WORLD,
            *ignored("boolean", "raw", why="values are used as they are, as in Mitsuba's rgb variants"),
            *ignored("boolean", "accel", why="texture units in Mitsuba"),
            *ignored("float", "max_value", why="isonoise computes the bounds of the values"),
        ),
        meaning="values on a grid, with 1 or 3 channels, in the unit cube",
    ),
)
