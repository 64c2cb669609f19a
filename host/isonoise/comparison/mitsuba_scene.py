"""Writes a scene as XML for Mitsuba 3, with the size, depth and sampler of the comparison."""

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.builtin import find_scene


def mitsuba_xml(source: Path, sampler: str, size: tuple[int, int] | None, max_depth: int | None) -> str:
    """XML text of a scene: the path integrator with isonoise's depth and roulette, an RGB film of the same size and
    filter, `sampler`, absolute file names. Raises SceneError if the file is not XML or has no sensor itself."""
    from defusedxml.ElementTree import parse

    path = find_scene(source)
    if path.suffix.lower() != ".xml":
        raise SceneError(f"{path}: Mitsuba 3 reads .xml scenes only; remove the scene from this comparison")
    # the caller has loaded the scene under the rule of --allow-outside
    compiled = compile_scene(load_description(source, allow_outside=True), size=size, max_depth=max_depth)
    root = parse(path).getroot()
    sensor = root.find("sensor")
    if sensor is None:
        raise SceneError(f"{path}: has no sensor in the file itself, which a comparison with Mitsuba 3 needs; add one")

    for old in root.findall("integrator"):
        root.remove(old)
    integrator = Element("integrator", type="path")
    _set(integrator, "integer", "max_depth", compiled.max_depth)
    _set(integrator, "integer", "rr_depth", compiled.rr_depth)
    _set(integrator, "boolean", "hide_emitters", str(compiled.hide_emitters).lower())
    root.append(integrator)

    for old in sensor.findall("sampler"):
        sensor.remove(old)
    SubElement(sensor, "sampler", type=sampler)
    film = sensor.find("film")
    if film is None:
        film = SubElement(sensor, "film", type="hdrfilm")
    _set(film, "string", "pixel_format", "rgb")
    if size is not None:
        for name in ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y"):
            _remove(film, name)
        _set(film, "integer", "width", size[0])
        _set(film, "integer", "height", size[1])

    for element in root.iter():
        for key in ("value", "filename"):
            is_file = element.tag == "include" or element.tag == "path" or element.get("name") == "filename"
            if is_file and key in element.attrib and (path.parent / element.get(key)).exists():
                element.set(key, str((path.parent / element.get(key)).resolve()))
    return tostring(root, encoding="unicode")


def _set(parent: Element, kind: str, name: str, value: object) -> None:
    _remove(parent, name)
    SubElement(parent, kind, name=name, value=str(value))


def _remove(parent: Element, name: str) -> None:
    first, *others = name.split("_")
    camel_case = first + "".join(word.capitalize() for word in others)
    for old in [child for child in parent if child.get("name") in (name, camel_case)]:
        parent.remove(old)
