"""Media, phase functions and volumes of the vocabulary."""

from isonoise.scene.vocabulary.common import ignored
from isonoise.scene.vocabulary.plugin import Child, Parameter, Plugin

P = Parameter

MEDIA = (
    Plugin(
        "medium",
        "homogeneous",
        (
            P("albedo", "reflectance", 0.75, volume=True, meaning="share of the collisions that scatter light"),
            P("sigma_t", "unbounded", 1.0, volume=True, meaning="extinction coefficient, collisions a unit of length"),
            P("scale", "float", 1.0, "[0, inf)", meaning="factor on sigma_t"),
            P(
                "sample_emitters",
                "boolean",
                True,
                meaning="whether lights are sampled from within; false saves time inside of glass",
            ),
            *ignored("boolean", "has_spectral_extinction", why="colours are told apart by themselves"),
        ),
        (Child("phase"),),
        meaning="a medium that is the same everywhere: fog, milk, wax; only volpath and volpathmis see it",
    ),
    Plugin("phase", "isotropic", meaning="scatters alike into all directions; where there is no phase function"),
    Plugin(
        "phase",
        "hg",
        (P("g", "float", 0.8, "(-1, 1)", meaning="mean cosine of the angle: 1 is onwards, -1 is back"),),
        meaning="Henyey and Greenstein's phase function",
    ),
    Plugin(
        "volume",
        "constvolume",
        (P("value", "unbounded", 1.0, meaning="the value everywhere; rgb may exceed 1"),),
        meaning="a number or colour, in place of a medium's parameter",
    ),
)
