"""Compiles media of the description to device records, and the media on the two sides of a shape.

Called by `scene/compile.py`.
"""

from typing import TYPE_CHECKING

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.volume import is_volume

if TYPE_CHECKING:
    from isonoise.scene.volume.heterogeneous import HeterogeneousMedia, HeterogeneousMediaBuilder

_DEFAULT_PHASE = {"type": "isotropic"}  # Mitsuba 3's, for a medium without a phase function


class Media:
    """Collects medium records; equal ones are stored once. Their phase functions become records of `bsdfs`."""

    def __init__(self, bsdfs: Bsdfs):
        self._bsdfs = bsdfs
        self._records: list[np.ndarray] = []
        self._heterogeneous_records: list[np.ndarray] = []
        self._builder: HeterogeneousMediaBuilder | None = None
        self._index_by_record: dict[bytes, int] = {}

    @property
    def records(self) -> np.ndarray:
        """(m,) structs.MEDIUM."""
        return np.concatenate(self._records) if self._records else np.zeros(0, structs.MEDIUM)

    @property
    def heterogeneous(self) -> "HeterogeneousMedia | None":
        """What heterogeneous media have beside their records; None if there are none."""
        return self._builder.media(np.concatenate(self._heterogeneous_records)) if self._builder else None

    def index(self, medium: dict | None) -> int:
        """The index of a medium of the description, MEDIUM_NONE for None."""
        if medium is None:
            return structs.MEDIUM_NONE
        record = np.zeros(1, structs.MEDIUM)
        more = uniform_records(1)
        if medium["type"] == "heterogeneous":
            more = self._heterogeneous_record(medium)
            record["sigma_t"] = medium["scale"]
        else:
            record["sigma_t"] = colour_to_rgb(medium["sigma_t"], "unbounded") * medium["scale"]
        record["albedo"] = _constant_albedo(medium["albedo"])
        record["phase"] = self._bsdfs.phase(medium.get("phase", _DEFAULT_PHASE), medium["sample_emitters"])
        key = record.tobytes() + more.tobytes()
        if key not in self._index_by_record:
            if len(self._records) == structs.MEDIUM_NONE:
                raise SceneError(f"the scene has more than {structs.MEDIUM_NONE:,} different media")
            self._index_by_record[key] = len(self._records)
            self._records.append(record)
            self._heterogeneous_records.append(more)
        return self._index_by_record[key]

    def _heterogeneous_record(self, medium: dict) -> np.ndarray:
        if self._builder is None:  # imported only where it is used
            from isonoise.scene.volume.heterogeneous import HeterogeneousMediaBuilder

            self._builder = HeterogeneousMediaBuilder()
        return self._builder.medium_record(medium)

    def sides(self, shape: dict) -> int:
        """structs.SHAPE["media"] of a shape of the description: its interior and exterior medium."""
        if "interior" not in shape and "exterior" not in shape:
            return structs.NONE
        return self.index(shape.get("interior")) | self.index(shape.get("exterior")) << 16


def uniform_records(count: int) -> np.ndarray:
    """(count,) structs.HETEROGENEOUS_MEDIUM of homogeneous media."""
    records = np.zeros(count, structs.HETEROGENEOUS_MEDIUM)
    records["sigma_t"] = records["albedo"] = structs.NONE
    return records


def _constant_albedo(albedo) -> np.ndarray:
    """The albedo as RGB; 1 where a grid has it."""
    if is_volume(albedo):
        return np.ones(3) if albedo["type"] == "gridvolume" else colour_to_rgb(albedo["value"], "reflectance")
    return colour_to_rgb(albedo, "reflectance")
