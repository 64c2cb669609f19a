"""Transmission of glTF materials: thin sheets, glass with a volume, diffuse transmission. Called by `materials.py`.

Formats: KHR_materials_transmission, KHR_materials_volume, KHR_materials_diffuse_transmission.
"""

import math

import numpy as np

from isonoise.scene.formats.gltf.layers import index_of_refraction, opaque_base
from isonoise.scene.formats.gltf.surface import SurfaceContext, blend
from isonoise.scene.formats.mesh_shape import rgb

_PBR = "pbrMetallicRoughness"
_MIN_ATTENUATION = 1e-6  # a colour of 0 stands for this transmittance
_MAX_ABSORPTION = 1e12  # opaque at any size that 32-bit floats resolve
_MAX_SMOOTH_ROUGHNESS = 0.03  # alpha below 0.001, the smallest of the principled BSDF


def is_solid_glass(context: SurfaceContext) -> bool:
    """Whether light refracts into a volume below the surface."""
    return (
        context.material.factor("KHR_materials_transmission", "transmissionFactor", 0.0) > 0
        and context.material.factor("KHR_materials_volume", "thicknessFactor", 0.0) > 0
    )


def is_transmissive(context: SurfaceContext) -> bool:
    """Whether light passes through the surface, except by its opacity."""
    return (
        context.material.factor("KHR_materials_transmission", "transmissionFactor", 0.0) > 0
        or context.material.factor("KHR_materials_diffuse_transmission", "diffuseTransmissionFactor", 0.0) > 0
    )


def base_layer(context: SurfaceContext, base_colour: dict, **changes) -> dict:
    """The opaque base, with changes as for `opaque_base`, or a share of a transmitting one by the extensions."""
    part = "KHR_materials_transmission"
    transmission = context.number(part, "transmissionFactor", 0.0, "transmissionTexture")
    metallic = context.number(_PBR, "metallicFactor", 1.0, "metallicRoughnessTexture", 2)
    if metallic == 1 or transmission == 0:
        return _with_diffuse_transmission(context, base_colour, changes)
    roughness = context.number(_PBR, "roughnessFactor", 1.0, "metallicRoughnessTexture", 1)
    is_smooth = not isinstance(roughness, dict) and roughness <= _MAX_SMOOTH_ROUGHNESS
    if is_solid_glass(context):
        return _solid_glass(context, base_colour, transmission, metallic, roughness, is_smooth)
    if is_smooth:
        transmitting = {
            "type": "thindielectric",
            "int_ior": index_of_refraction(context),
            "ext_ior": 1.0,
            "specular_transmittance": base_colour,
        }
    else:
        transmitting = {
            "type": "principledthin",
            "base_color": base_colour,
            "roughness": roughness,
            "spec_trans": 1.0,
            "eta": index_of_refraction(context),
        }
    opaque = transmitting if transmission == 1 else opaque_base(context, base_colour, metallic=0.0)
    dielectric = blend(transmission, opaque, transmitting)
    return blend(metallic, dielectric, opaque_base(context, base_colour, metallic=1.0))


def _solid_glass(
    context: SurfaceContext, base_colour: dict, transmission, metallic, roughness, is_smooth: bool
) -> dict:
    """Glass with refraction. As in `principled`, the base colour tints a ray that enters and leaves once."""
    ior = index_of_refraction(context)
    if context.material.factor("KHR_materials_specular", "specularFactor", 1.0) != 1:
        context.limit("specular", "on glass with a volume, the specular factor is left out")
    if is_smooth and transmission == 1 and metallic == 0 and base_colour["type"] == "rgb":
        tint = rgb(np.sqrt(base_colour["value"]))
        return {"type": "dielectric", "int_ior": ior, "ext_ior": 1.0, "specular_transmittance": tint}
    return {
        "type": "principled",
        "base_color": base_colour,
        "metallic": metallic,
        "roughness": roughness,
        "spec_trans": transmission,
        "eta": ior,
    }


def interior_medium(context: SurfaceContext) -> dict | None:
    """The absorption inside glass with a volume: Beer's law with the attenuation colour at the attenuation distance."""
    part = "KHR_materials_volume"
    distance = context.material.factor(part, "attenuationDistance", math.inf)
    colour = np.clip(context.material.factors(part, "attenuationColor", 3, 1.0), _MIN_ATTENUATION, 1.0)
    if not is_solid_glass(context) or (colour == 1).all() or not 0 < distance < math.inf:
        return None
    absorption = np.minimum(-np.log(colour) / distance, _MAX_ABSORPTION)
    largest = float(absorption.max())  # Mitsuba 3 takes no rgb above 1
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb(absorption / largest), "scale": largest}


def _with_diffuse_transmission(context: SurfaceContext, base_colour: dict, changes: dict) -> dict:
    part = "KHR_materials_diffuse_transmission"
    opaque = opaque_base(context, base_colour, **changes)
    weight = context.number(part, "diffuseTransmissionFactor", 0.0, "diffuseTransmissionTexture", 3)
    if weight == 0:
        return opaque
    context.limit("transmission", "where light is transmitted diffusely, the specular reflection is weaker")
    colour = context.colour(part, "diffuseTransmissionColorFactor", 1.0, "diffuseTransmissionColorTexture")
    sheet = {"type": "principledthin", "base_color": colour, "diff_trans": 2.0}
    metallic = context.number(_PBR, "metallicFactor", 1.0, "metallicRoughnessTexture", 2)
    return opaque if metallic == 1 else blend(weight, opaque, sheet)
