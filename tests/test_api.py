"""The public names: listed once for everybody, documented, annotated, with examples that run."""

import ast
import doctest
import importlib
import inspect
import re
import types
from pathlib import Path

import pytest

import isonoise
from isonoise.renderer import Renderer
from isonoise.renderer_options import RendererOptions

MADE_BY_FUNCTIONS = ("Cluster", "CompiledScene", "Outcome", "Scene", "State", "WaveRecord")
"""Classes whose constructor is not for users."""
SLOW_EXAMPLES = ("isonoise.comparison.compare_scenes", "isonoise.distributed.cluster")
"""Modules whose examples start processes or render many images."""
MODULES = sorted({"isonoise", *isonoise._PUBLIC_NAMES.values()} - {*SLOW_EXAMPLES})


def members(cls: type) -> dict[str, object]:
    """The public functions and properties of a class, those of its base classes in isonoise included."""
    found = {}
    for base in reversed(bases(cls)):
        found |= vars(base)
    kinds = (types.FunctionType, classmethod, staticmethod, property)
    has_get = {name: value for name, value in found.items() if isinstance(value, kinds) or hasattr(value, "func")}
    return {name: value for name, value in has_get.items() if not name.startswith("_")}


def function_of(member: object):
    """The function behind a method or a property."""
    for attribute in ("fget", "func", "__func__"):
        member = getattr(member, attribute, member)
    return member


def bases(cls: type) -> list[type]:
    """The class and its base classes in isonoise."""
    return [base for base in cls.__mro__ if base.__module__.startswith("isonoise.")]


def callables() -> dict[str, tuple[object, str]]:
    """Name -> public function or class, or method, and the docstring that describes its parameters."""
    found = {}
    for name in isonoise.__all__:
        value = getattr(isonoise, name)
        if isinstance(value, types.ModuleType):
            functions = {key: each for key, each in vars(value).items() if not key.startswith("_")}
            for key, each in functions.items():
                if isinstance(each, types.FunctionType) and each.__module__ == value.__name__:
                    found[f"{name}.{key}"] = each, each.__doc__
        elif isinstance(value, type):
            has_constructor = name not in MADE_BY_FUNCTIONS and not issubclass(value, Exception)
            found[name] = value if has_constructor else None, "\n".join(base.__doc__ or "" for base in bases(value))
            for key, member in members(value).items():
                function = function_of(member)
                documented = next((vars(base)[key] for base in value.__mro__ if documents(base, key)), member)
                found[f"{name}.{key}"] = function, function_of(documented).__doc__
        else:
            found[name] = value, value.__doc__
    return found


def documents(cls: type, name: str) -> bool:
    """Whether a class has its own docstring for a member."""
    return name in vars(cls) and bool(function_of(vars(cls)[name]).__doc__)


def test_the_lists_of_public_names_are_the_same():
    tree = ast.parse(Path(isonoise.__file__).read_text("utf-8"))
    branch = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {}
    for node in branch.body:
        imported |= {alias.name: node.module for alias in node.names}
    assert sorted(imported) == sorted(isonoise.__all__) == sorted(isonoise._PUBLIC_NAMES) == dir(isonoise)
    for name, module in isonoise._PUBLIC_NAMES.items():
        assert module in (imported[name], f"{imported[name]}.{name}"), name


def test_unknown_names():
    with pytest.raises(AttributeError, match="no attribute 'rendr'"):
        _ = isonoise.rendr


@pytest.mark.parametrize("name", sorted(callables()))
def test_docstrings_name_all_parameters(name):
    function, text = callables()[name]
    assert text, f"{name} has no docstring"
    if isinstance(function, types.FunctionType | type):
        for parameter in inspect.signature(function).parameters.values():
            if parameter.name not in ("self", "cls") and parameter.kind != parameter.VAR_POSITIONAL:
                assert re.search(rf"\b{parameter.name}\b", text), f"{name}: {parameter.name} is not described"


@pytest.mark.parametrize("name", sorted(callables()))
def test_annotations_are_complete(name):
    function, _ = callables()[name]
    if isinstance(function, types.FunctionType | type):
        signature = inspect.signature(function)
        missing = [each.name for each in signature.parameters.values() if each.annotation is each.empty]
        assert set(missing) <= {"self", "cls"}, name
        is_class = isinstance(function, type)
        assert is_class or signature.return_annotation is not signature.empty, f"{name}: no return annotation"


def test_the_options_that_are_passed_on_are_those_of_the_renderer():
    parameters = inspect.signature(Renderer).parameters
    assert list(RendererOptions.__annotations__) == [name for name in parameters if name != "scene"]


@pytest.mark.parametrize("module", [*MODULES, *(pytest.param(name, marks=pytest.mark.long) for name in SLOW_EXAMPLES)])
def test_examples_in_docstrings(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert doctest.testmod(importlib.import_module(module), extraglobs={"isonoise": isonoise}).failed == 0


def test_type_checkers_see_the_annotations():
    assert (Path(isonoise.__file__).parent / "py.typed").is_file()
