"""Makes the device records of spheres, disks and cylinders, many at once. Called by `surfaces.py`."""

import warnings
from collections.abc import Callable

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs, transforms


def sphere_records(shapes: list[dict], to_world: np.ndarray, name: Callable[[int], str]) -> np.ndarray:
    """(n,) structs.ANALYTIC of spheres with transforms (n, 4, 4). `name` names one in errors, by its number."""
    rotation, stretch = transforms.polar_decomposition(to_world)
    _warn_if_non_uniform(stretch, (0, 1, 2), name)
    radius = np.array([shape["radius"] for shape in shapes]) * np.abs(stretch[:, 0, 0])
    sphere_to_world = np.zeros((len(shapes), 4, 4))
    sphere_to_world[:, :3, :3] = rotation * radius[:, None, None]
    center = np.array([shape["center"] for shape in shapes])
    sphere_to_world[:, :3, 3] = transforms.transform_points(to_world, center[:, None])[:, 0]
    sphere_to_world[:, 3, 3] = 1
    records = _records(structs.ANALYTIC_SPHERE, sphere_to_world, name)
    records["center"], records["radius"] = sphere_to_world[:, :3, 3], radius
    return records


def disk_records(shapes: list[dict], to_world: np.ndarray, name: Callable[[int], str]) -> np.ndarray:
    """(n,) structs.ANALYTIC of disks."""
    return _records(structs.ANALYTIC_DISK, to_world, name)


def cylinder_records(shapes: list[dict], to_world: np.ndarray, name: Callable[[int], str]) -> np.ndarray:
    """(n,) structs.ANALYTIC of cylinders."""
    axes = np.stack([_cylinder_axes(shape) for shape in shapes])
    cylinder_to_world = to_world @ axes[:, 0] @ axes[:, 1] @ axes[:, 2]
    is_valid = np.isfinite(cylinder_to_world).all(axis=(1, 2))
    if not is_valid.all():
        raise SceneError(f"{name(int(np.argmin(is_valid)))}: its size exceeds the range of 64-bit floats")
    rotation, stretch = transforms.polar_decomposition(cylinder_to_world)
    _warn_if_non_uniform(stretch, (0, 1), name)
    # negative if mirrored: then the axis is mirrored too
    size = stretch[:, [0, 0, 2], [0, 0, 2]]
    cylinder_to_world[:, :3, :3] = rotation * size[:, None]
    return _records(structs.ANALYTIC_CYLINDER, cylinder_to_world, name)


def _cylinder_axes(shape: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation and scale of the unit cylinder to the axis of a shape."""
    axis = np.subtract(shape["p1"], shape["p0"])
    length, radius = np.linalg.norm(axis), shape["radius"]
    rotation = transforms.rotation_from_z(axis / length)
    return transforms.translate(shape["p0"]), rotation, transforms.scale((radius, radius, length))


def _records(kind: int, to_world: np.ndarray, name: Callable[[int], str]) -> np.ndarray:
    records = np.zeros(len(to_world), structs.ANALYTIC)
    records["kind"] = kind
    records["to_world"] = to_world[:, :3].reshape(-1, 12)
    records["to_object"] = np.linalg.inv(to_world)[:, :3].reshape(-1, 12)
    is_valid = np.isfinite(records["to_world"]).all(axis=1) & np.isfinite(records["to_object"]).all(axis=1)
    if not is_valid.all():
        raise SceneError(f"{name(int(np.argmin(is_valid)))}: its size exceeds the range of 32-bit floats")
    return records


def _warn_if_non_uniform(stretch: np.ndarray, axes: tuple[int, ...], name: Callable[[int], str]):
    """Mitsuba 3 warns as well and uses the scale of the first axis; the images agree."""
    diagonal = stretch[:, axes, axes]
    first = diagonal[:, :1]
    for index in np.flatnonzero(np.abs(diagonal - first).max(axis=1) > 1e-4 * np.abs(first[:, 0])):
        text = "non-uniform scale; the scale of the first axis is used, as in Mitsuba 3"
        warnings.warn(f"{name(int(index))}: {text}", stacklevel=2)


def analytic_areas(records: np.ndarray) -> np.ndarray:
    """Areas (n,) float64 of structs.ANALYTIC."""
    x, y, z = records["to_world"].reshape(-1, 3, 4)[:, :, :3].astype(float).transpose(2, 0, 1)
    disk = np.pi * np.linalg.norm(np.cross(x, y), axis=1)
    cylinder = 2.0 * np.pi * (np.linalg.norm(x, axis=1) * np.linalg.norm(z, axis=1))
    sphere = 4.0 * np.pi * records["radius"].astype(float) ** 2
    is_sphere, is_disk = (records["kind"] == kind for kind in (structs.ANALYTIC_SPHERE, structs.ANALYTIC_DISK))
    return np.where(is_sphere, sphere, np.where(is_disk, disk, cylinder))
