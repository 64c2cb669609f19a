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
    "vertex_colours": Support(YES, "COLOR_0 as `mesh_attribute` vertex_color, times the base colour"),
    "compression": Support(PARTLY, "KHR_mesh_quantization and sparse accessors; not Draco, not meshopt"),
    "scene_graph": Support(YES, "the default scene; cameras and lights keep their size under scale"),
    "instances": Support(YES, "copies of a mesh become instances if that saves 100,000 triangles"),
    "animation": Support(PARTLY, "skins in rest pose, morph targets with their default weights, no animation"),
    "includes": Support(YES, "buffers and images in files inside the folder of the scene, or in data URIs"),
    "cameras": Support(YES, "`perspective`, `orthographic`"),
    "point_lights": Support(PARTLY, "`point`, with candela as W/sr; without its range"),
    "spot_lights": Support(
        PARTLY, "`spot`, with candela as W/sr; the falloff between the cones is linear in the angle; without its range"
    ),
    "directional_lights": Support(YES, "`directional`, with lux as W/m²"),
    "extensions": Support(NO, "unknown optional ones are ignored, unknown required ones are an error"),
}
