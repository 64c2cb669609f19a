"""Public scenes of other formats, converted to Mitsuba 3 XML: Mitsuba and isonoise render the same pictures.

Seeds are fixed. False-alarm rates, the chance that a correct program fails under other seeds: 1 % for the blocks of a
scene, at most 0.8 % for its three image means.
"""

from pathlib import Path
from xml.etree import ElementTree

import pytest
import references

from isonoise.convert.convert import convert

SCENES = {
    "gltf/AlphaBlendModeTest/AlphaBlendModeTest.glb": 64,
    "gltf/BoxTextured/BoxTextured.glb": 64,
    "gltf/BoxVertexColors/BoxVertexColors.glb": 64,
    "gltf/Cameras/Cameras.gltf": 64,
    "gltf/EmissiveStrengthTest/EmissiveStrengthTest.glb": 64,
    "gltf/MetalRoughSpheresNoTextures/MetalRoughSpheresNoTextures.glb": 64,
    "gltf/NegativeScaleTest/NegativeScaleTest.glb": 64,
    "gltf/SimpleInstancing/SimpleInstancing.glb": 64,
    "gltf/TextureTransformMultiTest/TextureTransformMultiTest.glb": 64,
    "gltf/TransmissionTest/TransmissionTest.glb": 64,
    "gltf/TwoSidedPlane/TwoSidedPlane.gltf": 64,
    "obj/CornellBox-Original.obj": 64,
    "obj/CornellBox-Sphere.obj": 128,
    "obj/CornellBox-Water.obj": 128,
    "obj/spot.obj": 64,
    "obj/suzanne.obj": 64,
    "obj/teapot.obj": 64,
    "obj/water.obj": 128,
    "pbrt-coffee/pbrt/scene-v4.pbrt": 128,
    "pbrt-cornell-box/pbrt/scene-v4.pbrt": 128,
    "pbrt-cornell-box/scene-v4.pbrt": 128,
    "pbrt-volumetric-caustic/pbrt/scene-v4.pbrt": 128,
}
"""Files -> samples per pixel of a batch."""

BATCHES, SIZE, BLOCK = 16, (96, 96), 16


def adapt(path: Path) -> None:
    """Give a converted scene a box filter, because of the border, and rough thin sheets in place of clear ones.

    A `blendbsdf` with a delta part loses light in Mitsuba 3.9.1: black and a perfect mirror, half each, reflect 0.38 of
    a white environment.
    """
    tree = ElementTree.parse(path)
    for rfilter in tree.iter("rfilter"):
        rfilter.set("type", "box")
    for bsdf in tree.iter("bsdf") if tree.find(".//bsdf[@type='blendbsdf']") is not None else ():
        if bsdf.get("type") == "thindielectric":
            bsdf.set("type", "principledthin")
            for part in list(bsdf):
                if part.get("name") == "specular_transmittance":
                    part.set("name", "base_color")
                else:
                    bsdf.remove(part)
            for name, value in (("spec_trans", "1"), ("roughness", "0.3")):
                ElementTree.SubElement(bsdf, "float", name=name, value=value)
    tree.write(path)


def test_no_scene_is_left_out(public_scenes):
    found = {
        str(path.relative_to(public_scenes))
        for pattern in ("gltf/*/*.gl*", "obj/*.obj", "pbrt-*/**/*.pbrt")
        for path in public_scenes.glob(pattern)
    }
    assert found == set(SCENES)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", SCENES)
def test_mitsuba_renders_the_same_picture(public_scenes, tmp_path, name):
    """Means of blocks of 16 x 16 pixels, and of the image to 1 %."""
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    path = tmp_path / "scene.xml"
    converted = convert(public_scenes / name, path, size=SIZE)
    adapt(path)
    theirs = references.mitsuba_batches(path, SCENES[name], BATCHES, tmp_path, files=converted.files)
    ours = references.wave_batches(path, SCENES[name], BATCHES)
    image, reference = (references.from_batches(references.block_means(b, BLOCK)) for b in (ours, theirs))
    references.assert_agree(image, reference, tmp_path, share=1.0, rounding=1e-3)
    references.assert_means_agree(references.from_batches(ours), references.from_batches(theirs), relative=0.01)
