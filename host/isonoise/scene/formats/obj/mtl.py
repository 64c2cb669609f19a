"""Reads MTL files: the statements of each material, as numbers and texture maps. Called by `read.py`."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from isonoise.scene.files import read_bytes
from isonoise.scene.mesh.obj import decode
from isonoise.scene.parse.elements import SourceLocation

_COUNTS = {"ka": 3, "kd": 3, "ks": 3, "ke": 3, "tf": 3} | dict.fromkeys(
    ("ns", "ni", "d", "tr", "illum", "pr", "pm", "ps", "pc", "pcr", "aniso", "anisor"), 1
)
"""Statements with numbers, in small letters -> how many; a colour may also be one number."""
_MAPS = {
    **{f"map_{name}": name for name in ("kd", "ks", "ke", "ns", "d", "pr", "pm", "ps", "pc", "bump")},
    **{"bump": "bump", "norm": "norm", "map_norm": "norm", "map_tr": "tr", "map_rma": "rma", "map_orm": "orm"},
    **{"disp": "disp", "map_disp": "disp", "decal": "decal", "refl": "refl", "map_refl": "refl", "map_pcr": "pcr"},
}
"""Statements with an image, in small letters -> name of the map."""
_COMMENT = re.compile(r"\s#\s.*")
_NEWLINE = re.compile(r"\r\n|\r|\n")  # `splitlines` also splits at characters that names may have
_WORD = re.compile(r"\S+\s*")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_MAX_NUMBER = 1e18
_OPTION_SIZES = {"mm": (2, 2), "o": (1, 3), "s": (1, 3), "t": (1, 3)}  # least and most words; others have one
_XYZ_TO_RGB = np.array(  # ITU-R Rec. BT.709
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)


@dataclass
class TextureMap:
    """A texture statement."""

    file: str  # as written
    options: dict[str, list[str]]  # '-s 2 2' is 's': ['2', '2']
    location: SourceLocation

    def numbers(self, option: str, default: tuple[float, ...]) -> np.ndarray:
        """The numbers of an option, those that are missing from `default`."""
        words = self.options.get(option, [])
        values = _parse_numbers(words)
        if values is None:
            self.location.raise_error(f"-{option} needs numbers, got '{' '.join(words)[:40]}'")
        return np.array([*values, *default[len(values) :]])


@dataclass
class Material:
    """The statements of one `newmtl`, by name in small letters. The last one of a name wins."""

    name: str
    numbers: dict[str, list[float]] = field(default_factory=dict)
    maps: dict[str, TextureMap] = field(default_factory=dict)
    has_spectra: bool = False  # colours in files of their own
    has_halo: bool = False  # d -halo: opacity that depends on the direction of view
    is_from_blender: bool = False  # written by Blender 3.1 or newer, which says how it converts its materials


def read_mtl(path: Path) -> dict[str, Material]:
    """The materials of a file, by name. Raises SceneError where a number is invalid."""
    materials: dict[str, Material] = {}
    current = Material("")
    text = decode(read_bytes(path)).removeprefix("\ufeff")
    is_from_blender = re.match(r"# Blender \d+\.\d+\S* MTL", text) is not None
    for number, line in enumerate(_NEWLINE.split(text), 1):
        word, _, rest = line.strip().replace("\t", " ").partition(" ")
        key, rest = word.lower(), rest.strip()
        location = SourceLocation(str(path), number, word[:40])
        if key == "newmtl":
            current = materials[rest] = Material(rest, is_from_blender=is_from_blender)
        elif key in _COUNTS:
            _read_numbers(current, key, rest.partition("#")[0].strip(), location)
        elif key in _MAPS and (texture := _parse_map(rest, location)):
            current.maps[_MAPS[key]] = texture
    return materials


def _read_numbers(material: Material, key: str, text: str, location: SourceLocation) -> None:
    is_xyz = _COUNTS[key] == 3 and text.startswith("xyz ")
    if _COUNTS[key] == 3 and text.startswith("spectral"):
        material.has_spectra = True
        return
    words = text.removeprefix("xyz ").split()
    if "-halo" in words:
        material.has_halo = True
        words.remove("-halo")
    values = _parse_numbers(words)
    allowed = (1, 3) if _COUNTS[key] == 3 else (1,)
    if values is None or len(values) not in allowed or min(values) < 0:
        kind = "a colour" if _COUNTS[key] == 3 else "a number"
        location.raise_error(f"not {kind}: '{text[:40]}'")
    if is_xyz:
        values = np.maximum(_XYZ_TO_RGB @ np.broadcast_to(values, 3), 0.0)
    material.numbers[key] = np.broadcast_to(values, _COUNTS[key]).tolist()


def _parse_numbers(words: list[str]) -> list[float] | None:
    """Numbers; None if a word is none, or so large that products of numbers would leave the range of 32-bit floats."""
    if not all(_NUMBER.fullmatch(word) for word in words):
        return None
    values = [float(word) for word in words]
    return values if all(abs(value) <= _MAX_NUMBER for value in values) else None


def _parse_map(text: str, location: SourceLocation) -> TextureMap | None:
    """The options and the file name, which may contain blanks; None without a file name."""
    options: dict[str, list[str]] = {}
    position = 0
    while text.startswith("-", position):
        option, *words = _take_option(text, position)
        options[option[1:].strip().lower()] = [word.strip() for word in words]
        position += len(option) + sum(map(len, words))
    file = _COMMENT.sub("", text[position:]).strip().strip('"')
    return TextureMap(file, options, location) if file else None


def _take_option(text: str, position: int) -> Iterator[str]:
    """The option at a position of a text and its words, each with the blanks after it."""
    words = (match.group() for match in _WORD.finditer(text, position))
    option = next(words)
    yield option
    least, most = _OPTION_SIZES.get(option[1:].strip().lower(), (1, 1))
    for number, word in enumerate(islice(words, most)):
        if number >= least and not _NUMBER.fullmatch(word.strip()):
            return
        yield word
