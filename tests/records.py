"""What stands in the records of materials, by the slots of `isonoise.scene.material.bsdfs`."""

import numpy as np

from isonoise.scene import structs


def slot(bsdfs: np.ndarray, number: int) -> np.ndarray:
    """Colours (b, 3) that materials have in a slot, where no texture stands for them."""
    assert (bsdfs["textures"][:, number] == structs.NONE).all()
    return bsdfs["values"].reshape(-1, structs.BSDF_SLOTS, 3)[:, number]
