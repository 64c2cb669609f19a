"""How spots and projectors project their textures, as in Mitsuba 3 (3.9.1). Called by the rows of `light_kinds`.

A light's space has its origin at the light, x to the left of the image, y up and z along its axis.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from isonoise.scene.camera import tan_half_fov_x

_HARD_EDGE = 1e6  # LIGHT.inverse_transition: a projector has no soft edge


class Projection(NamedTuple):
    """The projection of one texture."""

    to_uv: np.ndarray  # (3, 3): structs.PROJECTION
    members: Mapping[str, float]  # of LIGHT


def project_spot(emitter: dict, aspect: float) -> Projection:
    """A texture of a spot: the square around the cone has u and v from 0 to 1."""
    axes = emitter.get("to_world", np.eye(4))[:3, :3]
    left, up, forward = (axes / np.linalg.norm(axes, axis=0)).T
    half = 0.5 / np.tan(np.radians(emitter["cutoff_angle"]))
    return Projection(np.array([half * left + 0.5 * forward, half * up + 0.5 * forward, forward]), {})


def project_image(emitter: dict, aspect: float) -> Projection:
    """The image of a projector, with the irradiance pi / (z² cos) at depth z and an angle to the axis.

    z is in the projector's space; the cosine is that with its z axis in the world, whose length counts.
    """
    to_world = emitter.get("to_world", np.eye(4))[:3, :3]
    left, up, forward = np.linalg.inv(to_world)
    tangent = tan_half_fov_x(emitter, aspect)
    rows = [0.5 * (forward - left / tangent), 0.5 * (forward - aspect * up / tangent), forward]
    corners = to_world @ np.array([(x, y / aspect, 1.0 / tangent) for x in (-1, 1) for y in (-1, 1)]).T
    axis = to_world[:, 2] / np.linalg.norm(to_world[:, 2])
    cosine = (axis @ corners / np.linalg.norm(corners, axis=0)).min()
    # the scale of all rows is free: with this one the irradiance is 1 / (w² cos), for an axis of length 1
    scale = np.sqrt(np.linalg.norm(to_world[:, 2]) / np.pi)
    members = {"cutoff": np.arccos(np.clip(cosine, -1.0, 1.0)) + 1e-5, "inverse_transition": _HARD_EDGE}
    return Projection(scale * np.array(rows), members)
