"""Media of the description -> records for the device, and what lies on the two sides of a shape."""

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.material.bsdfs import Bsdfs
from isonoise.scene.spectra import colour_to_rgb

_ISOTROPIC = {"type": "isotropic"}  # Mitsuba 3's phase function of a medium that names none


class Media:
    """Collects media, equal ones once; their phase functions become materials of `bsdfs`."""

    def __init__(self, bsdfs: Bsdfs):
        self._bsdfs = bsdfs
        self._records: list[np.ndarray] = []
        self._known: dict[bytes, int] = {}

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
        record["phase"] = self._bsdfs.phase(medium.get("phase", _ISOTROPIC), medium["sample_emitters"])
        key = record.tobytes()
        if key not in self._known:
            if len(self._records) == structs.MEDIUM_NONE:
                raise SceneError(f"a scene has at most {structs.MEDIUM_NONE:,} different media")
            self._known[key] = len(self._records)
            self._records.append(record)
        return self._known[key]

    def sides(self, shape: dict) -> int:
        """SHAPE.media of a shape of the description."""
        if "interior" not in shape and "exterior" not in shape:
            return structs.NONE
        return self.index(shape.get("interior")) | self.index(shape.get("exterior")) << 16
