"""The structure of the sources: no long files or functions, no circular imports."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
MAX_FILE_LINES, MAX_FUNCTION_LINES = 400, 70
SOURCES = sorted(
    path for folder in ("host", "kernels", "tests") for path in (CHECKOUT / folder).rglob("*.*") if path.is_file()
)
PYTHON = [path for path in SOURCES if path.suffix == ".py"]
KERNELS = [path for path in SOURCES if path.suffix in (".cl", ".h")]


def name_of(path: Path) -> str:
    return str(path.relative_to(CHECKOUT))


@pytest.mark.parametrize("path", PYTHON + KERNELS, ids=name_of)
def test_files_are_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_FILE_LINES


def python_functions(path: Path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, node.end_lineno - node.lineno + 1


def kernel_functions(path: Path):
    """Functions begin at an opening brace in the first column and end at a closing one."""
    lines = path.read_text(encoding="utf-8").splitlines()
    begin = None
    for number, line in enumerate(lines):
        if line == "{":
            begin = number
        elif line == "}" and begin is not None:
            yield re.sub(r"\(.*", "", lines[begin - 1]).split()[-1:], number - begin + 2
            begin = None


def test_functions_are_short():
    found = [(name_of(path), *function) for path in PYTHON for function in python_functions(path)]
    found += [(name_of(path), *function) for path in KERNELS for function in kernel_functions(path)]
    assert len(found) > 2000  # the search finds functions at all
    assert [function for function in found if function[2] > MAX_FUNCTION_LINES] == []


@cache
def imports() -> dict[str, set[str]]:
    """Module of the package -> modules of the package that it imports, wherever in the file."""
    package = CHECKOUT / "host" / "isonoise"
    modules = {}
    for path in package.rglob("*.py"):
        parts = ["isonoise", *path.relative_to(package).with_suffix("").parts]
        modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    found = {}
    for module, path in modules.items():
        names = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
        found[module] = {name for name in names if name in modules and not name.startswith(f"{module}.")} - {module}
    return found


def test_no_circular_imports():
    """Packages are left out: their __init__ only names what their modules hold."""
    remaining = {module: {name for name in names if "." in name} for module, names in imports().items()}
    packages = {module for module in remaining if any(other.startswith(f"{module}.") for other in remaining)}
    remaining = {module: names - packages for module, names in remaining.items() if module not in packages}
    while leaves := [module for module, names in remaining.items() if not names & set(remaining)]:
        for module in leaves:
            del remaining[module]
    assert not remaining, f"circular imports among {sorted(remaining)}"
