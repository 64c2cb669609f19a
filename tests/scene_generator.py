"""Random Mitsuba 3 scene files, with the meshes and images that they name: one for every seed, always the same.

All of the vocabulary that both isonoise and Mitsuba render turns up, nested and combined at random, in files old and
new. What is random stays within bounds that keep a small picture free of noise to below 1 % of its mean: lights are
wide or have no extent, albedos are below 0.9, paths are short.
"""

import math
import random
import struct
import zlib
from pathlib import Path
from xml.etree import ElementTree

import mitsuba_faults
import numpy as np

SIDES = (48, 48), (56, 40), (40, 48)
"""Width and height of films; whole blocks of 8 x 8 pixels."""

DARK = {7: "sky", 23: "lamp", 24: "lamp", 35: "sky", 62: "sky", 95: "sky", 98: "lamp"}
"""Seeds whose lights reach next to nothing that is seen: they get one more, and a camera that sees to the walls."""

_METALS = ("Au", "Cu", "Al", "Ag", "W", "Cr", "none")
_INDICES = ("air", "water", "bk7", "diamond", "acetone", "pet", "vacuum")
_OPAQUE = ("diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "principled")
_CLEAR = ("dielectric", "thindielectric", "roughdielectric")
_BUMPY = ("bumpmap", "normalmap")
_TEXTURES = ("bitmap", "bitmap", "checkerboard")
_FLAT = ("rectangle", "disk")
_CLOSED = ("cube", "sphere")
_MESHES = ("obj", "ply", "serialized")


def write_scene(folder: Path, seed: int, media: bool = True) -> Path:
    """Writes `scene.xml` and what belongs to it into a folder; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    return _Writer(folder, seed, media).write()


def plugins(path: Path) -> set[tuple[str, str]]:
    """(kind, name) of all plugins that a file uses."""
    return {(tag.tag, tag.get("type")) for tag in ElementTree.parse(path).iter() if tag.get("type")}


class _Writer:
    """One file in the making. `r` draws everything."""

    def __init__(self, folder: Path, seed: int, media: bool):
        self.folder, self.r = folder, random.Random(seed)
        self.more_light = DARK.get(seed)
        self.arrays = np.random.default_rng(seed)
        self.old = self.chance(0.2)
        self.foggy = media and self.chance(0.2)
        self.inside = self.chance(0.45)
        # all lights without extent: Mitsuba's blends are too bright by others (3.9.1: the pdf of a sample leaves the
        # weight out, so that the weights of both techniques exceed 1)
        self.sharp = not self.inside and self.chance(0.4)
        self.root = ElementTree.Element("scene", version="0.6.0" if self.old else self.r.choice(("2.1.0", "3.0.0")))
        self.count = 0
        self.shared: list[str] = []  # ids of materials that any shape may have

    # numbers, names, tags

    def chance(self, probability: float) -> bool:
        return self.r.random() < probability

    def between(self, low: float, high: float) -> float:
        return self.r.uniform(low, high)

    def name(self, what: str) -> str:
        self.count += 1
        return f"{what}{self.count}"

    def tag(self, parent, kind: str, type_: str | None = None, name: str = "", **attributes) -> ElementTree.Element:
        if type_ is not None:
            attributes = {"type": type_} | attributes
        if name:
            attributes = {"name": name} | attributes
        return ElementTree.SubElement(parent, kind, {k: _text(v) for k, v in attributes.items()})

    def float(self, parent, name: str, value: float):
        self.tag(parent, "float", name=name, value=value)

    def flag(self, parent, name: str, probability: float = 0.3):
        if self.chance(probability):
            self.tag(parent, "boolean", name=name, value=self.r.choice(("true", "false")))

    # the whole

    def write(self) -> Path:
        depth = self.r.randint(2, 6)
        volumetric = self.r.choice(("volpath", "volpathmis"))
        integrator = self.tag(self.root, "integrator", volumetric if self.foggy or self.chance(0.05) else "path")
        if not self.foggy and self.chance(0.1):
            integrator.set("type", "direct")
        else:
            self.tag(integrator, "integer", name="max_depth", value=depth)
            self.tag(integrator, "integer", name="rr_depth", value=self.r.randint(2, 7))
        self.flag(integrator, "hide_emitters", 0.2)
        for _ in range(2):
            if self.chance(0.7):
                self.shared.append(self.name("material"))
                self.material(self.root, 2, id=self.shared[-1])
        self.sensor()
        self.room() if self.inside else self.ground()
        for _ in range(self.r.randint(2, 4)):
            self.object(self.root, self.transform(self.place(), self.between(0.5, 1.1)))
        if self.chance(0.35):
            self.instances()
        self.lights()
        path = self.folder / "scene.xml"
        mitsuba_faults.leave_out(self.root)
        if self.old:
            _as_of_old(self.root)
        ElementTree.indent(self.root)
        ElementTree.ElementTree(self.root).write(path)
        return path

    def turn(self, to_world, angle: float):
        """A rotation about any axis; of length 1, since Mitsuba takes it as it is."""
        axis = np.array([self.between(-1, 1) for _ in range(3)])
        x, y, z = axis / np.linalg.norm(axis)
        self.tag(to_world, "rotate", x=x, y=y, z=z, angle=angle)

    def place(self) -> tuple[float, float, float]:
        return self.between(-2.2, 2.2), self.between(-1.5, 1.5), self.between(-2.2, 2.2)

    def sensor(self):
        kind = self.r.choices(("perspective", "thinlens", "orthographic"), (3, 1, 1))[0]
        sensor = self.tag(self.root, "sensor", kind)
        away = 3.7 if self.inside else 7.0
        angle, height = self.between(-0.6, 0.6), self.between(-0.2, 0.3)
        origin = (away * math.sin(angle), away * height, away * math.cos(angle))
        to_world = self.tag(sensor, "transform", name="to_world")
        if kind == "orthographic":
            size = self.between(2.0, 3.5)
            self.tag(to_world, "scale", x=size, y=size, z=1.0)
        if self.chance(0.15):
            self.tag(to_world, "scale", x=-1)
        target = [self.between(-0.4, 0.4) for _ in range(3)]
        self.tag(to_world, "lookat", origin=origin, target=target, up=(self.between(-0.2, 0.2), 1, 0))
        self.float(sensor, "near_clip", self.r.choice((0.01, 0.5, 2.5)))
        far_clip = self.r.choice((1e4, 100.0, away + 3.0))
        self.float(sensor, "far_clip", 100.0 if self.more_light else far_clip)
        if kind != "orthographic":
            if self.chance(0.2):
                self.tag(sensor, "string", name="focal_length", value=self.r.choice(("28mm", "50mm")))
            else:
                self.float(sensor, "fov", self.between(35, 75))
                axis = self.r.choice(("x", "y", "diagonal", "smaller", "larger"))
                self.tag(sensor, "string", name="fov_axis", value=axis)
        if kind == "thinlens":
            self.float(sensor, "aperture_radius", self.between(0.02, 0.4))
            self.float(sensor, "focus_distance", self.between(2.0, 8.0))
        elif kind == "perspective" and self.chance(0.3):
            self.float(sensor, "principal_point_offset_x", self.between(-0.3, 0.3))
            self.float(sensor, "principal_point_offset_y", self.between(-0.3, 0.3))
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
        shape = self.tag(self.root, "shape", self.r.choice((*_FLAT, "rectangle")))
        to_world = self.tag(shape, "transform", name="to_world")
        self.tag(to_world, "rotate", x=1, angle=-90)
        self.tag(to_world, "scale", value=self.between(4, 9))
        self.tag(to_world, "translate", y=-2)
        self.material(shape, 2, opaque=True)

    # shapes

    def transform(self, place, size: float, mirrored: bool = True):
        """A function that writes a transform into a shape of about size 1; `mirrored`: it may be a mirror image."""

        def write(shape):
            uneven = shape.get("type") not in ("sphere", "cylinder")
            to_world = self.tag(shape, "transform", name="to_world")
            if uneven and self.chance(0.4):
                self.tag(to_world, "scale", value=[self.between(0.4, 1.3) for _ in range(3)])
            # media: in Mitsuba the inside of a mirrored mesh is its outside
            if mirrored and not self.foggy and self.chance(0.15):
                self.tag(to_world, "scale", **{self.r.choice("xyz"): -1})
            self.tag(to_world, "scale", value=size)
            self.turn(to_world, self.between(-180, 180))
            if uneven and self.chance(0.15):
                shear = np.eye(4)
                shear[0, 1], shear[2, 0] = self.between(-0.4, 0.4), self.between(-0.4, 0.4)
                self.tag(to_world, "matrix", value=shear.ravel())
            self.tag(to_world, "translate", x=place[0], y=place[1], z=place[2])

        return write

    def object(self, parent, transform):
        kind = self.r.choice((*_FLAT, *_CLOSED, "cylinder", *_MESHES, *_MESHES))
        shape = self.tag(parent, "shape", kind)
        attribute = self.geometry(shape, kind)
        transform(shape)
        self.flag(shape, "flip_normals", 0.2)
        if self.foggy and kind in (*_CLOSED, *_MESHES) and self.chance(0.6):
            self.medium(shape)
        elif self.shared and self.chance(0.25):
            self.tag(shape, "ref", id=self.r.choice(self.shared))
        elif self.chance(0.95):
            self.material(shape, 3, attribute=attribute)
        return shape

    def geometry(self, shape, kind: str) -> str:
        """What a kind of shape has of its own; the name of a mesh attribute, if it has one."""
        if kind == "sphere" and self.chance(0.4):
            self.tag(shape, "point", name="center", x=0.2, y=self.between(-0.3, 0.3), z=0)
            self.float(shape, "radius", self.between(0.6, 1.1))
        elif kind == "cylinder":
            self.tag(shape, "point", name="p0", x=0, y=0.1, z=self.between(-1, -0.4))
            self.tag(shape, "point", name="p1", x=self.between(-0.3, 0.3), y=0, z=0.8)
            self.float(shape, "radius", self.between(0.3, 0.7))
        elif kind in _MESHES:
            return self.mesh(shape, kind)
        return ""

    def mesh(self, shape, kind: str) -> str:
        points, uvs, faces = self.surface()
        normals = _normals(points, faces) if self.chance(0.5) else None
        uvs = uvs if self.chance(0.8) else None
        path = self.folder / self.name(kind)
        self.tag(shape, "string", name="filename", value=path.name)
        self.flag(shape, "face_normals", 0.3)
        if kind == "serialized":
            index = _write_serialized(path, points, normals, uvs, faces, self.r)
            self.tag(shape, "integer", name="shape_index", value=index)
            return ""
        self.flag(shape, "flip_tex_coords", 0.3)
        if kind == "obj":
            path.write_text(_obj(points, normals, uvs, faces, self.chance(0.5)))
            return ""
        attribute = self.r.choice(("", "vertex_color", "face_heat"))
        per = {"vertex_color": (len(points), 3), "face_heat": (len(faces), 1)}.get(attribute, (0, 0))
        values = self.arrays.uniform(0.1, 0.8, per)
        _write_ply(path, points, normals, uvs, faces, attribute, values, binary=self.chance(0.7))
        return attribute

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, texture coordinates and triangles of a bumpy ball, a ring or a wavy sheet."""
        kind = self.r.choice(("ball", "ring", "sheet"))
        columns, rows = self.r.randint(6, 24), self.r.randint(5, 16)
        u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)))
        around, wave = 2 * np.pi * u, self.r.randint(1, 3)
        if kind == "ball":
            height = np.pi * v
            radius = 1 + self.between(0, 0.25) * np.sin(wave * around) * np.sin(height) ** 2
            sine = np.sin(height)
            points = radius * np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(height)])
        elif kind == "ring":
            tube, thick = -2 * np.pi * v, self.between(0.2, 0.4)
            reach = 0.7 + thick * np.cos(tube)
            points = np.stack([reach * np.cos(around), reach * np.sin(around), thick * np.sin(tube)])
        else:
            points = np.stack([2 * u - 1, 2 * v - 1, self.between(0, 0.3) * np.sin(wave * around) * np.cos(4 * v)])
        first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
        up = first + columns + 1
        faces = np.concatenate([np.stack([first, up, up + 1], 1), np.stack([first, up + 1, first + 1], 1)])
        if kind == "sheet":
            faces = faces[:, ::-1]
        if kind == "ball":  # at the poles half of the triangles have no area
            corners = np.round(points.T[faces], 9)
            flat = [len(np.unique(triangle, axis=0)) < 3 for triangle in corners]
            faces = faces[~np.array(flat)]
        return points.T, np.stack([u, v], 1), faces

    def instances(self):
        group, id_ = self.tag(self.root, "shape", "shapegroup"), self.name("group")
        group.set("id", id_)
        for _ in range(self.r.randint(1, 3)):
            place = [self.between(-0.5, 0.5) for _ in range(3)]
            self.object(group, self.transform(place, self.between(0.3, 0.7)))
        for _ in range(self.r.randint(1, 4)):
            instance = self.tag(self.root, "shape", "instance")
            self.transform(self.place(), self.between(0.5, 1.0))(instance)
            self.tag(instance, "ref", id=id_)

    # materials

    def material(self, parent, depth: int, opaque=False, attribute: str = "", bumpy=True, **attributes):
        """A material of up to `depth` wrappings; `opaque`: light passes nowhere through it; `bumpy`: it may be so."""
        kinds = [*_OPAQUE, *_OPAQUE, *(() if opaque else _CLEAR)]
        if depth > 0:
            wrappers = [
                "twosided",
                *(("blendbsdf",) if self.sharp else ()),
                *(() if opaque else ("mask",)),
                *(_BUMPY if bumpy else ()),
            ]
            kinds = kinds if self.chance(0.6) else wrappers
        kind = self.r.choice(kinds)
        bsdf = self.tag(parent, "bsdf", kind, **attributes)

        def nested():
            self.material(bsdf, depth - 1, opaque or kind == "twosided", attribute, bumpy and kind not in _BUMPY)

        if kind == "twosided":
            for _ in range(self.r.randint(1, 2)):
                nested()
        elif kind == "mask":
            self.number(bsdf, "opacity", 0.2, 0.9, attribute)
            nested()
        elif kind == "blendbsdf":
            self.number(bsdf, "weight", 0.1, 0.9, attribute)
            nested()
            nested()
        elif kind == "bumpmap":
            self.texture(bsdf, "", 0.0, 1.0, number=True, kinds=("bitmap",))  # Mitsuba has the slope of no other
            self.float(bsdf, "scale", self.between(-0.08, 0.08))
            nested()
        elif kind == "normalmap":
            texture = self.tag(bsdf, "texture", "bitmap", name="normalmap")
            slopes = self.arrays.uniform(-0.25, 0.25, (6, 6, 2))
            normals = np.concatenate([slopes, np.ones((6, 6, 1))], axis=2)
            normals /= np.linalg.norm(normals, axis=2, keepdims=True)
            self.bitmap(texture, 0.5 + 0.5 * normals, "png")
            self.tag(texture, "boolean", name="raw", value="true")
            nested()
        else:
            getattr(self, f"_{kind}")(bsdf, attribute, opaque)

    def _diffuse(self, bsdf, attribute, opaque):
        if self.chance(0.9):
            self.colour(bsdf, "reflectance", 0.1, 0.85, attribute)

    def _conductor(self, bsdf, attribute, opaque):
        choice = self.r.randint(0, 2)
        if choice == 0:
            self.tag(bsdf, "string", name="material", value=self.r.choice(_METALS))
        elif choice == 1:
            for name, low, high in (("eta", 0.2, 2.0), ("k", 1.5, 5.0)):
                self.colour(bsdf, name, low, high, plain=True)
        self.colour(bsdf, "specular_reflectance", 0.4, 0.9, attribute)

    def _roughconductor(self, bsdf, attribute, opaque):
        self._conductor(bsdf, attribute, opaque)
        self.roughness(bsdf, attribute)

    def _dielectric(self, bsdf, attribute, opaque):
        self.indices(bsdf)
        for name in ("specular_reflectance", "specular_transmittance"):
            if self.chance(0.3):
                self.colour(bsdf, name, 0.4, 0.9, attribute)

    _thindielectric = _dielectric

    def _roughdielectric(self, bsdf, attribute, opaque):
        self._dielectric(bsdf, attribute, opaque)
        self.roughness(bsdf, attribute)

    def _plastic(self, bsdf, attribute, opaque):
        self.indices(bsdf)  # and no mesh attributes: Mitsuba asks for the mean of these colours, which they lack
        self.colour(bsdf, "diffuse_reflectance", 0.1, 0.85)
        if self.chance(0.3):
            self.colour(bsdf, "specular_reflectance", 0.3, 0.9)
        self.flag(bsdf, "nonlinear", 0.5)

    def _roughplastic(self, bsdf, attribute, opaque):
        self._plastic(bsdf, attribute, opaque)
        self.tag(bsdf, "string", name="distribution", value=self.r.choice(("beckmann", "ggx")))
        self.float(bsdf, "alpha", self.between(0.05, 0.6))
        self.flag(bsdf, "sample_visible", 0.2)

    def _principled(self, bsdf, attribute, opaque):
        self.colour(bsdf, "base_color", 0.1, 0.85, attribute)
        self.number(bsdf, "roughness", 0.25, 0.9, attribute)
        names = ["anisotropic", "metallic", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat"]
        names += ["clearcoat_gloss", *(() if opaque else ("spec_trans",))]
        for name in names:
            if self.chance(0.35):
                self.number(bsdf, name, 0.05, 0.95, attribute)
        if self.chance(0.5):
            self.float(bsdf, "eta", self.between(1.2, 1.8))
        elif self.chance(0.5):
            self.float(bsdf, "specular", self.between(0.1, 0.9))

    def indices(self, bsdf):
        """Of both sides, never the same: rough materials refuse that, by Mitsuba and here."""
        within, outside = self.r.sample(_INDICES, 2)
        if self.chance(0.4):
            self.tag(bsdf, "string", name="int_ior", value=within)
            self.tag(bsdf, "string", name="ext_ior", value=outside)
        elif self.chance(0.7):
            self.float(bsdf, "int_ior", self.between(1.1, 1.9))
            if self.chance(0.3):
                self.float(bsdf, "ext_ior", self.between(1.0, 1.09) if self.chance(0.7) else self.between(1.91, 2.2))

    def roughness(self, bsdf, attribute):
        if self.chance(0.8):
            self.tag(bsdf, "string", name="distribution", value=self.r.choice(("beckmann", "ggx")))
        if self.chance(0.5):
            self.number(bsdf, "alpha", 0.1, 0.6, attribute)
        else:
            for name in ("alpha_u", "alpha_v"):
                self.number(bsdf, name, 0.08, 0.6, attribute)
        self.flag(bsdf, "sample_visible", 0.2)

    def medium(self, shape):
        """A homogeneous medium inside a closed shape, and a boundary that lets light in."""
        kind = self.r.choice(("null", "null", "dielectric", "roughdielectric", "thindielectric"))
        bsdf = self.tag(shape, "bsdf", kind)
        if kind != "null":
            getattr(self, f"_{kind}")(bsdf, "", False)
        medium = self.tag(shape, "medium", "homogeneous", name="interior")
        self.colour(medium, "sigma_t", 0.2, 0.9, plain=True)  # Mitsuba takes no colour above 1: that is for the scale
        self.colour(medium, "albedo", 0.3, 0.95, plain=True)
        if self.chance(0.6):
            self.float(medium, "scale", self.between(0.5, 4.0))
        if self.chance(0.7):
            phase = self.tag(medium, "phase", self.r.choice(("hg", "isotropic")))
            if phase.get("type") == "hg":
                self.float(phase, "g", self.between(-0.7, 0.7))

    # colours and textures

    def colour(self, parent, name: str, low: float, high: float, attribute: str = "", plain: bool = False):
        """A reflectance-like parameter, in one of the ways to write it."""
        if not plain and self.chance(0.35):
            self.texture(parent, name, low, high, attribute=attribute)
            return
        values = [self.between(low, high) for _ in range(3)]
        way = self.r.choice(("rgb", "rgb", "grey", "flat", "pairs"))
        if way == "rgb":
            self.tag(parent, "rgb", name=name, value=values)
        elif way == "grey":
            self.tag(parent, "rgb", name=name, value=values[0])
        elif way == "flat":
            self.tag(parent, "spectrum", name=name, value=values[0])
        else:
            pairs = zip((380, 520, 640, 800), (*values, values[0]), strict=True)
            self.tag(parent, "spectrum", name=name, value=", ".join(f"{w}:{_text(v)}" for w, v in pairs))

    def number(self, parent, name: str, low: float, high: float, attribute: str = ""):
        """A parameter that is a number."""
        if self.chance(0.3):
            self.texture(parent, name, low, high, number=True, attribute=attribute)
        else:
            self.float(parent, name, self.between(low, high))

    def texture(self, parent, name: str, low, high, number: bool = False, attribute: str = "", kinds=_TEXTURES):
        """A texture with values from low to high."""
        is_colour = attribute == "vertex_color"
        if attribute and is_colour != number and self.chance(0.6) and low > 0 and high < 1:
            texture = self.tag(parent, "texture", "mesh_attribute", name=name)
            self.tag(texture, "string", name="name", value=attribute)
            self.float(texture, "scale", self.between(0.5, 1.0))
            return
        texture = self.tag(parent, "texture", self.r.choice(kinds), name=name)
        if texture.get("type") == "bitmap":
            encoding = self.r.choice(("png", "bmp", "jpg", "exr", "hdr") if not number else ("png", "exr"))
            size = (self.r.randint(2, 9), self.r.randint(2, 9), 1 if number else 3)
            self.bitmap(texture, self.arrays.uniform(low, min(high, 1.0), size), encoding)
            if number:
                self.tag(texture, "boolean", name="raw", value="true")
            if self.chance(0.5):
                self.tag(texture, "string", name="filter_type", value=self.r.choice(("nearest", "bilinear")))
            if self.chance(0.6):
                self.tag(texture, "string", name="wrap_mode", value=self.r.choice(("repeat", "mirror", "clamp")))
        else:
            for colour in ("color0", "color1"):
                if number:
                    self.float(texture, colour, self.between(low, high))
                else:
                    self.colour(texture, colour, low, high, plain=True)
        if self.chance(0.6):
            to_uv = self.tag(texture, "transform", name="to_uv")
            self.tag(to_uv, "scale", x=self.between(0.5, 6), y=self.between(-4, 4), z=1)
            if self.chance(0.4):
                self.tag(to_uv, "rotate", z=1, angle=self.between(0, 360))
            if self.chance(0.4):
                self.tag(to_uv, "translate", x=self.between(-1, 1), y=self.between(-1, 1))

    def bitmap(self, parent, values: np.ndarray, encoding: str):
        """Writes an image file and names it. Integers hold `values` without a transfer function."""
        path = self.folder / f"{self.name('image')}.{encoding}"
        self.tag(parent, "string", name="filename", value=path.name)
        if encoding == "exr":
            import OpenEXR

            pixels = np.repeat(values, 3 if values.shape[2] == 1 else 1, axis=2).astype(np.float32)
            OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.ascontiguousarray(pixels)}).write(str(path))
        elif encoding == "hdr":
            height, width, _ = values.shape
            _, exponent = np.frexp(values.max(axis=2))
            mantissa = values / np.exp2(exponent - 8.0)[..., None]
            rgbe = np.concatenate([mantissa, exponent[..., None] + 128], axis=2).astype(np.uint8)
            head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
            path.write_bytes(head.encode() + rgbe.tobytes())
        else:
            from PIL import Image

            pixels = np.rint(255 * values).astype(np.uint8)
            picture = Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)
            picture.save(path, **({"quality": 95, "subsampling": 0} if encoding == "jpg" else {}))

    # light

    def lights(self):
        """One that is wide, or a few that have no extent."""
        far = [self.constant, self.envmap, self.envmap, self.directional, lambda: self.area_light((1, 5, 2))]
        near = [self.point, self.spot, lambda: self.area_light((-3.2, 1.5, 1.5)), self.directional]
        if self.sharp:
            far = near = [self.point, self.spot, self.directional]
        self.area_light((0, 3.0, 0)) if self.inside else self.r.choice(far)()
        for _ in range(self.r.choice((0, 1, 1, 2))):
            self.r.choice(near)()
        if self.more_light == "sky":
            emitter = self.tag(self.root, "emitter", "constant")
            self.tag(emitter, "rgb", name="radiance", value=0.4)
        elif self.more_light == "lamp":
            emitter = self.tag(self.root, "emitter", "point")
            self.tag(emitter, "point", name="position", x=0.5, y=1.5, z=3.5)
            self.tag(emitter, "rgb", name="intensity", value=10.0)

    def emission(self, emitter, name: str, level: float):
        if self.chance(0.7):
            self.tag(emitter, "rgb", name=name, value=[level * self.between(0.5, 1) for _ in range(3)])
        elif self.chance(0.5):
            self.tag(emitter, "spectrum", name=name, value=0.7 * level)
        else:
            self.tag(
                emitter, "spectrum", name=name, value=f"400:0, 500:{_text(level)}, 600:{_text(0.6 * level)}, 700:1"
            )

    def area_light(self, place):
        """A shape that shines. Mitsuba samples textured light by the image, laid once over the shape's uv: so it has to
        be a bitmap without `to_uv`, and a shape that has every uv once. Mirrored cylinders shine to one side where it
        samples them, and to the other where rays meet them.
        """
        textured = self.chance(0.3)
        kind = self.r.choice((*_FLAT, "sphere") if textured else (*_FLAT, *_CLOSED, "cylinder", *_MESHES))
        shape = self.tag(self.root, "shape", kind)
        self.geometry(shape, kind)
        if kind in _FLAT:
            to_world = self.tag(shape, "transform", name="to_world")
            self.tag(to_world, "scale", x=self.between(0.8, 1.6), y=self.between(0.8, 1.6), z=1)
            self.tag(to_world, "lookat", origin=place, target=(0, -1, 0), up=(0, 0, 1))
        else:
            self.transform(place, self.between(0.5, 0.9), mirrored=kind != "cylinder" and not textured)(shape)
        if self.chance(0.4):
            self.material(shape, 1)
        emitter = self.tag(shape, "emitter", "area")
        if textured:
            texture = self.tag(emitter, "texture", "bitmap", name="radiance")
            level = self.between(1, 6)
            values = level * self.arrays.uniform(0.2, 1, (self.r.randint(2, 6), self.r.randint(2, 6), 3))
            self.bitmap(texture, values, self.r.choice(("exr", "hdr")))
        else:
            self.emission(emitter, "radiance", self.between(2, 8))

    def point(self):
        emitter = self.tag(self.root, "emitter", "point")
        place = self.between(-3, 3), 2.8, self.between(-1, 3)
        if self.chance(0.5):
            self.tag(emitter, "point", name="position", x=place[0], y=place[1], z=place[2])
        else:
            to_world = self.tag(emitter, "transform", name="to_world")
            self.tag(to_world, "translate", x=place[0], y=place[1], z=place[2])
        self.emission(emitter, "intensity", self.between(4, 20))

    def spot(self):
        emitter = self.tag(self.root, "emitter", "spot")
        to_world = self.tag(emitter, "transform", name="to_world")
        origin = self.between(-3, 3), 2.8, self.between(-1, 3)
        self.tag(to_world, "lookat", origin=origin, target=self.place(), up=(0.3, 0, 1))
        cutoff = self.between(20, 60)
        self.float(emitter, "cutoff_angle", cutoff)
        if self.chance(0.6):
            self.float(emitter, "beam_width", cutoff * self.between(0.2, 0.95))
        self.emission(emitter, "intensity", self.between(10, 40))

    def directional(self):
        emitter = self.tag(self.root, "emitter", "directional")
        direction = self.between(-0.6, 0.6), -1, self.between(-0.8, 0.3)
        if self.chance(0.5):
            self.tag(emitter, "vector", name="direction", x=direction[0], y=direction[1], z=direction[2])
        else:
            to_world = self.tag(emitter, "transform", name="to_world")
            self.tag(to_world, "lookat", origin=(0, 0, 0), target=direction, up=(0, 0, 1))
        self.emission(emitter, "irradiance", self.between(0.5, 3))

    def constant(self):
        self.emission(self.tag(self.root, "emitter", "constant"), "radiance", self.between(0.3, 1.2))

    def envmap(self):
        emitter = self.tag(self.root, "emitter", "envmap")
        sky = self.arrays.uniform(0.05, 0.6, (self.r.randint(4, 12), self.r.randint(6, 20), 3))
        if self.chance(0.3):  # a lamp
            sky[1, self.r.randrange(sky.shape[1])] = 12.0
        encoding = self.r.choice(("exr", "hdr", "png"))
        self.bitmap(emitter, np.minimum(sky, 1.0) if encoding == "png" else sky, encoding)
        if self.chance(0.5):
            self.float(emitter, "scale", self.between(0.4, 2.0))
        if self.chance(0.7):
            to_world = self.tag(emitter, "transform", name="to_world")
            if self.chance(0.2):
                self.tag(to_world, "scale", x=-1)
            self.turn(to_world, self.between(0, 360))


def _text(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    return ", ".join(f"{v:.6g}" for v in value)


def _as_of_old(root: ElementTree.Element):
    """Names as Mitsuba 0.6 had them: maxDepth, intIOR."""
    for tag in root.iter():
        if "name" in tag.attrib and tag.tag not in ("ref",):
            first, *others = tag.get("name").split("_")
            tag.set("name", first + "".join("IOR" if part == "ior" else part.capitalize() for part in others))


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals of the points, means over the faces that meet there, seams included."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    same = np.unique(np.round(points, 6), axis=0, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((same.max() + 1, 3))
    for i in range(3):
        np.add.at(sums, same[faces[:, i]], np.cross(b - a, c - a))
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return (sums / np.where(lengths > 0, lengths, 1))[same]


def _obj(points, normals, uvs, faces, quads: bool) -> str:
    lines = ["v " + " ".join(f"{x:.6g}" for x in point) for point in points]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in (() if uvs is None else uvs)]
    lines += ["vn " + " ".join(f"{x:.6g}" for x in normal) for normal in (() if normals is None else normals)]
    # the first half of the triangles and the second pair up to the cells of the grid, where none is left out
    half = len(faces) // 2
    paired = quads and len(faces) % 2 == 0 and (faces[:half, 2] == faces[half:, 1]).all()
    polygons = np.column_stack([faces[:half], faces[half:, 2]]) if paired else faces
    for polygon in polygons + 1:
        corners = (f"{i}/{'' if uvs is None else i}/{'' if normals is None else i}".rstrip("/") for i in polygon)
        lines.append("f " + " ".join(corners))
    return "\n".join(lines) + "\n"


def _write_ply(path: Path, points, normals, uvs, faces, attribute: str, values, binary: bool):
    columns = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
    if normals is not None:
        columns |= {"nx": normals[:, 0], "ny": normals[:, 1], "nz": normals[:, 2]}
    if uvs is not None:
        columns |= {"u": uvs[:, 0], "v": uvs[:, 1]}
    if attribute == "vertex_color":
        columns |= {"r": values[:, 0], "g": values[:, 1], "b": values[:, 2]}
    heat = attribute == "face_heat"
    head = ["ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0", f"element vertex {len(points)}"]
    head += [f"property float {name}" for name in columns]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head += ["property float heat_x"] if heat else []
    head += ["end_header", ""]
    if binary:
        vertices = np.stack(list(columns.values()), axis=1).astype("<f4").tobytes()
        record = np.zeros(len(faces), [("n", "u1"), ("i", "<i4", 3), *([("heat", "<f4")] if heat else [])])
        record["n"], record["i"] = 3, faces
        if heat:
            record["heat"] = values[:, 0]
        body = vertices + record.tobytes()
    else:
        lines = [" ".join(f"{x:.6g}" for x in row) for row in zip(*columns.values(), strict=True)]
        tails = [f" {x:.6g}" for x in values[:, 0]] if heat else [""] * len(faces)
        lines += [f"3 {a} {b} {c}{tail}" for (a, b, c), tail in zip(faces, tails, strict=True)]
        body = ("\n".join(lines) + "\n").encode()
    path.write_bytes("\n".join(head).encode() + body)


def _write_serialized(path: Path, points, normals, uvs, faces, r: random.Random) -> int:
    """A file of two meshes; returns which of them is meant. The other one is a single triangle."""
    double = r.random() < 0.5
    type_ = "<f8" if double else "<f4"

    def stream(points, normals, uvs, faces) -> bytes:
        flags = (0x2000 if double else 0x1000) | (0x1 if normals is not None else 0) | (0x2 if uvs is not None else 0)
        data = struct.pack("<I", flags) + b"mesh\0" + struct.pack("<QQ", len(points), len(faces))
        data += b"".join(np.asarray(a, type_).tobytes() for a in (points, normals, uvs) if a is not None)
        return struct.pack("<HH", 0x041C, 4) + zlib.compress(data + np.asarray(faces, "<u4").tobytes())

    index = r.randint(0, 1)
    other = np.eye(3), None, None, [[0, 1, 2]]
    meshes = [stream(*other), stream(*other)]
    meshes[index] = stream(points, normals, uvs, faces)
    table = struct.pack("<QQI", 0, len(meshes[0]), 2)
    path.write_bytes(meshes[0] + meshes[1] + table)
    return index
