"""Mutations of files for tests/fuzzing.py: each takes the bytes or text of a sound file and a random generator."""

import json
import random
import re
import xml.etree.ElementTree as ElementTree
import zlib

import small_files

from isonoise.scene.parse import plugin_tables
from isonoise.scene.vocabulary import PLUGINS, UNSUPPORTED_PLUGINS

_WORDS = "nan inf -1 0 1e400 -1e38 3.5e38 1e-45 99999999999999999999 4294967296 $n $ \\$n $$ ../.. . /dev/zero none.ply"
_MORE_WORDS = "1,2 true False a.ply a.png a.exr scene.xml part.xml a.mtl \u212b\U0001f600 a b t g : 400:1 400:1,400:2"
ODD_STRINGS = ["", *_WORDS.split(), *_MORE_WORDS.split(), "x" * 100_000, "a" * 300, "1" * 400, "0 0 0", "1 2 3 4"]
ODD_STRINGS += ["1e30", "-0.0", "0x10", "1_0", "65536", "0 0 0 0 0 0 0 0 0"]
EXTREME_NUMBERS = ["0", "1", "-1", "0.5", "1e-30", "1e30", "1e17", "-1e18", "3e38", "1e-38", "89.9999", "2"]
EXTREME_NUMBERS += ["1e-6", "1e6"]
TAGS = ["float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum", "transform", "ref", "include"]
TAGS += ["alias", "default", "path", "lookat", "matrix", "translate", "rotate", "scale", "scene", *plugin_tables.KINDS]
NAMES = sorted({parameter.name for plugin in PLUGINS for parameter in plugin.parameters} | {"interior", "exterior", ""})
TYPES = sorted({plugin.name for plugin in PLUGINS} | {name for names in UNSUPPORTED_PLUGINS.values() for name in names})
ODD_NUMBERS = [b"0", b"-1", b"nan", b"inf", b"1e400", b"-1e300", b"1e39", b"4294967296", b"1000000000", b"3.5", b"x"]
ODD_NUMBERS += [b"999999999999999"]
ODD_INTEGERS = [0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 10**9, 65535, 65536, 2**63, 2**64 - 1]
ODD_INTEGERS += [0x7FC00000, 0x7F800000, 0x7F7FFFFF]  # bits of NaN, infinity and the largest float


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """Apply one to four changes: truncation, deletion, repetition, random bytes, bit flips, extreme numbers, copies."""
    result = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        size = len(result)
        position = rng.randrange(size + 1)
        length = min(int(rng.expovariate(1 / 8)) + 1, size)
        match rng.randrange(9):
            case 0:
                del result[position:]
            case 1:
                del result[position : position + length]
            case 2:
                result[position:position] = result[max(position - length, 0) : position] * rng.choice((1, 2, 50))
            case 3:
                result[position : position + length] = rng.randbytes(length)
            case 4:
                result[position:position] = rng.randbytes(length)
            case 5 if size:
                result[position % size] ^= 1 << rng.randrange(8)
            case 6:
                width = rng.choice((1, 2, 4, 8))
                number = rng.choice(ODD_INTEGERS) % (1 << (8 * width))
                result[position : position + width] = number.to_bytes(width, rng.choice(("little", "big")))
            case 7:
                words = [(m.start(), m.end()) for m in small_files.NUMBER.finditer(bytes(result[:4096]))]
                if words:
                    begin, end = rng.choice(words)
                    result[begin:end] = rng.choice(ODD_NUMBERS)
            case 8:
                other = rng.randrange(size + 1)
                piece = bytes(result[other : other + length])
                result[position : position + len(piece)] = piece
    return bytes(result)


def mutate_png(data: bytes, rng: random.Random) -> bytes:
    """Mutate the content of a chunk and fix its checksum; in 30 % of the cases mutate any bytes."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    chunks, position = [], 8
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        chunks.append((data[position + 4 : position + 8], data[position + 8 : position + 8 + length]))
        position += 12 + length
    changed = rng.randrange(len(chunks))
    for number, (name, content) in enumerate(chunks):
        if number == changed:
            content = (
                _mutate_deflated(content, rng) if name == b"IDAT" and rng.random() < 0.5 else mutate_bytes(content, rng)
            )
        chunks[number] = small_files.png_chunk(name, content)
    rng.random() < 0.1 and rng.shuffle(chunks)
    return data[:8] + b"".join(chunks)


def mutate_serialized(data: bytes, rng: random.Random) -> bytes:
    """Mutate the data before it is deflated; in half of the cases mutate any bytes."""
    if rng.random() < 0.5:
        return mutate_bytes(data, rng)
    return data[:4] + _mutate_deflated(data[4:-20], rng) + data[-20:]


def _mutate_deflated(data: bytes, rng: random.Random) -> bytes:
    """Inflate, mutate and deflate again."""
    inflater = zlib.decompressobj()
    return zlib.compress(mutate_bytes(inflater.decompress(data), rng)) + inflater.unused_data


def mutate_glb(data: bytes, rng: random.Random) -> bytes:
    """Mutate the JSON chunk; in 30 % of the cases mutate any bytes."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    length = int.from_bytes(data[12:16], "little")
    header, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    _mutate_values(header, rng)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    return (
        data[:8]
        + (20 + len(text) + len(rest)).to_bytes(4, "little")
        + len(text).to_bytes(4, "little")
        + data[16:20]
        + text
        + rest
    )


def mutate_json(data: bytes, rng: random.Random) -> bytes:
    """Change values; in 30 % of the cases mutate any bytes."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    content = json.loads(data)
    _mutate_values(content, rng)
    return json.dumps(content).encode()


def _mutate_values(header: dict, rng: random.Random) -> None:
    """Remove or replace one to four values, at any depth."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        containers = [header]
        for container in containers:
            inner = container.values() if isinstance(container, dict) else container
            containers += [value for value in inner if isinstance(value, (dict, list)) and value]
        container = rng.choice(containers)
        key = rng.choice(sorted(container)) if isinstance(container, dict) else rng.randrange(len(container))
        if rng.random() < 0.2:
            del container[key]
        else:
            container[key] = rng.choice(
                [*ODD_INTEGERS, 2, 3, 4, 0.5, -1e300, "", "x", "VEC3", "MAT4", [], {}, [0, 0, 0], None, True]
            )


def mutate_xml(text: str, rng: random.Random) -> bytes:
    """Change names, values and structure; most results are well-formed."""
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 3, 5))):
        if len(list(root.iter())) > 1000:
            break
        nodes = list(root.iter())
        node, other = rng.choice(nodes), rng.choice(nodes)
        match rng.randrange(16):
            case 0 | 1 | 2 if node.attrib:
                node.set(rng.choice(sorted(node.attrib)), rng.choice(ODD_STRINGS))
            case 3 if node.attrib:
                del node.attrib[rng.choice(sorted(node.attrib))]
            case 4:
                node.set(
                    rng.choice(("id", "name", "type", "value", "x", "version", "foo")), rng.choice(ODD_STRINGS + NAMES)
                )
            case 5:
                node.tag = rng.choice(TAGS)
            case 6 if "type" in node.attrib:
                node.set("type", rng.choice(TYPES))
            case 7 if "name" in node.attrib:
                node.set("name", rng.choice(NAMES))
            case 8 if len(node):
                node.remove(rng.choice(list(node)))
            case 9:
                copy = ElementTree.fromstring(ElementTree.tostring(other))
                node.insert(rng.randrange(len(node) + 1), copy)
            case 10:
                identifier = rng.choice([n.get("id") for n in nodes if n.get("id")] or ["a"])
                ElementTree.SubElement(node, "ref", id=identifier, name=rng.choice(NAMES))
            case 12 | 13 | 14 | 15 if node.tag not in ("string", "scene"):
                for key in set(node.attrib) & {"value", "x", "y", "z", "angle", "origin"}:
                    node.set(
                        key,
                        re.sub(
                            r"[-+.\de]+", lambda _: rng.choice(EXTREME_NUMBERS), node.get(key), count=rng.choice((0, 1))
                        ),
                    )
            case 11:
                inner = ElementTree.fromstring(ElementTree.tostring(node))
                for _ in range(rng.choice((1, 3, 70, 300))):
                    outer = ElementTree.Element(node.tag, dict(node.attrib))
                    outer.append(inner)
                    inner = outer
                node[:] = [inner]
    try:
        data = ElementTree.tostring(root)
    except RecursionError:  # too deep for ElementTree to write
        return b"<a>" * 5000
    return mutate_bytes(data, rng) if rng.random() < 0.1 else data


_PBRT_TOKEN = re.compile(r'"[^"]*"|[^\s"]+')
_PBRT_WORDS = ["[", "]", '"', "#", "Shape", "AttributeBegin", "AttributeEnd", "WorldBegin", "Identity", "1 2 3", "true"]
_PBRT_WORDS += ['"float radius"', '"rgb L" [ 1 2 3 ]', '"texture reflectance" "checks"', '"string filename" "../a.png"']


def mutate_pbrt(data: bytes, rng: random.Random) -> bytes:
    """One to four changes of tokens: other numbers, copies, deletions, exchanges; a third of the inputs: of bytes."""
    if rng.random() < 1 / 3:
        return mutate_bytes(data, rng)
    text = data.decode()
    for _ in range(rng.choice((1, 1, 2, 4))):
        places = [match.span() for match in _PBRT_TOKEN.finditer(text)]
        (begin, end), (other_begin, other_end) = rng.choice(places), rng.choice(places)
        numbers = [place for place in places if text[place[0]] in "-.0123456789"]
        match rng.randrange(6):
            case 0:
                begin, end = rng.choice(numbers or places)
                replacement = rng.choice([*EXTREME_NUMBERS, *(word.decode() for word in ODD_NUMBERS)])
            case 1:
                replacement = text[other_begin:other_end]
            case 2:
                replacement = ""
            case 3:
                replacement = f"{text[begin:end]} {text[other_begin:other_end]}"
            case 4:
                replacement = rng.choice(_PBRT_WORDS)
            case 5:
                replacement = '"' + rng.choice(ODD_STRINGS) + '"'
        text = text[:begin] + replacement + text[end:]
    return text.encode()
