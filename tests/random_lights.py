"""Random emitters. Used by scene_generator.py."""

from functools import partial

import numpy as np
from random_shapes import CLOSED, FLAT, MESHES, RandomShapes
from random_xml import to_text

from isonoise.scene.light.light_kinds import KIND_OF_PLUGIN

OTHER_LIGHTS = [
    plugin
    for plugin in KIND_OF_PLUGIN
    if plugin not in ("point", "spot", "directional", "constant", "envmap", "projector")  # test_material_pictures.py
]


class RandomLights(RandomShapes):
    """Emitters: wide ones, or several without extent."""

    def lights(self):
        """A wide light, or a few without extent."""
        far = [self.constant, self.envmap, self.envmap, self.directional, lambda: self.area_light((1, 5, 2))]
        others = [partial(self.other_light, plugin) for plugin in OTHER_LIGHTS]
        near = [self.point, self.spot, lambda: self.area_light((-3.2, 1.5, 1.5)), self.directional, *others]
        if self.point_like_lights:
            far = near = [self.point, self.spot, self.directional, *others]
        self.area_light((0, 3.0, 0)) if self.in_room else self.r.choice(far)()
        for _ in range(self.r.choice((0, 1, 1, 2))):
            self.r.choice(near)()
        environments = {name for name, kind in KIND_OF_PLUGIN.items() if kind.is_environment}
        has_environment = any(emitter.get("type") in environments for emitter in self.root.iter("emitter"))
        if self.extra_light == "sky" and not has_environment:
            emitter = self.tag(self.root, "emitter", "constant")
            self.tag(emitter, "rgb", name="radiance", value=0.4)
        elif self.extra_light == "lamp":
            emitter = self.tag(self.root, "emitter", "point")
            self.tag(emitter, "point", name="position", x=0.5, y=1.5, z=3.5)
            self.tag(emitter, "rgb", name="intensity", value=10.0)

    def emission(self, emitter, name: str, level: float):
        if self.chance(0.7):
            self.tag(emitter, "rgb", name=name, value=[level * self.uniform(0.5, 1) for _ in range(3)])
        elif self.chance(0.5):
            self.tag(emitter, "spectrum", name=name, value=0.7 * level)
        else:
            self.tag(
                emitter, "spectrum", name=name, value=f"400:0, 500:{to_text(level)}, 600:{to_text(0.6 * level)}, 700:1"
            )

    def area_light(self, place):
        """An area light.

        Mitsuba samples textured lights by the image, applied once over the shape's uv: so it must be a bitmap without
        `to_uv` on a shape that has every uv once. Mitsuba samples mirrored cylinders on one side, but rays see the
        emission on the other.
        """
        textured = self.chance(0.3)
        kind = self.r.choice((*FLAT, "sphere") if textured else (*FLAT, *CLOSED, "cylinder", *MESHES))
        shape = self.tag(self.root, "shape", kind)
        self.geometry(shape, kind)
        if kind in FLAT:
            to_world = self.tag(shape, "transform", name="to_world")
            self.tag(to_world, "scale", x=self.uniform(0.8, 1.6), y=self.uniform(0.8, 1.6), z=1)
            self.tag(to_world, "lookat", origin=place, target=(0, -1, 0), up=(0, 0, 1))
        else:
            self.transform(place, self.uniform(0.5, 0.9), mirrored=kind != "cylinder" and not textured)(shape)
        if self.chance(0.4):
            self.material(shape, 1)
        emitter = self.tag(shape, "emitter", "area")
        if textured:
            texture = self.tag(emitter, "texture", "bitmap", name="radiance")
            level = self.uniform(1, 6)
            values = level * self.arrays.uniform(0.2, 1, (self.r.randint(2, 6), self.r.randint(2, 6), 3))
            self.bitmap(texture, values, self.r.choice(("exr", "hdr")))
        else:
            self.emission(emitter, "radiance", self.uniform(2, 8))

    def point(self):
        emitter = self.tag(self.root, "emitter", "point")
        place = self.uniform(-3, 3), 2.8, self.uniform(-1, 3)
        if self.chance(0.5):
            self.tag(emitter, "point", name="position", x=place[0], y=place[1], z=place[2])
        else:
            to_world = self.tag(emitter, "transform", name="to_world")
            self.tag(to_world, "translate", x=place[0], y=place[1], z=place[2])
        self.emission(emitter, "intensity", self.uniform(4, 20))

    def spot(self):
        emitter = self.tag(self.root, "emitter", "spot")
        to_world = self.tag(emitter, "transform", name="to_world")
        origin = self.uniform(-3, 3), 2.8, self.uniform(-1, 3)
        self.tag(to_world, "lookat", origin=origin, target=self.random_place(), up=(0.3, 0, 1))
        cutoff = self.uniform(20, 60)
        self.float(emitter, "cutoff_angle", cutoff)
        if self.chance(0.6):
            self.float(emitter, "beam_width", cutoff * self.uniform(0.2, 0.95))
        self.emission(emitter, "intensity", self.uniform(10, 40))

    def other_light(self, plugin: str):
        """A light without a method of its own."""
        emitter = self.tag(self.root, "emitter", plugin)
        to_world = self.tag(emitter, "transform", name="to_world")
        origin = self.uniform(-3, 3), 2.8, self.uniform(-1, 3)
        self.tag(to_world, "lookat", origin=origin, target=self.random_place(), up=(0.3, 0, 1))
        self.emission(emitter, KIND_OF_PLUGIN[plugin].emission, self.uniform(10, 40))
        self.any_parameters(emitter)

    def directional(self):
        emitter = self.tag(self.root, "emitter", "directional")
        direction = self.uniform(-0.6, 0.6), -1, self.uniform(-0.8, 0.3)
        if self.chance(0.5):
            self.tag(emitter, "vector", name="direction", x=direction[0], y=direction[1], z=direction[2])
        else:
            to_world = self.tag(emitter, "transform", name="to_world")
            self.tag(to_world, "lookat", origin=(0, 0, 0), target=direction, up=(0, 0, 1))
        self.emission(emitter, "irradiance", self.uniform(0.5, 3))

    def constant(self):
        self.emission(self.tag(self.root, "emitter", "constant"), "radiance", self.uniform(0.3, 1.2))

    def envmap(self):
        emitter = self.tag(self.root, "emitter", "envmap")
        sky = self.arrays.uniform(0.05, 0.6, (self.r.randint(4, 12), self.r.randint(6, 20), 3))
        if self.chance(0.3):  # a lamp
            sky[1, self.r.randrange(sky.shape[1])] = 12.0
        encoding = self.r.choice(("exr", "hdr", "png"))
        self.bitmap(emitter, np.minimum(sky, 1.0) if encoding == "png" else sky, encoding)
        if self.chance(0.5):
            self.float(emitter, "scale", self.uniform(0.4, 2.0))
        if self.chance(0.7):
            to_world = self.tag(emitter, "transform", name="to_world")
            if self.chance(0.2):
                self.tag(to_world, "scale", x=-1)
            self.rotate(to_world, self.uniform(0, 360))
