"""How far glTF 2.0 is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import NO, PARTLY, YES, Support

SUPPORT = {
    "triangles": Support(YES, "`mesh`"),
    "strips_fans": Support(YES, "`mesh`"),
    "lines_points": Support(NO, "they have no surface and are left out"),
    "normals": Support(YES, "vertex normals; flat shading without"),
    "uvs": Support(YES, "texture coordinates of the mesh"),
    "uv_sets": Support(PARTLY, "a mesh has one set: the one that its material needs"),
    "tangents": Support(PARTLY, "computed from the texture coordinates; those of the file are ignored"),
    "vertex_colours": Support(
        PARTLY, "COLOR_0 as `mesh_attribute` vertex_color, times the base colour; over a texture only their luminance"
    ),
    "compression": Support(PARTLY, "KHR_mesh_quantization and sparse accessors; not Draco, not meshopt"),
    "scene_graph": Support(YES, "the default scene; cameras and lights keep their size under scale"),
    "instances": Support(YES, "copies of a mesh become instances if that saves 100,000 triangles"),
    "animation": Support(
        PARTLY, "shown at rest: animations are not played; skins in rest pose, morph targets with their default weights"
    ),
    "includes": Support(YES, "buffers and images in files inside the folder of the scene, or in data URIs"),
    "diffuse": Support(YES, "`principled` base_color: factor, texture, vertex colours; Burley's lobe, not Lambert's"),
    "metal": Support(YES, "`principled` metallic: factor and texture"),
    "roughness": Support(YES, "`principled` roughness: factor and texture"),
    "one_sided": Support(PARTLY, "they are visible from both sides, as `twosided`; rasterisers leave out their backs"),
    "specular": Support(
        PARTLY,
        "`principled` eta from KHR_materials_ior and _specular; specularFactor as `blendbsdf`; "
        "reflection of dielectrics has no colour; KHR_materials_pbrSpecularGlossiness becomes metallic-roughness",
    ),
    "emission": Support(
        PARTLY, "`area` with factor, texture and KHR_materials_emissive_strength, on the front of a surface only"
    ),
    "opacity": Support(
        PARTLY,
        "`mask`; the cutoff of alphaMode MASK is compared after interpolation of the texture, and not with the "
        "alpha of vertices",
    ),
    "transmission": Support(
        PARTLY,
        "`thindielectric`, `principledthin` or, with a volume, `dielectric`, `principled`; diffuse transmission as "
        "`principledthin`",
    ),
    "volume": Support(YES, "absorption as medium `homogeneous` in closed meshes; thickness only switches it on"),
    "clearcoat": Support(
        PARTLY,
        "on opaque dielectrics a `blendbsdf` of two `principled`; on others and with normal maps a white lobe that is "
        "right at normal incidence and too dark at grazing angles; left out on glass with a volume",
    ),
    "sheen": Support(
        PARTLY,
        "`blendbsdf` with a cloth-like `principled`: the right mean albedo, too dark at grazing angles; the mean of a "
        "roughness texture",
    ),
    "anisotropy": Support(PARTLY, "`principled` anisotropic from the strength; no rotation, no texture"),
    "iridescence": Support(NO, "Mitsuba 3 has no thin films; the surface reflects without their colours"),
    "dispersion": Support(NO, "the index of refraction is the same for all colours"),
    "unlit": Support(PARTLY, "a black surface that emits the base colour, so it also lights others"),
    "material_variants": Support(PARTLY, "the default variant"),
    "textures": Support(YES, "`bitmap`: PNG, JPEG, WebP; factors are multiplied into the image"),
    "texture_transform": Support(YES, "`to_uv`"),
    "texture_sampler": Support(YES, "wrap_mode and filter_type; images are extended where the axes wrap differently"),
    "normal_map": Support(
        PARTLY,
        "`normalmap`; meshes are divided where the image is mirrored; left out if it needs another set of texture "
        "coordinates than the rest",
    ),
    "occlusion_map": Support(YES, "not used: light transport computes occlusion"),
    "cameras": Support(YES, "`perspective`, `orthographic`"),
    "point_lights": Support(PARTLY, "`point`, candela as W/sr (PNG previews expose themselves); without its range"),
    "spot_lights": Support(
        PARTLY,
        "`spot`, candela as W/sr; the falloff between the cones is linear in the angle, with the same power; without "
        "its range",
    ),
    "directional_lights": Support(YES, "`directional`, lux as W/m²"),
    "extensions": Support(NO, "unknown optional ones are ignored, unknown required ones are an error"),
}
