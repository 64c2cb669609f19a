"""Says what a file is that is no scene, and what to do with it. Called by `load` for names without a known suffix."""

from pathlib import Path
from typing import NoReturn

from isonoise.errors import SceneError
from isonoise.scene.files import open_regular_file
from isonoise.scene.formats.registry import FORMATS

_IMAGE = "an image, not a scene: put it around a scene with --env, or name it in a scene as a texture"
_OTHER_MODEL = "a file of another program; export it as glTF (.glb), OBJ or PLY"
_BY_SUFFIX = {
    ".serialized": 'a mesh of Mitsuba, not a scene: name it in a scene as <shape type="serialized">',
    ".mtl": "the materials of an OBJ file, not a scene: give the .obj file",
    ".bin": "the data of a glTF file, not a scene: give the .gltf file",
    ".vol": 'a grid of a medium, not a scene: name it in a scene as <volume type="gridvolume">',
    ".npz": "a checkpoint, not a scene: continue it with --resume, or describe it with `isonoise info`",
    **dict.fromkeys((".png", ".jpg", ".jpeg", ".bmp", ".tga", ".hdr", ".exr", ".tif", ".tiff", ".webp"), _IMAGE),
    **dict.fromkeys(
        (".blend", ".fbx", ".dae", ".3ds", ".abc", ".usd", ".usda", ".usdc", ".usdz", ".max", ".ma", ".mb", ".c4d",
         ".skp", ".3mf", ".step", ".stp", ".iges", ".off", ".x3d", ".ifc"), _OTHER_MODEL
    ),
}  # fmt: skip
_BY_CONTENT = {
    b"glTF": "a glTF file: give it a name that ends in .glb",
    b"ply\n": "a PLY file: give it a name that ends in .ply",
    b"ply\r": "a PLY file: give it a name that ends in .ply",
    b"\x89PNG": _IMAGE,
    b"\xff\xd8\xff": _IMAGE,
    b"\x76\x2f\x31\x01": _IMAGE,
    b"#?RA": _IMAGE,
}


def refuse_other_files(path: Path) -> None:
    """Raise SceneError unless the file may be XML. `path` has no suffix of a scene."""
    if path.suffix.lower() in _BY_SUFFIX:
        _refuse(path, f"it is {_BY_SUFFIX[path.suffix.lower()]}")
    try:
        with open_regular_file(path) as file:
            begin = file.read(4096)
    except OSError:
        return  # reading it as XML raises the error
    kind = next((kind for magic, kind in _BY_CONTENT.items() if begin.startswith(magic)), None)
    if kind:
        _refuse(path, f"it is {kind}")
    text = begin.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text and not text.startswith(b"<") and not begin.startswith((b"\xff\xfe", b"\xfe\xff")):
        _refuse(path, "it is no scene that isonoise reads")


def _refuse(path: Path, reason: str) -> NoReturn:
    suffixes = ", ".join(suffix for format_ in FORMATS for suffix in format_.suffixes)
    raise SceneError(f"{path}: {reason} (scenes: Mitsuba 3 .xml, {suffixes})")
