"""Sensors, films, reconstruction filters, samplers and integrators of the vocabulary."""

from isonoise.scene.vocabulary.common import PLACED, ignored
from isonoise.scene.vocabulary.plugin import IGNORED, UNSUPPORTED, Child, Parameter, Plugin

P = Parameter
_CLIP = (
    P("near_clip", "float", 1e-2, "(0, inf)", meaning="depth at which the picture begins"),
    P("far_clip", "float", 1e4, "(0, inf)", meaning="depth at which it ends"),
)
_CHILDREN = (Child("film"), Child("sampler"), Child("medium"))
_SHUTTER = ignored("float", "shutter_open", "shutter_close", why="nothing moves in a scene")
_FOCUS = ignored("float", "focus_distance", why="all distances are in focus")
_SRF = P("srf", "any", status=UNSUPPORTED, meaning="isonoise renders RGB")
_PINHOLE = (
    P("fov", "float", interval="(0, 180)", meaning="angle of view along fov_axis, degrees", unset="by focal_length"),
    P("focal_length", "string", meaning="of a 35 mm camera, as in 50mm", unset="50mm"),
    P(
        "fov_axis",
        "string",
        "x",
        choices=("x", "y", "diagonal", "smaller", "larger"),
        meaning="side of the picture that fov spans",
    ),
    *_CLIP,
    *PLACED,
    *_SHUTTER,
    _SRF,
)
_FILM_SIDE = "[1, 65536]"
_DEPTH = "[-1, 2147483647]"
_SAMPLE_COUNT = P("sample_count", "integer", 4, "[1, 4294967295]", meaning="samples per pixel where nothing else says")
_BLOCKS = (
    *ignored("integer", "block_size", "samples_per_pass", why="how Mitsuba cuts its work"),
    *ignored("float", "timeout", why="isonoise render --time says it"),
)
_HIDE = P("hide_emitters", "boolean", False, meaning="lights are not in the picture themselves")
_PATH = (
    P("max_depth", "integer", -1, _DEPTH, meaning="longest path: 1 sees lights alone, 2 direct light, -1 has no end"),
    P("rr_depth", "integer", 5, "[1, 2147483647]", meaning="depth from which russian roulette may end a path"),
    _HIDE,
    *_BLOCKS,
)

SENSORS = (
    Plugin(
        "sensor",
        "perspective",
        (
            *_PINHOLE,
            P("principal_point_offset_x", "float", 0.0, meaning="shift of the picture, in its widths"),
            P("principal_point_offset_y", "float", 0.0, meaning="shift of the picture, in its heights"),
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
            P("aperture_radius", "float", required=True, interval="[0, inf)", meaning="of the lens"),
            P("focus_distance", "float", interval="(0, inf)", meaning="of the plane in focus", unset="far_clip"),
        ),
        _CHILDREN,
        meaning="a camera with a round lens: depth of field",
    ),
    Plugin(
        "sensor",
        "orthographic",
        (*_CLIP, *PLACED, *_SHUTTER, *_FOCUS, _SRF),
        _CHILDREN,
        meaning="a camera of parallel rays; to_world scales its picture, from -1 to 1",
    ),
)

FILMS = (
    Plugin(
        "film",
        "hdrfilm",
        (
            P("width", "integer", 768, _FILM_SIDE, meaning="pixels"),
            P("height", "integer", 576, _FILM_SIDE, meaning="pixels"),
            P("crop_offset_x", "integer", 0, "[0, 65536]", meaning="pixels left of the window that is rendered"),
            P("crop_offset_y", "integer", 0, "[0, 65536]", meaning="pixels above it"),
            P("crop_width", "integer", interval=_FILM_SIDE, meaning="pixels of the window", unset="width"),
            P("crop_height", "integer", interval=_FILM_SIDE, meaning="pixels of the window", unset="height"),
            *ignored("string", "file_format", "pixel_format", "component_format", why="the name of the output says it"),
            *ignored(
                "boolean", "sample_border", why="a sample belongs to one pixel: pixels at the border are as others"
            ),
            *ignored("boolean", "compensate", why="sums are always compensated"),
            *ignored("boolean", "banner", "high_quality_edges", why="parameters of older versions"),
        ),
        (Child("rfilter"),),
        meaning="size and window of the picture",
    ),
    Plugin("rfilter", "box", meaning="the mean over the pixel"),
    Plugin(
        "rfilter",
        "tent",
        (P("radius", "float", 1.0, "(0, inf)", meaning="pixels"),),
        meaning="falls to zero linearly",
    ),
    Plugin(
        "rfilter",
        "gaussian",
        (P("stddev", "float", 0.5, "(0, inf)", meaning="pixels; cut at four of them"),),
        meaning="a Gaussian; where there is no rfilter",
    ),
)

SAMPLERS = tuple(
    Plugin(
        "sampler",
        name,
        (_SAMPLE_COUNT,),
        any_parameter=True,
        status=IGNORED,
        meaning="only sample_count is read: the numbers are isonoise's own",
    )
    for name in ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
)

INTEGRATORS = (
    Plugin("integrator", "path", _PATH, meaning="path tracing; where there is no integrator"),
    Plugin("integrator", "volpath", _PATH, meaning="path tracing with media; surfaces may let light through unturned"),
    Plugin(
        "integrator",
        "volpathmis",
        (*_PATH, *ignored("boolean", "use_spectral_mis", why="colours are always weighted together")),
        meaning="the same as volpath, which here weights colours together as well",
    ),
    Plugin(
        "integrator",
        "direct",
        (
            _HIDE,
            *ignored(
                "integer", "shading_samples", "emitter_samples", "bsdf_samples", why="one of each, as path has them"
            ),
            *_BLOCKS,
        ),
        meaning="direct light: as path with max_depth 2",
    ),
    Plugin(
        "integrator",
        "moment",
        (),
        (Child("integrator", least=1),),
        status=IGNORED,
        meaning="the integrator inside it is read; isonoise writes error estimates of its own",
    ),
    Plugin(
        "integrator",
        "aov",
        ignored("string", "aovs", why="isonoise has no such layers"),
        (Child("integrator", least=1),),
        status=IGNORED,
        meaning="the integrator inside it is read",
    ),
)
