"""How far pbrt-v4 is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import NO, PARTLY, YES, Support

SUPPORT = {
    "triangles": Support(YES, "trianglemesh and plymesh: `mesh`"),
    "polygons": Support(YES, "quads of PLY files: two triangles; bilinearmesh: two triangles, or 128 if it is curved"),
    "quadrics": Support(
        PARTLY, "`sphere`, `disk`, `cylinder`; partial or non-uniformly scaled ones, cones and paraboloids: fine meshes"
    ),
    "curves": Support(PARTLY, "loopsubdiv: subdivided triangles; curve, hyperboloid and nurbs are left out"),
    "normals": Support(YES, "also of mirrored and reversed shapes"),
    "uvs": Support(YES, "pbrt's default coordinates where a mesh has none"),
    "compression": Support(YES, "meshes and included files that end in .gz"),
    "scene_graph": Support(YES, "attributes, named coordinate systems, mirrored scenes"),
    "instances": Support(YES, "`shapegroup` and `instance`"),
    "animation": Support(NO, "everything is where it is at the start of the exposure"),
    "includes": Support(YES, "Include, Import, meshes, images and spectra, from the scene's folder"),
    "diffuse": Support(PARTLY, "`diffuse`; coateddiffuse: `plastic` or `roughplastic`; pbrt-v3's `sigma` is ignored"),
    "metal": Support(YES, "`conductor` or `roughconductor` by eta and k, or by reflectance"),
    "roughness": Support(PARTLY, "alpha of GGX, with the remapping of pbrt-v4 or v3; a coat has one number"),
    "specular": Support(
        PARTLY,
        "coats without scattering inside, their absorption on the way in and out; pbrt-v3's plastic and uber: coats",
    ),
    "emission": Support(PARTLY, "`area`, also two-sided, with images and by power; invisible lights become visible"),
    "opacity": Support(PARTLY, "alpha: `mask`; pbrt-v3's shadowalpha is ignored"),
    "transmission": Support(
        PARTLY,
        "`dielectric`, `roughdielectric`, `thindielectric`; diffusetransmission: `principledthin` in one colour",
    ),
    "media": Support(
        PARTLY,
        "`homogeneous`; uniformgrid: `heterogeneous`; both without emission; rgbgrid, cloud and nanovdb: left out",
    ),
    "clearcoat": Support(PARTLY, "coatedconductor: `principled` with a clearcoat"),
    "anisotropy": Support(PARTLY, "alpha_u and alpha_v; coats get the mean"),
    "dispersion": Support(NO, "the index of refraction at 588 nm is used"),
    "mixed_materials": Support(YES, "`blendbsdf`"),
    "measured_materials": Support(NO, "a plain material takes their place"),
    "textures": Support(
        PARTLY, "`bitmap`; products, mixtures and inversions are computed; images that do not match: their means"
    ),
    "procedural_textures": Support(PARTLY, "`checkerboard` in two dimensions; others become constants"),
    "texture_transform": Support(PARTLY, "scales and offsets; spherical, cylindrical and planar mappings: as by uv"),
    "texture_sampler": Support(PARTLY, "repeat, clamp, point and bilinear; black: clamp"),
    "normal_map": Support(YES, "`normalmap`"),
    "bump_map": Support(PARTLY, "images as displacement of materials: `bumpmap`; displacement of meshes is ignored"),
    "cameras": Support(PARTLY, "`perspective`, `thinlens`, `orthographic`; realistic and spherical: `perspective`"),
    "film": Support(PARTLY, "size, crop, filter, ISO and exposure time, samples, depth; other sensors: as cie1931"),
    "point_lights": Support(YES, "`point`"),
    "spot_lights": Support(PARTLY, "`spot`, its soft edge as a texture; of a cone wider than 75 degrees a linear edge"),
    "projected_lights": Support(YES, "projection: `projector`; goniometric: six of them"),
    "directional_lights": Support(YES, "`directional`"),
    "environment": Support(PARTLY, "`constant` or `envmap`; of several images only the last one; portals are ignored"),
    "spectra": Support(PARTLY, "rgb, blackbody, sampled and named spectra: linear RGB; aces2065-1 is read as sRGB"),
    "extensions": Support(NO, "unknown parameters are ignored"),
}
