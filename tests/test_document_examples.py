"""The examples of the documents: options and names exist; the long tests run them, with small budgets."""

import ast
import importlib

import document_examples
import pytest

from isonoise.cli import make_parser

BLOCKS = [block for page in document_examples.PAGES for block in document_examples.blocks(page)]
PAGES_WITH_EXAMPLES = sorted(
    {block.page for block in BLOCKS if block.language in ("sh", "python") and not block.not_run}
)


def of_language(language: str):
    found = [block for block in BLOCKS if block.language == language]
    return pytest.mark.parametrize("block", found, ids=str)


def test_blocks_name_their_language():
    """Otherwise nobody runs them. Diagrams have none, and no commands."""
    assert {block.language for block in BLOCKS} <= {"", "bibtex", "json", "python", "sh", "toml", "xml"}
    assert [block for block in BLOCKS if not block.language and "isonoise " in block.body] == []
    assert sum(bool(block.not_run) for block in BLOCKS) <= 5
    assert len(PAGES_WITH_EXAMPLES) > 5


@of_language("sh")
def test_commands_have_these_options(block):
    for arguments in document_examples.isonoise_commands(block.body):
        assert make_parser().parse_args(arguments).command == arguments[0]


@of_language("python")
def test_imported_names_exist(block):
    for node in ast.walk(ast.parse(block.body)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                importlib.import_module(alias.name)
        elif isinstance(node, ast.ImportFrom) and node.module.startswith("isonoise"):
            module = importlib.import_module(node.module)
            assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "isonoise":
            assert hasattr(importlib.import_module("isonoise"), node.attr)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES_WITH_EXAMPLES)
def test_examples_run(page, tmp_path):
    assert document_examples.run_page(document_examples.CHECKOUT / page, tmp_path) > 0
