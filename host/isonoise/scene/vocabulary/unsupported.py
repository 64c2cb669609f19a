"""Plugins that Mitsuba 3 (3.9) has and isonoise does not, by kind, each with the reason or an alternative.

Errors name them, so that users do not look for a typing mistake. Plugins that the texts name have to be supported. To
add a plugin, remove its row here.
"""

_POLARISED = "polarisation is not supported"
_DERIVATIVES = "isonoise does not compute derivatives"
_PAIRS = "write <spectrum> with pairs of wavelength and value"
_SKY_MODEL = "needs the sky model's data, which comes with Mitsuba: render it to an envmap there"

UNSUPPORTED_PLUGINS: dict[str, dict[str, str]] = {
    "sensor": {
        "batch": "one image per render: render its sensors one by one",
        "distant": "measures radiance from infinity: orthographic is similar",
        "irradiancemeter": "no image: a diffuse surface seen by orthographic is similar",
        "radiancemeter": "no image: perspective with one pixel and a small fov is similar",
    },
    "film": {"specfilm": "images are RGB: use hdrfilm"},
    "rfilter": {
        "catmullrom": "has negative lobes, which filter importance sampling does not support: use gaussian or tent",
        "lanczos": "has negative lobes, which filter importance sampling does not support: use gaussian or tent",
        "mitchell": "has negative lobes, which filter importance sampling does not support: use gaussian or tent",
    },
    "integrator": {
        "depth": "shows distances, not light",
        "direct_projective": f"{_DERIVATIVES}: use direct",
        "prb": f"{_DERIVATIVES}: use path, with max_depth 6 unless it is given",
        "prb_basic": f"{_DERIVATIVES}: use path, with max_depth 6 unless it is given",
        "prb_projective": f"{_DERIVATIVES}: use path, with max_depth 6 unless it is given",
        "prbvolpath": f"{_DERIVATIVES}: use volpath, with max_depth 6 unless it is given",
        "ptracer": "traces from the emitters: use path, the image is the same",
        "stokes": f"{_POLARISED}: use the integrator inside it",
    },
    "bsdf": {
        "circular": _POLARISED,
        "hair": "curves are not supported",
        "measured": "needs measured data: fit a principled or roughconductor",
        "measured_polarized": _POLARISED,
        "polarizer": _POLARISED,
        "pplastic": "plastic with polarisation: use roughplastic",
        "retarder": _POLARISED,
    },
    "shape": {
        "blender": "exists only in Mitsuba's Blender add-on: export ply",
        "bsplinecurve": "curves are not supported: export them as meshes",
        "ellipsoids": "for Gaussian splats, which are not supported",
        "ellipsoidsmesh": "for Gaussian splats, which are not supported",
        "linearcurve": "curves are not supported: export them as meshes",
        "merge": "merges meshes inside Mitsuba: use the shapes themselves, the image is the same",
        "sdfgrid": "signed distance fields are not supported: export a mesh",
    },
    "emitter": {
        "directionalarea": "emits along its normal only: use spot or directional",
        "sunsky": _SKY_MODEL,
        "timed_sunsky": _SKY_MODEL,
    },
    "texture": {
        "blackbody": "Mitsuba has it in spectral modes only: write its colour as <rgb>",
        "irregular": _PAIRS,
        "regular": _PAIRS,
        "volume": "volumes as textures are not supported",
    },
    "phase": {
        "blendphase": "one phase function per medium",
        "rayleigh": "hg with g = 0 is similar",
        "sggx": "for volumes of fibres and flakes",
        "tabphase": "fit hg to it",
    },
}
