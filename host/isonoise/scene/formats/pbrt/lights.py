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
from isonoise.scene.formats.pbrt.projected_lights import (
    MAX_SOFT_CUTOFF_DEGREES,
    goniometric_projectors,
    projector,
    soft_edge,
)
from isonoise.scene.formats.pbrt.surfaces_of_revolution import scales_uniformly
from isonoise.scene.formats.pbrt.textures import Textures
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image
from isonoise.scene.spectra import MITSUBA_LUMINANCE

_LIGHTS = ("point", "spot", "distant", "infinite", "goniometric", "projection")
_MAX_CUTOFF_DEGREES = 89.9  # Mitsuba's spot is narrower than a hemisphere
_MIN_CONE_DEGREES = 1e-6
_MIN_SOFT_EDGE = 1e-9  # difference of the cosines at its ends
_TO_ENVMAP = np.array(  # from the space of Mitsuba's `envmap` to that of pbrt-v3's: z up, azimuth from +x
    [[0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class Lights:
    """Makes the emitters of a scene, all times `exposure`, the film's factor on radiance."""

    def __init__(self, colours: Colours, textures: Textures, report: ImportReport):
        self._colours, self._textures, self._report = colours, textures, report
        self.exposure = 1.0

    def make(self, kind: str, parameters: Parameters, to_world: np.ndarray) -> list[dict]:
        """The emitters of a `LightSource`: one, or six for a goniometric light."""
        if kind not in _LIGHTS:
            parameters.position.raise_unknown("unknown light", kind, _LIGHTS)
        self._report.count("lights")
        parameters.ignore("samples", "nsamples")
        if kind == "goniometric":
            return self._goniometric(parameters, to_world)
        make = {"point": self._point, "spot": self._spot, "distant": self._distant, "infinite": self._infinite}
        return [make.get(kind, self._projection)(parameters, to_world)]

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
            texture = {
                "type": "bitmap",
                "bitmap": self._textures.scaled_image(image, factor, parameters),
                "wrap_mode": "clamp",
            }
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
        if not (_MIN_CONE_DEGREES <= cone <= 180 and delta >= 0):
            problem = f"coneangle has to be {_MIN_CONE_DEGREES:g} to 180, conedeltaangle at least 0"
            parameters.position.raise_error(problem)
        start = max(cone - delta, 0.0)
        cos_end, cos_start = math.cos(math.radians(cone)), math.cos(math.radians(start))
        # the middle of the solid angles of both cones, 2 pi (1 - cos a) = 4 pi sin(a / 2)^2
        extent = 2 * math.pi * sum(math.sin(math.radians(angle) / 2) ** 2 for angle in (start, cone))
        if cone > _MAX_CUTOFF_DEGREES:
            self._report.limit("spot_lights", "a cone wider than a hemisphere is cut to one", place)
            cone = _MAX_CUTOFF_DEGREES
        spot = {
            "type": "spot",
            "to_world": self._aim(parameters, to_world),
            "cutoff_angle": cone,
            "beam_width": min(start, cone),
            "intensity": rgb(self._intensity(parameters, extent)),
        }
        is_narrow = cos_start - cos_end < _MIN_SOFT_EDGE  # a texture could not show the edge
        if start < cone <= MAX_SOFT_CUTOFF_DEGREES and not is_narrow:
            edge = {"type": "bitmap", "bitmap": soft_edge(cone, start), "raw": True, "wrap_mode": "clamp"}
            spot |= {"beam_width": cone, "texture": edge}
        elif start < cone and not is_narrow:
            problem = "the soft edge of a wide cone is linear in the angle; in pbrt it is a smooth step of its cosine"
            self._report.limit("spot_lights", problem, place)
        return spot

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
            self._report.limit("environment", problem, parameters.position_of(name).place)
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
        return {
            "type": "envmap",
            "bitmap": self._textures.scaled_image(image, factor, parameters),
            "to_world": rotation,
        }

    def _projection(self, parameters: Parameters, to_world: np.ndarray) -> dict:
        """A projection light."""
        self._report.use("projected_lights")
        image, name = self._light_image(parameters)
        fov = parameters.number("fov", 90.0)
        if not 0.01 <= fov <= 179:
            parameters.position_of("fov").raise_error(f"fov has to be 0.01 to 179 degrees, got {fov:g}")
        pixels = np.broadcast_to(image.linear(), (*image.pixels.shape[:2], 3))
        pixels = pixels[::-1] if name == "mapname" else pixels  # pbrt-v3 shows the first row at the bottom
        made = projector(pixels * self._intensity_of_image(parameters), fov, _rigid(to_world))
        power = parameters.number("power", None)
        if power is not None and power > 0:
            # the projector's image is cos^3 / pi times the intensity; cos^3 is the solid angle of an area at distance 1
            irradiance = _luminance(made["irradiance"]["bitmap"])
            height, width = irradiance.shape
            plane_area = 4 * math.tan(math.radians(fov) / 2) ** 2 * max(width, height) / min(width, height)
            emitted = math.pi * float(irradiance.mean()) * plane_area
            made["scale"] = power * float(self._factor(parameters).mean()) / emitted if emitted > 0 else 0.0
        return made

    def _goniometric(self, parameters: Parameters, to_world: np.ndarray) -> list[dict]:
        """A point light with a diagram of its directions, as six projectors."""
        self._report.use("projected_lights")
        if not {"filename", "mapname"} & set(parameters.names):
            return [self._point(parameters, to_world)]
        image, _ = self._light_image(parameters)
        intensity = self._intensity_of_image(parameters)
        power = parameters.number("power", None)
        if power is not None and power > 0:
            emitted = 4 * math.pi * float(image.linear().mean())
            intensity = intensity * (power / emitted if emitted > 0 else 0.0)
        return goniometric_projectors(image, intensity, _rigid(to_world))

    def _intensity_of_image(self, parameters: Parameters) -> np.ndarray:
        return self._emission(parameters, "I") * self._factor(parameters)

    def _light_image(self, parameters: Parameters) -> tuple[Image, str]:
        """The image of a light, and the name of its parameter: `mapname` in pbrt-v3."""
        name = "mapname" if "mapname" in parameters else "filename"
        if name not in parameters:
            parameters.position.raise_error('the light needs "string filename"')
        image = self._textures.read_image(parameters, name)
        self._check_pixels(image, parameters, name)
        return image, name

    def _check_pixels(self, image: Image, parameters: Parameters, name: str) -> None:
        if not np.isfinite(image.pixels).all():
            parameters.position_of(name).raise_error("the image of a light has pixels that are not finite numbers")


def _rigid(to_world: np.ndarray) -> np.ndarray:
    """The transform without its scale; of a mirroring one, the mirror stays."""
    rigid = to_world.copy()
    u, _, vt = np.linalg.svd(to_world[:3, :3])
    rigid[:3, :3] = u @ vt
    return rigid


def sum_of_environments(first: dict, second: dict) -> dict | None:
    """One emitter for the light of two environments; None if both have images."""
    if first["type"] == second["type"] == "constant":
        return {"type": "constant", "radiance": rgb(_radiance(first) + _radiance(second))}
    constant, envmap = (first, second) if first["type"] == "constant" else (second, first)
    if constant["type"] == "envmap":
        return None
    with np.errstate(over="ignore"):  # pixels that are not finite are errors later
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
