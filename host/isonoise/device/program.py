"""Makes the text of each program from kernel files: includes flattened, records and constants defined.

One text can be hashed, cached and dumped, and an include path with a space cannot break it.
"""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import resources

import numpy as np

_INCLUDE = re.compile(r'#include\s+"([^"]+)"')
_RECORDS = "generated/records.h"  # included by util/vec.h
_RECORDS_LINE = f'#line 1 "{_RECORDS}"'
_C_TYPES = {"f4": "float", "u4": "uint", "i4": "int"}


@functools.cache
def kernel_source(name: str) -> str:
    """Text of one file of `kernels/`."""
    return resources.files("isonoise.kernels").joinpath(name).read_text(encoding="utf-8")


def flatten(
    name: str,
    headers: Mapping[str, str] | None = None,
    seen: set[str] | None = None,
    source: Callable[[str], str] = kernel_source,
) -> str:
    """Text of a kernel file with every include in place, each once.

    `#line` directives let compiler messages name file and line.

    Parameters
    ----------
    name : file of `kernels/`, or one of `headers`
    headers : texts of generated headers, by the name under which kernels include them (`generated/NAME.h`). None or
        empty: all generated headers are empty. That of the records is empty too: `stage_source` adds its text.
    seen : files that are not included again; gets the names of those that are
    source : reads a file of `kernels/`

    Raises
    ------
    KeyError
        If `headers` has entries, but not an included header other than that of the records.
    """
    seen = set() if seen is None else seen
    seen.add(name)
    lines = [f'#line 1 "{name}"']
    for number, line in enumerate(_text_of(name, headers, source).splitlines(), start=1):
        if line.startswith("#include"):
            included = _INCLUDE.match(line)[1]
            if included not in seen:
                lines.append(flatten(included, headers, seen, source))
            lines.append(f'#line {number + 1} "{name}"')
        else:
            lines.append("" if line.startswith("#pragma once") else line)
    return "\n".join(lines)


def _text_of(name: str, headers: Mapping[str, str] | None, source: Callable[[str], str]) -> str:
    """Text of a file of `kernels/` or of a generated header."""
    if not name.startswith("generated/"):
        return source(name)
    return headers[name] if headers and name != _RECORDS else ""


@functools.cache
def _words(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", text))


def declare_struct(name: str, dtype: np.dtype) -> str:
    """C declaration of a record of 4-byte members, which host and device cannot lay out differently."""
    members = []
    for field in dtype.names:
        base, shape = dtype[field].base, dtype[field].shape
        c_type = _C_TYPES[base.str[1:]]
        members.append(f"    {c_type} {field}{''.join(f'[{n}]' for n in shape)};")
    return "typedef struct {\n" + "\n".join(members) + f"\n}} {name};"


def record_reader(name: str, dtype: np.dtype) -> str:
    """C function `<name>_at`: a copy of a table's record, of which compilers leave out the members that nobody reads.

    It reads words at signed indices. When several paths read at once, compilers then gather with 32-bit indices.
    Members behind a pointer are gathered with 64-bit addresses, which takes twice the instructions.
    """
    lines, word = [], 0
    kinds = sorted({_C_TYPES[dtype[field].base.str[1:]] for field in dtype.names})
    for field in dtype.names:
        base, shape = dtype[field].base, dtype[field].shape
        for place in [""] if not shape else [f"[{k}]" for k in range(shape[0])]:
            lines.append(f"    record.{field}{place} = {_C_TYPES[base.str[1:]]}s[at + {word}];")
            word += 1
    return "\n".join(
        [
            f"INLINE {name} {name}_at(__global const {name}* table, uint index)",
            "{",
            *(f"    __global const {kind}* {kind}s = (__global const {kind}*)table;" for kind in kinds),
            f"    const int at = {word} * (int)index;",
            f"    {name} record;",
            *lines,
            "    return record;",
            "}",
        ]
    )


def stage_source(
    names: str | Iterable[str],
    structs: Mapping[str, np.dtype],
    constants: Mapping[str, int | str],
    features: Mapping[str, bool],
    headers: Mapping[str, str] | None = None,
) -> tuple[str, tuple[str, ...]]:
    """Text of a program and its build options.

    A feature is a macro FEATURE_<name> of 0 or 1. Options set only those that the text mentions, so that a feature of
    another stage does not rebuild this one.

    Parameters
    ----------
    names : file of a stage, or of several that are built as one program
    structs : C name -> record; those that the text mentions are declared, with their `<name>_at` functions
    constants : macro -> unsigned number, or expression; those that the text mentions are defined, and those that their
        expressions mention
    features : feature -> whether it is on
    headers : generated headers, see `flatten`
    """
    files = (names,) if isinstance(names, str) else tuple(names)
    parts = (tuple(mapping.items()) for mapping in (structs, constants, headers or {}))
    text, mentioned = _program_text(kernel_source, files, *parts)
    return text, ("-cl-std=CL1.2", *(f"-DFEATURE_{name}={int(features[name])}" for name in mentioned))


@functools.lru_cache(maxsize=64)
def _program_text(
    source: Callable[[str], str],
    files: tuple[str, ...],
    structs: tuple[tuple[str, np.dtype], ...],
    constants: tuple[tuple[str, int | str], ...],
    headers: tuple[tuple[str, str], ...],
) -> tuple[str, tuple[str, ...]]:
    """Text of a program, and the features that it mentions.

    It takes tens of milliseconds and does not depend on the scene, so it is cached for the next render. `source` reads
    the files; as an argument it is part of the key.
    """
    constant_of, header_of = dict(constants), dict(headers)

    seen: set[str] = set()
    body = "\n".join(flatten(name, header_of, seen, source) for name in files)
    words = set().union(*(_words(_text_of(name, header_of, source)) for name in seen))
    todo = words & constant_of.keys()
    while todo:
        todo = set().union(*(_words(str(constant_of[key])) for key in todo)) - words
        words |= todo
        todo &= constant_of.keys()
    readers = [record_reader(key, dtype) for key, dtype in structs if f"{key}_at" in words]
    body = body.replace(_RECORDS_LINE, "\n".join([_RECORDS_LINE, *readers]), 1)
    prelude = ["#pragma OPENCL FP_CONTRACT OFF"]
    macros = {key: f"({value})" if isinstance(value, str) else f"{value}u" for key, value in constants}
    prelude += [f"#define {key} {value}" for key, value in macros.items() if key in words]
    prelude += [declare_struct(key, dtype) for key, dtype in structs if key in words]
    mentioned = sorted(word.removeprefix("FEATURE_") for word in words if word.startswith("FEATURE_"))
    return "\n".join([*prelude, body]) + "\n", tuple(mentioned)
