"""Maps pbrt's Camera, Film, PixelFilter, Sampler and Integrator to a sensor and an integrator.

Called by `scene_builder.py`. pbrt's camera space is left-handed: x is right, y up, z forward; Mitsuba's x is left.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from isonoise.limits import MAX_PIXELS
from isonoise.scene import transforms
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.report import ImportReport

_CAMERAS = ("perspective", "orthographic", "realistic", "spherical", "environment")
_NEAR_CLIP, _FAR_CLIP = 1e-5, 1e8  # pbrt clips nothing
_MAX_RELATIVE_SHEAR = 1e-3
_SQUARE_PIXEL_TOLERANCE = 1e-3
_MAX_SIDE = 65536
_ONLY_PATH_TRACED = ("bdpt", "mlt", "sppm", "lightpath", "simplepath", "simplevolpath")  # same image
_DIRECT = ("directlighting", "whitted")
_INTEGRATORS = ("path", "volpath", *_ONLY_PATH_TRACED, *_DIRECT, "ambientocclusion", "ao", "randomwalk", "function")
_DEFAULT_MAX_DEPTH = 5
_MAX_SAMPLES = 1 << 30


@dataclass
class Setting:
    """A directive with a type and parameters, such as Film."""

    type: str
    parameters: Parameters


@dataclass
class Screen:
    """The window of the image in camera space, at distance 1."""

    half_width: float
    half_height: float
    center: tuple[float, float]


@dataclass
class CameraSettings:
    """What precedes WorldBegin, by directive."""

    report: ImportReport
    settings: dict[str, Setting] = field(default_factory=dict)
    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))  # from pbrt's camera space
    medium: dict | None = None  # around the camera

    def get(self, directive: str, default_type: str, parameters: Parameters) -> Setting:
        """The setting of a directive, or its default without parameters."""
        return self.settings.get(directive, Setting(default_type, parameters))


def exposure(camera: Parameters, film: Setting) -> float:
    """The factor of the film on radiance.

    pbrt-v4: exposure time times ISO / 100 (PixelSensor::Create). pbrt-v3, whose film is `image`: `scale`.
    """
    if film.type == "image":
        return max(film.parameters.number("scale", 1.0), 0.0)
    seconds = camera.number("shutterclose", 1.0) - camera.number("shutteropen", 0.0)
    speed = film.parameters.number("iso", 100.0)
    return seconds * speed / 100.0 if seconds > 0 and speed > 0 else 1.0


def make_sensor(settings: CameraSettings, empty: Parameters) -> dict:
    """The sensor with its film and sampler. `empty` are the parameters of a directive that the file lacks."""
    camera = settings.get("Camera", "perspective", empty)
    film = make_film(settings, empty)
    if camera.type not in _CAMERAS:
        camera.parameters.position.raise_unknown("unknown camera", camera.type, _CAMERAS)
    settings.report.count("cameras")
    settings.report.use("cameras", f"'{camera.type}'")
    camera.parameters.ignore("shutteropen", "shutterclose")
    if camera.type == "orthographic":
        sensor = _orthographic(settings, camera.parameters, film)
    else:
        sensor = _perspective(settings, camera, film)
    sensor |= {"near_clip": _NEAR_CLIP, "far_clip": _FAR_CLIP, "film": film, "sampler": _sampler(settings, empty)}
    if settings.medium is not None:
        sensor["medium"] = settings.medium
    return sensor


def _perspective(settings: CameraSettings, camera: Setting, film: dict) -> dict:
    parameters = camera.parameters
    if camera.type != "perspective":
        problem = f"the {camera.type} camera becomes a perspective one with an angle of view of 45 degrees"
        settings.report.limit("cameras", problem, parameters.position.place)
        parameters.ignore(*(value.name for value in parameters.unused()))
    fov = parameters.number("fov", 90.0 if camera.type == "perspective" else 45.0)
    half_fov = parameters.number("halffov", None)
    fov = 2 * half_fov if half_fov is not None and half_fov > 0 else fov
    if not 1e-4 <= fov < 180:
        parameters.position_of("fov").raise_error(f"fov has to be at least 0.0001 and below 180 degrees, got {fov:g}")
    rotation, scale = _split_scale(settings.to_world, parameters)
    screen = _screen(parameters, film, settings.report)
    tangent = math.tan(math.radians(fov) / 2)
    half_width = screen.half_width * tangent * scale[0] / scale[2]
    half_height = screen.half_height * tangent * scale[1] / scale[2]
    _check_pixels_are_square(half_width, half_height, film, parameters, settings.report)
    sensor = {"type": "perspective", "fov": 2 * math.degrees(math.atan(half_width)), "fov_axis": "x"}
    lens_radius = parameters.number("lensradius", 0.0)
    focal_distance = parameters.number("focaldistance", 1e6)
    is_shifted = any(screen.center)
    if lens_radius > 0:
        sensor |= {"type": "thinlens", "aperture_radius": lens_radius * scale[0]}
        sensor["focus_distance"] = max(focal_distance * scale[2], 1e-6)
        if is_shifted:
            problem = "the off-center screenwindow of a camera with a lens is centered"
            settings.report.limit("cameras", problem, parameters.position.place)
    elif is_shifted:
        sensor["principal_point_offset_x"] = screen.center[0] / (2 * screen.half_width)
        sensor["principal_point_offset_y"] = -screen.center[1] / (2 * screen.half_height)
    sensor["to_world"] = rotation @ transforms.scale((-1.0, 1.0, 1.0))
    return sensor


def _orthographic(settings: CameraSettings, parameters: Parameters, film: dict) -> dict:
    screen = _screen(parameters, film, settings.report)
    if parameters.number("lensradius", 0.0) > 0:
        problem = "the lens of an orthographic camera is ignored: everything is in focus"
        settings.report.limit("cameras", problem, parameters.position.place)
    parameters.ignore("focaldistance")
    _, scale = _split_scale(settings.to_world, parameters)
    width, height = screen.half_width * scale[0], screen.half_height * scale[1]
    _check_pixels_are_square(width, height, film, parameters, settings.report)
    window = transforms.translate((*screen.center, 0.0)) @ transforms.scale(
        (-screen.half_width, screen.half_width, 1.0)
    )
    return {"type": "orthographic", "to_world": settings.to_world @ window}


def _split_scale(to_world: np.ndarray, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """A rigid transform and the scale of each axis before it."""
    scale = np.linalg.norm(to_world[:3, :3], axis=0)
    if not (np.isfinite(scale).all() and scale.min() > 0):
        parameters.position.raise_error("the transform of the camera cannot be inverted")
    rigid = to_world.copy()
    rigid[:3, :3] /= scale
    if np.abs(rigid[:3, :3].T @ rigid[:3, :3] - np.eye(3)).max() > _MAX_RELATIVE_SHEAR:
        parameters.position.raise_error("the transform of the camera shears: the axes have to be at right angles")
    u, _, vt = np.linalg.svd(rigid[:3, :3])
    rigid[:3, :3] = u @ vt
    return rigid, scale


def _screen(parameters: Parameters, film: dict, report: ImportReport) -> Screen:
    """The window of the image, in which the shorter side goes from -1 to 1."""
    aspect = parameters.number("frameaspectratio", film["width"] / film["height"])
    if not 1e-4 < aspect < 1e4:
        parameters.position_of("frameaspectratio").raise_error("frameaspectratio has to be 0.0001 to 10000")
    half_width, half_height, center = max(aspect, 1.0), max(1.0 / aspect, 1.0), (0.0, 0.0)
    window = parameters.array("screenwindow", ("float", "integer"))
    if window is not None:
        if len(window) != 4 or not (window[0] < window[1] and window[2] < window[3]):
            parameters.position_of("screenwindow").raise_error(
                "screenwindow is xmin xmax ymin ymax, with min below max"
            )
        half_width, half_height = 0.5 * (window[1] - window[0]), 0.5 * (window[3] - window[2])
        center = (0.5 * float(window[0] + window[1]), 0.5 * float(window[2] + window[3]))
    return Screen(float(half_width), float(half_height), center)


def _check_pixels_are_square(width: float, height: float, film: dict, parameters: Parameters, report) -> None:
    ratio = width / height * film["height"] / film["width"]
    if abs(ratio - 1) > _SQUARE_PIXEL_TOLERANCE:
        problem = "pixels that are not square become square: the width of the window is kept"
        report.limit("cameras", problem, parameters.position.place)


def make_film(settings: CameraSettings, empty: Parameters) -> dict:
    """The film with its filter."""
    report, film = settings.report, settings.get("Film", "rgb", empty)
    parameters = film.parameters
    report.use("film")
    if film.type not in ("rgb", "gbuffer", "image", "spectral"):
        parameters.position.raise_error(f"unknown film '{film.type[:40]}': use rgb")
    is_legacy = film.type == "image"
    width = parameters.integer("xresolution", 640 if is_legacy else 1280)
    height = parameters.integer("yresolution", 480 if is_legacy else 720)
    if not (1 <= width <= _MAX_SIDE and 1 <= height <= _MAX_SIDE and width * height <= MAX_PIXELS):
        parameters.position_of("xresolution").raise_error(
            f"the image has {width} x {height} pixels; it may have 1 to {MAX_PIXELS:,} and sides up to {_MAX_SIDE}"
        )
    made = {"type": "hdrfilm", "width": width, "height": height, "rfilter": _filter(settings, empty, is_legacy)}
    made |= _crop(parameters, width, height)
    sensor = parameters.text("sensor", "cie1931")
    if sensor != "cie1931" or parameters.number("whitebalance", 0.0):
        report.limit("film", f"the response of the sensor '{sensor}' and its white balance are ignored")
    for name in ("maxcomponentvalue", "maxsampleluminance"):
        if parameters.number(name, None) is not None:
            report.limit(
                "film", f"'{name}' is ignored: bright samples are not clamped", parameters.position_of(name).place
            )
    parameters.ignore("filename", "diagonal", "savefp16", "iso", "scale", "coordinatesystem", "nbuckets", "lambdamin")
    parameters.ignore("lambdamax")
    return made


def _crop(parameters: Parameters, width: int, height: int) -> dict:
    """The crop window: `cropwindow` in fractions, or `pixelbounds`, both xmin xmax ymin ymax."""
    fractions = parameters.array("cropwindow", ("float", "integer"))
    pixels = parameters.array("pixelbounds", ("integer",))
    for name, window in (("cropwindow", fractions), ("pixelbounds", pixels)):
        if window is not None and len(window) != 4:
            parameters.position_of(name).raise_error(f"{name} needs four numbers")
    if fractions is None and pixels is None:
        return {}
    if fractions is not None:
        x = sorted(math.ceil(width * min(max(fraction, 0.0), 1.0)) for fraction in fractions[:2])
        y = sorted(math.ceil(height * min(max(fraction, 0.0), 1.0)) for fraction in fractions[2:])
    else:
        x = [int(min(max(bound, 0), width)) for bound in pixels[:2]]
        y = [int(min(max(bound, 0), height)) for bound in pixels[2:]]
    if x[0] >= x[1] or y[0] >= y[1]:
        parameters.position.raise_error("the crop window contains no pixel")
    return {"crop_offset_x": x[0], "crop_offset_y": y[0], "crop_width": x[1] - x[0], "crop_height": y[1] - y[0]}


def _filter(settings: CameraSettings, empty: Parameters, is_legacy: bool) -> dict:
    setting = settings.get("PixelFilter", "box" if is_legacy else "gaussian", empty)
    parameters, kind = setting.parameters, setting.type
    defaults = {"box": 0.5, "gaussian": 2.0 if is_legacy else 1.5, "triangle": 2.0, "mitchell": 2.0, "sinc": 4.0}
    if kind not in defaults:
        parameters.position.raise_unknown("unknown filter", kind, defaults)
    radii = [parameters.number(f"{axis}radius", parameters.number(f"{axis}width", defaults[kind])) for axis in "xy"]
    alpha, sigma = parameters.number("alpha", None), parameters.number("sigma", 0.5)
    parameters.ignore("B", "C", "tau")
    if not all(1e-3 <= radius <= 1e3 for radius in radii):
        parameters.position.raise_error("the radius of a filter has to be 0.001 to 1000 pixels")
    if radii[0] != radii[1]:
        settings.report.limit("film", "a filter with two radii gets the same in both directions")
    if kind == "box":
        if radii[0] != 0.5:
            settings.report.limit("film", "a box filter becomes one pixel wide")
        return {"type": "box"}
    if kind == "triangle":
        return {"type": "tent", "radius": radii[0]}
    if kind in ("mitchell", "sinc"):
        settings.report.limit("film", f"the filter '{kind}', which has negative lobes, becomes a Gaussian")
        return {"type": "gaussian", "stddev": 0.5}
    if alpha is not None or is_legacy:
        alpha = 2.0 if alpha is None else alpha
        sigma = math.sqrt(0.5 / alpha) if alpha > 0 else 0.5  # pbrt-v3: exp(-alpha x^2)
    return {"type": "gaussian", "stddev": min(max(sigma, 1e-3), 1e3)}


def _sampler(settings: CameraSettings, empty: Parameters) -> dict:
    setting = settings.get("Sampler", "zsobol", empty)
    parameters = setting.parameters
    if setting.type == "stratified":
        count = parameters.integer("xsamples", 4) * parameters.integer("ysamples", 4)
    else:
        count = parameters.integer("pixelsamples", 16)
    parameters.ignore("pixelsamples", "xsamples", "ysamples", "jitter", "dimensions", "seed", "randomization")
    parameters.ignore("samplepixelcenter")
    if not 1 <= count <= _MAX_SAMPLES:
        parameters.position.raise_error(f"the number of samples per pixel has to be 1 to {_MAX_SAMPLES}, got {count}")
    kind = "independent" if setting.type in ("independent", "random") else "multijitter"
    return {"type": kind, "sample_count": count}


def make_integrator(settings: CameraSettings, empty: Parameters, has_volumes: bool) -> dict:
    """The integrator. pbrt counts bounces, Mitsuba edges of the path, so max_depth is maxdepth + 1.

    `has_volumes`: there are media or surfaces that let light pass straight through, which only volpath handles as pbrt
    does.
    """
    default = Setting("volpath", empty)
    setting = settings.settings.get("Integrator", settings.settings.get("SurfaceIntegrator", default))
    parameters, report = setting.parameters, settings.report
    if setting.type not in _INTEGRATORS:
        parameters.position.raise_unknown("unknown integrator", setting.type, _INTEGRATORS)
    if setting.type in ("ambientocclusion", "ao", "function", "randomwalk"):
        report.limit("film", f"the integrator '{setting.type}' is replaced by path tracing")
    depth = parameters.integer("maxdepth", _DEFAULT_MAX_DEPTH)
    if setting.type in _DIRECT:
        problem = f"the integrator '{setting.type}' is replaced by 'direct': mirrors and glass show only lights"
        report.limit("film", problem, parameters.position.place)
    if parameters.boolean("regularize", False):
        report.limit("film", "'regularize' is ignored: rough reflections of reflections stay sharp")
    parameters.ignore(*(value.name for value in parameters.unused()))
    if setting.type in _DIRECT:
        return {"type": "direct"}
    return {"type": "volpath" if has_volumes else "path", "max_depth": min(max(depth, 0), 2**31 - 2) + 1}


def ignores_media(settings: CameraSettings) -> bool:
    """Whether the file's integrator renders no media."""
    setting = settings.settings.get("Integrator", settings.settings.get("SurfaceIntegrator"))
    return setting is not None and setting.type in ("path", "simplepath", *_DIRECT, "ambientocclusion", "ao", "sppm")
