"""Tables of an experiment's TOML file, whose errors name file and key; for `experiment_file`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from isonoise.errors import UserError
from isonoise.input_files import read_regular_file
from isonoise.suggestions import suggestion

Value = TypeVar("Value")
Check = Callable[[str, object], Value]
"""Gets the name of a value and the value, and returns it converted; raises UserError if it is wrong."""


def read_toml(path: Path) -> tuple[str, dict]:
    """Text and content of a TOML file. Raises UserError."""
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        try:
            import tomli as tomllib
        except ModuleNotFoundError as error:
            raise UserError("an experiment's file needs tomli: pip install 'isonoise[compare]'") from error
    try:
        text = read_regular_file(path).decode("utf-8").replace("\r\n", "\n")
        return text, tomllib.loads(text)
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
        self.where, self._content = where, content
        for key in content:
            if key not in known:
                raise self.error(f"there is no key '{key}'{suggestion(key, known)}; known are {', '.join(known)}")

    def take(self, key: str, check: Check[Value], default: Value | None = None, required: bool = False) -> Value:
        """The value of a key, checked: `check` gets its name and what the file has. Raises UserError."""
        if key not in self._content:
            if required:
                raise self.error(f"'{key}' is missing")
            return default
        return self.check(key, self._content[key], check)

    def check(self, key: str, value: object, check: Check[Value]) -> Value:
        """A value, checked."""
        with self.errors():
            return check(key, value)

    def child(self, key: str, number: int, item: str | Mapping, name: str, known: Sequence[str]) -> "ExperimentTable":
        """A table of a list of tables; a text stands for a table that has only the key `name`."""
        content = {name: item} if isinstance(item, str) else item
        label = content.get(name)
        return ExperimentTable(f"{self.where}: {key}[{number}]{f' ({label})' if label else ''}", content, known)

    def error(self, problem: str) -> UserError:
        """An error about this table."""
        return UserError(f"{self.where}: {problem}")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Adds file and place to errors within the `with` block."""
        try:
            yield
        except UserError as error:
            raise self.error(str(error)) from error
