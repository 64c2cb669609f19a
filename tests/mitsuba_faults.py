"""What Mitsuba (3.9.1) renders otherwise than its own documentation or another way to write the same has it.

Each was found as a difference from isonoise, and made sure of without it: `leave_out` says how. The random scenes are
written without, so that they compare what both mean to be the same.
"""

from xml.etree import ElementTree

_NEARLY_BLACK = "1e-05"
_BUMPY = ("bumpmap", "normalmap")


def leave_out(root: ElementTree.Element) -> None:
    """Changes a scene, with parameters as they are called since version 2, where Mitsuba is known to be at fault."""
    _show_a_sky(root)
    _mirror_no_bumps(root)
    _turn_no_textured_spheres(root)
    _bump_no_blends(root)
    for bump in _all(root, "bumpmap"):
        _turn_no_heights(bump)
        _bump_nothing_stretched(bump)


def _all(element: ElementTree.Element, *kinds: str) -> list[ElementTree.Element]:
    return [bsdf for bsdf in element.iter("bsdf") if bsdf.get("type") in kinds]


def _show_a_sky(root: ElementTree.Element) -> None:
    """A path that met nothing but what let it through is thrown away, with all light that it found at the masks on its
    way, unless there is a sky to see: a lone masked rectangle of opacity p under a point light is p^2 as bright as an
    opaque one, and p before a wall. A sky that is all but black keeps the light.
    """
    if not _all(root, "mask") or any(e.get("type") in ("constant", "envmap") for e in root.findall("emitter")):
        return
    for hide in root.findall("integrator/boolean[@name='hide_emitters']"):
        hide.set("value", "false")
    emitter = ElementTree.SubElement(root, "emitter", type="constant")
    ElementTree.SubElement(emitter, "rgb", name="radiance", value=_NEARLY_BLACK)


def _mirror_no_bumps(root: ElementTree.Element) -> None:
    """Mirrored meshes have their geometric normals turned, but not those that their files bring, and the normals of
    bumps are turned to the former: a bump of height 0 swaps both sides.

    And where dp/du goes along z, as on the floor of a cube that is not turned, a bump has no frame (see
    `_bump_nothing_stretched`): what is level there is black.
    """
    bumpy = {bsdf.get("id") for bsdf in root.findall("bsdf") if _all(bsdf, "bumpmap")}
    for shape in root.iter("shape"):
        to_world = shape.find("transform")
        if to_world is None or not (_all(shape, "bumpmap") or {ref.get("id") for ref in shape.findall("ref")} & bumpy):
            continue
        for scale in to_world.findall("scale"):
            if "-1" in scale.attrib.values():
                to_world.remove(scale)
        if to_world.find("rotate") is None:
            ElementTree.SubElement(to_world, "rotate", y="1", angle="8")


def _turn_no_textured_spheres(root: ElementTree.Element) -> None:
    """The point of a turned sphere that is asked for by its uv (`eval_parameterization`), as textured lights are
    sampled, may have another uv: sampling the light and meeting it differ by up to 10 %.
    """
    for shape in root.iter("shape"):
        if shape.get("type") == "sphere" and shape.find("emitter/texture") is not None:
            _without(shape.find("transform"), "rotate")


def _bump_no_blends(root: ElementTree.Element) -> None:
    """A blend of smooth and rough plastic under a normal map is up to 6 % darker than both under that map, added up."""
    for wrapper in _all(root, *_BUMPY):
        for around in list(wrapper.iter("bsdf")):
            for number, part in enumerate(around):
                while part.get("type") == "blendbsdf":
                    around[number] = part = part.find("bsdf")


def _turn_no_heights(bump: ElementTree.Element) -> None:
    """The slope (`eval_1_grad`) of an image that `to_uv` turns is not that of its heights, unless it is square."""
    for to_uv in bump.findall("texture/transform"):
        _without(to_uv, "rotate")


def _bump_nothing_stretched(bump: ElementTree.Element) -> None:
    """The frame of a bump is laid along dp/du in world space as if that was of the frame without the bump: what is
    stretched is stretched along another direction, even by a bump of height 0.
    """
    for bsdf in bump.iter("bsdf"):
        for tag in list(bsdf):
            if tag.get("name") in ("alpha_v", "anisotropic"):
                bsdf.remove(tag)
            elif tag.get("name") == "alpha_u":
                tag.set("name", "alpha")


def _without(element: ElementTree.Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)
