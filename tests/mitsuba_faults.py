"""Known faults of Mitsuba (3.9.1): cases in which it contradicts its documentation or itself.

Each was found as a difference from isonoise and confirmed with Mitsuba alone, as the functions below describe. The
random scenes avoid them.
"""

from xml.etree import ElementTree

_NEARLY_BLACK = "1e-05"
_BUMP_TYPES = ("bumpmap", "normalmap")


def avoid_faults(root: ElementTree.Element) -> None:
    """Change a scene, with parameter names of version 2 and later, so that it avoids the faults."""
    _add_environment_to_masks(root)
    _remove_mirrored_bumps(root)
    _remove_rotated_textured_spheres(root)
    _remove_blends_in_bumps(root)
    for bump in _bsdfs_of_type(root, "bumpmap"):
        _remove_rotated_heights(bump)
        _remove_anisotropic_bumps(bump)


def _bsdfs_of_type(element: ElementTree.Element, *kinds: str) -> list[ElementTree.Element]:
    return [bsdf for bsdf in element.iter("bsdf") if bsdf.get("type") in kinds]


def _add_environment_to_masks(root: ElementTree.Element) -> None:
    """A path that passes only through masks and then escapes is dropped with all direct light found at the masks,
    unless the scene has an environment emitter. So a masked rectangle of opacity p under a point light is p^2 as bright
    as an opaque one, but p in front of a wall. A nearly black environment avoids this.
    """
    if not _bsdfs_of_type(root, "mask") or any(
        e.get("type") in ("constant", "envmap") for e in root.findall("emitter")
    ):
        return
    for hide in root.findall("integrator/boolean[@name='hide_emitters']"):
        hide.set("value", "false")
    emitter = ElementTree.SubElement(root, "emitter", type="constant")
    ElementTree.SubElement(emitter, "rgb", name="radiance", value=_NEARLY_BLACK)


def _remove_mirrored_bumps(root: ElementTree.Element) -> None:
    """Mirroring flips a mesh's geometric normals but not the normals in its file, and bump maps flip their normals to
    the geometric ones: a bump of height 0 swaps both sides.

    Where dp/du is along z, as on the floor of an unrotated cube, a bump map has no frame (see
    `_remove_anisotropic_bumps`), and level parts are black.
    """
    bumpy = {bsdf.get("id") for bsdf in root.findall("bsdf") if _bsdfs_of_type(bsdf, "bumpmap")}
    for shape in root.iter("shape"):
        to_world = shape.find("transform")
        if to_world is None or not (
            _bsdfs_of_type(shape, "bumpmap") or {ref.get("id") for ref in shape.findall("ref")} & bumpy
        ):
            continue
        for scale in to_world.findall("scale"):
            if "-1" in scale.attrib.values():
                to_world.remove(scale)
        if to_world.find("rotate") is None:
            ElementTree.SubElement(to_world, "rotate", y="1", angle="8")


def _remove_rotated_textured_spheres(root: ElementTree.Element) -> None:
    """On a rotated sphere, the point that `eval_parameterization` returns for a uv may have another uv. Textured
    emitters are sampled with it, so light sampling and hits of the light differ by up to 10 %.
    """
    for shape in root.iter("shape"):
        if shape.get("type") == "sphere" and shape.find("emitter/texture") is not None:
            _remove_children(shape.find("transform"), "rotate")


def _remove_blends_in_bumps(root: ElementTree.Element) -> None:
    """A blend of smooth and rough plastic in a normal map is up to 6 % darker than their weighted sum in that map."""
    for wrapper in _bsdfs_of_type(root, *_BUMP_TYPES):
        for around in list(wrapper.iter("bsdf")):
            for number, part in enumerate(around):
                while part.get("type") == "blendbsdf":
                    around[number] = part = part.find("bsdf")


def _remove_rotated_heights(bump: ElementTree.Element) -> None:
    """With a rotation in `to_uv`, the gradient (`eval_1_grad`) is wrong unless the image is square."""
    for to_uv in bump.findall("texture/transform"):
        _remove_children(to_uv, "rotate")


def _remove_anisotropic_bumps(bump: ElementTree.Element) -> None:
    """The frame of a bump map is built from dp/du in world space as if it were in the local frame. So anisotropic bsdfs
    are rotated, even by a bump of height 0.
    """
    for bsdf in bump.iter("bsdf"):
        for tag in list(bsdf):
            if tag.get("name") in ("alpha_v", "anisotropic"):
                bsdf.remove(tag)
            elif tag.get("name") == "alpha_u":
                tag.set("name", "alpha")


def _remove_children(element: ElementTree.Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)
