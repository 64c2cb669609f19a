"""Splits a pbrt file into tokens and knows the line and column of each. Called by `directives.py`."""

import re
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from isonoise.scene.parse.elements import Location
from isonoise.suggestions import closest_name

WORD, STRING, OPEN, CLOSE, END = "word", "string", "[", "]", "end"

_SKIPPED = re.compile(r"(?:[ \t\r\n\f\v]+|#[^\n]*)*")
_WORD = re.compile(r'[^ \t\r\n\f\v"\[\]#]+')
_STRING = re.compile(r'"((?:[^"\\\n]|\\.)*)"')
_ESCAPE = re.compile(r"\\(.)")
_ESCAPES = {"b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t"}
_NOT_PLAIN = re.compile(r'["\[#]')
_MAX_SHOWN_CHARS = 40


class Source:
    """The text of one file."""

    def __init__(self, path: Path, text: str):
        self.path, self.text = path, text
        self._line_starts: list[int] | None = None

    def line_and_column(self, offset: int) -> tuple[int, int]:
        """Both from 1."""
        if self._line_starts is None:
            self._line_starts = [0, *(match.end() for match in re.finditer("\n", self.text))]
        line = bisect_right(self._line_starts, offset)
        return line, offset - self._line_starts[line - 1] + 1


@dataclass(frozen=True, slots=True)
class Position(Location):
    """A character of a file; as text it is file:line:column."""

    source: Source
    offset: int

    @property
    def line(self) -> int:
        """The line, from 1."""
        return self.source.line_and_column(self.offset)[0]

    def raise_unknown(self, problem: str, name: str, choices: Iterable[str]) -> NoReturn:
        """Raise a SceneError such as "unknown camera 'nme'; did you mean 'name'?"."""
        hint = closest_name(name, list(choices))
        suggestion = f"; did you mean '{hint}'?" if hint else ""
        self.raise_error(f"{problem} '{_shortened(name)}'{suggestion}")

    @property
    def place(self) -> str:
        """File name, line and column, for reports."""
        line, column = self.source.line_and_column(self.offset)
        return f"{self.source.path.name}:{line}:{column}"

    def __str__(self) -> str:
        line, column = self.source.line_and_column(self.offset)
        return f"{self.source.path}:{line}:{column}"


class Token(NamedTuple):
    """A word, a string without its quotes, a bracket, or the end of the file."""

    kind: str
    text: str
    position: Position

    def __str__(self) -> str:
        shown = _shortened(self.text)
        return {STRING: f'the string "{shown}"', END: "the end of the file"}.get(self.kind, f"'{shown}'")


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN_CHARS else text[:_MAX_SHOWN_CHARS] + "..."


class Tokenizer:
    """Reads the tokens of a file one after the other."""

    def __init__(self, source: Source):
        self.source = source
        self._offset = 0
        self._peeked: Token | None = None

    def next(self) -> Token:
        """The next token, which is consumed."""
        token = self.peek()
        self._peeked = None
        return token

    def peek(self) -> Token:
        """The next token, which is not consumed."""
        if self._peeked is None:
            self._peeked = self._read()
        return self._peeked

    def read_numbers(self) -> np.ndarray | None:
        """The numbers up to the closing bracket, after an opening one; None if there is anything but numbers.

        It is much faster than reading tokens, which find the place of an error.
        """
        text, start = self.source.text, self._offset
        end = text.find("]", start)
        if end < 0 or _NOT_PLAIN.search(text, start, end):
            return None
        try:
            numbers = np.array(text[start:end].split(), np.float64)
        except ValueError:
            return None
        self._offset = end + 1
        return numbers

    def _read(self) -> Token:
        text = self.source.text
        start = _SKIPPED.match(text, self._offset).end()
        position = Position(self.source, start)
        if start == len(text):
            self._offset = start
            return Token(END, "", position)
        if text[start] in "[]":
            self._offset = start + 1
            return Token(text[start], text[start], position)
        if text[start] == '"':
            match = _STRING.match(text, start)
            if match is None:
                position.raise_error("a string has no closing quote on its line")
            self._offset = match.end()
            return Token(STRING, _ESCAPE.sub(lambda m: _ESCAPES.get(m[1], m[1]), match[1]), position)
        match = _WORD.match(text, start)
        self._offset = match.end()
        return Token(WORD, match[0], position)
