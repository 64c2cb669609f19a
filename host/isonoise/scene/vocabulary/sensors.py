"""Sensors, films, reconstruction filters, samplers and integrators of the vocabulary."""

from isonoise.scene.registry import UNSUPPORTED, Child, Parameter, Plugin
from isonoise.scene.vocabulary.common import PLACED, ignored

P = Parameter
_CLIP = (P("near_clip", "float", 1e-2, "(0, inf)"), P("far_clip", "float", 1e4, "(0, inf)"))
_CHILDREN = (Child("film"), Child("sampler"), Child("medium"))
_SHUTTER = ignored("float", "shutter_open", "shutter_close")
_FOCUS = ignored("float", "focus_distance")
_SRF = P("srf", "any", status=UNSUPPORTED)
_PINHOLE = (
    P("fov", "float", interval="(0, 180)"),
    P("focal_length", "string"),
    P("fov_axis", "string", "x", choices=("x", "y", "diagonal", "smaller", "larger")),
    *_CLIP,
    *PLACED,
    *_SHUTTER,
    _SRF,
)
_FILM_SIDE = "[1, 65536]"
_DEPTH = "[-1, 2147483647]"
_SAMPLE_COUNT = P("sample_count", "integer", 4, "[1, 4294967295]")
_BLOCKS = (*ignored("integer", "block_size", "samples_per_pass"), *ignored("float", "timeout"))
_PATH = (
    P("max_depth", "integer", -1, _DEPTH),
    P("rr_depth", "integer", 5, "[1, 2147483647]"),
    P("hide_emitters", "boolean", False),
    *_BLOCKS,
)

SENSORS = (
    Plugin(
        "sensor",
        "perspective",
        (
            *_PINHOLE,
            P("principal_point_offset_x", "float", 0.0),
            P("principal_point_offset_y", "float", 0.0),
            *_FOCUS,
        ),
        _CHILDREN,
    ),
    Plugin(
        "sensor",
        "thinlens",
        (
            *_PINHOLE,
            P("aperture_radius", "float", required=True, interval="[0, inf)"),
            P("focus_distance", "float", interval="(0, inf)"),
        ),
        _CHILDREN,
    ),
    Plugin("sensor", "orthographic", (*_CLIP, *PLACED, *_SHUTTER, *_FOCUS, _SRF), _CHILDREN),
)

FILMS = (
    Plugin(
        "film",
        "hdrfilm",
        (
            P("width", "integer", 768, _FILM_SIDE),
            P("height", "integer", 576, _FILM_SIDE),
            P("crop_offset_x", "integer", 0, "[0, 65536]"),
            P("crop_offset_y", "integer", 0, "[0, 65536]"),
            P("crop_width", "integer", interval=_FILM_SIDE),
            P("crop_height", "integer", interval=_FILM_SIDE),
            *ignored("string", "file_format", "pixel_format", "component_format"),
            *ignored("boolean", "sample_border", "compensate", "banner", "high_quality_edges"),
        ),
        (Child("rfilter"),),
    ),
    Plugin("rfilter", "box"),
    Plugin("rfilter", "tent", (P("radius", "float", 1.0, "(0, inf)"),)),
    Plugin("rfilter", "gaussian", (P("stddev", "float", 0.5, "(0, inf)"),)),
)

SAMPLERS = tuple(
    Plugin("sampler", name, (_SAMPLE_COUNT,), any_parameter=True)
    for name in ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
)

INTEGRATORS = (
    Plugin("integrator", "path", _PATH),
    Plugin("integrator", "volpath", _PATH),
    Plugin(
        "integrator",
        "direct",
        (
            P("hide_emitters", "boolean", False),
            *ignored("integer", "shading_samples", "emitter_samples", "bsdf_samples"),
            *_BLOCKS,
        ),
    ),
    Plugin("integrator", "moment", (), (Child("integrator", least=1),)),
    Plugin("integrator", "aov", ignored("string", "aovs"), (Child("integrator", least=1),)),
)
