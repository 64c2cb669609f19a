"""Random shapes, groups and instances, with mesh files. Used by scene_generator.py."""

import numpy as np
from mesh_files import obj_text, vertex_normals, write_ply, write_serialized
from random_materials import RandomMaterials

FLAT = ("rectangle", "disk")
CLOSED = ("cube", "sphere")
MESHES = ("obj", "ply", "serialized")


class RandomShapes(RandomMaterials):
    """Shapes, groups and instances."""

    def transform(self, place, size: float, mirrored: bool = True):
        """Returns a function that writes a transform into a shape of about size 1; `mirrored`: it may mirror."""

        def write(shape):
            uneven = shape.get("type") not in ("sphere", "cylinder")
            to_world = self.tag(shape, "transform", name="to_world")
            if uneven and self.chance(0.4):
                self.tag(to_world, "scale", value=[self.uniform(0.4, 1.3) for _ in range(3)])
            # media: in Mitsuba the inside of a mirrored mesh is its outside
            if mirrored and not self.has_media and self.chance(0.15):
                self.tag(to_world, "scale", **{self.r.choice("xyz"): -1})
            self.tag(to_world, "scale", value=size)
            self.rotate(to_world, self.uniform(-180, 180))
            if uneven and self.chance(0.15):
                shear = np.eye(4)
                shear[0, 1], shear[2, 0] = self.uniform(-0.4, 0.4), self.uniform(-0.4, 0.4)
                self.tag(to_world, "matrix", value=shear.ravel())
            self.tag(to_world, "translate", x=place[0], y=place[1], z=place[2])

        return write

    def object(self, parent, transform):
        kind = self.r.choice((*FLAT, *CLOSED, "cylinder", *MESHES, *MESHES))
        shape = self.tag(parent, "shape", kind)
        attribute = self.geometry(shape, kind)
        transform(shape)
        self.maybe_boolean(shape, "flip_normals", 0.2)
        if self.has_media and kind in (*CLOSED, *MESHES) and self.chance(0.6):
            self.medium(shape)
        elif self.shared_materials and self.chance(0.25):
            self.tag(shape, "ref", id=self.r.choice(self.shared_materials))
        elif self.chance(0.95):
            self.material(shape, 3, attribute=attribute)
        return shape

    def geometry(self, shape, kind: str) -> str:
        """Writes the parameters of a shape; returns the name of its mesh attribute, or an empty string."""
        if kind == "sphere" and self.chance(0.4):
            self.tag(shape, "point", name="center", x=0.2, y=self.uniform(-0.3, 0.3), z=0)
            self.float(shape, "radius", self.uniform(0.6, 1.1))
        elif kind == "cylinder":
            self.tag(shape, "point", name="p0", x=0, y=0.1, z=self.uniform(-1, -0.4))
            self.tag(shape, "point", name="p1", x=self.uniform(-0.3, 0.3), y=0, z=0.8)
            self.float(shape, "radius", self.uniform(0.3, 0.7))
        elif kind in MESHES:
            return self.mesh(shape, kind)
        return ""

    def mesh(self, shape, kind: str) -> str:
        points, uvs, faces = self.surface()
        normals = vertex_normals(points, faces) if self.chance(0.5) else None
        uvs = uvs if self.chance(0.8) else None
        path = self.folder / self.name(kind)
        self.tag(shape, "string", name="filename", value=path.name)
        self.maybe_boolean(shape, "face_normals", 0.3)
        if kind == "serialized":
            index = write_serialized(path, points, normals, uvs, faces, self.r)
            self.tag(shape, "integer", name="shape_index", value=index)
            return ""
        self.maybe_boolean(shape, "flip_tex_coords", 0.3)
        if kind == "obj":
            path.write_text(obj_text(points, normals, uvs, faces, self.chance(0.5)))
            return ""
        attribute = self.r.choice(("", "vertex_color", "face_heat"))
        per = {"vertex_color": (len(points), 3), "face_heat": (len(faces), 1)}.get(attribute, (0, 0))
        values = self.arrays.uniform(0.1, 0.8, per)
        write_ply(path, points, normals, uvs, faces, attribute, values, binary=self.chance(0.7))
        return attribute

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns points, texture coordinates and triangles of a bumpy ball, a ring or a wavy sheet."""
        kind = self.r.choice(("ball", "ring", "sheet"))
        columns, rows = self.r.randint(6, 24), self.r.randint(5, 16)
        u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)))
        around, wave = 2 * np.pi * u, self.r.randint(1, 3)
        if kind == "ball":
            height = np.pi * v
            radius = 1 + self.uniform(0, 0.25) * np.sin(wave * around) * np.sin(height) ** 2
            sine = np.sin(height)
            points = radius * np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(height)])
        elif kind == "ring":
            tube, thick = -2 * np.pi * v, self.uniform(0.2, 0.4)
            reach = 0.7 + thick * np.cos(tube)
            points = np.stack([reach * np.cos(around), reach * np.sin(around), thick * np.sin(tube)])
        else:
            points = np.stack([2 * u - 1, 2 * v - 1, self.uniform(0, 0.3) * np.sin(wave * around) * np.cos(4 * v)])
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
            place = [self.uniform(-0.5, 0.5) for _ in range(3)]
            self.object(group, self.transform(place, self.uniform(0.3, 0.7)))
        for _ in range(self.r.randint(1, 4)):
            instance = self.tag(self.root, "shape", "instance")
            self.transform(self.random_place(), self.uniform(0.5, 1.0))(instance)
            self.tag(instance, "ref", id=id_)
