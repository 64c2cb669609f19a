"""The supported subset of Mitsuba 3's scene vocabulary, as tables; names, units and defaults are its own (3.9)."""

from isonoise.scene.registry import IGNORED, UNSUPPORTED, Child, Parameter, Plugin

P = Parameter


def _ignored(type_: str, *names: str) -> tuple[Parameter, ...]:
    return tuple(P(name, type_, status=IGNORED) for name in names)


_PLACED = (P("to_world", "transform"),)
_SHAPE = (*_PLACED, P("flip_normals", "boolean", False), *_ignored("float", "silhouette_sampling_weight"))
_SHAPE_CHILDREN = (Child("bsdf"), Child("emitter", types=("area",)))
_MESH = (P("filename", "file", required=True), *_SHAPE, P("face_normals", "boolean", False))
_EMITTER = _ignored("float", "sampling_weight")
_CLIP = (P("near_clip", "float", 1e-2, "(0, inf)"), P("far_clip", "float", 1e4, "(0, inf)"))
_FILM_SIDE = "[1, 65536]"
_DEPTH = "[-1, 2147483647]"
_SAMPLE_COUNT = P("sample_count", "integer", 4, "[1, 4294967295]")

PLUGINS: tuple[Plugin, ...] = (
    Plugin(
        "sensor",
        "perspective",
        (
            P("fov", "float", interval="(0, 180)"),
            P("focal_length", "string"),
            P("fov_axis", "string", "x", choices=("x", "y", "diagonal", "smaller", "larger")),
            *_CLIP,
            P("principal_point_offset_x", "float", 0.0),
            P("principal_point_offset_y", "float", 0.0),
            *_PLACED,
            *_ignored("float", "shutter_open", "shutter_close", "focus_distance"),
            P("srf", "any", status=UNSUPPORTED),
        ),
        (Child("film"), Child("sampler")),
    ),
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
            *_ignored("string", "file_format", "pixel_format", "component_format"),
            *_ignored("boolean", "sample_border", "compensate", "banner", "high_quality_edges"),
        ),
        (Child("rfilter"),),
    ),
    Plugin("rfilter", "box"),
    Plugin("rfilter", "tent", (P("radius", "float", 1.0, "(0, inf)"),)),
    Plugin("rfilter", "gaussian", (P("stddev", "float", 0.5, "(0, inf)"),)),
    *(
        Plugin("sampler", name, (_SAMPLE_COUNT,), any_parameter=True)
        for name in ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
    ),
    Plugin(
        "integrator",
        "path",
        (
            P("max_depth", "integer", -1, _DEPTH),
            P("rr_depth", "integer", 5, "[1, 2147483647]"),
            P("hide_emitters", "boolean", False),
            *_ignored("integer", "block_size", "samples_per_pass"),
            *_ignored("float", "timeout"),
        ),
    ),
    Plugin(
        "integrator",
        "direct",
        (
            P("hide_emitters", "boolean", False),
            *_ignored("integer", "shading_samples", "emitter_samples", "bsdf_samples"),
            *_ignored("integer", "block_size", "samples_per_pass"),
            *_ignored("float", "timeout"),
        ),
    ),
    Plugin("integrator", "moment", (), (Child("integrator", least=1),)),
    Plugin("integrator", "aov", _ignored("string", "aovs"), (Child("integrator", least=1),)),
    Plugin("bsdf", "diffuse", (P("reflectance", "reflectance", 0.5),)),
    Plugin(
        "bsdf",
        "dielectric",
        (
            P("int_ior", "index", "bk7"),
            P("ext_ior", "index", "air"),
            P("specular_reflectance", "reflectance", 1.0),
            P("specular_transmittance", "reflectance", 1.0),
        ),
    ),
    Plugin(
        "bsdf",
        "conductor",
        (
            P("material", "string"),
            P("eta", "unbounded"),
            P("k", "unbounded"),
            P("specular_reflectance", "reflectance", 1.0),
        ),
    ),
    Plugin("bsdf", "twosided", (), (Child("bsdf", most=2, least=1, types=("diffuse", "conductor")),)),
    Plugin("shape", "rectangle", _SHAPE, _SHAPE_CHILDREN),
    Plugin("shape", "cube", _SHAPE, _SHAPE_CHILDREN),
    Plugin(
        "shape",
        "sphere",
        (P("center", "vector", (0.0, 0.0, 0.0)), P("radius", "float", 1.0, "(0, inf)"), *_SHAPE),
        _SHAPE_CHILDREN,
    ),
    Plugin("shape", "disk", _SHAPE, _SHAPE_CHILDREN),
    Plugin(
        "shape",
        "cylinder",
        (
            P("p0", "vector", (0.0, 0.0, 0.0)),
            P("p1", "vector", (0.0, 0.0, 1.0)),
            P("radius", "float", 1.0, "(0, inf)"),
            *_SHAPE,
        ),
        _SHAPE_CHILDREN,
    ),
    Plugin("shape", "obj", (*_MESH, *_ignored("boolean", "flip_tex_coords")), _SHAPE_CHILDREN),
    Plugin("shape", "ply", (*_MESH, *_ignored("boolean", "flip_tex_coords")), _SHAPE_CHILDREN),
    Plugin(  # isonoise's own: what meshes without a scene become
        "shape",
        "mesh",
        (
            P("vertices", "positions", required=True),
            P("faces", "indices", required=True),
            P("normals", "positions"),
            *_SHAPE,
            P("face_normals", "boolean", False),
        ),
        _SHAPE_CHILDREN,
    ),
    Plugin("emitter", "area", (P("radiance", "radiance", 1.0), *_EMITTER)),
    Plugin("emitter", "point", (P("intensity", "radiance", 1.0), P("position", "vector"), *_PLACED, *_EMITTER)),
    Plugin("emitter", "directional", (P("irradiance", "radiance", 1.0), P("direction", "vector"), *_PLACED, *_EMITTER)),
    Plugin("emitter", "constant", (P("radiance", "radiance", 1.0), *_EMITTER)),
    Plugin(
        "scene",
        "scene",
        _ignored("boolean", "embree_use_robust_intersections"),
        (
            Child("integrator"),
            Child("sensor", most=1 << 16),
            Child("shape", most=1 << 32),
            Child("emitter", most=1 << 32, types=("point", "directional", "constant")),
            Child("bsdf", most=1 << 32),
        ),
    ),
)

ELSEWHERE: dict[str, tuple[str, ...]] = {
    kind: tuple(names.split())
    for kind, names in {
        "sensor": "batch distant irradiancemeter orthographic radiancemeter thinlens",
        "film": "specfilm",
        "rfilter": "catmullrom lanczos mitchell",
        "integrator": "depth direct_projective prb prb_basic prb_projective prbvolpath ptracer stokes volpath "
        "volpathmis",
        "bsdf": "blendbsdf bumpmap circular hair mask measured measured_polarized normalmap null plastic polarizer "
        "pplastic principled principledthin retarder roughconductor roughdielectric roughplastic thindielectric",
        "shape": "blender bsplinecurve ellipsoids ellipsoidsmesh instance linearcurve merge sdfgrid serialized "
        "shapegroup",
        "emitter": "directionalarea envmap projector spot sunsky timed_sunsky",
        "texture": "bitmap blackbody checkerboard d65 irregular mesh_attribute rawconstant regular srgb uniform volume",
        "medium": "heterogeneous homogeneous",
        "phase": "blendphase hg isotropic rayleigh sggx tabphase",
        "volume": "constvolume gridvolume",
    }.items()
}
"""Plugins that Mitsuba 3 has and isonoise does not: named in the error, so that nobody looks for a typing mistake."""


def plugins_of(kind: str) -> dict[str, Plugin]:
    """The supported plugins of a kind by name."""
    return {p.name: p for p in PLUGINS if p.kind == kind}


def kinds_of(name: str) -> tuple[str, ...]:
    """All kinds in which Mitsuba 3 has a plugin with this name."""
    here = tuple(p.kind for p in PLUGINS if p.name == name)
    return here + tuple(kind for kind, names in ELSEWHERE.items() if name in names)
