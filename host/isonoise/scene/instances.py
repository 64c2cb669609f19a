"""Instances: shape groups that are compiled once, in a space of their own, and placed in the world several times.

Called by `compile.py`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs

_MAX_ROUND_TRIP_GAIN = 2.0**24
"""Largest growth of rounding errors on the way to group space and back: beyond it nothing of a point's coordinates is
left in 32-bit floats."""


@dataclass(frozen=True)
class Space:
    """The shapes of the world or of a shape group, or all instances."""

    keys: list[str]  # in the description
    shapes: list[dict]
    label: str  # the name of a shape in errors, with its key as {}

    def name(self, number: int) -> str:
        """The name of a shape in errors."""
        return self.label.replace("{}", self.keys[number])


@dataclass(frozen=True)
class Spaces:
    """All shapes of a scene."""

    world: Space
    groups: list[Space]
    instances: Space
    group_of_instance: list[int]
    group_ids: list[int]  # id() of the description of each group


def split_instances(shapes: Mapping[str, dict]) -> Spaces:
    """Sort the shapes of a description into spaces. Groups without an instance are left out."""
    groups = {id(shape): name for name, shape in shapes.items() if shape["type"] == "shapegroup"}
    world, instances = Space([], [], "shape '{}'"), Space([], [], "instance '{}'")
    for name, shape in shapes.items():
        if shape["type"] != "shapegroup":
            space = instances if shape["type"] == "instance" else world
            space.keys.append(name)
            space.shapes.append(shape)
    spaces, index_of_group = [], {}  # by id: a resolved reference is the same dict as its target
    for name, instance in zip(instances.keys, instances.shapes, strict=True):
        group = instance["shape"]
        if id(group) not in index_of_group:
            index_of_group[id(group)] = len(spaces)
            parts = {key: part for key, part in group.items() if isinstance(part, dict)}
            label = "{} of shapegroup '" + groups.get(id(group), name) + "'"
            spaces.append(Space(list(parts), list(parts.values()), label))
    group_of_instance = [index_of_group[id(instance["shape"])] for instance in instances.shapes]
    return Spaces(world, spaces, instances, group_of_instance, list(index_of_group))


def instance_records(spaces: Spaces) -> np.ndarray:
    """(i,) structs.INSTANCE. Raises SceneError if a transform exceeds the range of 32-bit floats."""
    instances = spaces.instances.shapes
    records = np.zeros(len(instances), structs.INSTANCE)
    if not len(records):
        return records
    identity = np.eye(4)
    matrices = np.stack([instance.get("to_world", identity) for instance in instances])
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
        name = spaces.instances.name(int(np.argmin(is_valid)))
        raise SceneError(f"{name}: its to_world exceeds the range of 32-bit floats; use a smaller scale or shear")
    records["root"] = 1 + np.array(spaces.group_of_instance)
    return records
