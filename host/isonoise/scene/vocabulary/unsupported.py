"""Plugins that Mitsuba 3 (3.9) has and isonoise does not, by kind, each with the reason or the way out.

They are named in errors, so that nobody looks for a typing mistake. Who adds a plugin takes its row away.
"""

_POLARISED = "polarised light is not traced"
_DERIVATIVES = "renders derivatives; isonoise has none"
_SPECTRAL = "isonoise renders RGB: write <rgb> or a plain <spectrum>"
_SKY = "needs the fitted tables of the sky model, which come with Mitsuba: bake it to an envmap there"

UNSUPPORTED_PLUGINS: dict[str, dict[str, str]] = {
    "sensor": {
        "batch": "one image a render: render its sensors one by one",
        "distant": "measures radiance from infinity; orthographic is close",
        "irradiancemeter": "no image; a diffuse surface seen by orthographic is close",
        "radiancemeter": "no image; a perspective camera of one pixel and small fov is close",
    },
    "film": {"specfilm": "images are RGB: use hdrfilm"},
    "rfilter": {
        "catmullrom": "has negative lobes, which a sample that belongs to one pixel cannot have: use gaussian or tent",
        "lanczos": "has negative lobes, which a sample that belongs to one pixel cannot have: use gaussian or tent",
        "mitchell": "has negative lobes, which a sample that belongs to one pixel cannot have: use gaussian or tent",
    },
    "integrator": {
        "depth": "shows distances, no light",
        "direct_projective": _DERIVATIVES,
        "prb": _DERIVATIVES,
        "prb_basic": _DERIVATIVES,
        "prb_projective": _DERIVATIVES,
        "prbvolpath": _DERIVATIVES,
        "ptracer": "traces from the lights: use path, the image is the same",
        "stokes": _POLARISED,
    },
    "bsdf": {
        "circular": _POLARISED,
        "hair": "curves are not supported",
        "measured": "needs measured data in a format of its own: fit a principled or roughconductor",
        "measured_polarized": _POLARISED,
        "polarizer": _POLARISED,
        "pplastic": "plastic with polarisation: use roughplastic",
        "principledthin": "the thin variant of principled: use principled, or thindielectric for panes",
        "retarder": _POLARISED,
    },
    "shape": {
        "blender": "exists only inside Mitsuba's Blender add-on: export ply",
        "bsplinecurve": "curves are not supported: export them as meshes",
        "ellipsoids": "for Gaussian splats, which are not supported",
        "ellipsoidsmesh": "for Gaussian splats, which are not supported",
        "linearcurve": "curves are not supported: export them as meshes",
        "merge": "joins meshes inside Mitsuba: write the shapes themselves, the image is the same",
        "sdfgrid": "signed distance fields are not supported: export a mesh",
    },
    "emitter": {
        "directionalarea": "shines along its normal alone: use spot or directional",
        "projector": "a lamp that throws an image is not built: spot is the nearest",
        "sunsky": _SKY,
        "timed_sunsky": _SKY,
    },
    "texture": {
        "blackbody": _SPECTRAL,
        "d65": _SPECTRAL,
        "irregular": _SPECTRAL,
        "rawconstant": "write the number or <rgb> itself",
        "regular": _SPECTRAL,
        "srgb": "write <rgb> itself",
        "uniform": "write the number itself",
        "volume": "volumes as textures are not supported",
    },
    "medium": {
        "heterogeneous": "only media that are the same everywhere",
    },
    "phase": {
        "blendphase": "one phase function a medium",
        "rayleigh": "hg with g = 0 is close",
        "sggx": "for volumes of fibres and flakes",
        "tabphase": "fit hg to it",
    },
    "volume": {
        "gridvolume": "only media that are the same everywhere",
    },
}
