"""What identifies the code of a strategy that is not part of isonoise, so that an edited one is noticed.

Called by `planning`, and by the workers of a cluster.
"""

import ast
import hashlib
import importlib.util
import inspect
import os
import sys
import sysconfig
import textwrap
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib.metadata import packages_distributions, version
from pathlib import Path
from types import ModuleType

from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS, make_spec
from isonoise.errors import UserError

_INSTALLED = tuple(os.path.realpath(sysconfig.get_path(name)) for name in ("purelib", "platlib"))
_STANDARD_LIBRARY = os.path.realpath(sysconfig.get_path("stdlib"))
_MAIN = "__main__"
"""The module of a script or notebook."""
_first_seen: dict[str, str] = {}
"""File of a module -> SHA-256 of its content when this process looked at it for the first time."""


def code_of(spec: str) -> str | None:
    """Identity of the code that a strategy has beside isonoise's own.

    Parameters
    ----------
    spec : str
        As `make_strategy` takes it, or Mitsuba 3 with a sampler.

    Returns
    -------
    str or None
        Names of the files and a SHA-256 of their content: those of the strategy's class, its base classes, the
        callables and objects that are its attributes, and the modules in the same folder that these import. Of a script
        or notebook only the classes and functions that it uses. For an installed package name and version come first;
        for Mitsuba 3 they are all. None: it is part of isonoise.

    Raises
    ------
    UserError
        If the code cannot be read, or a file has been edited since this process imported it.
    """
    if spec in MITSUBA_SAMPLERS:
        return f"mitsuba {version('mitsuba')}"
    parts = {part for part in _parts(make_spec(spec)) if not _is_known(part.__module__)}
    if not parts:
        return None
    texts, others = _texts_of_main([part for part in parts if part.__module__ == _MAIN])
    modules = {part.__module__ for part in (*parts, *others)} - {_MAIN}
    texts |= {os.path.basename(path): _read_unchanged(path) for name in modules for path in _files_of(name)}
    digest = hashlib.sha256()
    for name in sorted(texts):
        digest.update(name.encode() + b"\0" + texts[name].encode() + b"\0")
    return ", ".join([*_packages(modules), f"{', '.join(sorted(texts))}: sha256 {digest.hexdigest()}"])


def _parts(strategy: object) -> Iterator[type]:
    """The classes, and functions, that a strategy consists of."""
    yield from type(strategy).__mro__
    for value in vars(strategy).values():
        if inspect.isroutine(value) or inspect.isclass(value):
            yield value
        elif not isinstance(value, str | bytes | int | float | complex | tuple | list | dict | None):
            yield from type(value).__mro__


def _texts_of_main(parts: Iterable[object]) -> tuple[dict[str, str], list[object]]:
    """The text of classes and functions of a script or notebook, and of what they use there, by name.

    The rest of a script, such as its call of `compare`, may change. Also returns what they use of other modules.
    """
    texts: dict[str, str] = {}
    waiting, others = list(parts), []
    while waiting:
        part = waiting.pop()
        if part.__qualname__ in texts:
            continue
        text = _source(part)
        texts[part.__qualname__] = text
        for node in ast.walk(ast.parse(text)):
            value = vars(sys.modules[_MAIN]).get(node.id) if isinstance(node, ast.Name) else None
            if not (inspect.isclass(value) or inspect.isfunction(value)):
                if isinstance(value, bool | int | float | str | tuple):
                    texts[node.id] = repr(value)
            elif value.__module__ == _MAIN:
                waiting.append(value)
            elif not _is_known(value.__module__):
                others.append(value)
    return texts, others


def _source(part: object) -> str:
    """The text of a class or function. A class of a notebook has no file: it is the text of its methods and values."""
    with suppress(OSError, TypeError):
        return textwrap.dedent(inspect.getsource(part))
    try:
        members = vars(part) if inspect.isclass(part) else {}
        texts = [textwrap.dedent(inspect.getsource(each)) for each in members.values() if inspect.isfunction(each)]
    except (OSError, TypeError) as error:
        raise UserError(
            f"the source of '{part.__qualname__}' cannot be read and recorded: put it into a module"
        ) from error
    values = {name: each for name, each in members.items() if isinstance(each, bool | int | float | str | tuple)}
    return "\n".join([*texts, repr({name: each for name, each in values.items() if not name.startswith("__")})])


def _is_known(module: str) -> bool:
    """Whether a module is isonoise's, NumPy's or the standard library's."""
    return module.partition(".")[0] in {"isonoise", "builtins", "numpy", *sys.stdlib_module_names}


def _files_of(name: str) -> set[str]:
    """Files of a module, and of those in its folder that it imports."""
    module = sys.modules[name]
    if not getattr(module, "__file__", None):
        raise UserError(f"'{name}' is no file, so that the code of a strategy in it cannot be recorded")
    first = os.path.realpath(module.__file__)
    folder, found, waiting = _root(module, first), set(), [(name, first)]
    while waiting:
        name, path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        for imported in _imports(name, path):
            spec = None
            with suppress(ImportError, ValueError, AttributeError):
                spec = importlib.util.find_spec(imported)
            origin = os.path.realpath(spec.origin) if spec and spec.has_location and spec.origin else ""
            if origin.endswith(".py") and _is_below(origin, folder):
                waiting.append((imported, origin))
    return found


def _root(module: ModuleType, path: str) -> str:
    """The folder whose modules belong to the same program: that of the outermost package, or of the module."""
    depth = module.__name__.count(".") + (os.path.basename(path) == "__init__.py")
    folder = os.path.dirname(path)
    for _ in range(depth):
        folder = os.path.dirname(folder)
    if folder in _INSTALLED:  # the neighbours are other packages
        return os.path.join(folder, module.__name__.partition(".")[0])
    return folder


def _is_below(path: str, folder: str) -> bool:
    """Whether a file is in a folder, and not in an environment of Python inside that folder."""
    return path.startswith(folder + os.sep) and not any(
        path.startswith(other + os.sep) and not folder.startswith(other) for other in (*_INSTALLED, _STANDARD_LIBRARY)
    )


def _imports(name: str, path: str) -> Iterable[str]:
    """Names that the source file of a module imports; some of them are modules."""
    package = name if os.path.basename(path) == "__init__.py" else name.rpartition(".")[0]
    try:
        tree = ast.parse(_content(path))
    except SyntaxError:
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                with suppress(ImportError):
                    base = importlib.util.resolve_name("." * node.level + base, package)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _read_unchanged(path: str) -> str:
    """SHA-256 of a file, which must be the one that this process has imported."""
    digest = hashlib.sha256(_content(path)).hexdigest()
    if _first_seen.setdefault(path, digest) != digest:
        raise UserError(f"'{path}' has been edited since this Python process imported it: start the process again")
    return digest


def _content(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"cannot read '{path}', the code of a strategy: {error.strerror}") from error


def _packages(modules: Iterable[str]) -> list[str]:
    """Names and versions of the installed packages that have these modules."""
    files = [os.path.realpath(sys.modules[name].__file__) for name in modules]
    if not any(path.startswith(folder + os.sep) for path in files for folder in _INSTALLED):
        return []
    installed = packages_distributions()
    found = {package for name in modules for package in installed.get(name.partition(".")[0], ())}
    return [f"{package} {version(package)}" for package in sorted(found)]
