"""Compiles media of the description to device records, and the media on the two sides of a shape.

Called by `scene/compile.py`.
"""

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.spectra import colour_to_rgb

_DEFAULT_PHASE = {"type": "isotropic"}  # Mitsuba 3's, for a medium without a phase function


class Media:
    """Collects medium records; equal ones are stored once. Their phase functions become records of `bsdfs`."""

    def __init__(self, bsdfs: Bsdfs):
        self._bsdfs = bsdfs
        self._records: list[np.ndarray] = []
        self._index_by_record: dict[bytes, int] = {}

    @property
    def records(self) -> np.ndarray:
        """(m,) structs.MEDIUM."""
        return np.concatenate(self._records) if self._records else np.zeros(0, structs.MEDIUM)

    def index(self, medium: dict | None) -> int:
        """The index of a medium of the description, MEDIUM_NONE for None."""
        if medium is None:
            return structs.MEDIUM_NONE
        record = np.zeros(1, structs.MEDIUM)
        record["sigma_t"] = colour_to_rgb(medium["sigma_t"], "unbounded") * medium["scale"]
        record["albedo"] = colour_to_rgb(medium["albedo"], "reflectance")
        record["phase"] = self._bsdfs.phase(medium.get("phase", _DEFAULT_PHASE), medium["sample_emitters"])
        key = record.tobytes()
        if key not in self._index_by_record:
            if len(self._records) == structs.MEDIUM_NONE:
                raise SceneError(f"the scene has more than {structs.MEDIUM_NONE:,} different media")
            self._index_by_record[key] = len(self._records)
            self._records.append(record)
        return self._index_by_record[key]

    def sides(self, shape: dict) -> int:
        """structs.SHAPE["media"] of a shape of the description: its interior and exterior medium."""
        if "interior" not in shape and "exterior" not in shape:
            return structs.NONE
        return self.index(shape.get("interior")) | self.index(shape.get("exterior")) << 16
