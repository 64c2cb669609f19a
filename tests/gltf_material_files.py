"""Builds small glTF files with one material, for tests, and finds what the material became."""

import io

import numpy as np
import PIL.Image
from gltf_files import QUAD, Gltf, read_file, shapes_of

from isonoise.scene.spectra import srgb_to_linear

RNG = np.random.default_rng(5)
COLOURS = RNG.integers(0, 256, (4, 4, 3), np.uint8)
ALPHA = RNG.integers(0, 256, (4, 4, 1), np.uint8)
RGBA = np.concatenate([COLOURS, ALPHA], axis=2)
UVS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "f4")
WHITE = {"type": "rgb", "value": [1.0, 1.0, 1.0]}
PLASTIC = {"pbrMetallicRoughness": {"metallicFactor": 0.0}}


class MaterialFile(Gltf):
    """A file with a square that shows one material."""

    def __init__(self, material: dict, *images: np.ndarray, sampler: dict | None = None, **attributes):
        super().__init__(materials=[material])
        for number, pixels in enumerate(images):
            data = io.BytesIO()
            PIL.Image.fromarray(pixels.squeeze()).save(data, "PNG")
            self.add("images", bufferView=self.view(data.getvalue()), mimeType="image/png")
            self.add("textures", source=number, **({"sampler": self.add("samplers", **sampler)} if sampler else {}))
        self.node(mesh=self.mesh(QUAD, [0, 1, 2, 0, 2, 3], attributes={"TEXCOORD_0": UVS} | attributes, material=0))

    def shapes(self, folder) -> list[dict]:
        """The shapes of the file, which have to give a scene without warnings."""
        scene, report = read_file(self, folder)
        assert report.warnings() == []
        return shapes_of(scene)

    def shape(self, folder) -> dict:
        (shape,) = self.shapes(folder)
        return shape

    def bsdf(self, folder) -> dict:
        return self.shape(folder)["bsdf"]


def linear(pixels: np.ndarray) -> np.ndarray:
    return srgb_to_linear(pixels / 255)


def warnings_of(file: Gltf, folder) -> str:
    return "\n".join(read_file(file, folder)[1].warnings())


def pbr(**values) -> dict:
    return {"pbrMetallicRoughness": values}


def extended(extension: str, values: dict, material: dict = PLASTIC) -> dict:
    return material | {"extensions": {f"KHR_materials_{extension}": values}}


def inside(bsdf: dict, *types: str) -> dict:
    """The BSDF inside wrappers of these types."""
    for type_ in types:
        assert bsdf["type"] == type_
        bsdf = bsdf["bsdf"]
    return bsdf


def rich_material_file() -> MaterialFile:
    """A file with everything that materials can have: one with all layers, one of glass with a volume, an old one."""
    layers = {
        "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatNormalTexture": {"index": 0}},
        "KHR_materials_sheen": {"sheenColorFactor": [1, 1, 1], "sheenColorTexture": {"index": 0}},
        "KHR_materials_specular": {"specularFactor": 0.5, "specularColorTexture": {"index": 0}},
        "KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": {"index": 0}},
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.4},
        "KHR_materials_emissive_strength": {"emissiveStrength": 2},
    }
    transform = {"offset": [0.5, 0], "scale": [2, 1], "rotation": 0.3}
    textures = {
        "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": transform}},
        "metallicRoughnessTexture": {"index": 0, "texCoord": 0},
    }
    material = pbr(**textures) | {
        "normalTexture": {"index": 0, "scale": 0.3},
        "emissiveTexture": {"index": 0},
        "emissiveFactor": [1, 1, 1],
        "alphaMode": "MASK",
        "alphaCutoff": 0.4,
        "doubleSided": True,
        "extensions": layers,
    }
    colours = np.repeat(np.array([[0.1], [0.4], [0.7], [1.0]], "f4"), 3, axis=1)
    sampler = {"wrapS": 33071, "wrapT": 33648, "magFilter": 9729}
    file = MaterialFile(material, RGBA, sampler=sampler, COLOR_0=colours)
    volume = {"thicknessFactor": 1, "attenuationDistance": 1, "attenuationColor": [0.5, 0.5, 0.5]}
    refracting = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": volume}
    glass = file.add("materials", **PLASTIC, extensions=refracting | {"KHR_materials_ior": {"ior": 1.4}})
    glossy = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 0}, "glossinessFactor": 0.5}
    old = file.add("materials", extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    for index in (glass, glass, old):
        file.node(mesh=file.mesh(QUAD, [0, 1, 2, 0, 2, 3], attributes={"TEXCOORD_0": UVS}, material=index))
    return file
