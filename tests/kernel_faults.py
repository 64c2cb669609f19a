"""Deliberate faults in kernels, which checks must find."""

from collections.abc import Callable

from isonoise.device import program


def source_with_fault(file: str, before: str, after: str) -> Callable[[str], str]:
    """In place of `program.kernel_source`: reads kernel files, with a text of `file` replaced."""
    original = program.kernel_source

    def read(name: str) -> str:
        text = original(name)
        assert name != file or before in text
        return text.replace(before, after) if name == file else text

    return read
