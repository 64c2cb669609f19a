"""What a format's features are, and how far each is supported. Every format has a table of `Support` by feature.

`ImportReport` takes its words from these tables; `tables.py` makes scenes/formats.md from them.
"""

from typing import NamedTuple

YES, PARTLY, NO = "yes", "partly", "no"

FEATURES = {
    "triangles": "triangles",
    "polygons": "polygons",
    "strips_fans": "triangle strips and fans",
    "lines_points": "lines and points",
    "quadrics": "spheres, disks, cylinders",
    "curves": "curves and subdivision surfaces",
    "normals": "vertex normals",
    "uvs": "texture coordinates",
    "uv_sets": "several sets of texture coordinates",
    "tangents": "tangents",
    "vertex_colours": "vertex colours",
    "compression": "compressed meshes",
    "scene_graph": "transforms",
    "instances": "instances",
    "animation": "animation, skins, morph targets",
    "includes": "files that it names",
    "diffuse": "diffuse colour",
    "metal": "metal",
    "roughness": "roughness",
    "one_sided": "single-sided surfaces",
    "specular": "specular reflection",
    "emission": "emission",
    "opacity": "opacity",
    "transmission": "transmission",
    "volume": "absorption inside",
    "media": "scattering media",
    "clearcoat": "clearcoat",
    "sheen": "sheen",
    "anisotropy": "anisotropy",
    "iridescence": "iridescence",
    "dispersion": "dispersion",
    "unlit": "unlit materials",
    "mixed_materials": "mixed materials",
    "measured_materials": "measured materials, hair, subsurface scattering",
    "material_variants": "material variants",
    "textures": "image textures",
    "procedural_textures": "procedural textures",
    "texture_transform": "texture transforms",
    "texture_sampler": "wrapping and filtering",
    "normal_map": "normal maps",
    "bump_map": "bump maps, displacement",
    "occlusion_map": "occlusion maps",
    "cameras": "cameras",
    "film": "film, sampler, integrator settings",
    "point_lights": "point lights",
    "spot_lights": "spot lights",
    "projected_lights": "lights with images",
    "directional_lights": "directional lights",
    "environment": "environment lights",
    "spectra": "spectra",
    "extensions": "other extensions",
}
"""Title of each feature, in the order of tables."""


class Support(NamedTuple):
    """How far a format's feature is supported."""

    status: str  # YES, PARTLY or NO
    note: str = ""  # what it becomes in Mitsuba 3's vocabulary; what is missing; why not
