"""Public scenes of other formats, converted to Mitsuba 3 XML: Mitsuba and isonoise render the same pictures.

Seeds are fixed. False-alarm rates, the chance that a correct program fails under other seeds: 1 % for the blocks of a
scene, at most 0.8 % for its three image means.
"""

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
    """Means of blocks of 16 x 16 pixels, and of the image to 1 %. With a box filter borders are the same."""
    pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    path = tmp_path / "scene.xml"
    converted = convert(public_scenes / name, path, size=SIZE)
    text = path.read_text("utf-8")
    path.write_text(text.replace('<rfilter type="gaussian"/>', '<rfilter type="box"/>'), "utf-8")
    theirs = references.mitsuba_batches(path, SCENES[name], BATCHES, tmp_path, files=converted.files)
    ours = references.wave_batches(path, SCENES[name], BATCHES)
    image, reference = (references.from_batches(references.block_means(b, BLOCK)) for b in (ours, theirs))
    references.assert_agree(image, reference, tmp_path, share=1.0, rounding=1e-3)
    references.assert_means_agree(references.from_batches(ours), references.from_batches(theirs), relative=0.01)
