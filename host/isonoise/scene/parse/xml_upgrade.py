"""Upgrades files of Mitsuba 0.x to Mitsuba 3's vocabulary, as Mitsuba 3.9 does (transform_upgrade in its parser).

Parameter names become snake_case, `diffuse_reflectance` of a diffuse bsdf becomes `reflectance`, and offsets and scales
of textures become a `to_uv`. Defaults are those of Mitsuba 3. Files of version 2 need no upgrade.
"""

import re

from isonoise.scene import transforms
from isonoise.scene.parse.elements import Element
from isonoise.scene.parse.xml_tags import Tag

_MAX_MAJOR_VERSION = 3
_MIN_UNCHANGED_VERSION = 2
_UV_PARAMETERS = ("uoffset", "voffset", "uscale", "vscale")
_REMOVED = {
    "camera": "write <sensor>",
    "luminaire": "write <emitter>",
    "srgb": "write <rgb> with linear values",
    "blackbody": "write <rgb> with linear values",
    "animation": "write a <transform>",
    "subsurface": "remove it, there is no replacement",
}


def needs_upgrade(root: Tag) -> bool:
    """Whether a file needs an upgrade. Raises SceneError if its version is missing or not supported."""
    if "version" not in root.attributes:
        root.raise_error('the root element needs a version, such as <scene version="3.0.0">')
    version = root.attributes["version"].strip()
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9}){0,2}", version):
        root.raise_error(f"'{version[:20]}' is not a version such as 3.0.0")
    major = int(version.split(".")[0])
    if major > _MAX_MAJOR_VERSION:
        root.raise_error(f"version {version} is not supported; isonoise reads files up to version {_MAX_MAJOR_VERSION}")
    return major < _MIN_UNCHANGED_VERSION


def upgrade_tag(tag: Tag):
    """Rename an element of an old file. Raises SceneError if Mitsuba 3 removed it."""
    if tag.name in _REMOVED:
        tag.raise_error(f"was removed in Mitsuba 3; {_REMOVED[tag.name]}")
    if tag.name == "lookAt":
        tag.name = "lookat"


def upgrade_element(element: Element):
    """Rename and convert the parameters of one object of an old file, in place."""
    entries, uv_values = [], {}
    for name, value, location in element.entries:
        name = snake_case(name)
        if name == "diffuse_reflectance" and element.type == "diffuse":
            name = "reflectance"
        if name not in _UV_PARAMETERS:
            entries.append((name, value, location))
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            location.raise_error(f"'{name}' has to be a number")
        if name in uv_values:
            location.raise_error(f"'{name}' is given twice")
        uv_values[name], last_location = value, location
    if uv_values:
        scale = transforms.scale((uv_values.get("uscale", 1.0), uv_values.get("vscale", 1.0), 1.0))
        offset = transforms.translate((uv_values.get("uoffset", 0.0), uv_values.get("voffset", 0.0), 0.0))
        entries.append(("to_uv", scale @ offset, last_location))
    element.entries = entries


def snake_case(name: str) -> str:
    """toWorld -> to_world, intIOR -> int_ior: split before each run of capitals that follows a lower-case letter."""
    return re.sub(r"(?<=[a-z])[A-Z]+", lambda match: "_" + match[0].lower(), name)
