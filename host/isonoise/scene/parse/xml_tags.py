"""Parses XML files to tags with line numbers. Depth is bounded; entities and DTDs are rejected (see defusedxml)."""

from pathlib import Path

from isonoise.errors import SceneError
from isonoise.input_files import size_bytes
from isonoise.scene.files import open_regular_file
from isonoise.scene.parse.elements import SourceLocation

MAX_DEPTH = 64  # nested elements: more than scenes need, and within Python's recursion limit
_CHUNK_BYTES = 1 << 16  # a huge file that is not XML is rejected after the first chunk


class Tag:
    """One XML element and its location."""

    __slots__ = ("attributes", "children", "file", "line", "name")

    def __init__(self, name: str, attributes: dict[str, str], file: str, line: int):
        self.name, self.attributes, self.file, self.line = name, attributes, file, line
        self.children: list[Tag] = []

    @property
    def location(self) -> SourceLocation:
        shown = " ".join(f'{k}="{v[:60]}"' for k, v in self.attributes.items() if k in ("type", "name", "id"))
        name = self.name[:60]
        return SourceLocation(self.file, self.line, f"<{name} {shown}>" if shown else f"<{name}>")


class _TreeBuilder:
    """Target of the XML parser."""

    def __init__(self, file: str):
        self.file, self.root, self.stack, self.expat = file, None, [], None

    def start(self, name, attributes):
        tag = Tag(name, dict(attributes), self.file, self.expat.CurrentLineNumber)
        if len(self.stack) >= MAX_DEPTH:
            tag.location.raise_error(f"nested more than {MAX_DEPTH} levels deep")
        if self.stack:
            self.stack[-1].children.append(tag)
        else:
            self.root = tag
        self.stack.append(tag)

    def end(self, name):
        self.stack.pop()

    def data(self, text):
        if text.strip():
            location = SourceLocation(self.file, self.expat.CurrentLineNumber)
            location.raise_error(f"text between elements is not allowed: '{text.strip()[:40]}'")

    def close(self):
        return self.root


def parse_tags(path: Path) -> Tag:
    """The root tag of a file. Raises SceneError if the file is not well-formed XML."""
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import DefusedXMLParser, ParseError

    builder = _TreeBuilder(str(path))
    parser = DefusedXMLParser(target=builder, forbid_dtd=True)
    builder.expat = parser.parser
    try:
        with open_regular_file(path) as file:
            unread = size_bytes(file)
            while chunk := file.read(min(_CHUNK_BYTES, unread)):
                unread -= len(chunk)
                parser.feed(chunk)
        return parser.close()
    except ParseError as error:
        line = error.position[0]
        reason = str(error).split(":")[0]
        is_empty = reason == "no element found" and builder.root is None
        problem = "the file contains no scene" if is_empty else f"not well-formed XML ({reason})"
        SourceLocation(str(path), line).raise_error(f"{problem}; scenes are Mitsuba 3 XML, meshes OBJ, PLY, STL or GLB")
    except DefusedXmlException:
        SourceLocation(str(path)).raise_error("DTDs and entities are not supported; remove the <!DOCTYPE>")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, LookupError) as error:  # an unknown encoding, or bytes that are invalid in it
        SourceLocation(str(path)).raise_error(f"not an XML file ({error})")
