"""Reads parameters from the records of materials."""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.material.bsdf_kinds import KINDS, bsdf_bits


def slot(bsdfs: np.ndarray, name: str) -> np.ndarray:
    """Colours (b, 3) in the slot of a parameter, of materials of one kind without textures."""
    (kind,) = (kind for kind in KINDS.values() if (bsdfs["kind"] == bsdf_bits(kind.name)).all())
    number = [slot.name for slot in kind.slots].index(name)
    assert (bsdfs["textures"][:, number] == structs.NONE).all()
    return bsdfs["values"].reshape(-1, structs.BSDF_SLOTS, 3)[:, number]
