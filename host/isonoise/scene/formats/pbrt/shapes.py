"""Maps pbrt's shapes to meshes in world space and to analytic shapes. Called by `scene_builder.py`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.pbrt.directives import find_file
from isonoise.scene.formats.pbrt.loop_subdivision import possible_levels, subdivide
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.pbrt.surfaces_of_revolution import (
    QUADRICS,
    Quadric,
    grid_faces,
    is_mirroring,
    report_mesh,
    scales_uniformly,
)
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.mesh.mesh import Mesh
from isonoise.scene.mesh.ply import read_ply

_UNSUPPORTED = ("curve", "hyperboloid", "nurbs")
SHAPES = ("trianglemesh", "plymesh", "bilinearmesh", "loopsubdiv", "heightfield", *QUADRICS, *_UNSUPPORTED)
_POINTS = ("point3", "point", "vector3")
_NORMALS = ("normal", "normal3")
_UVS = ("point2", "float", "vector2")
_PATCH_CELLS = 8  # along each side of a bilinear patch that is no parallelogram
_MAX_FINE_PATCHES = 20_000
_PARALLELOGRAM_TOLERANCE = 1e-5  # relative to the diagonal
_CORNER_UVS = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]], np.float32)  # pbrt's default for each triangle, v flipped


@dataclass
class Geometry:
    """The geometry of one directive `Shape`, in world space."""

    mesh: Mesh | None = None  # or:
    analytic: dict | None = None  # scene dict without material
    analytic_area: float = 0.0
    light_count: int = 1  # pbrt-v4 makes a light of every triangle or patch
    smooth: bool = False  # a mesh without normals gets smooth ones

    @property
    def area(self) -> float:
        """Surface area."""
        if self.mesh is None:
            return self.analytic_area
        first, second, third = (self.mesh.vertices[self.mesh.faces[:, corner]] for corner in range(3))
        return 0.5 * float(np.linalg.norm(np.cross(second - first, third - first), axis=1).sum())


@dataclass
class ShapeReader:
    """Reads the geometry of shapes. `base` and `folder` are those of `find_file`."""

    base: Path
    folder: Path | None
    report: ImportReport

    def read(
        self, kind: str, parameters: Parameters, to_world: np.ndarray, reverse_orientation: bool, is_textured: bool
    ) -> Geometry | None:
        """The geometry of a shape; None if it is left out. Raises SceneError where it is invalid."""
        if kind in QUADRICS:
            return self._read_quadric(kind, parameters, to_world, reverse_orientation, is_textured)
        if kind in _UNSUPPORTED:
            self.report.limit("curves", f"the shape '{kind}' is left out", parameters.position.place)
            parameters.ignore(*(value.name for value in parameters.unused()))
            return None
        readers = {"trianglemesh": self._triangles, "plymesh": self._ply, "bilinearmesh": self._patches}
        readers |= {"loopsubdiv": self._subdivision_surface, "heightfield": self._height_field}
        if kind not in readers:
            parameters.position.raise_unknown("unknown shape", kind, SHAPES)
        mesh, patch_count = readers[kind](parameters)
        self.report.count("triangles", len(mesh.faces))
        if is_textured and not len(mesh.uvs):
            mesh = _with_default_uvs(mesh)
        mesh = to_world_space(mesh, to_world, reverse_orientation)
        return Geometry(mesh, light_count=patch_count or len(mesh.faces), smooth=kind == "loopsubdiv")

    def _read_quadric(
        self, kind: str, parameters: Parameters, to_world: np.ndarray, reverse_orientation: bool, is_textured: bool
    ) -> Geometry:
        self.report.use("quadrics")
        self.report.count("quadrics")
        quadric = Quadric(kind, parameters)
        is_distorted = not scales_uniformly(to_world)
        if quadric.is_whole and not is_distorted and not (is_textured and kind != "sphere"):
            shape = quadric.analytic_shape(to_world, reverse_orientation)
            return Geometry(None, shape, quadric.area(to_world))
        report_mesh(quadric, is_distorted, parameters, self.report)
        return Geometry(to_world_space(quadric.mesh(), to_world, reverse_orientation))

    def _triangles(self, parameters: Parameters) -> tuple[Mesh, int]:
        self.report.use("triangles")
        points, normals, uvs = self._vertices(parameters)
        indices = parameters.array("indices", ("integer",))
        if indices is None and len(points) == 3:
            indices = np.arange(3)
        faces = _faces(indices, 3, len(points), parameters)
        parameters.ignore("S", "faceIndices", "discarddegenerateUVs", "shadowalpha")
        return Mesh(points, faces, normals, uvs), 0

    def _vertices(self, parameters: Parameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, normals and texture coordinates; without normals or coordinates, arrays of length 0."""
        points = parameters.array("P", _POINTS)
        if points is None:
            parameters.position.raise_error('the shape needs vertices: "point3 P"')
        normals = parameters.array("N", (*_NORMALS, "vector3", "vector"))
        name = "uv" if "uv" in parameters else "st"
        uvs = parameters.array(name, _UVS)
        if uvs is not None and uvs.ndim == 1:
            if len(uvs) % 2:
                parameters.position_of(name).raise_error(f"'{name}' needs two numbers for each vertex")
            uvs = uvs.reshape(-1, 2)
        for array, array_name in ((normals, "N"), (uvs, name)):
            if array is not None and len(array) != len(points):
                parameters.position_of(array_name).raise_error(
                    f"'{array_name}' has {len(array)} values for {len(points)} vertices"
                )
        if normals is not None:
            self.report.use("normals")
        if uvs is not None:
            self.report.use("uvs")
        return (
            points,
            np.zeros((0, 3)) if normals is None else normals,
            np.zeros((0, 2), np.float32) if uvs is None else _flipped(uvs),
        )

    def _ply(self, parameters: Parameters) -> tuple[Mesh, int]:
        self.report.use("triangles")
        name = parameters.text("filename")
        if name is None:
            parameters.position.raise_error('a plymesh needs "string filename"')
        if "displacement" in parameters:
            self.report.limit("bump_map", "displacement of a mesh is ignored", name)
            parameters.ignore("displacement", "edgelength", "displacement.edgelength")
        path = find_file(name, self.base, self.folder, parameters.position_of("filename"))
        if path.suffix.lower() == ".gz":
            self.report.use("compression")
        mesh = read_ply(path, flip_tex_coords=True)
        mesh.attributes = {}  # pbrt has no vertex colours
        return mesh, 0

    def _subdivision_surface(self, parameters: Parameters) -> tuple[Mesh, int]:
        points = parameters.array("P", _POINTS)
        if points is None:
            parameters.position.raise_error('the shape needs vertices: "point3 P"')
        faces = _faces(parameters.array("indices", ("integer",)), 3, len(points), parameters)
        name = "nlevels" if "nlevels" in parameters else "levels"
        levels = min(max(parameters.integer(name, 3), 0), 10)
        parameters.ignore("scheme")
        self.report.use("curves")
        possible = possible_levels(len(faces), levels)
        if possible < levels:
            problem = f"a subdivision surface has {possible} levels: more would make too many triangles"
            self.report.limit("curves", problem, parameters.position.place)
        points, faces = subdivide(points, faces, possible)
        return Mesh(points, faces, np.zeros((0, 3))), 0

    def _height_field(self, parameters: Parameters) -> tuple[Mesh, int]:
        """pbrt-v3's `heightfield`: heights over the unit square."""
        columns, rows = parameters.integer("nu", 0), parameters.integer("nv", 0)
        heights = parameters.array("Pz", ("float",))
        if heights is None or min(rows, columns) < 2 or len(heights) != rows * columns:
            parameters.position.raise_error('a heightfield needs "integer nu", "integer nv" and nu x nv "float Pz"')
        x, y = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
        points = np.stack([x.ravel(), y.ravel(), heights], axis=1)
        return Mesh(points, grid_faces(rows, columns), np.zeros((0, 3)), _flipped(points[:, :2])), 0

    def _patches(self, parameters: Parameters) -> tuple[Mesh, int]:
        """Bilinear patches; their corners are at uv (0, 0), (1, 0), (0, 1), (1, 1)."""
        self.report.use("polygons")
        points, normals, uvs = self._vertices(parameters)
        indices = parameters.array("indices", ("integer",))
        if indices is None and len(points) == 4:
            indices = np.arange(4)
        corners = _faces(indices, 4, len(points), parameters)
        parameters.ignore("faceIndices")
        if "emissionfilename" in parameters:
            self.report.limit(
                "emission", "'emissionfilename' is ignored", parameters.position_of("emissionfilename").place
            )
            parameters.ignore("emissionfilename")
        self.report.count("bilinear patches", len(corners))
        corner_uvs = uvs[corners] if len(uvs) else np.tile(_flipped(_UNIT_CORNERS), (len(corners), 1, 1))
        is_simple = _are_parallelograms(points[corners]) | (len(corners) > _MAX_FINE_PATCHES)
        cells = np.where(is_simple, 1, _PATCH_CELLS)
        parts = [
            _subdivided(
                points[corners[cells == count]],
                normals[corners[cells == count]] if len(normals) else None,
                corner_uvs[cells == count],
                count,
            )
            for count in np.unique(cells)
        ]
        return _joined(parts), len(corners)


_UNIT_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


def to_world_space(mesh: Mesh, to_world: np.ndarray, reverse_orientation: bool) -> Mesh:
    """The transformed mesh, its triangles oriented so that their normals are those of pbrt.

    pbrt-v4 (`Triangle`): with vertex normals, the geometric normal is on their side. Otherwise it is that of the
    vertices' order in object space, reversed on demand.
    """
    vertices = transforms.transform_points(to_world, mesh.vertices)
    normals, faces = mesh.normals, mesh.faces
    if len(normals):
        normals = transforms.transform_normals(to_world, normals)
        normals = -normals if reverse_orientation else normals
        lengths = np.linalg.norm(normals, axis=1)[:, None]
        normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        first, second, third = (vertices[faces[:, corner]] for corner in range(3))
        shading = normals[faces].sum(axis=1)
        is_reversed = np.einsum("ij,ij->i", np.cross(second - first, third - first), shading) < 0
        faces = np.where(is_reversed[:, None], faces[:, ::-1], faces)
    elif reverse_orientation != is_mirroring(to_world):
        faces = faces[:, ::-1]
    return Mesh(vertices, np.ascontiguousarray(faces), normals, mesh.uvs)


def _faces(indices: np.ndarray | None, corners: int, vertices: int, parameters: Parameters) -> np.ndarray:
    """Vertex indices (n, corners)."""
    if indices is None:
        parameters.position.raise_error('the shape needs "integer indices"')
    if len(indices) % corners:
        parameters.position_of("indices").raise_error(f"the number of indices has to be a multiple of {corners}")
    if indices.min() < 0 or indices.max() >= vertices:
        parameters.position_of("indices").raise_error(
            f"an index is outside 0 to {vertices - 1}, the vertices that exist"
        )
    return indices.astype(np.int64).reshape(-1, corners)


def _flipped(uvs: np.ndarray) -> np.ndarray:
    """Texture coordinates with v = 0 at the top of an image."""
    return np.stack([uvs[..., 0], 1.0 - uvs[..., 1]], axis=-1).astype(np.float32)


def _with_default_uvs(mesh: Mesh) -> Mesh:
    """A mesh whose triangles have pbrt's default texture coordinates; they share no vertices."""
    corners = mesh.faces.ravel()
    normals = mesh.normals[corners] if len(mesh.normals) else mesh.normals
    uvs = np.tile(_CORNER_UVS, (len(mesh.faces), 1))
    return Mesh(mesh.vertices[corners], np.arange(len(corners)).reshape(-1, 3), normals, uvs)


def _are_parallelograms(corners: np.ndarray) -> np.ndarray:
    """Whether patches (n, 4, 3) are parallelograms, which two triangles represent exactly."""
    excess = corners[:, 0] + corners[:, 3] - corners[:, 1] - corners[:, 2]
    diagonal = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
    return np.linalg.norm(excess, axis=1) <= _PARALLELOGRAM_TOLERANCE * diagonal


def _subdivided(points: np.ndarray, normals: np.ndarray | None, uvs: np.ndarray, cells: int) -> Mesh:
    """Patches with corners (n, 4, ...) as grids of cells x cells cells."""
    s = np.linspace(0.0, 1.0, cells + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(s, s))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)  # of the corners

    def interpolate(values: np.ndarray) -> np.ndarray:
        return np.einsum("gc,nck->ngk", weights, values).reshape(-1, values.shape[2])

    first = np.arange(len(points))[:, None, None] * len(weights)
    return Mesh(
        interpolate(points),
        (first + grid_faces(cells + 1, cells + 1)).reshape(-1, 3),
        np.zeros((0, 3)) if normals is None else interpolate(normals),
        interpolate(uvs).astype(np.float32),
    )


def _joined(parts: list[Mesh]) -> Mesh:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
    )
