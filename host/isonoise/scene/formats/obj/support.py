"""How far OBJ and MTL is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import NO, PARTLY, YES, Support

SUPPORT = {
    "triangles": Support(YES, "a `mesh` for each material; groups and objects are not told apart"),
    "polygons": Support(YES, "triangles; concave polygons are cut by ear clipping"),
    "lines_points": Support(
        NO, "they have no surface, nor have faces of one or two corners: make tubes or spheres of them"
    ),
    "curves": Support(NO, "convert curves and surfaces to polygons before the export"),
    "normals": Support(YES, "smooth without `vn`, flat with `s off`"),
    "uvs": Support(YES),
    "vertex_colours": Support(PARTLY, "`v x y z r g b`, sRGB, times Kd; not together with map_Kd"),
    "includes": Support(YES, "several MTL files; names with blanks, backslashes or another case are found"),
    "diffuse": Support(YES, "Kd, map_Kd"),
    "metal": Support(
        YES, "Pm, map_Pm: `principled`; Ks far above Kd: `roughconductor`, with illum 3, 5, 8 `conductor`"
    ),
    "roughness": Support(YES, "Pr, map_Pr; Ns, map_Ns as alpha² = 2 / (Ns + 2)"),
    "specular": Support(
        PARTLY,
        "Ks, map_Ks: factor on the coat of `roughplastic`; illum 3: a mirror in a `blendbsdf`; with map_Ns only the "
        "mean",
    ),
    "emission": Support(YES, "Ke, map_Ke: `area`, on the side of the normal"),
    "opacity": Support(PARTLY, "d, Tr, map_d: `mask`; not -halo"),
    "transmission": Support(PARTLY, "illum 4, 6, 7: `dielectric` with Ni; of Tf only the hue"),
    "clearcoat": Support(PARTLY, "Pc, Pcr, map_Pc: `principled`; not map_Pcr"),
    "sheen": Support(YES, "Ps, map_Ps: `principled`"),
    "anisotropy": Support(PARTLY, "aniso: `principled`; its rotation anisor is left out"),
    "textures": Support(PARTLY, "with -imfchan and -mm; not decal; PNG, JPEG, BMP, TGA, OpenEXR, Radiance HDR"),
    "texture_transform": Support(PARTLY, "-s, -o; not -t"),
    "texture_sampler": Support(YES, "repeated, or -clamp on"),
    "normal_map": Support(YES, "norm, or a map_Bump that contains normals: `normalmap`"),
    "bump_map": Support(PARTLY, "map_Bump, -bm: `bumpmap`, white is 1 % of the image's width high; disp is a bump map"),
    "environment": Support(NO, "reflection maps (refl) are not used: reflections are traced"),
    "spectra": Support(NO, "write colours as RGB or xyz"),
}
