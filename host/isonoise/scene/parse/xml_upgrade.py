"""Files of Mitsuba 0.x, upgraded to Mitsuba 3's vocabulary as it does so itself (transform_upgrade of its parser, 3.9).

Names of parameters become snake_case, `diffuse_reflectance` of a diffuse bsdf `reflectance`, offsets and scales of
textures a `to_uv`. Defaults are Mitsuba 3's own. Files of version 2 read like those of version 3.
"""

import re

from isonoise.scene import transforms
from isonoise.scene.parse.elements import Element
from isonoise.scene.parse.xml_tags import Tag

_NEWEST = 3  # major version
_FIRST_UNCHANGED = 2
_UV = ("uoffset", "voffset", "uscale", "vscale")
_GONE = {
    "camera": "write <sensor>",
    "luminaire": "write <emitter>",
    "srgb": "write <rgb> with linear values",
    "blackbody": "write <rgb> with linear values",
    "animation": "write the <transform> of one moment",
    "subsurface": "there is no replacement for it",
}


def is_old(root: Tag) -> bool:
    """Whether a file has to be upgraded. Raises SceneError where its version is missing or not known."""
    if "version" not in root.attributes:
        root.location.raise_error('the root element lacks its version, such as <scene version="3.0.0">')
    version = root.attributes["version"].strip()
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9}){0,2}", version):
        root.location.raise_error(f"'{version[:20]}' is not a version; an example is 3.0.0")
    major = int(version.split(".")[0])
    if major > _NEWEST:
        root.location.raise_error(f"version {version} is not read; isonoise reads files up to version {_NEWEST}")
    return major < _FIRST_UNCHANGED


def upgrade_tags(root: Tag):
    """Rename elements of an old file; complain about those that Mitsuba 3 has no more."""
    queue = [root]
    while queue:
        tag = queue.pop()
        if tag.name in _GONE:
            tag.location.raise_error(
                f"belongs to Mitsuba 0.x, and Mitsuba 3 does not read it either; {_GONE[tag.name]}"
            )
        if tag.name == "lookAt":
            tag.name = "lookat"
        queue.extend(reversed(tag.children))


def upgrade_element(element: Element):
    """Rename and convert the parameters of one object of an old file, in place."""
    entries, moved = [], {}
    for name, value, location in element.entries:
        name = snake_case(name)
        if name == "diffuse_reflectance" and element.type == "diffuse":
            name = "reflectance"
        if name not in _UV:
            entries.append((name, value, location))
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            location.raise_error(f"'{name}' is a number")
        if name in moved:
            location.raise_error(f"'{name}' is given twice")
        moved[name], last = value, location
    if moved:
        scale = transforms.scale((moved.get("uscale", 1.0), moved.get("vscale", 1.0), 1.0))
        offset = transforms.translate((moved.get("uoffset", 0.0), moved.get("voffset", 0.0), 0.0))
        entries.append(("to_uv", scale @ offset, last))
    element.entries = entries


def snake_case(name: str) -> str:
    """toWorld -> to_world, intIOR -> int_ior: every run of capitals after a small letter."""
    return re.sub(r"(?<=[a-z])[A-Z]+", lambda match: "_" + match[0].lower(), name)
