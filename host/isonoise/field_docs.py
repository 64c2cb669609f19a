"""Docstrings of dataclasses whose fields carry their meaning, which is also that of the columns of a file."""

import textwrap
from dataclasses import fields
from typing import TypeVar

Class = TypeVar("Class", bound=type)


def document_fields(cls: Class) -> Class:
    """Add the section "Attributes" to the docstring of a dataclass: name, type and `doc` of its fields."""
    entries = []
    for field in fields(cls):
        meaning = textwrap.fill(field.metadata["doc"], 108, initial_indent=" " * 8, subsequent_indent=" " * 8)
        kind = field.type.__name__ if isinstance(field.type, type) else str(field.type).removeprefix("typing.")
        entries.append(f"    {field.name} : {kind}\n{meaning}")
    cls.__doc__ = "\n".join([f"{(cls.__doc__ or '').rstrip()}\n", "    Attributes", "    ----------", *entries, "    "])
    return cls
