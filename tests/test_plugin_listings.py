"""`isonoise plugins` and the tables of host/docs/plugins.md."""

import json
import re
from pathlib import Path

import pytest
from plugin_cases import SUPPORTED_PLUGINS, case_id

from isonoise.cli import main
from isonoise.scene.parse import plugin_tables
from isonoise.scene.vocabulary import UNSUPPORTED_PLUGINS

CHECKOUT = Path(__file__).resolve().parent.parent
TABLES = (CHECKOUT / "host" / "docs" / "plugins.md").read_text("utf-8")


def test_documented_tables_are_current():
    assert plugin_tables.update_tables(TABLES) == TABLES, (
        "update them: python -m isonoise.scene.parse.plugin_tables host/docs/plugins.md"
    )
    for kind in plugin_tables.KINDS:
        for name, status, meaning in plugin_tables.list_plugins(kind):
            assert f"`{name}`" in TABLES
            assert meaning
            assert status in plugin_tables.STATUS.values()


def test_listed_kinds_are_complete():
    assert set(plugin_tables.KINDS) == {plugin.kind for plugin in SUPPORTED_PLUGINS} | set(UNSUPPORTED_PLUGINS)
    for kind in plugin_tables.KINDS:
        names = [row[0] for row in plugin_tables.list_plugins(kind)]
        assert len(set(names)) == len(names)


def test_command_lists_plugins(capsys):
    assert main(["plugins"]) == 0
    listed = capsys.readouterr().out
    for kind in plugin_tables.KINDS:
        assert re.search(rf"^{kind}$", listed, re.MULTILINE)
        for name, status, _ in plugin_tables.list_plugins(kind):
            assert re.search(rf"^  {name} +{status}  ", listed, re.MULTILINE), name
    assert main(["plugins", "emitter"]) == 0
    listed = capsys.readouterr().out
    assert "sunsky" in listed
    assert "roughplastic" not in listed


@pytest.mark.parametrize("plugin", SUPPORTED_PLUGINS, ids=case_id)
def test_command_describes_a_plugin(plugin, capsys):
    assert main(["plugins", plugin.name]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"{plugin.kind} '{plugin.name}' ({plugin_tables.STATUS[plugin.status]}): ")
    for parameter in plugin.parameters:
        assert re.search(rf"^  {parameter.name}  ", text, re.MULTILINE), parameter.name


def test_command_describes_unsupported_and_unknown_plugins(capsys):
    assert main(["plugins", "sunsky"]) == 0
    assert "emitter 'sunsky': not supported (Mitsuba 3 has it): " in capsys.readouterr().out
    assert main(["plugins", "roughconducter"]) == 2
    assert "did you mean 'roughconductor'?" in capsys.readouterr().err


def test_command_prints_json(capsys):
    assert main(["plugins", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert len(facts) == sum(len(plugin_tables.list_plugins(kind)) for kind in plugin_tables.KINDS)
    assert main(["plugins", "sphere", "--json"]) == 0
    (sphere,) = json.loads(capsys.readouterr().out)
    radius = next(parameter for parameter in sphere["parameters"] if parameter["name"] == "radius")
    assert radius == {
        "name": "radius",
        "type": "number",
        "values": "(0, inf)",
        "default": "1",
        "texture": False,
        "status": "supported",
        "meaning": "before to_world",
    }
