"""The extensions of glTF that isonoise reads or may ignore. Called by `read.py`."""

from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.report import ImportReport

_MAX_LISTED = 8  # extensions in a warning

# The modules that read these report what they cannot map.
_READ = {
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_texture_transform",
}
# These do not change the image of the default scene at rest.
_WITHOUT_EFFECT = {
    "AGI_articulations",
    "AGI_stk_metadata",
    "CESIUM_RTC",
    "EXT_instance_features",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "FB_geometry_metadata",
    "GODOT_single_root",
    "KHR_animation_pointer",
    "KHR_audio_emitter",
    "KHR_interactivity",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_physics_rigid_bodies",
    "KHR_implicit_shapes",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MOZ_hubs_components",
    "MSFT_audio_emitter",
    "MSFT_lod",
}
# What these add is one of two versions of the same data; the other one is read.
_WITH_FALLBACK = {
    "EXT_meshopt_compression",
    "EXT_texture_avif",
    "KHR_draco_mesh_compression",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "MSFT_packing_normalRoughnessMetallic",
    "MSFT_packing_occlusionRoughnessMetallic",
    "MSFT_texture_dds",
}
COMPRESSED_MESHES = ("KHR_draco_mesh_compression",)
ADVICE = {
    "KHR_draco_mesh_compression": "export the model without Draco compression",
    "EXT_meshopt_compression": "export the model without meshopt compression",
    "KHR_meshopt_compression": "export the model without meshopt compression",
    "KHR_texture_basisu": "export the model with PNG or JPEG images",
    "EXT_texture_avif": "export the model with PNG or JPEG images",
    "MSFT_texture_dds": "export the model with PNG or JPEG images",
}


def check_extensions(document: Document, report: ImportReport) -> None:
    """Raise SceneError if the file requires an unknown extension; report unknown optional ones, all in one text."""
    required = document.root.strings("extensionsRequired")
    for number, name in enumerate(required):
        if name not in _READ | _WITHOUT_EFFECT:
            advice = ADVICE.get(name, "export the model without it")
            place = f"extensionsRequired[{number}]"
            document.root.fail(place, f"the extension '{name[:80]}' is not supported; {advice}")
    used = dict.fromkeys(document.root.strings("extensionsUsed"))
    if "KHR_materials_variants" in used:
        report.use("material_variants")
    if "KHR_mesh_quantization" in used:
        report.use("compression")
    known = _READ | _WITHOUT_EFFECT | _WITH_FALLBACK
    unknown = [name[:80] for name in used if name not in known]
    if unknown:
        listed = ", ".join(unknown[:_MAX_LISTED]) + (", ..." if len(unknown) > _MAX_LISTED else "")
        report.limit("extensions", f"{listed} {'is' if len(unknown) == 1 else 'are'} unknown and ignored")
