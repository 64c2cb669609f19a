"""glTF: pictures of small models, against what geometry says they have to show."""

import numpy as np
import pytest
from gltf_files import read_file
from gltf_material_files import MaterialFile, pbr

import isonoise
from isonoise.scene import transforms

pytestmark = pytest.mark.long

# a surface that leans towards the top of the image: its normal is (0, sin, cos) of 45 degrees, green is up
LEANING = np.tile(np.round(255 * (np.array([0, 0.7071, 0.7071]) + 1) / 2).astype(np.uint8), (4, 4, 1))
LEANING[0, 0] = 0  # an image of one colour would be no texture
UPRIGHT = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "f4")
QUARTER_TURN = {"extensions": {"KHR_texture_transform": {"rotation": np.pi / 2}}}
CASES = {  # texture coordinates, node, texture, direction on the surface to which its normal leans, camera's side
    "upright": (UPRIGHT, {}, {}, (0, 1, 0), 1),
    "mirrored coordinates": (UPRIGHT * np.array([-1, 1], "f4"), {}, {}, (0, 1, 0), 1),
    "upside down": (UPRIGHT * np.array([1, -1], "f4"), {}, {}, (0, -1, 0), 1),
    "turned mesh": (UPRIGHT[:, ::-1] * np.array([-1, 1], "f4"), {}, {}, (-1, 0, 0), 1),
    "turned image": (UPRIGHT, {}, QUARTER_TURN, (1, 0, 0), 1),
    "mirrored node": (UPRIGHT, {"scale": [-1, 1, 1], "translation": [1, 0, 0]}, {}, (0, 1, 0), 1),
    "node upside down": (UPRIGHT, {"scale": [1, -1, 1], "translation": [0, 1, 0]}, {}, (0, -1, 0), 1),
    "from behind": (UPRIGHT, {}, {}, (0, -1, 0), -1),
}


def light_from(direction, bsdf_shape: dict, side: int) -> float:
    """The mean radiance under parallel light from a direction in the plane and from the front, at 45 degrees."""
    towards = -np.array(direction, float) - [0, 0, side]
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "shape": bsdf_shape,
        "light": {"type": "directional", "direction": towards.tolist(), "irradiance": 1.0},
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "to_world": transforms.look_at((0.5, 0.5, 4 * side), (0.5, 0.5, 0), (0, 1, 0)),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        },
    }
    return float(np.asarray(isonoise.render(scene, spp=16).rgb)[2:6, 2:6].mean())


@pytest.mark.parametrize("case", CASES)
def test_normal_maps_lean_the_right_way(tmp_path, case):
    """A surface is brightest under the light that it leans to. From behind, its normal is the opposite one."""
    uvs, node, texture, leans_to, side = CASES[case]
    material = {"normalTexture": {"index": 0} | texture} | pbr(metallicFactor=0, roughnessFactor=1)
    file = MaterialFile(material, LEANING, TEXCOORD_0=uvs)
    file.content["nodes"][0] |= node
    scene, _ = read_file(file, tmp_path)
    (shape,) = (part for part in scene.values() if isinstance(part, dict) and part["type"] == "mesh")
    assert shape["bsdf"]["type"] == "normalmap"
    lights = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
    levels = [light_from(direction, shape, side) for direction in lights]
    assert lights[int(np.argmax(levels))] == leans_to, levels
    assert min(levels) < 0.05 * max(levels)  # the opposite light is behind the leaning surface


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], "f4")
CUBE_FACES = [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
    *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
]


def test_volumes_absorb_as_their_colour_says(tmp_path):
    """Through a cube of index 1: the base colour once, and the attenuation colour to the power of depth / distance."""
    volume = {"thicknessFactor": 1, "attenuationDistance": 0.5, "attenuationColor": [0.9, 0.5, 0.2]}
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": volume,
        "KHR_materials_ior": {"ior": 1.0},
    }
    smooth = pbr(metallicFactor=0, roughnessFactor=0, baseColorFactor=[1, 0.5, 0.8, 1])
    file = MaterialFile(smooth | {"extensions": extensions})
    file.content["nodes"] = [{"mesh": file.mesh(CUBE, np.ravel(CUBE_FACES), material=0)}]
    scene, report = read_file(file, tmp_path)
    assert report.warnings() == []
    scene["integrator"] = {"type": "volpath", "max_depth": 8}
    scene["light"] = {"type": "constant", "radiance": 1.0}
    scene["sensor"] = {
        "type": "perspective",
        "fov": 0.1,
        "to_world": transforms.look_at((0.5, 0.5, 9), (0.5, 0.5, 0), (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }
    image = np.asarray(isonoise.render(scene, spp=1024).rgb)
    expected = np.array([1, 0.5, 0.8]) * np.array([0.9, 0.5, 0.2]) ** 2
    error = image.mean(axis=(0, 1)) / expected - 1
    assert np.abs(error).max() < 0.015, error  # six standard errors: absorption is sampled
