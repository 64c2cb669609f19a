"""What the registry says, for people: the listing of `isonoise plugins` and the tables of host/docs/plugins.md.

`python -m isonoise.scene.parse.plugin_tables host/docs/plugins.md` writes these tables anew.
"""

import re
import sys
from pathlib import Path

from isonoise.scene.vocabulary import PLUGINS, UNSUPPORTED_PLUGINS, plugins_of
from isonoise.scene.vocabulary.plugin import IGNORED, SUPPORTED, UNSUPPORTED, Child, Parameter, Plugin

KINDS = ("integrator", "sensor", "film", "rfilter", "sampler", "bsdf", "texture", "emitter", "shape")
KINDS += ("medium", "phase", "volume")
"""Kinds of plugins in the order of listings; the scene itself is none of them."""

STATUS = {SUPPORTED: "supported", IGNORED: "read over", UNSUPPORTED: "not supported"}
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
    "any": "",
}
_INTERVALS = {"reflectance": "[0, 1]", "radiance": "[0, inf)", "unbounded": "[0, inf)", "index": "(0, inf)"}
_BEGIN, _END = "<!-- plugins: begin -->", "<!-- plugins: end -->"


def overview(kind: str) -> list[tuple[str, str, str]]:
    """(name, status, meaning) of all plugins of a kind, those that are read first."""
    here = [(plugin.name, STATUS[plugin.status], plugin.meaning) for plugin in plugins_of(kind).values()]
    return here + [(name, STATUS[UNSUPPORTED], reason) for name, reason in UNSUPPORTED_PLUGINS.get(kind, {}).items()]


def facts(plugin: Plugin) -> dict:
    """A plugin as a dict of plain values, for JSON."""
    return {
        "kind": plugin.kind,
        "name": plugin.name,
        "status": STATUS[plugin.status],
        "meaning": plugin.meaning,
        "parameters": [parameter_facts(parameter) for parameter in plugin.parameters],
        "children": [_child_facts(child) for child in plugin.children],
    }


def absent_facts(kind: str, name: str) -> dict:
    """The same of a plugin that is not supported."""
    return {"kind": kind, "name": name, "status": STATUS[UNSUPPORTED], "meaning": UNSUPPORTED_PLUGINS[kind][name]}


def parameter_facts(parameter: Parameter) -> dict:
    """A parameter as texts: name, type, values, default, whether it may be a texture, status, meaning."""
    interval = parameter.interval or _INTERVALS.get(parameter.type, "")
    return {
        "name": parameter.name,
        "type": _TYPES.get(parameter.type, parameter.type),
        "values": ", ".join(parameter.choices) or interval,
        "default": "required" if parameter.required else parameter.unset or _written(parameter.default),
        "texture": parameter.texture,
        "status": STATUS[parameter.status],
        "meaning": parameter.meaning,
    }


def _child_facts(child: Child) -> dict:
    return {"kind": child.kind, "least": child.least, "most": child.most, "types": list(child.types)}


def _written(value) -> str:
    """A default as a scene file has it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ", ".join(f"{number:g}" for number in value)
    return value if isinstance(value, str) else f"{value:g}"


def markdown() -> str:
    """The tables: a row a plugin, with the parameters that are read, then what is not supported."""
    lines = []
    for kind in KINDS:
        if not plugins_of(kind):
            continue
        lines += ["", f"### {kind}", "", "| plugin | what it is | parameters, defaults |", "|---|---|---|"]
        for plugin in plugins_of(kind).values():
            over = " (read over)" if plugin.status == IGNORED else ""
            lines.append(f"| `{plugin.name}`{over} | {plugin.meaning} | {_parameters(plugin)} |")
    lines += ["", "### Not supported", "", "| kind | plugin | why, or what to do |", "|---|---|---|"]
    for kind in KINDS:
        reasons: dict[str, list[str]] = {}
        for name, reason in UNSUPPORTED_PLUGINS.get(kind, {}).items():
            reasons.setdefault(reason, []).append(f"`{name}`")
        lines += [f"| {kind} | {', '.join(names)} | {reason} |" for reason, names in reasons.items()]
    for plugin in PLUGINS:
        lines += [
            f"| {plugin.kind} | `{parameter.name}` of `{plugin.name}` | {parameter.meaning} |"
            for parameter in plugin.parameters
            if parameter.status == UNSUPPORTED
        ]
    return re.sub(r"<(\w+)>", r"`<\1>`", "\n".join([*lines, ""]))  # or Markdown takes them for HTML


def _parameters(plugin: Plugin) -> str:
    read, over = [], []
    for parameter in plugin.parameters:
        fact = parameter_facts(parameter)
        if parameter.status == SUPPORTED:
            star = "\\*" if parameter.texture else ""
            read.append(f"`{parameter.name}`{star}" + (f" {fact['default']}" if fact["default"] else ""))
        elif parameter.status == IGNORED:
            over.append(f"`{parameter.name}`")
    text = "; ".join(read)
    if over:
        text += f"{'; ' if text else ''}read over: {', '.join(over)}"
    return text or "-"


def with_tables(text: str) -> str:
    """The text of host/docs/plugins.md with its tables as they have to be. Raises ValueError where it has no place for
    them."""
    begin, end = text.index(_BEGIN) + len(_BEGIN), text.index(_END)
    return f"{text[:begin]}\n{markdown()}\n{text[end:]}"


if __name__ == "__main__":
    for _file in map(Path, sys.argv[1:]):
        _file.write_text(with_tables(_file.read_text("utf-8")), "utf-8")
