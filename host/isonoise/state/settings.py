"""What the image of a render depends on, as plain values, and how the settings of two renders differ.

Called by `Renderer`, which is continued only with equal settings, and by merging.
"""

import contextlib
import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from isonoise import __version__
from isonoise.errors import UserError
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.strategies import describe

NAMES = {
    "version": "version of isonoise",
    "size": "image size",
    "strategy": "strategy",
    "sampler": "sampler",
    "seed": "seed",
    "max_depth": "max_depth",
    "parameters": "scene parameters (-D)",
    "layers": "layers (--layers)",
}
"""Settings with a value of their own -> name in messages."""
_NOT_IN_THE_SCENE = ("max_depth", "sampler", "sample_count", "exposure", "hash")
"""Fields of `CompiledScene` with a setting of their own, or that follow from the others."""


def render_settings(renderer) -> dict[str, object]:
    """The settings of a `Renderer`: values as in `NAMES`, and

    - `scene`: the file or built-in scene; `scene_hash`: of all that the scene compiles to;
    - `scene_parts`: name of an array or setting of `CompiledScene` -> hash;
    - `files`: name of a file that the scene was read from, relative to the scene's folder -> sha256 of its content;
    - `film_window`: size of the film, the pixel of it where the image begins, and size of the image;
    - `exposure`: of the scene, for previews;
    - `overrides`: what the caller gave in place of the scene's own size, depth, sampler and view, else None;
    - `layers`: their names; `needs`: the fields of `Needs`; `device`, which may change while a render goes on.
    """
    scene: CompiledScene = renderer.scene
    return {
        "version": __version__,
        "scene": renderer.source_name,
        "size": [scene.width, scene.height],
        "film_window": [list(part) for part in scene.film_window],
        "strategy": describe(renderer.strategy),
        "sampler": scene.sampler,
        "seed": renderer.seed,
        "max_depth": scene.max_depth,
        "parameters": dict(sorted(renderer.parameters.items())),
        "scene_hash": scene.hash,
        "scene_parts": {field.name: _part_hash(getattr(scene, field.name)) for field in fields(scene)},
        "files": file_hashes(renderer.files),
        "radiance_scale": scene.radiance_scale,
        "exposure": scene.exposure,
        "overrides": renderer.overrides,
        "needs": asdict(renderer.needs) | {"layers": list(renderer.needs.layers)},
        "layers": list(renderer.layer_names),
        "device": ", ".join(renderer.devices),
    }


def file_hashes(paths: Iterable[Path]) -> dict[str, str | None]:
    """Name -> sha256 of the files, in hexadecimal digits; names are relative to the folder of the first file.

    None for a file that cannot be read any more: a scene may be removed while it is rendered.
    """
    hashes, base = {}, None
    for path in paths:
        base = base or path.parent
        digest = None
        with contextlib.suppress(OSError), open(path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        hashes[os.path.relpath(path, base) if path.is_relative_to(base) else str(path)] = digest
    return hashes


def check_settings(stored: Mapping[str, object], current: Mapping[str, object]) -> None:
    """Raise UserError, which names all differences, unless a render with these settings can be continued."""
    differences = differences_of(stored, current, NAMES)
    if differences:
        raise UserError(f"the render cannot be continued: {'; '.join(differences)}")


def differences_of(stored: Mapping[str, object], current: Mapping[str, object], names: Iterable[str]) -> list[str]:
    """How these settings and the scenes differ, as clauses."""
    values = [
        f"the {NAMES[key]} was {_text(stored[key])} and is now {_text(current[key])}"
        for key in names
        if stored[key] != current[key]
    ]
    return values + _scene_differences(stored, current)


def _scene_differences(stored: Mapping[str, object], current: Mapping[str, object]) -> list[str]:
    """How the scenes differ, as clauses: their files if one has changed, else the compiled arrays and settings.

    Files that changed without an effect do not count, nor does another size or depth.
    """
    parts, now = stored["scene_parts"], current["scene_parts"]
    ignored = _NOT_IN_THE_SCENE if stored["size"] == current["size"] else (*_NOT_IN_THE_SCENE, "camera")
    changed_parts = [name for name in parts if parts[name] != now.get(name) and name not in ignored]
    if not changed_parts:
        return []
    files, files_now = stored["files"], current["files"]
    clauses = [f"'{name}' has changed" for name in files if name in files_now and files[name] != files_now[name]]
    clauses += [f"'{name}' was read and is no longer" for name in files if name not in files_now]
    clauses += [f"'{name}' was not read before" for name in files_now if name not in files]
    has_same_name = next(iter(files), None) == next(iter(files_now), None)  # the scene's own file comes first
    if clauses and has_same_name:
        return clauses
    return [f"the scene '{stored['scene']}' differs from '{current['scene']}' in: {', '.join(changed_parts)}"]


def _text(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}={text}" for name, text in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return "x".join(map(str, value)) if value and isinstance(value[0], int) else ", ".join(value) or "none"
    return str(value)


def _part_hash(value: object) -> str:
    """Hex digest of an array, of a number or text, or of an environment map with its arrays."""
    digest = hashlib.blake2b(digest_size=8)
    for part in vars(value).values() if hasattr(value, "__dataclass_fields__") else [value]:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).data.cast("B") if part.size else b"")
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()
