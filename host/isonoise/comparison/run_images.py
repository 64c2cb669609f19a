"""The images of a comparison's runs as EXR files, for `isonoise compare --keep-images`; called by `runner`.

The file of a run has the image, too. The EXR file is made from it, for other programs.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isonoise.comparison.checked_files import is_valid_image, make_folder, write_image
from isonoise.comparison.plan import SceneEntry, StrategyEntry

_HEADER = ("scene", "strategy", "seed", "device", "samples", "stopped_by")
"""Facts of a run that are written to the header, with the prefix 'isonoise.' as in the images of renders."""


def image_path(directory: Path, scene: SceneEntry, strategy: StrategyEntry, seed: int) -> Path:
    """File of a run's image."""
    return directory / "images" / scene.slug / strategy.slug / f"{seed}.exr"


def ensure_image(path: Path, run: Mapping[str, np.ndarray], run_sha256: str) -> None:
    """Write the final image of a run unless the file is valid and of this run.

    Parameters
    ----------
    path : Path
        Of the image: R, G and B, linear, float16.
    run : mapping
        The arrays of the run's file.
    run_sha256 : str
        SHA-256 of that file.

    Raises
    ------
    UserError
        If the image cannot be written.
    """
    identity = {"kind": "image", "run_sha256": run_sha256}
    if is_valid_image(path, identity):
        return
    facts = json.loads(str(run["facts"]))
    make_folder(path.parent)
    header = {f"isonoise.{name}": facts.get(name) for name in _HEADER} | {"isonoise.time_s": facts["elapsed_s"]}
    write_image(path, {"": run["rgb"]}, header, identity)
