"""Converts glTF materials of KHR_materials_pbrSpecularGlossiness to metallic-roughness. Called by `materials.py`.

Conversion: Khronos Group, "convert-between-workflows", in the examples of that extension.
"""

from dataclasses import replace

import numpy as np

from isonoise.scene.formats.bitmaps import Sampling
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.surface import Material
from isonoise.scene.formats.gltf.textures import MaterialTexture, MaterialTextures
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image

_EXTENSION = "KHR_materials_pbrSpecularGlossiness"
_PBR = "pbrMetallicRoughness"
_DIELECTRIC = 0.04  # reflectance at normal incidence of the metallic-roughness model
_LUMA = np.array([0.299, 0.587, 0.114])  # of perceived brightness
_MIN_DIVISOR = 1e-6
_ROWS = 256  # of an image that are converted at a time


def as_metallic_roughness(material: Material, textures: MaterialTextures, report: ImportReport) -> Material:
    """The material with a metallic-roughness model, unless it has one or lacks the extension."""
    values = material.values.extension(_EXTENSION)
    if values is None or _PBR in material.values:
        return material
    report.limit("specular", "specular and glossiness are converted to metallic and roughness", material.place)
    diffuse = np.clip(values.numbers("diffuseFactor", 4, (1.0,) * 4), 0.0, 1.0)
    specular = np.clip(values.numbers("specularFactor", 3, (1.0,) * 3), 0.0, 1.0)
    glossiness = min(max(values.number("glossinessFactor", 1.0), 0.0), 1.0)
    diffuse_texture = textures.read(values, "diffuseTexture")
    specular_texture = textures.read(values, "specularGlossinessTexture")
    if diffuse_texture is None and specular_texture is None:
        base, metallic = _convert(diffuse[:3], specular)
        return _with_model(material, [*base, diffuse[3]], float(metallic), 1.0 - glossiness)
    if diffuse_texture and specular_texture and _coordinates(diffuse_texture) != _coordinates(specular_texture):
        problem = "its two textures are read with the sampler and the coordinates of one"
        report.limit("texture_transform", problem, material.place)
    base, packed = textures.bitmaps.once(
        ("specular-glossiness", material.place),
        lambda: _convert_images(diffuse_texture, specular_texture, diffuse[:3], specular, glossiness),
    )
    source = diffuse_texture or specular_texture
    converted = _with_model(material, [1.0, 1.0, 1.0, diffuse[3]], 1.0, 1.0)
    images = {"baseColorTexture": base, "metallicRoughnessTexture": packed}
    return replace(
        converted, textures=material.textures | {name: replace(source, image=image) for name, image in images.items()}
    )


def _coordinates(texture: MaterialTexture) -> tuple[Sampling, int]:
    return texture.sampling, texture.uv_set


def _with_model(material: Material, colour: list[float], metallic: float, roughness: float) -> Material:
    factors = [float(channel) for channel in colour]
    model = {"baseColorFactor": factors, "metallicFactor": metallic, "roughnessFactor": roughness}
    values = material.values
    return replace(material, values=JsonObject(values.file, values.place, values.values | {_PBR: model}))


def _convert(diffuse: np.ndarray, specular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(base colour (..., 3), metallic (...)) of linear diffuse and specular colours (..., 3)."""
    rest = 1.0 - specular.max(axis=-1, keepdims=True)
    bright_diffuse, bright_specular = (np.sqrt(colour**2 @ _LUMA)[..., None] for colour in (diffuse, specular))
    b = bright_diffuse * rest / (1.0 - _DIELECTRIC) + bright_specular - 2.0 * _DIELECTRIC
    discriminant = np.maximum(b**2 - 4.0 * _DIELECTRIC * (_DIELECTRIC - bright_specular), 0.0)
    metallic = np.clip((np.sqrt(discriminant) - b) / (2.0 * _DIELECTRIC), 0.0, 1.0)
    metallic = np.where(bright_specular <= _DIELECTRIC, 0.0, metallic)
    from_diffuse = diffuse * rest / (1.0 - _DIELECTRIC) / np.maximum(1.0 - metallic, _MIN_DIVISOR)
    from_specular = (specular - _DIELECTRIC * (1.0 - metallic)) / np.maximum(metallic, _MIN_DIVISOR)
    base = from_diffuse + metallic**2 * (from_specular - from_diffuse)
    return np.clip(base, 0.0, 1.0), metallic[..., 0]


def _convert_images(
    diffuse_texture: MaterialTexture | None,
    specular_texture: MaterialTexture | None,
    diffuse: np.ndarray,
    specular: np.ndarray,
    glossiness: float,
) -> tuple[Image, Image]:
    """(base colour with the alpha of the diffuse image, roughness in green and metallic in blue), linear floats.

    They have the size of the larger image.
    """
    images = [texture.image for texture in (diffuse_texture, specular_texture) if texture]
    size = max((image.pixels.shape[:2] for image in images), key=np.prod)
    diffuse_image, diffuse_alpha = _planes(diffuse_texture, size)
    specular_image, specular_alpha = _planes(specular_texture, size)
    base, packed = np.zeros((*size, 3), np.float32), np.zeros((*size, 3), np.float32)
    for begin in range(0, size[0], _ROWS):
        rows = slice(begin, begin + _ROWS)
        base[rows], packed[rows, :, 2] = _convert(diffuse * diffuse_image[rows], specular * specular_image[rows])
        packed[rows, :, 1] = 1.0 - glossiness * specular_alpha[rows, :, 0]
    has_alpha = diffuse_texture is not None and diffuse_texture.image.alpha is not None
    return Image(base, np.ascontiguousarray(diffuse_alpha) if has_alpha else None), Image(packed)


def _planes(texture: MaterialTexture | None, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Linear colour (height, width, 3) and alpha (height, width, 1) at a size; ones for what is missing."""
    colour = alpha = np.ones((1, 1, 1), np.float32)
    if texture:
        colour = texture.image.linear()
        alpha = alpha if texture.image.alpha is None else Image(texture.image.alpha).linear(raw=True)
    return np.broadcast_to(_resize(colour, size), (*size, 3)), _resize(alpha, size)


def _resize(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The nearest pixels of a larger or smaller size."""
    if pixels.shape[:2] == size:
        return pixels
    rows, columns = (np.arange(new) * old // new for new, old in zip(size, pixels.shape[:2], strict=True))
    return pixels[rows][:, columns]
