"""Instances: groups of shapes that are compiled once, in a space of their own, and stand in several places."""

from collections.abc import Mapping

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs

_SHEAREST = 2.0**24
"""How much larger than a point the terms of its coordinates may become on the way to the group's space and back: from
here on nothing of the point is left in 32-bit floats."""


def split_instances(
    shapes: Mapping[str, dict],
) -> tuple[dict[str, dict], list[dict[str, dict]], dict[str, tuple[dict, int]]]:
    """(shapes that stand in the world, groups, instances with the number of their group), by the names for errors.

    Groups that have no instance are left out: nobody sees them.
    """
    names = {id(shape): name for name, shape in shapes.items()}
    world, groups, instances = {}, [], {}
    numbers: dict[int, int] = {}  # of the groups, by identity: a reference is the dict that it refers to
    for name, shape in shapes.items():
        if shape["type"] == "instance":
            group = shape["shape"]
            number = numbers.setdefault(id(group), len(groups))
            if number == len(groups):
                of = f"of shapegroup '{names.get(id(group), name)}'"
                groups.append({f"{key} {of}": part for key, part in group.items() if isinstance(part, dict)})
            instances[f"instance '{name}'"] = (shape, number)
        elif shape["type"] != "shapegroup":
            world[f"shape '{name}'"] = shape
    return world, groups, instances


def instance_records(instances: Mapping[str, tuple[dict, int]]) -> np.ndarray:
    """(i,) structs.INSTANCE. Raises SceneError where a transform leaves the range of 32-bit floats."""
    records = np.zeros(len(instances), structs.INSTANCE)
    if not len(records):
        return records
    matrices = np.stack([instance.get("to_world", np.eye(4)) for instance, _ in instances.values()])
    with np.errstate(over="ignore"):
        matrices[:, :3] = matrices[:, :3].astype(np.float32)  # the inverse is that of the matrix as the device has it
        records["to_world"] = matrices[:, :3].reshape(-1, 12)
        fits = np.isfinite(matrices).all(axis=(1, 2)) & (np.linalg.det(matrices[:, :3, :3]) != 0)
        matrices[~fits] = np.eye(4)
        inverses = np.linalg.inv(matrices)
        records["to_object"] = inverses[:, :3].reshape(-1, 12)
    there_and_back = np.abs(matrices[:, :3, :3]) @ np.abs(inverses[:, :3, :3])
    fits &= np.isfinite(records["to_object"]).all(axis=1) & (there_and_back <= _SHEAREST).all(axis=(1, 2))
    if not fits.all():
        raise SceneError(f"{list(instances)[int(np.argmin(fits))]}: its to_world leaves the range of 32-bit floats")
    records["root"] = [1 + number for _, number in instances.values()]
    return records
