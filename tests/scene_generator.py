"""Writes random Mitsuba 3 scene files with their meshes and images; a seed always gives the same file.

The files use all plugins that both isonoise and Mitsuba render, nested and combined at random, in the syntax of old and
new versions. Random values are bounded so that the noise of a small picture is below 1 % of its mean: lights are wide
or have no extent, albedos are below 0.9, paths are short.
"""

import math
from pathlib import Path
from xml.etree import ElementTree

import mitsuba_faults
from random_lights import RandomLights
from random_shapes import FLAT

SIDES = (48, 48), (56, 40), (40, 48)
"""Width and height of films; whole blocks of 8 x 8 pixels."""

EXTRA_LIGHTS = {7: "sky", 23: "lamp", 24: "lamp", 35: "sky", 62: "sky", 95: "sky", 98: "lamp"}
"""Seeds whose pictures would be almost black: they get one more light, and a large far_clip."""


def write_scene(folder: Path, seed: int, media: bool = True) -> Path:
    """Writes `scene.xml` and its meshes and images into a folder; returns the path of the scene."""
    folder.mkdir(parents=True, exist_ok=True)
    return _RandomScene(folder, seed, media, EXTRA_LIGHTS.get(seed)).write()


def plugins(path: Path) -> set[tuple[str, str]]:
    """Returns (kind, name) of all plugins that a file uses."""
    return {(tag.tag, tag.get("type")) for tag in ElementTree.parse(path).iter() if tag.get("type")}


class _RandomScene(RandomLights):
    """One scene file: integrator, sensor, ground or room; objects and lights come from the base classes."""

    def write(self) -> Path:
        depth = self.r.randint(2, 6)
        volumetric = self.r.choice(("volpath", "volpathmis"))
        integrator = self.tag(self.root, "integrator", volumetric if self.has_media or self.chance(0.05) else "path")
        if not self.has_media and self.chance(0.1):
            integrator.set("type", "direct")
        else:
            self.tag(integrator, "integer", name="max_depth", value=depth)
            self.tag(integrator, "integer", name="rr_depth", value=self.r.randint(2, 7))
        self.maybe_boolean(integrator, "hide_emitters", 0.2)
        for _ in range(2):
            if self.chance(0.7):
                self.shared_materials.append(self.name("material"))
                self.material(self.root, 2, id=self.shared_materials[-1])
        self.sensor()
        self.room() if self.in_room else self.ground()
        for _ in range(self.r.randint(2, 4)):
            self.object(self.root, self.transform(self.random_place(), self.uniform(0.5, 1.1)))
        if self.chance(0.35):
            self.instances()
        self.lights()
        path = self.folder / "scene.xml"
        mitsuba_faults.avoid_faults(self.root)
        if self.is_version_0_6:
            _rename_as_in_0_6(self.root)
        ElementTree.indent(self.root)
        ElementTree.ElementTree(self.root).write(path)
        return path

    def sensor(self):
        kind = self.r.choices(("perspective", "thinlens", "orthographic"), (3, 1, 1))[0]
        sensor = self.tag(self.root, "sensor", kind)
        away = 3.7 if self.in_room else 7.0
        angle, height = self.uniform(-0.6, 0.6), self.uniform(-0.2, 0.3)
        origin = (away * math.sin(angle), away * height, away * math.cos(angle))
        to_world = self.tag(sensor, "transform", name="to_world")
        if kind == "orthographic":
            size = self.uniform(2.0, 3.5)
            self.tag(to_world, "scale", x=size, y=size, z=1.0)
        if self.chance(0.15):
            self.tag(to_world, "scale", x=-1)
        target = [self.uniform(-0.4, 0.4) for _ in range(3)]
        self.tag(to_world, "lookat", origin=origin, target=target, up=(self.uniform(-0.2, 0.2), 1, 0))
        self.float(sensor, "near_clip", self.r.choice((0.01, 0.5, 2.5)))
        far_clip = self.r.choice((1e4, 100.0, away + 3.0))
        self.float(sensor, "far_clip", 100.0 if self.extra_light else far_clip)
        if kind != "orthographic":
            if self.chance(0.2):
                self.tag(sensor, "string", name="focal_length", value=self.r.choice(("28mm", "50mm")))
            else:
                self.float(sensor, "fov", self.uniform(35, 75))
                axis = self.r.choice(("x", "y", "diagonal", "smaller", "larger"))
                self.tag(sensor, "string", name="fov_axis", value=axis)
        if kind == "thinlens":
            self.float(sensor, "aperture_radius", self.uniform(0.02, 0.4))
            self.float(sensor, "focus_distance", self.uniform(2.0, 8.0))
        elif kind == "perspective" and self.chance(0.3):
            self.float(sensor, "principal_point_offset_x", self.uniform(-0.3, 0.3))
            self.float(sensor, "principal_point_offset_y", self.uniform(-0.3, 0.3))
        film = self.tag(sensor, "film", "hdrfilm")
        width, height = self.r.choice(SIDES)
        crop = self.chance(0.2)
        self.tag(film, "integer", name="width", value=width * (1 + crop))
        self.tag(film, "integer", name="height", value=height * (1 + crop))
        if crop:
            for axis, side in (("x", width), ("y", height)):
                self.tag(film, "integer", name=f"crop_offset_{axis}", value=self.r.randint(0, side))
            self.tag(film, "integer", name="crop_width", value=width)
            self.tag(film, "integer", name="crop_height", value=height)
        self.tag(film, "rfilter", "box")
        self.tag(film, "string", name="pixel_format", value="rgb")
        self.tag(sensor, "sampler", "independent")

    def room(self):
        box = self.tag(self.root, "shape", "cube")
        self.tag(self.tag(box, "transform", name="to_world"), "scale", x=5, y=4, z=5)
        self.tag(box, "boolean", name="flip_normals", value="true")
        self.material(box, 1, opaque=True)

    def ground(self):
        shape = self.tag(self.root, "shape", self.r.choice((*FLAT, "rectangle")))
        to_world = self.tag(shape, "transform", name="to_world")
        self.tag(to_world, "rotate", x=1, angle=-90)
        self.tag(to_world, "scale", value=self.uniform(4, 9))
        self.tag(to_world, "translate", y=-2)
        self.material(shape, 2, opaque=True)


def _rename_as_in_0_6(root: ElementTree.Element):
    """Renames parameters as in Mitsuba 0.6: maxDepth, intIOR."""
    for tag in root.iter():
        if "name" in tag.attrib and tag.tag not in ("ref",):
            first, *others = tag.get("name").split("_")
            tag.set("name", first + "".join("IOR" if part == "ior" else part.capitalize() for part in others))
