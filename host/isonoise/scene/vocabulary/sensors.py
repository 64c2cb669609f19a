"""Sensors, films, reconstruction filters, samplers and integrators of the vocabulary."""

from isonoise.scene.vocabulary.common import FIELD_OF_VIEW, TO_WORLD, ignored
from isonoise.scene.vocabulary.plugin import IGNORED, UNSUPPORTED, Child, Parameter, Plugin

P = Parameter
_CLIP = (
    P("near_clip", "float", 1e-2, "(0, inf)", meaning="nearest visible depth"),
    P("far_clip", "float", 1e4, "(0, inf)", meaning="farthest visible depth"),
)
_CHILDREN = (Child("film"), Child("sampler"), Child("medium"))
_SHUTTER = ignored("float", "shutter_open", "shutter_close", why="there is no motion")
_FOCUS = ignored("float", "focus_distance", why="everything is in focus")
_SRF = P("srf", "any", status=UNSUPPORTED, meaning="isonoise renders RGB")
_PINHOLE = (
    *FIELD_OF_VIEW,
    *_CLIP,
    *TO_WORLD,
    *_SHUTTER,
    _SRF,
)
_FILM_SIDE = "[1, 65536]"
_DEPTH = "[-1, 2147483647]"
_SAMPLE_COUNT = P("sample_count", "integer", 4, "[1, 4294967295]", meaning="samples per pixel, unless --spp is given")
_BLOCKS = (
    *ignored("integer", "block_size", "samples_per_pass", why="how Mitsuba schedules its work"),
    *ignored("float", "timeout", why="use isonoise render --time"),
)
_HIDE = P("hide_emitters", "boolean", False, meaning="emitters are not directly visible")
_PATH = (
    P("max_depth", "integer", -1, _DEPTH, meaning="1 is emitters only, 2 is direct light, -1 is unlimited"),
    P("rr_depth", "integer", 5, "[1, 2147483647]", meaning="depth from which Russian roulette may end a path"),
    _HIDE,
    *_BLOCKS,
)

SENSORS = (
    Plugin(
        "sensor",
        "perspective",
        (
            *_PINHOLE,
            P("principal_point_offset_x", "float", 0.0, meaning="shift of the image, in fractions of its width"),
            P("principal_point_offset_y", "float", 0.0, meaning="shift of the image, in fractions of its height"),
            *_FOCUS,
        ),
        _CHILDREN,
        meaning="a pinhole camera",
    ),
    Plugin(
        "sensor",
        "thinlens",
        (
            *_PINHOLE,
            P("aperture_radius", "float", required=True, interval="[0, inf)", meaning="radius of the lens"),
            P(
                "focus_distance",
                "float",
                interval="(0, inf)",
                meaning="distance of the plane in focus",
                unset="far_clip",
            ),
        ),
        _CHILDREN,
        meaning="a camera with a round lens, for depth of field",
    ),
    Plugin(
        "sensor",
        "orthographic",
        (*_CLIP, *TO_WORLD, *_SHUTTER, *_FOCUS, _SRF),
        _CHILDREN,
        meaning="a camera with parallel rays; the image is [-1, 1] wide, scaled by to_world",
    ),
)

FILMS = (
    Plugin(
        "film",
        "hdrfilm",
        (
            P("width", "integer", 768, _FILM_SIDE, meaning="pixels"),
            P("height", "integer", 576, _FILM_SIDE, meaning="pixels"),
            P("crop_offset_x", "integer", 0, "[0, 65536]", meaning="pixels left of the crop window"),
            P("crop_offset_y", "integer", 0, "[0, 65536]", meaning="pixels above the crop window"),
            P("crop_width", "integer", interval=_FILM_SIDE, meaning="width of the crop window, pixels", unset="width"),
            P(
                "crop_height",
                "integer",
                interval=_FILM_SIDE,
                meaning="height of the crop window, pixels",
                unset="height",
            ),
            P(
                "exposure",
                "float",
                interval="(0, inf)",
                meaning="factor on radiance in .png files; isonoise's own",
                unset="by the image's brightness",
            ),
            *ignored("string", "file_format", "pixel_format", "component_format", why="set by the output file's name"),
            *ignored(
                "boolean", "sample_border", why="a sample belongs to one pixel, so the border needs no extra samples"
            ),
            *ignored("boolean", "compensate", why="sums are always compensated"),
            *ignored("boolean", "banner", "high_quality_edges", why="parameters of older Mitsuba versions"),
        ),
        (Child("rfilter"),),
        meaning="size and crop window of the image",
    ),
    Plugin("rfilter", "box", meaning="mean over the pixel"),
    Plugin("rfilter", "tent", (P("radius", "float", 1.0, "(0, inf)", meaning="pixels"),), meaning="linear falloff"),
    Plugin(
        "rfilter",
        "gaussian",
        (P("stddev", "float", 0.5, "(0, inf)", meaning="pixels; truncated at four times stddev"),),
        meaning="Gaussian; the default",
    ),
)

SAMPLERS = (
    Plugin(
        "sampler",
        "independent",
        (_SAMPLE_COUNT,),
        any_parameter=True,
        meaning="independent random numbers",
    ),
    *(
        Plugin(
            "sampler",
            name,
            (_SAMPLE_COUNT,),
            any_parameter=True,
            meaning="isonoise's sampler sobol, which is the default",
        )
        for name in ("stratified", "multijitter", "orthogonal", "ldsampler")
    ),
)

INTEGRATORS = (
    Plugin("integrator", "path", _PATH, meaning="path tracing; the default"),
    Plugin("integrator", "volpath", _PATH, meaning="path tracing with media and pass-through surfaces"),
    Plugin(
        "integrator",
        "volpathmis",
        (*_PATH, *ignored("boolean", "use_spectral_mis", why="isonoise always weights colours together")),
        meaning="the same as volpath: isonoise always weights colours together",
    ),
    Plugin(
        "integrator",
        "direct",
        (
            _HIDE,
            *ignored("integer", "shading_samples", "emitter_samples", "bsdf_samples", why="one of each, as in path"),
            *_BLOCKS,
        ),
        meaning="direct light: path with max_depth 2",
    ),
    Plugin(
        "integrator",
        "moment",
        (),
        (Child("integrator", min_count=1),),
        status=IGNORED,
        meaning="the nested integrator is used; isonoise writes its own error estimates",
    ),
    Plugin(
        "integrator",
        "aov",
        ignored("string", "aovs", why="isonoise has other layers"),
        (Child("integrator", min_count=1),),
        status=IGNORED,
        meaning="the nested integrator is used",
    ),
)
