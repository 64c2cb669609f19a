"""Presents the vocabulary to people: the listings of `isonoise plugins` and the tables of host/docs/plugins.md.

To update the tables: `python -m isonoise.scene.parse.plugin_tables host/docs/plugins.md`.
"""

import re
import sys
from pathlib import Path

from isonoise.scene.vocabulary import PLUGINS, UNSUPPORTED_PLUGINS, plugins_of
from isonoise.scene.vocabulary.plugin import IGNORED, SUPPORTED, UNSUPPORTED, Child, Parameter, Plugin

KINDS = ("integrator", "sensor", "film", "rfilter", "sampler", "bsdf", "texture", "emitter", "shape")
KINDS += ("medium", "phase", "volume")
"""Kinds of plugins in the order of listings, without the scene itself."""

STATUS = {SUPPORTED: "supported", IGNORED: "ignored", UNSUPPORTED: "not supported"}
_TYPES = {
    "reflectance": "colour",
    "radiance": "colour",
    "unbounded": "colour",
    "index": "number or name",
    "float": "number",
    "integer": "whole number",
    "file": "file name",
    "positions": "array",
    "indices": "array",
    "raw": "number or vector",
    "grid": "array",
    "any": "",
}
_INTERVALS = {"reflectance": "[0, 1]", "radiance": "[0, inf)", "unbounded": "[0, inf)", "index": "(0, inf)"}
_BEGIN, _END = "<!-- plugins: begin -->", "<!-- plugins: end -->"


def list_plugins(kind: str) -> list[tuple[str, str, str]]:
    """(name, status, meaning) of all plugins of a kind, the supported ones first."""
    supported = [(plugin.name, STATUS[plugin.status], plugin.meaning) for plugin in plugins_of(kind).values()]
    return supported + [(name, STATUS[UNSUPPORTED], why) for name, why in UNSUPPORTED_PLUGINS.get(kind, {}).items()]


def plugin_info(plugin: Plugin) -> dict:
    """A plugin as a dict of plain values, for JSON."""
    return {
        "kind": plugin.kind,
        "name": plugin.name,
        "status": STATUS[plugin.status],
        "meaning": plugin.meaning,
        "parameters": [parameter_info(parameter) for parameter in plugin.parameters],
        "children": [_child_info(child) for child in plugin.children],
    }


def unsupported_plugin_info(kind: str, name: str) -> dict:
    """An unsupported plugin as a dict of plain values, for JSON."""
    return {"kind": kind, "name": name, "status": STATUS[UNSUPPORTED], "meaning": UNSUPPORTED_PLUGINS[kind][name]}


def parameter_info(parameter: Parameter) -> dict:
    """A parameter as strings: name, type, values, default, status, meaning; and whether a texture is allowed."""
    interval = parameter.interval or _INTERVALS.get(parameter.type, "")
    return {
        "name": parameter.name,
        "type": _TYPES.get(parameter.type, parameter.type),
        "values": ", ".join(parameter.choices) or interval,
        "default": "required" if parameter.required else parameter.unset or _format_default(parameter.default),
        "texture": parameter.texture,
        "status": STATUS[parameter.status],
        "meaning": parameter.meaning,
    }


def _child_info(child: Child) -> dict:
    return {"kind": child.kind, "min_count": child.min_count, "max_count": child.max_count, "types": list(child.types)}


def _format_default(value) -> str:
    """A default value as written in a scene file."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ", ".join(f"{number:g}" for number in value)
    return value if isinstance(value, str) else f"{value:g}"


def markdown_tables() -> str:
    """One table per kind with a row for each supported plugin, then a table of everything that is not supported."""
    lines = []
    for kind in KINDS:
        if not plugins_of(kind):
            continue
        lines += ["", f"### {kind}", "", "| plugin | what it is | parameters, defaults |", "|---|---|---|"]
        for plugin in plugins_of(kind).values():
            ignored = f" ({STATUS[IGNORED]})" if plugin.status == IGNORED else ""
            lines.append(f"| `{plugin.name}`{ignored} | {plugin.meaning} | {_markdown_parameters(plugin)} |")
    lines += ["", "### Not supported", "", "| kind | plugin | why, or what to do |", "|---|---|---|"]
    for kind in KINDS:
        names_by_reason: dict[str, list[str]] = {}
        for name, reason in UNSUPPORTED_PLUGINS.get(kind, {}).items():
            names_by_reason.setdefault(reason, []).append(f"`{name}`")
        lines += [f"| {kind} | {', '.join(names)} | {reason} |" for reason, names in names_by_reason.items()]
    for plugin in PLUGINS:
        lines += [
            f"| {plugin.kind} | `{parameter.name}` of `{plugin.name}` | {parameter.meaning} |"
            for parameter in plugin.parameters
            if parameter.status == UNSUPPORTED
        ]
    return re.sub(r"<(\w+)>", r"`<\1>`", "\n".join([*lines, ""]))  # Markdown would take them for HTML


def _markdown_parameters(plugin: Plugin) -> str:
    supported, ignored = [], []
    for parameter in plugin.parameters:
        default = parameter_info(parameter)["default"]
        if parameter.status == SUPPORTED:
            star = "\\*" if parameter.texture else ""
            supported.append(f"`{parameter.name}`{star}" + (f" {default}" if default else ""))
        elif parameter.status == IGNORED:
            ignored.append(f"`{parameter.name}`")
    if ignored:
        supported.append(f"{STATUS[IGNORED]}: {', '.join(ignored)}")
    return "; ".join(supported) or "-"


def update_tables(text: str) -> str:
    """The text of host/docs/plugins.md with current tables. Raises ValueError if it lacks the begin or end marker."""
    begin, end = text.index(_BEGIN) + len(_BEGIN), text.index(_END)
    return f"{text[:begin]}\n{markdown_tables()}\n{text[end:]}"


if __name__ == "__main__":
    for _file in map(Path, sys.argv[1:]):
        _file.write_text(update_tables(_file.read_text("utf-8")), "utf-8")
