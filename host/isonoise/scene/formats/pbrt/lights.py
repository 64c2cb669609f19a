"""Maps pbrt's lights to Mitsuba's emitters. Called by `scene_builder.py`.

pbrt-v4 scales every light so that its spectrum has luminance 1 before `scale`, `power` or `illuminance`; with rgb the
values count as they are. See `colours.py`.
"""

import math

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.pbrt.colours import Colours
from isonoise.scene.formats.pbrt.environment import equal_area_directions, resample_equal_area
from isonoise.scene.formats.pbrt.parameters import SPECTRUM_TYPES, Parameters
from isonoise.scene.formats.pbrt.surfaces_of_revolution import scales_uniformly
from isonoise.scene.formats.pbrt.textures import Textures
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image
from isonoise.scene.spectra import MITSUBA_LUMINANCE

_LIGHTS = ("point", "spot", "distant", "infinite", "goniometric", "projection")
_MAX_CUTOFF_DEGREES = 89.9  # Mitsuba's spot is narrower than a hemisphere
_TO_ENVMAP = np.array(  # from the space of Mitsuba's `envmap` to that of pbrt-v3's: z up, azimuth from +x
    [[0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class Lights:
    """Makes the emitters of a scene, all times `exposure`, the imaging ratio of pbrt-v4's sensor."""

    def __init__(self, colours: Colours, textures: Textures, report: ImportReport):
        self._colours, self._textures, self._report = colours, textures, report
        self.exposure = 1.0

    def make(self, kind: str, parameters: Parameters, to_world: np.ndarray) -> dict:
        """The emitter of a `LightSource`."""
        if kind not in _LIGHTS:
            parameters.position.raise_unknown("unknown light", kind, _LIGHTS)
        self._report.count("lights")
        parameters.ignore("samples", "nsamples")
        make = {"distant": self._distant, "infinite": self._infinite, "spot": self._spot}.get(kind, self._point)
        if kind in ("goniometric", "projection"):
            return self._image_light(kind, parameters, to_world)
        return make(parameters, to_world)

    def area_emitter(self, parameters: Parameters, area: float, light_count: int) -> dict:
        """The emitter of a shape under `AreaLightSource`, which is cut into `light_count` lights."""
        self._report.use("emission")
        parameters.ignore("samples", "nsamples")
        factor = self._factor(parameters)
        power = parameters.number("power", None)
        sides = 2 if parameters.boolean("twosided", False) else 1
        image = self._textures.read_image(parameters, "filename") if "filename" in parameters else None
        if power is not None and power > 0:
            emitted = math.pi * area * sides
            if image is not None:
                emitted *= float(np.mean(_luminance(image)))
            factor = factor * (power * light_count / emitted if emitted > 0 else 0.0)
        if image is not None:
            texture = {"type": "bitmap", "bitmap": self._textures.scaled_image(image, factor), "wrap_mode": "clamp"}
            return {"type": "area", "radiance": texture}
        return {"type": "area", "radiance": rgb(self._emission(parameters, "L") * factor)}

    def _emission(self, parameters: Parameters, name: str) -> np.ndarray:
        value = parameters.find(name, "float", *SPECTRUM_TYPES)
        return np.ones(3) if value is None else self._colours.emission(value)

    def _factor(self, parameters: Parameters) -> np.ndarray:
        """`scale`, a number or in pbrt-v3 a spectrum, times the exposure; (3,)."""
        value = parameters.find("scale", "float", "integer", *SPECTRUM_TYPES)
        if value is None:
            return np.full(3, self.exposure)
        scale = np.full(3, value.values[0]) if value.type in ("float", "integer") else self._colours.unbounded(value)
        if scale.min() < 0:
            value.position.raise_error("'scale' of a light cannot be negative")
        return scale * self.exposure

    def _intensity(self, parameters: Parameters, directional_extent: float) -> np.ndarray:
        """Radiant intensity (3,); with `power`, over an extent in steradians."""
        intensity = self._emission(parameters, "I") * self._factor(parameters)
        power = parameters.number("power", None)
        return intensity * (power / directional_extent) if power is not None and power > 0 else intensity

    def _point(self, parameters: Parameters, to_world: np.ndarray) -> dict:
        self._report.use("point_lights")
        origin = parameters.vector("from", (0, 0, 0))
        position = transforms.transform_points(to_world, origin[None])[0]
        intensity = self._intensity(parameters, 4 * math.pi)
        return {"type": "point", "position": position.tolist(), "intensity": rgb(intensity)}

    def _spot(self, parameters: Parameters, to_world: np.ndarray) -> dict:
        self._report.use("spot_lights")
        cone = parameters.number("coneangle", 30.0)
        delta = parameters.number("conedeltaangle", 5.0)
        place = parameters.position.place
        if not (0 < cone <= 180 and delta >= 0):
            parameters.position.raise_error("coneangle has to be in (0, 180], conedeltaangle at least 0")
        start = max(cone - delta, 0.0)
        cos_end, cos_start = math.cos(math.radians(cone)), math.cos(math.radians(start))
        extent = 2 * math.pi * ((1 - cos_start) + (cos_start - cos_end) / 2)
        if cone > _MAX_CUTOFF_DEGREES:
            self._report.limit("spot_lights", "a cone wider than a hemisphere is cut to one", place)
            cone = _MAX_CUTOFF_DEGREES
        if start < cone:
            problem = "the soft edge is linear in the angle; in pbrt it is a smooth step of its cosine"
            self._report.limit("spot_lights", problem, place)
        return {
            "type": "spot",
            "to_world": self._aim(parameters, to_world),
            "cutoff_angle": cone,
            "beam_width": min(start, cone),
            "intensity": rgb(self._intensity(parameters, extent)),
        }

    def _aim(self, parameters: Parameters, to_world: np.ndarray) -> np.ndarray:
        """The transform that moves +z to the axis of a light with `from` and `to`."""
        ends = np.stack([parameters.vector("from", (0, 0, 0)), parameters.vector("to", (0, 0, 1))])
        origin, target = transforms.transform_points(to_world, ends)
        try:
            return transforms.look_at(origin, target)
        except ValueError:
            parameters.position.raise_error("'from' and 'to' of a light have to differ")

    def _distant(self, parameters: Parameters, to_world: np.ndarray) -> dict:
        self._report.use("directional_lights")
        irradiance = self._emission(parameters, "L") * self._factor(parameters)
        illuminance = parameters.number("illuminance", None)
        if illuminance is not None and illuminance > 0:
            irradiance = irradiance * illuminance
        direction = to_world[:3, :3] @ (parameters.vector("to", (0, 0, 1)) - parameters.vector("from", (0, 0, 0)))
        if not direction.any():
            parameters.position.raise_error("'from' and 'to' of a light have to differ")
        direction = direction / np.linalg.norm(direction)
        return {"type": "directional", "direction": direction.tolist(), "irradiance": rgb(irradiance)}

    def _infinite(self, parameters: Parameters, to_world: np.ndarray) -> dict:
        self._report.use("environment")
        factor = self._factor(parameters)
        if "portal" in parameters:
            parameters.ignore("portal")
            problem = "the portal of an infinite light is ignored: light comes from all directions"
            self._report.limit("environment", problem, parameters.position.place)
        illuminance = parameters.number("illuminance", None)
        name = "filename" if "filename" in parameters else "mapname"
        if name not in parameters or not parameters.text(name):
            if illuminance is not None and illuminance > 0:
                factor = factor * illuminance / math.pi
            return {"type": "constant", "radiance": rgb(self._emission(parameters, "L") * factor)}
        image = Image(self._textures.read_image(parameters, name).pixels)
        self._check_pixels(image, parameters, name)
        if "L" in parameters:
            factor = factor * self._emission(parameters, "L")
        is_square = image.pixels.shape[0] == image.pixels.shape[1]
        if name == "filename" and not is_square:
            problem = "the image is not square, so it is read as latitude and longitude, as in pbrt-v3"
            self._report.limit("environment", problem, parameters.place(name).place)
        if name == "mapname" or not is_square:
            return self._envmap(image, factor, to_world @ _TO_ENVMAP, parameters)
        if illuminance is not None and illuminance > 0:
            factor = factor * illuminance / _upward_illuminance(image)
        return self._envmap(resample_equal_area(image), factor, to_world, parameters)

    def _envmap(self, image: Image, factor: np.ndarray, to_world: np.ndarray, parameters: Parameters) -> dict:
        if not scales_uniformly(to_world):
            parameters.position.raise_error("the transform of an infinite light may only rotate, mirror and scale")
        linear = to_world[:3, :3]
        rotation = np.eye(4)
        rotation[:3, :3] = linear / abs(np.linalg.det(linear)) ** (1 / 3)
        return {"type": "envmap", "bitmap": self._textures.scaled_image(image, factor), "to_world": rotation}

    def _image_light(self, kind: str, parameters: Parameters, to_world: np.ndarray) -> dict:
        """A goniometric or projection light: a point light of the same mean intensity, or a spot."""
        factor = 1.0
        parameters.ignore("mapname", "filename")
        name = "filename" if "filename" in parameters else "mapname"
        if kind == "goniometric" and name in parameters:
            image = self._textures.read_image(parameters, name)
            self._check_pixels(image, parameters, name)
            factor = 1.0 if parameters.number("power", -1.0) > 0 else float(image.linear().mean())
        if kind == "projection":
            parameters.ignore("fov")
        problem = f"a {kind} light becomes a point light: its image is ignored"
        self._report.limit("point_lights", problem, parameters.position.place)
        point = self._point(parameters, to_world)
        point["intensity"] = rgb(np.array(point["intensity"]["value"]) * factor)
        return point

    def _check_pixels(self, image: Image, parameters: Parameters, name: str) -> None:
        if not np.isfinite(image.pixels).all():
            parameters.place(name).raise_error("the image of a light has pixels that are not finite numbers")


def sum_of_environments(first: dict, second: dict) -> dict | None:
    """One emitter for the light of two environments; None if both have images."""
    if first["type"] == second["type"] == "constant":
        return {"type": "constant", "radiance": rgb(_radiance(first) + _radiance(second))}
    constant, envmap = (first, second) if first["type"] == "constant" else (second, first)
    if constant["type"] == "envmap":
        return None
    pixels = envmap["bitmap"].linear() + _radiance(constant).astype(np.float32)
    return envmap | {"bitmap": Image(pixels)}


def _radiance(constant: dict) -> np.ndarray:
    return np.array(constant["radiance"]["value"])


def _luminance(image: Image) -> np.ndarray:
    linear = image.linear()
    return linear @ MITSUBA_LUMINANCE if linear.shape[2] == 3 else linear[..., 0]


def _upward_illuminance(image: Image) -> float:
    """What pbrt-v4 takes for the illuminance of a surface that faces +z under an equal-area map: half of it."""
    cosine = np.maximum(equal_area_directions(len(image.pixels))[..., 2], 0)
    illuminance = float((_luminance(image) * cosine).mean()) * 2 * math.pi
    return illuminance if illuminance > 0 else 1.0
