"""Compiles heterogeneous media: grids of values, where they are, and bounds of the extinction for free flights.

Called by `scene/material/media.py`. A ray crosses a coarse grid of cells with the minimum and the maximum of the
extinction coefficient in each: kernels/media/heterogeneous.h. Conventions are Mitsuba 3's (3.9.1): a volume fills the
unit cube, its values are at the centres of the grid's cells, and a medium ends at the world-aligned box around the
volume of its sigma_t. Where that box is larger than the volume, `wrap_mode` says what is there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.textures import TEXTURE_CLAMP, TEXTURE_MIRROR, TEXTURE_NEAREST
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.transforms import scale, translate
from isonoise.scene.volume import is_volume
from isonoise.scene.volume.grid_file import VolumeGrid, check_grid, read_vol

_MAX_OPTICAL_THICKNESS = 2.0**24
"""Of a medium's box: with more, a mean free path is shorter than the steps of 32-bit positions."""
_MAX_SIGMA_T = 1e30  # as in `parse.constraints`
_MIN_SIZE = 1e-30
_CELL_SIZE = 4  # values of the grid along a side of a cell
_MAX_CELLS = 64  # along an axis
_MARGIN = 0.25  # values beyond a cell's border that count as in it: positions are rounded
_UNIT_CUBE = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
_WRAP_FLAGS = {"clamp": TEXTURE_CLAMP, "repeat": 0, "mirror": TEXTURE_MIRROR}


@dataclass(frozen=True)
class HeterogeneousMedia:
    """What the device reads of heterogeneous media. The values are those of the files, without a medium's scale."""

    records: np.ndarray  # (M,) structs.HETEROGENEOUS_MEDIUM, one for each of all media
    grids: np.ndarray  # (n,) structs.GRID
    values: np.ndarray  # (v,) float32
    extinction_bounds: np.ndarray  # (c, 2) float32: minimum and maximum in each cell, with the scale

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by the names of the kernel arguments."""
        return {
            "heterogeneous_media": self.records,
            "grids": self.grids,
            "grid_values": self.values,
            "extinction_bounds": self.extinction_bounds,
        }


@dataclass(frozen=True)
class _Grid:
    """A stored grid."""

    values: np.ndarray  # (nz, ny, nx, channels) float32
    first: int  # index of its first value
    bounds: np.ndarray  # (2, 3): of the file


class HeterogeneousMediaBuilder:
    """Collects grids, each stored once, and records of media."""

    def __init__(self):
        self._grids: dict[str | int, _Grid] = {}  # by path, or by id() of what is in memory
        self._sources: list[object] = []  # holds what is in memory, so that its id() stays valid
        self._records: list[np.ndarray] = []
        self._index_by_record: dict[bytes, int] = {}
        self._bounds: list[np.ndarray] = []
        self._record_by_extinction: dict[tuple[int, float], np.ndarray] = {}  # by grid and scale
        self._medium_by_id: dict[int, tuple[dict, np.ndarray]] = {}  # holds the dict, too
        self._value_count = self._cell_count = 0

    def medium_record(self, medium: dict) -> np.ndarray:
        """(1,) structs.HETEROGENEOUS_MEDIUM of a medium of the description; a new file is read."""
        if id(medium) not in self._medium_by_id:
            self._medium_by_id[id(medium)] = (medium, self._make_record(medium))
        return self._medium_by_id[id(medium)][1]

    def media(self, records: np.ndarray) -> HeterogeneousMedia:
        """Everything that was collected, with the records (M,) of all media."""
        values = [grid.values.reshape(-1) for grid in self._grids.values()]
        return HeterogeneousMedia(
            records,
            np.concatenate(self._records),
            values[0] if len(values) == 1 else np.concatenate(values),
            np.concatenate(self._bounds),
        )

    def _make_record(self, medium: dict) -> np.ndarray:
        volume = medium["sigma_t"]
        if not is_volume(volume):
            volume = {"type": "constvolume", "value": volume}
        index, grid = self._add_grid(volume, "unbounded")
        key = index, medium["scale"]
        if key not in self._record_by_extinction:
            self._record_by_extinction[key] = self._make_extinction_record(volume, index, grid, medium["scale"])
        record = self._record_by_extinction[key].copy()
        if is_volume(medium["albedo"]) and medium["albedo"]["type"] == "gridvolume":
            record["albedo"], albedo = self._add_grid(medium["albedo"], "reflectance")
            if albedo.values.max() > 1:
                raise SceneError(f"{_name(medium['albedo'])}: an albedo is at most 1, got {albedo.values.max():g}")
        return record

    def _make_extinction_record(self, volume: dict, index: int, grid: _Grid, factor: float) -> np.ndarray:
        """The record of a medium without its albedo. `factor`: the medium's scale."""
        record = np.zeros(1, structs.HETEROGENEOUS_MEDIUM)
        record["sigma_t"], record["albedo"] = index, structs.NONE
        corners = _transformed(self._to_world(volume, grid), _corners(_UNIT_CUBE))
        world = np.stack([corners.min(axis=0), corners.max(axis=0)])
        highest = float(grid.values.max()) * factor
        limit = min(_MAX_OPTICAL_THICKNESS / max(np.linalg.norm(world[1] - world[0]), _MIN_SIZE), _MAX_SIGMA_T)
        if not highest <= limit:
            raise SceneError(
                f"{_name(volume)}: sigma_t times scale reaches {highest:g}; in a volume of this size it is "
                f"limited to {limit:.3g}, an optical thickness of {_MAX_OPTICAL_THICKNESS:,.0f}; reduce scale"
            )
        with np.errstate(over="ignore"):  # checked below
            record["lower"], record["upper"] = world
            self._add_extinction_bounds(record, volume, grid, _corners(world), factor)
        if not all(np.isfinite(record[name]).all() for name in ("lower", "upper", "to_cells")):
            _raise_out_of_range(volume)
        return record

    def _add_extinction_bounds(
        self, record: np.ndarray, volume: dict, grid: _Grid, corners: np.ndarray, factor: float
    ) -> None:
        """Store the bounds of cells that cover a box, given by its corners (8, 3) in the world."""
        to_local = self._to_local(volume, grid)
        local = _transformed(to_local, corners)
        lower, upper = local.min(axis=0), local.max(axis=0)
        size = np.array(grid.values.shape[2::-1])
        counts = np.clip(np.ceil(size * (upper - lower) / _CELL_SIZE - 1e-6), 1, _MAX_CELLS).astype(int)
        nearest = volume.get("filter_type") == "nearest"
        wrap = volume.get("wrap_mode", "clamp")
        ranges = [
            list(_value_ranges(int(size[a]), int(counts[a]), lower[a], upper[a], nearest, wrap)) for a in range(3)
        ]
        bounds = cell_bounds(grid.values, *ranges).reshape(-1, 2) * factor
        record["first_cell"] = self._cell_count
        record["cells"] = counts
        record["to_cells"] = (scale(counts / (upper - lower)) @ translate(-lower) @ to_local)[:3].ravel()
        self._bounds.append(np.asarray(bounds, np.float32))
        self._cell_count += len(bounds)

    def _add_grid(self, volume: dict, kind: str) -> tuple[int, _Grid]:
        """The index of the record of a volume, and its grid."""
        grid = self._load(volume, kind)
        record = np.zeros(1, structs.GRID)
        with np.errstate(over="ignore"):  # checked below
            record["to_local"] = self._to_local(volume, grid)[:3].ravel()
        if not np.isfinite(record["to_local"]).all():
            _raise_out_of_range(volume)
        record["size"], record["channels"] = grid.values.shape[2::-1], grid.values.shape[3]
        record["first"] = grid.first
        record["flags"] = _WRAP_FLAGS[volume.get("wrap_mode", "clamp")]
        record["flags"] |= TEXTURE_NEAREST if volume.get("filter_type") == "nearest" else 0
        key = record.tobytes()
        if key not in self._index_by_record:
            self._index_by_record[key] = len(self._records)
            self._records.append(record)
        return self._index_by_record[key], grid

    def _load(self, volume: dict, kind: str) -> _Grid:
        if volume["type"] == "constvolume":
            rgb = colour_to_rgb(volume["value"], kind).astype(np.float32)
            rgb = rgb[:1] if (rgb == rgb[0]).all() else rgb
            return self._store(f"constant {rgb.tobytes().hex()}", VolumeGrid(rgb.reshape(1, 1, 1, -1)))
        source = volume.get("filename", volume.get("grid", volume.get("data")))
        key = source if isinstance(source, str) else id(source)
        if key in self._grids:
            return self._grids[key]
        if isinstance(source, str):
            return self._store(key, read_vol(source))
        self._sources.append(source)
        values = source.values if isinstance(source, VolumeGrid) else source
        bounds = source.bounds if isinstance(source, VolumeGrid) else _UNIT_CUBE
        return self._store(key, VolumeGrid(check_grid(values, SourceLocation("gridvolume")), np.asarray(bounds, float)))

    def _store(self, key: str | int, grid: VolumeGrid) -> _Grid:
        if key not in self._grids:
            self._grids[key] = _Grid(grid.values, self._value_count, grid.bounds)
            self._value_count += grid.values.size
        return self._grids[key]

    def _to_world(self, volume: dict, grid: _Grid) -> np.ndarray:
        """From the unit cube of a volume to the world."""
        to_world = volume.get("to_world", np.eye(4))
        if not volume.get("use_grid_bbox"):
            return to_world
        size = grid.bounds[1] - grid.bounds[0]
        if not (np.isfinite(grid.bounds).all() and (size > 0).all()):
            raise SceneError(f"{_name(volume)}: its box, which use_grid_bbox asks for, is empty or not finite")
        return to_world @ translate(grid.bounds[0]) @ scale(size)

    def _to_local(self, volume: dict, grid: _Grid) -> np.ndarray:
        """From the world to the unit cube of a volume."""
        try:
            return np.linalg.inv(self._to_world(volume, grid))
        except np.linalg.LinAlgError:
            _raise_out_of_range(volume)


def _raise_out_of_range(volume: dict) -> NoReturn:
    raise SceneError(f"{_name(volume)}: the place of the volume exceeds the range of 32-bit floats; move or scale it")


def _transformed(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _name(volume: dict) -> str:
    return volume.get("filename", volume["type"])


def _corners(box: np.ndarray) -> np.ndarray:
    """The eight corners (8, 3) of a box (2, 3)."""
    return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _value_ranges(size: int, count: int, lower: float, upper: float, nearest: bool, wrap: str) -> Iterator[np.ndarray]:
    """For each cell along an axis, the indices of the values that points inside it read."""
    edges = size * np.linspace(lower, upper, count + 1) - (0.0 if nearest else 0.5)
    for begin, end in zip(edges[:-1] - _MARGIN, edges[1:] + _MARGIN, strict=True):
        if end - begin > 2 * size:
            yield np.arange(size)
            continue
        indices = np.arange(int(np.floor(begin)), int(np.floor(end)) + (1 if nearest else 2))
        if wrap == "clamp":
            indices = np.clip(indices, 0, size - 1)
        elif wrap == "repeat":
            indices %= size
        else:
            indices %= 2 * size
            indices = np.minimum(indices, 2 * size - 1 - indices)
        yield np.unique(indices)


def cell_bounds(
    values: np.ndarray, x_ranges: list[np.ndarray], y_ranges: list[np.ndarray], z_ranges: list[np.ndarray]
) -> np.ndarray:
    """The minimum and maximum (cz, cy, cx, 2) of values (nz, ny, nx, channels) in cells, given by index ranges.

    One layer of cells is reduced after the other, so that temporary arrays stay small.
    """
    layers = []
    for indices in z_ranges:
        slab = values[indices]
        pair = np.stack([-slab.min(axis=0).min(axis=-1), slab.max(axis=0).max(axis=-1)])
        low, high = _reduce(_reduce(pair, y_ranges, 1), x_ranges, 2).astype(float)
        layers.append(np.stack([-low, high], axis=-1))
    return np.stack(layers)


def _reduce(values: np.ndarray, ranges: list[np.ndarray], axis: int) -> np.ndarray:
    """The maximum over each range of indices of an axis."""
    begins = np.cumsum([0, *map(len, ranges)])[:-1]
    return np.maximum.reduceat(np.take(values, np.concatenate(ranges), axis), begins, axis)
