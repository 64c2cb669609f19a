"""Media, phase functions and volumes of the vocabulary."""

from isonoise.scene.vocabulary.common import ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter

MEDIA = (
    Plugin(
        "medium",
        "homogeneous",
        (
            P("albedo", "reflectance", 0.75, volume=True, meaning="fraction of collisions that scatter"),
            P("sigma_t", "unbounded", 1.0, volume=True, meaning="extinction coefficient, collisions per unit length"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on sigma_t"),
            P(
                "sample_emitters",
                "boolean",
                True,
                meaning="sample emitters at scattering events; false saves time inside glass",
            ),
            *ignored("boolean", "has_spectral_extinction", why="isonoise detects spectral extinction"),
        ),
        (Child("phase"),),
        meaning="a uniform medium such as fog, milk or wax; needs volpath or volpathmis",
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
        (P("value", "unbounded", 1.0, meaning="the constant value; rgb may exceed 1"),),
        meaning="a constant, for a parameter of a medium",
    ),
)
