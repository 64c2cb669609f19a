"""Instances: shape groups that are compiled once, in a space of their own, and placed in the world several times.

Called by `compile.py`.
"""

from collections.abc import Mapping

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs

_MAX_ROUND_TRIP_GAIN = 2.0**24
"""Largest growth of rounding errors on the way to group space and back: beyond it nothing of a point's coordinates is
left in 32-bit floats."""


def split_instances(
    shapes: Mapping[str, dict],
) -> tuple[dict[str, dict], list[dict[str, dict]], dict[str, tuple[dict, int]]]:
    """(shapes of the world, shapes of each group, instances with the index of their group), by names for errors.

    Groups without an instance are left out.
    """
    names = {id(shape): name for name, shape in shapes.items()}
    world, groups, instances = {}, [], {}
    group_indices: dict[int, int] = {}  # by id: a resolved reference is the same dict as its target
    for name, shape in shapes.items():
        if shape["type"] == "instance":
            group = shape["shape"]
            index = group_indices.setdefault(id(group), len(groups))
            if index == len(groups):
                suffix = f"of shapegroup '{names.get(id(group), name)}'"
                groups.append({f"{key} {suffix}": part for key, part in group.items() if isinstance(part, dict)})
            instances[f"instance '{name}'"] = (shape, index)
        elif shape["type"] != "shapegroup":
            world[f"shape '{name}'"] = shape
    return world, groups, instances


def instance_records(instances: Mapping[str, tuple[dict, int]]) -> np.ndarray:
    """(i,) structs.INSTANCE. Raises SceneError if a transform exceeds the range of 32-bit floats."""
    records = np.zeros(len(instances), structs.INSTANCE)
    if not len(records):
        return records
    matrices = np.stack([instance.get("to_world", np.eye(4)) for instance, _ in instances.values()])
    with np.errstate(over="ignore"):
        matrices[:, :3] = matrices[:, :3].astype(np.float32)  # invert the matrix that the device has
        records["to_world"] = matrices[:, :3].reshape(-1, 12)
        is_valid = np.isfinite(matrices).all(axis=(1, 2)) & (np.linalg.det(matrices[:, :3, :3]) != 0)
        matrices[~is_valid] = np.eye(4)
        inverses = np.linalg.inv(matrices)
        records["to_object"] = inverses[:, :3].reshape(-1, 12)
    gain = np.abs(matrices[:, :3, :3]) @ np.abs(inverses[:, :3, :3])
    is_valid &= np.isfinite(records["to_object"]).all(axis=1) & (gain <= _MAX_ROUND_TRIP_GAIN).all(axis=(1, 2))
    if not is_valid.all():
        name = list(instances)[int(np.argmin(is_valid))]
        raise SceneError(f"{name}: its to_world exceeds the range of 32-bit floats; use a smaller scale or shear")
    records["root"] = [1 + group for _, group in instances.values()]
    return records
