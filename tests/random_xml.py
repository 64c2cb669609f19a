"""Base of the random scene generator: random numbers, names and XML elements. Used by scene_generator.py."""

import random
from pathlib import Path
from xml.etree import ElementTree

import numpy as np


def to_text(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    return ", ".join(f"{v:.6g}" for v in value)


class RandomXml:
    """A scene file in progress. All random decisions come from `r`, random arrays from `arrays`."""

    def __init__(self, folder: Path, seed: int, media: bool, extra_light: str | None):
        self.folder, self.r = folder, random.Random(seed)
        self.extra_light = extra_light
        self.arrays = np.random.default_rng(seed)
        self.is_version_0_6 = self.chance(0.2)
        self.has_media = media and self.chance(0.2)
        self.in_room = self.chance(0.45)
        # no light has an extent: under others Mitsuba's blends are too bright (3.9.1: the pdf of a sample leaves the
        # weight out, so that the weights of both techniques exceed 1)
        self.point_like_lights = not self.in_room and self.chance(0.4)
        self.root = ElementTree.Element(
            "scene", version="0.6.0" if self.is_version_0_6 else self.r.choice(("2.1.0", "3.0.0"))
        )
        self.count = 0
        self.shared_materials: list[str] = []  # ids

    def chance(self, probability: float) -> bool:
        return self.r.random() < probability

    def uniform(self, low: float, high: float) -> float:
        return self.r.uniform(low, high)

    def name(self, what: str) -> str:
        self.count += 1
        return f"{what}{self.count}"

    def tag(self, parent, kind: str, type_: str | None = None, name: str = "", **attributes) -> ElementTree.Element:
        if type_ is not None:
            attributes = {"type": type_} | attributes
        if name:
            attributes = {"name": name} | attributes
        return ElementTree.SubElement(parent, kind, {k: to_text(v) for k, v in attributes.items()})

    def float(self, parent, name: str, value: float):
        self.tag(parent, "float", name=name, value=value)

    def maybe_boolean(self, parent, name: str, probability: float = 0.3):
        if self.chance(probability):
            self.tag(parent, "boolean", name=name, value=self.r.choice(("true", "false")))

    def rotate(self, to_world, angle: float):
        """A rotation about a random axis of length 1: Mitsuba does not normalise it."""
        axis = np.array([self.uniform(-1, 1) for _ in range(3)])
        x, y, z = axis / np.linalg.norm(axis)
        self.tag(to_world, "rotate", x=x, y=y, z=z, angle=angle)

    def random_place(self) -> tuple[float, float, float]:
        return self.uniform(-2.2, 2.2), self.uniform(-1.5, 1.5), self.uniform(-2.2, 2.2)
