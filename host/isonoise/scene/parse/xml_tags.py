"""Parses XML files to tags with line numbers, one child of the root at a time.

Depth is bounded. DTDs are rejected, and with them entities, which could grow without bound.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from isonoise.errors import SceneError
from isonoise.input_files import size_bytes
from isonoise.scene.files import open_regular_file
from isonoise.scene.parse.elements import Location, SourceLocation

MAX_DEPTH = 64  # nested elements: more than scenes need, and within Python's recursion limit
_CHUNK_BYTES = 1 << 16  # a huge file that is not XML is rejected after the first chunk


class Tag(Location):
    """One XML element, which is its own location."""

    __slots__ = ("attributes", "children", "file", "line", "name")

    def __init__(self, name: str, attributes: dict[str, str], file: str, line: int):
        self.name, self.attributes, self.file, self.line = name, attributes, file, line
        self.children: list[Tag] | tuple[()] = ()

    def __str__(self) -> str:
        shown = " ".join(f'{k}="{v[:60]}"' for k, v in self.attributes.items() if k in ("type", "name", "id"))
        name = self.name[:60]
        return str(SourceLocation(self.file, self.line, f"<{name} {shown}>" if shown else f"<{name}>"))

    def without_element(self) -> Location:
        return SourceLocation(self.file, self.line)


class _TagBuilder:
    """Makes tags from what expat reports. `finished` holds the root tag, then each child of it that is complete."""

    def __init__(self, file: str):
        self.file, self.stack, self.finished, self.is_empty = file, [], [], True
        self.expat = expat.ParserCreate(None, "}")
        self.expat.buffer_text = True
        self.expat.StartElementHandler = self.start
        self.expat.EndElementHandler = self.end
        self.expat.CharacterDataHandler = self.text
        self.expat.StartDoctypeDeclHandler = self.doctype

    def start(self, name: str, attributes: dict[str, str]):
        tag = Tag("{" + name if "}" in name else name, attributes, self.file, self.expat.CurrentLineNumber)
        depth = len(self.stack)
        if depth >= MAX_DEPTH:
            tag.raise_error(f"nested more than {MAX_DEPTH} levels deep")
        if depth > 1:
            parent = self.stack[-1]
            parent.children = [*parent.children, tag]
        elif depth == 0:
            self.is_empty = False
            self.finished.append(tag)
        self.stack.append(tag)

    def end(self, name: str):
        tag = self.stack.pop()
        if len(self.stack) == 1:
            self.finished.append(tag)

    def text(self, text: str):
        if not text.isspace():
            location = SourceLocation(self.file, self.expat.CurrentLineNumber)
            location.raise_error(f"text between elements is not allowed: '{text.strip()[:40]}'")

    def doctype(self, *declaration):
        SourceLocation(self.file).raise_error("DTDs and entities are not supported; remove the <!DOCTYPE>")


def iterate_tags(path: Path) -> Iterator[Tag]:
    """The root tag of a file, without children, then its children one by one, so that the file is never in memory.

    Raises SceneError if the file is not well-formed XML.
    """
    builder = _TagBuilder(str(path))
    try:
        with open_regular_file(path) as file:
            unread = size_bytes(file)
            while chunk := file.read(min(_CHUNK_BYTES, unread)):
                unread -= len(chunk)
                builder.expat.Parse(chunk, False)
                yield from builder.finished
                builder.finished.clear()
        builder.expat.Parse(b"", True)
    except expat.ExpatError as error:
        reason = str(error).split(":")[0]
        is_empty = reason == "no element found" and builder.is_empty
        problem = "the file contains no scene" if is_empty else f"not well-formed XML ({reason})"
        location = SourceLocation(str(path), error.lineno)
        location.raise_error(f"{problem}; scenes are Mitsuba 3 XML, glTF, OBJ, PLY, STL or pbrt files")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, LookupError) as error:  # an unknown encoding, or bytes that are invalid in it
        SourceLocation(str(path)).raise_error(f"not an XML file ({error})")
