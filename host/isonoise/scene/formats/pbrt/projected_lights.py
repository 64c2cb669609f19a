"""Lights that pbrt shapes by images: projections, goniometric diagrams, soft edges of spots. Called by `lights.py`.

Mitsuba's `projector` has the radiant intensity pi * image / cos^3, pbrt's projection that of the image: the images are
multiplied by cos^3 / pi.
"""

import math

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.pbrt.environment import square_texels
from isonoise.scene.image.image import Image

MAX_SOFT_CUTOFF_DEGREES = 75.0  # a wider cone would need a finer image of its edge
_SPOT_PIXELS = 256
_MIN_FACE_PIXELS, _MAX_FACE_PIXELS = 16, 512
_FACES = (  # rotations of +z to the axes of a cube
    np.eye(3),
    np.diag([-1.0, 1.0, -1.0]),
    np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
)


def projector(intensity: np.ndarray, fov: float, to_world: np.ndarray) -> dict:
    """A projector with the radiant intensity (height, width, 3); its axes are pbrt's: x is right.

    `fov` in degrees spans the shorter side.
    """
    height, width, _ = intensity.shape
    shorter = math.tan(math.radians(fov) / 2) / min(width, height)
    x = shorter * (2 * np.arange(width) + 1 - width)
    y = shorter * (2 * np.arange(height) + 1 - height)
    cosine = 1 / np.sqrt(1 + x**2 + y[:, None] ** 2)
    with np.errstate(over="ignore"):  # pixels that are not finite are errors later
        pixels = (intensity * (cosine**3 / np.pi)[..., None]).astype(np.float32)
    return {
        "type": "projector",
        "irradiance": {"type": "bitmap", "bitmap": Image(pixels), "filter_type": "nearest", "wrap_mode": "clamp"},
        "fov": fov,
        "fov_axis": "smaller",
        "to_world": to_world @ transforms.scale((-1.0, 1.0, 1.0)),
    }


def goniometric_projectors(image: Image, intensity: np.ndarray, to_world: np.ndarray) -> list[dict]:
    """Six projectors, the faces of a cube, for a point light whose directions are weighted by an image.

    A square image has pbrt-v4's equal-area mapping, another one pbrt-v3's latitude and longitude; y is up.
    """
    diagram = image.linear().mean(axis=2)
    size = min(max(max(diagram.shape) // 2, _MIN_FACE_PIXELS), _MAX_FACE_PIXELS)
    centers = (2 * np.arange(size) + 1) / size - 1
    right, down = np.meshgrid(centers, centers)
    directions = np.stack([right, -down, np.ones_like(right)], axis=2)
    directions /= np.linalg.norm(directions, axis=2)[..., None]
    lights = []
    for rotation in _FACES:
        values = diagram[_diagram_texels(np.einsum("rci,ji->rcj", directions, rotation), diagram.shape)]
        face = to_world.copy()
        face[:3, :3] = to_world[:3, :3] @ rotation
        lights.append(projector(values[..., None] * intensity, 90.0, face))
    return lights


def _diagram_texels(directions: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) in the diagram of directions (..., 3) in the light's space."""
    x, y, z = np.moveaxis(directions, -1, 0)
    height, width = shape
    if height == width:
        return square_texels(np.stack([x, z, y], axis=-1), height)
    row = np.arccos(np.clip(y, -1, 1)) / np.pi * height
    column = np.arctan2(z, x) / (2 * np.pi) % 1 * width
    return np.minimum(row.astype(int), height - 1), np.minimum(column.astype(int), width - 1)


def soft_edge(cutoff: float, start: float) -> Image:
    """The texture of a spot whose intensity falls from angle `start` to `cutoff`, in degrees.

    It falls as a smooth step of the cosine (pbrt-v4, SpotLight). The image is the square around the cone.
    """
    centers = (2 * np.arange(_SPOT_PIXELS) + 1) / _SPOT_PIXELS - 1
    tangent = math.tan(math.radians(cutoff)) * np.hypot(*np.meshgrid(centers, centers))
    end, full = math.cos(math.radians(cutoff)), math.cos(math.radians(start))
    share = np.clip((1 / np.sqrt(1 + tangent**2) - end) / (full - end), 0, 1)
    return Image((share**2 * (3 - 2 * share)).astype(np.float32)[..., None])
