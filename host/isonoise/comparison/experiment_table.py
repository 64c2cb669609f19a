"""Tables of an experiment's TOML file, whose errors name file and key; for `experiment_file`."""

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from isonoise.errors import UserError
from isonoise.input_files import read_regular_file

Value = TypeVar("Value")


def parse_toml(path: Path) -> dict:
    """The content of a TOML file. Raises UserError."""
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        try:
            import tomli as tomllib
        except ModuleNotFoundError as error:
            raise UserError("an experiment's file needs tomli: pip install 'isonoise[compare]'") from error
    try:
        return tomllib.loads(read_regular_file(path).decode("utf-8"))
    except OSError as error:
        raise UserError(f"cannot read the experiment '{path}': {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"experiment '{path}' is not TOML: {error}") from error


class ExperimentTable:
    """A table, whose values are taken one by one.

    Parameters
    ----------
    where : str
        File and place of the table, for messages.
    content : mapping
        Its keys and values.
    known : sequence of str
        The keys that it may have.

    Raises
    ------
    UserError
        If it has another key.
    """

    def __init__(self, where: str, content: Mapping, known: Sequence[str]):
        self._where, self._content = where, content
        for key in content:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f" (did you mean '{close[0]}'?)" if close else ""
                raise self.error(key, f"is unknown{hint}; known are {', '.join(known)}")

    def take(
        self, key: str, convert: Callable[[object], Value], default: Value | None = None, required: bool = False
    ) -> Value:
        """The converted value of a key. `convert` raises ValueError, which becomes a UserError with the key."""
        if key not in self._content:
            if required:
                raise UserError(f"{self._where}: '{key}' is missing")
            return default
        return self.convert(key, self._content[key], convert)

    def convert(self, key: str, value: object, convert: Callable[[object], Value]) -> Value:
        """The converted value."""
        try:
            return convert(value)
        except ValueError as error:
            raise self.error(key, f"= {value!r} {error}") from None

    def child(self, key: str, number: int, item: str | Mapping, name: str, known: Sequence[str]) -> "ExperimentTable":
        """A table of a list of tables; a text stands for a table that has only the key `name`."""
        content = {name: item} if isinstance(item, str) else item
        label = content.get(name)
        return ExperimentTable(f"{self._where}: {key}[{number}]{f' ({label})' if label else ''}", content, known)

    def error(self, key: str, problem: str) -> UserError:
        """An error about a key."""
        return UserError(f"{self._where}: '{key}' {problem}")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Adds file and place to errors within the `with` block."""
        try:
            yield
        except UserError as error:
            raise UserError(f"{self._where}: {error}") from error
