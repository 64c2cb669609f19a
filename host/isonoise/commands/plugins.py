"""`isonoise plugins`: lists Mitsuba 3's plugins with their support, or the parameters of one plugin."""

import argparse
import shutil

from isonoise.command_output import print_json
from isonoise.commands import EXIT_DONE
from isonoise.errors import UserError
from isonoise.scene.parse import plugin_tables
from isonoise.scene.parse.elements import did_you_mean
from isonoise.scene.vocabulary import UNSUPPORTED_PLUGINS, kinds_of, plugins_of
from isonoise.tables import Table, columns, text_table


def run(options: argparse.Namespace) -> int:
    """Run the command; returns the exit code. Raises UserError for an unknown kind or plugin."""
    name = options.name
    kinds = plugin_tables.KINDS if name is None else (name,) if name in plugin_tables.KINDS else ()
    if name is not None and not kinds and name not in _names():
        raise UserError(f"'{name}' is neither a kind nor a plugin{did_you_mean(name, _names())}")
    described = [(kind, name) for kind in kinds_of(name) if kind in plugin_tables.KINDS] if not kinds else None
    if options.json:
        listed = described or [(kind, row[0]) for kind in kinds for row in plugin_tables.list_plugins(kind)]
        print_json([_facts(kind, plugin) for kind, plugin in listed])
    elif described:
        print("\n\n".join("\n".join(_description(kind, plugin)) for kind, plugin in described))
    else:
        print("\n\n".join(f"{kind}\n{_plugin_table(kind)}" for kind in kinds))
    return EXIT_DONE


def _names() -> list[str]:
    names = {row[0] for kind in plugin_tables.KINDS for row in plugin_tables.list_plugins(kind)}
    return sorted(names | set(plugin_tables.KINDS))


def _facts(kind: str, name: str) -> dict:
    plugin = plugins_of(kind).get(name)
    return plugin_tables.plugin_info(plugin) if plugin else plugin_tables.unsupported_plugin_info(kind, name)


def _plugin_table(kind: str) -> str:
    return _text_table(("plugin", "status", "meaning"), plugin_tables.list_plugins(kind))


def _description(kind: str, name: str) -> list[str]:
    """Lines about one plugin: meaning, parameters, children."""
    if name in UNSUPPORTED_PLUGINS.get(kind, {}):
        return [f"{kind} '{name}': not supported (Mitsuba 3 has it): {UNSUPPORTED_PLUGINS[kind][name]}"]
    facts = _facts(kind, name)
    lines = [f"{kind} '{name}' ({facts['status']}): {facts['meaning']}"]
    rows = []
    for parameter in facts["parameters"]:
        type_ = parameter["type"] + (" or texture" if parameter["texture"] and parameter["type"] != "texture" else "")
        is_supported = parameter["status"] == plugin_tables.STATUS[plugin_tables.SUPPORTED]
        meaning = parameter["meaning"] if is_supported else f"{parameter['status']}: {parameter['meaning']}"
        rows.append((parameter["name"], type_, parameter["values"], parameter["default"], meaning))
    if rows:
        lines.append(_text_table(("parameter", "type", "values", "default", "meaning"), rows))
    for child in facts["children"]:
        types = f" ({', '.join(child['types'])})" if child["types"] else ""
        lines.append(f"  children: {_format_range(child['min_count'], child['max_count'])} {child['kind']}{types}")
    return lines


def _format_range(min_count: int, max_count: int) -> str:
    if max_count >= 1 << 16:
        return f"{min_count} or more"
    return str(max_count) if min_count == max_count else f"{min_count} to {max_count}"


def _text_table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table whose last column is wrapped at the width of the terminal."""
    table = Table(columns(*heads, left=range(len(heads))), rows)
    return text_table(table, indent="  ", wrap=shutil.get_terminal_size((120, 24)).columns)
