"""`isonoise plugins`: what of Mitsuba 3's vocabulary is read, what is not and why, and what parameters a plugin has."""

import argparse
import json
import shutil
import textwrap

from isonoise.commands import EXIT_DONE
from isonoise.errors import UserError
from isonoise.scene.parse import plugin_tables
from isonoise.scene.parse.elements import closest_name
from isonoise.scene.vocabulary import UNSUPPORTED_PLUGINS, kinds_of, plugins_of


def run(options: argparse.Namespace) -> int:
    """List all kinds, one kind, or describe the plugins of a name. Raises UserError where there is no such name."""
    name = options.name
    kinds = plugin_tables.KINDS if name is None else (name,) if name in plugin_tables.KINDS else ()
    if name is not None and not kinds and name not in _names():
        raise UserError(f"'{name}' is neither a kind nor a plugin; did you mean '{closest_name(name, _names())}'?")
    found = [(kind, name) for kind in kinds_of(name) if kind in plugin_tables.KINDS] if not kinds else None
    if options.json:
        listed = found or [(kind, row[0]) for kind in kinds for row in plugin_tables.list_plugins(kind)]
        print(json.dumps([_facts(kind, plugin) for kind, plugin in listed], indent=1))
    elif found:
        print("\n\n".join("\n".join(_description(kind, plugin)) for kind, plugin in found))
    else:
        print("\n\n".join("\n".join(_listing(kind)) for kind in kinds))
    return EXIT_DONE


def _names() -> list[str]:
    names = {row[0] for kind in plugin_tables.KINDS for row in plugin_tables.list_plugins(kind)}
    return sorted(names | set(plugin_tables.KINDS))


def _facts(kind: str, name: str) -> dict:
    plugin = plugins_of(kind).get(name)
    return plugin_tables.plugin_info(plugin) if plugin else plugin_tables.unsupported_plugin_info(kind, name)


def _listing(kind: str) -> list[str]:
    return [kind, *_table(plugin_tables.list_plugins(kind))]


def _description(kind: str, name: str) -> list[str]:
    """A plugin in full."""
    if name in UNSUPPORTED_PLUGINS.get(kind, {}):
        return [f"{kind} '{name}': not supported (Mitsuba 3 has it): {UNSUPPORTED_PLUGINS[kind][name]}"]
    facts = _facts(kind, name)
    lines = [f"{kind} '{name}' ({facts['status']}): {facts['meaning']}"]
    rows = []
    for parameter in facts["parameters"]:
        type_ = parameter["type"] + (" or texture" if parameter["texture"] and parameter["type"] != "texture" else "")
        over = (
            "" if parameter["status"] == plugin_tables.STATUS[plugin_tables.SUPPORTED] else f"{parameter['status']}: "
        )
        rows.append((parameter["name"], type_, parameter["values"], parameter["default"], over + parameter["meaning"]))
    if rows:
        lines += _table([("parameter", "type", "values", "default", "meaning"), *rows])
    for child in facts["children"]:
        types = f" ({', '.join(child['types'])})" if child["types"] else ""
        lines.append(f"  holds {_number(child['least'], child['most'])} {child['kind']}{types}")
    return lines


def _number(least: int, most: int) -> str:
    if most >= 1 << 16:
        return f"{least} or more"
    return str(most) if least == most else f"{least} to {most}"


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows as columns of text; the last one is folded at the width of the terminal."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    left = sum(widths) + 2 * len(widths) + 2
    room = max(shutil.get_terminal_size((120, 24)).columns - left, 30)
    lines = []
    for row in rows:
        head = "  " + "".join(f"{cell:{width}}  " for cell, width in zip(row, widths, strict=False))
        for number, part in enumerate(textwrap.wrap(row[-1], room) or [""]):
            lines.append(((head if number == 0 else " " * left) + part).rstrip())
    return lines
