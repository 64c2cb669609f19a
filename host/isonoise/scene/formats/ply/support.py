"""How far PLY is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import NO, PARTLY, YES, Support

SUPPORT = {
    "triangles": Support(YES, "`mesh`; ASCII and binary"),
    "polygons": Support(YES, "triangles; concave polygons are cut by ear clipping"),
    "strips_fans": Support(NO, "convert triangle strips to faces, for example with MeshLab"),
    "lines_points": Support(NO, "edges are left out; a file without faces is an error: make a mesh of it"),
    "normals": Support(YES),
    "uvs": Support(YES, "per vertex, or per corner (texcoord)"),
    "vertex_colours": Support(PARTLY, "`mesh_attribute`: vertex colours, or else face colours; not with a texture"),
    "opacity": Support(NO, "the alpha of colours is left out"),
    "textures": Support(PARTLY, "the first comment TextureFile"),
}
