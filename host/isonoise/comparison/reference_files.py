"""Reads the references and variances of a comparison; called by `runner` and `results`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.comparison.checked_files import InvalidFileError, read_image
from isonoise.comparison.identity import ImageDigests, reference_identity
from isonoise.comparison.plan import Plan, SceneEntry, file_sha256, variance_path
from isonoise.errors import UserError
from isonoise.film.exr import read_reference, reference_layers


@dataclass(frozen=True)
class ReferenceImage:
    """A reference as `read_reference` reads it, and the SHA-256 that runs measured against it store."""

    rgb: np.ndarray
    standard_error: np.ndarray | None
    sha256: str


def read_scene_reference(directory: Path, plan: Plan, scene: SceneEntry) -> ReferenceImage:
    """The reference of a scene, rendered or given.

    Raises InvalidFileError if a rendered one is missing, damaged or of something else; UserError if a given one cannot
    be read or is not the one that the plan was made with.
    """
    path = directory / scene.reference
    if scene.reference_sha256 is None:
        channels, digest = read_image(path, reference_identity(plan, scene, "reference"))
        return ReferenceImage(*reference_layers(channels, path), digest)
    image = read_reference(path)
    if file_sha256(path) != scene.reference_sha256:
        raise UserError(f"the reference '{path}' is not the one that the comparison began with: restore it")
    return ReferenceImage(*image, scene.reference_sha256)


def read_variance(directory: Path, plan: Plan, scene: SceneEntry) -> tuple[np.ndarray, str]:
    """Relative variance of one sample, (height, width), and the SHA-256 that the oracle's runs store.

    Raises InvalidFileError if it is missing, damaged or of something else.
    """
    channels, digest = read_image(variance_path(directory, scene), reference_identity(plan, scene, "variance"))
    return channels["variance"], digest


def read_digests(directory: Path, plan: Plan, scene: SceneEntry) -> ImageDigests:
    """What the runs of the scene store. Raises InvalidFileError and UserError as `read_scene_reference`."""
    try:
        variance = read_variance(directory, plan, scene)[1]
    except InvalidFileError:
        variance = None
    return ImageDigests(read_scene_reference(directory, plan, scene).sha256, variance)
