"""Parses pbrt files into directives, following Include and Import. Called by `read.py`.

The grammar is that of pbrt-v4 (https://pbrt.org/fileformat-v4); pbrt-v3's WorldEnd, TransformTimes and types are
accepted too.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from isonoise.scene.files import is_inside, outside_message, read_decompressed
from isonoise.scene.formats.pbrt.parameters import TYPES, Parameters, Value, check_value
from isonoise.scene.formats.pbrt.tokens import CLOSE, END, OPEN, STRING, WORD, Position, Source, Token, Tokenizer
from isonoise.scene.parse.elements import path_exists

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_MAX_INCLUDE_DEPTH = 32
_MAX_INCLUDES = 10_000  # of one scene: a file that includes others twice each grows exponentially

_NUMBERS = {"LookAt": 9, "Rotate": 4, "Scale": 3, "Translate": 3, "Transform": 16, "ConcatTransform": 16}
_NUMBERS["TransformTimes"] = 2
_NAMES = {"CoordinateSystem": 1, "CoordSysTransform": 1, "NamedMaterial": 1, "ObjectBegin": 1, "ObjectInstance": 1}
_NAMES |= {"ColorSpace": 1, "Include": 1, "Import": 1}
_PARAMETERS = {"Accelerator", "AreaLightSource", "Camera", "Film", "Integrator", "LightSource", "MakeNamedMaterial"}
_PARAMETERS |= {"MakeNamedMedium", "Material", "PixelFilter", "Sampler", "Shape", "Attribute", "SurfaceIntegrator"}
_PARAMETERS |= {"VolumeIntegrator", "Renderer"}
_BARE = {"AttributeBegin", "AttributeEnd", "TransformBegin", "TransformEnd", "Identity", "ReverseOrientation"}
_BARE |= {"WorldBegin", "WorldEnd", "ObjectEnd"}
_OTHERS = {"Texture", "MediumInterface", "ActiveTransform", "Option"}
DIRECTIVES = frozenset({*_NUMBERS, *_NAMES, *_PARAMETERS, *_BARE, *_OTHERS})


class Directive(NamedTuple):
    """One directive with its arguments."""

    name: str
    arguments: list[str]  # names and types in quotes, or a bare word
    numbers: np.ndarray
    parameters: Parameters
    position: Position


def read_directives(path: Path, folder: Path | None) -> Iterator[Directive]:
    """The directives of a file and of those that it includes, in order.

    Files have to be in `folder` or below it, unless it is None. Raises SceneError with file, line and column where the
    text is no pbrt scene.
    """
    yield from _Parser(path.parent, folder).read(_read_source(path), [path.resolve()])


def _read_source(path: Path) -> Source:
    return Source(path, read_decompressed(path).removeprefix(_BYTE_ORDER_MARK).decode("utf-8", errors="replace"))


class _Parser:
    def __init__(self, base: Path, folder: Path | None):
        self._base = base  # names of files are relative to the folder of the main file
        self._folder = folder
        self._include_count = 0

    def read(self, source: Source, open_files: list[Path]) -> Iterator[Directive]:
        tokens = Tokenizer(source)
        while (token := tokens.next()).kind != END:
            directive = _read_directive(tokens, token)
            if directive.name in ("Include", "Import"):
                path = self._included_file(directive, open_files)
                yield from self.read(_read_source(path), [*open_files, path.resolve()])
            else:
                yield directive

    def _included_file(self, directive: Directive, open_files: list[Path]) -> Path:
        name = directive.arguments[0]
        path = find_file(name, self._base, self._folder, directive.position)
        self._include_count += 1
        if path.resolve() in open_files:
            directive.position.raise_error(f"'{name}' includes itself, directly or through other files")
        if len(open_files) > _MAX_INCLUDE_DEPTH:
            directive.position.raise_error(f"files are included more than {_MAX_INCLUDE_DEPTH} levels deep")
        if self._include_count > _MAX_INCLUDES:
            directive.position.raise_error(f"more than {_MAX_INCLUDES:,} files are included")
        return path


def find_file(name: str, base: Path, folder: Path | None, position: Position) -> Path:
    """The path of a file that a scene names. Raises SceneError if it is missing or may not be read."""
    path = base / name.replace("\\", "/")
    if "\0" in name or not name:
        position.raise_error("the name of a file is empty or contains a zero byte")
    try:
        inside = is_inside(path, folder)
    except (OSError, RuntimeError) as error:
        position.raise_error(f"'{name}' cannot be read ({error})")
    if not inside:
        position.raise_error(outside_message(path, folder))
    if not path_exists(path):
        position.raise_error(f"the file '{path}' does not exist")
    return path


def _read_directive(tokens: Tokenizer, token: Token) -> Directive:
    name, position = token.text, token.position
    if token.kind != WORD:
        position.raise_error(f"expected a directive such as Shape, got {token}")
    if name not in DIRECTIVES:
        position.raise_unknown("unknown directive", name, DIRECTIVES)
    arguments, numbers, values = [], np.zeros(0), []
    if name in _NUMBERS:
        numbers = _read_numbers(tokens, name)
    elif name in _NAMES:
        arguments = [_read_string(tokens, name)]
    elif name == "MediumInterface":
        arguments = [_read_string(tokens, name)]
        arguments += [_read_string(tokens, name)] if tokens.peek().kind == STRING else arguments
    elif name == "ActiveTransform":
        arguments = [tokens.next().text]
    elif name == "Option":
        values = [_read_parameter(tokens)]
    elif name == "Texture":
        arguments = [_read_string(tokens, name) for _ in range(3)]
        values = _read_parameters(tokens)
    elif name in _PARAMETERS:
        arguments = [_read_string(tokens, name)]
        values = _read_parameters(tokens)
    return Directive(name, arguments, numbers, Parameters(values, position), position)


def _read_string(tokens: Tokenizer, name: str) -> str:
    token = tokens.next()
    is_bracketed = token.kind == OPEN
    if is_bracketed:
        token = tokens.next()
    if token.kind != STRING:
        token.position.raise_error(f"{name} needs a name in quotes here, got {token}")
    if is_bracketed:
        _expect_close(tokens, name)
    return token.text


def _expect_close(tokens: Tokenizer, name: str) -> None:
    token = tokens.next()
    if token.kind != CLOSE:
        token.position.raise_error(f"{name} needs a closing bracket here, got {token}")


def _read_numbers(tokens: Tokenizer, name: str) -> np.ndarray:
    """The numbers of a transform, in brackets or not."""
    count = _NUMBERS[name]
    is_bracketed = tokens.peek().kind == OPEN
    if is_bracketed:
        tokens.next()
    numbers = np.zeros(count)
    for index in range(count):
        token = tokens.next()
        number = _to_number(token)
        if number is None or not abs(number) < 1e38:
            token.position.raise_error(f"{name} needs {count} finite numbers; got {token} as number {index + 1}")
        numbers[index] = number
    if is_bracketed:
        _expect_close(tokens, name)
    return numbers


def _to_number(token: Token) -> float | None:
    if token.kind != WORD:
        return None
    try:
        return float(token.text)
    except ValueError:
        return None


def _read_parameters(tokens: Tokenizer) -> list[Value]:
    values = []
    while tokens.peek().kind == STRING:
        values.append(_read_parameter(tokens))
    return values


def _read_parameter(tokens: Tokenizer) -> Value:
    token = tokens.next()
    words = token.text.split() if token.kind == STRING else []
    if len(words) != 2:
        token.position.raise_error(f'a parameter is a type and a name, such as "float radius"; got {token}')
    type_, name = words
    if type_ not in TYPES:
        token.position.raise_unknown(f"'{name[:40]}' has the unknown type", type_, TYPES)
    value = Value(type_, name, _read_values(tokens, name), token.position)
    check_value(value)
    return value


def _read_values(tokens: Tokenizer, name: str) -> np.ndarray | list[str]:
    """The values of a parameter, one or a list in brackets: numbers as an array, strings and booleans as texts."""
    if tokens.peek().kind != OPEN:
        return _to_values([tokens.next()], name)
    tokens.next()
    numbers = tokens.read_numbers()
    if numbers is not None:
        return numbers
    items = []
    while (token := tokens.next()).kind != CLOSE:
        items.append(token)
        if token.kind not in (WORD, STRING):
            token.position.raise_error(f"'{name}' needs a closing bracket before {token}")
    return _to_values(items, name)


def _to_values(items: list[Token], name: str) -> np.ndarray | list[str]:
    if items and (items[0].kind == STRING or items[0].text in ("true", "false")):
        wrong = next((token for token in items if token.kind != STRING and token.text not in ("true", "false")), None)
        if wrong:
            wrong.position.raise_error(f"'{name}' mixes texts with {wrong}")
        return [token.text for token in items]
    numbers = [_to_number(token) for token in items]
    if None in numbers:
        token = items[numbers.index(None)]
        token.position.raise_error(f"'{name}' needs a number here, got {token}")
    return np.array(numbers, np.float64)
