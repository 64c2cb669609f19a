"""The feature set: what of the program, the buffers and the stages a scene and a strategy need; all else is left out.

Kernels test `FEATURE_<name>` with #if; the host sets every one to 0 or 1.
"""

from dataclasses import dataclass

import numpy as np

from isonoise.scene import light_list, structs, textures
from isonoise.scene.bsdfs import reads_uvs
from isonoise.scene.compiled import CompiledScene
from isonoise.scene.light_tree import pays
from isonoise.statistics import NOTHING_MORE, Needs


@dataclass(frozen=True)
class Feature:
    """What a feature is and what it costs when it is on."""

    meaning: str
    cost: str


FEATURES = {
    "TRIANGLES": Feature(
        "triangle meshes", "64 bytes a triangle and its share of the hierarchy, block test in intersect and shadow"
    ),
    "VERTEX_NORMALS": Feature(
        "smooth shading by vertex normals", "12 bytes a vertex and 12 a triangle, interpolation in shade"
    ),
    "UVS": Feature("texture coordinates", "8 bytes a vertex and 12 a triangle, interpolation in shade"),
    "TEXTURES": Feature("parameters that vary over a surface", "records and texels, code in shade"),
    "BITMAPS": Feature("images as textures", "4 or 16 bytes a texel, code in shade"),
    "CHECKERBOARDS": Feature("checkerboards", "code in shade"),
    "MESH_ATTRIBUTES": Feature("colours of vertices and faces", "12 bytes each, code in shade"),
    "ANALYTICS": Feature("shapes that are not triangles", "a record each, a second kind of leaf"),
    "SPHERES": Feature("spheres", "sphere test in intersect and shadow"),
    "DISKS": Feature("disks", "disk test in intersect and shadow"),
    "CYLINDERS": Feature("cylinders", "cylinder test in intersect and shadow"),
    "INSTANCES": Feature(
        "groups of shapes that stand in several places",
        "100 bytes an instance, 8 bytes a path; transforms of rays in intersect and shadow, of surfaces in shade",
    ),
    "DIFFUSE": Feature("diffuse reflection", "code in shade"),
    "DIELECTRIC": Feature("smooth glass", "code in shade"),
    "THIN_DIELECTRIC": Feature("thin smooth glass", "code in shade"),
    "CONDUCTOR": Feature("smooth metal", "code in shade"),
    "ROUGH_CONDUCTOR": Feature("rough metal", "code in shade"),
    "ROUGH_DIELECTRIC": Feature("rough glass", "code in shade"),
    "PLASTIC": Feature("smooth plastic", "code in shade"),
    "ROUGH_PLASTIC": Feature("rough plastic", "code in shade"),
    "PRINCIPLED": Feature("the principled material", "code in shade"),
    "BECKMANN": Feature("rough surfaces by Beckmann's distribution", "code in shade"),
    "ALL_NORMALS": Feature("rough surfaces sampled by all their normals", "code in shade"),
    "NULL": Feature("surfaces that let all through", "code in shade"),
    "SIDES": Feature("materials that differ on the two sides", "code in shade"),
    "MASK": Feature("opacity", "code in shade"),
    "BLEND": Feature("blends of materials", "code in shade"),
    "BUMP": Feature("bump maps", "code in shade"),
    "NORMAL_MAP": Feature("normal maps", "code in shade"),
    "TWOSIDED": Feature("two-sided materials", "code in shade"),
    "VOLPATH": Feature(
        "surfaces that let paths and light through unturned",
        "8 bytes a path; the shadow stage looks at such surfaces instead of ending there",
    ),
    "MEDIA": Feature("media", "12 bytes a path, free flights in shade, transmittance in the shadow stage"),
    "AREA_LIGHTS": Feature("surfaces that shine", "light table, emission and its weight in shade"),
    "TEXTURED_LIGHTS": Feature("lights whose radiance varies over them", "texture look-up in light sampling"),
    "TRIANGLE_LIGHTS": Feature("triangles that shine", "sampling code in shade"),
    "SPHERE_LIGHTS": Feature("spheres that shine", "sampling code in shade"),
    "DISK_LIGHTS": Feature("disks that shine", "sampling code in shade"),
    "CYLINDER_LIGHTS": Feature("cylinders that shine", "sampling code in shade"),
    "POINT_LIGHTS": Feature("point lights", "sampling code in shade"),
    "SPOT_LIGHTS": Feature("spot lights", "sampling code in shade"),
    "DIRECTIONAL_LIGHTS": Feature("directional lights", "sampling code in shade"),
    "CONSTANT_LIGHT": Feature("constant environment", "sampling code and radiance of missed rays in shade"),
    "ENVIRONMENT_MAP": Feature("environment map", "20 bytes a texel, code in shade"),
    "MANY_LIGHTS": Feature("more than one light", "8 bytes a light, code in shade"),
    "LIGHT_TREE": Feature(
        "many lights, picked by what they could send to a point", "about 100 bytes a light, 32 a path, code in shade"
    ),
    "LIGHT_LIST": Feature(
        "some lights, each weighed by what it could send to a point", "52 bytes a light, 32 a path, code in shade"
    ),
    "NEXT_EVENT": Feature("next-event estimation", "shadow stage, 44 bytes a path"),
    "RUSSIAN_ROULETTE": Feature("russian roulette", "code in shade"),
    "HIDE_EMITTERS": Feature("lights hidden from the camera", "code in shade"),
    "THIN_LENS": Feature("a lens with depth of field", "code in generate"),
    "ORTHOGRAPHIC": Feature("a camera of parallel rays", "code in generate"),
    "FILTER_TABLE": Feature("pixel filter other than a box", "table of 16 KiB"),
    "MEDIAN": Feature("chunk medians M_x", "4 bytes a pixel and entry of a chunk, 4 more, sorting in reduce"),
    "BATCHES": Feature("chunks of means of several samples", "8 bytes a pixel, a division an entry in reduce"),
    "POWER": Feature("mean of a power of the samples", "8 bytes a pixel, a power or logarithm a sample in reduce"),
    "HALF": Feature("mean of every second sample", "24 bytes a pixel, three sums in reduce"),
    "COUNT_TESTS": Feature("nodes and blocks of triangles tested, counted", "8 bytes a path, code in intersect"),
}


_SMOOTH = {
    structs.BSDF_DIFFUSE,
    structs.BSDF_ROUGH_CONDUCTOR,
    structs.BSDF_ROUGH_DIELECTRIC,
    structs.BSDF_PLASTIC,
    structs.BSDF_ROUGH_PLASTIC,
    structs.BSDF_PRINCIPLED,
    structs.BSDF_HG,
}
"""Materials of which next-event estimation can find something."""

_ROUGH = (structs.BSDF_ROUGH_CONDUCTOR, structs.BSDF_ROUGH_DIELECTRIC, structs.BSDF_ROUGH_PLASTIC)
"""Materials of which the distribution of normals can be chosen."""


def features(scene: CompiledScene, needs: Needs = NOTHING_MORE) -> dict[str, bool]:
    """Which features the scene uses, and the statistics of `needs` ask for. Keys and order as in `FEATURES`."""
    analytic, bsdf, light = set(scene.analytics["kind"]), set(scene.bsdfs["kind"]), set(scene.lights["kind"])
    surface_lights = {structs.LIGHT_TRIANGLE, structs.LIGHT_SPHERE, structs.LIGHT_DISK, structs.LIGHT_CYLINDER}
    rough = np.isin(scene.bsdfs["kind"], _ROUGH)
    endless = scene.max_depth < 0
    next_event = bool(light) and bool(bsdf & _SMOOTH) and (endless or scene.max_depth > 1)
    weighs_lights = next_event and pays(scene.lights)
    volpath = len(scene.media) > 0 or bool((scene.bsdfs["flags"] & structs.BSDF_SEE_THROUGH).any())
    lists_lights = light_list.serves(scene.lights) and not volpath  # one by one they take 2 to 5 times as long
    return {
        "TRIANGLES": len(scene.faces) > 0,
        "VERTEX_NORMALS": bool((scene.shapes["flags"] & structs.SHAPE_VERTEX_NORMALS).any()),
        "UVS": reads_uvs(scene.bsdfs) or bool((scene.lights["texture"] != structs.NONE).any()),
        "TEXTURES": len(scene.textures) > 0,
        "BITMAPS": textures.TEXTURE_BITMAP in scene.textures["kind"],
        "CHECKERBOARDS": textures.TEXTURE_CHECKERBOARD in scene.textures["kind"],
        "MESH_ATTRIBUTES": textures.TEXTURE_MESH_ATTRIBUTE in scene.textures["kind"],
        "ANALYTICS": len(scene.analytics) > 0,
        "SPHERES": structs.ANALYTIC_SPHERE in analytic,
        "DISKS": structs.ANALYTIC_DISK in analytic,
        "CYLINDERS": structs.ANALYTIC_CYLINDER in analytic,
        "INSTANCES": len(scene.instances) > 0,
        "DIFFUSE": structs.BSDF_DIFFUSE in bsdf,
        "DIELECTRIC": structs.BSDF_DIELECTRIC in bsdf,
        "THIN_DIELECTRIC": structs.BSDF_THIN_DIELECTRIC in bsdf,
        "CONDUCTOR": structs.BSDF_CONDUCTOR in bsdf,
        "ROUGH_CONDUCTOR": structs.BSDF_ROUGH_CONDUCTOR in bsdf,
        "ROUGH_DIELECTRIC": structs.BSDF_ROUGH_DIELECTRIC in bsdf,
        "PLASTIC": structs.BSDF_PLASTIC in bsdf,
        "ROUGH_PLASTIC": structs.BSDF_ROUGH_PLASTIC in bsdf,
        "PRINCIPLED": structs.BSDF_PRINCIPLED in bsdf,
        "BECKMANN": bool((rough & (scene.bsdfs["flags"] & structs.BSDF_GGX == 0)).any()),
        "ALL_NORMALS": bool((scene.bsdfs["flags"] & structs.BSDF_SAMPLE_ALL).any()),
        "NULL": structs.BSDF_NULL in bsdf,
        "SIDES": structs.BSDF_SIDES in bsdf,
        "MASK": structs.BSDF_MASK in bsdf,
        "BLEND": structs.BSDF_BLEND in bsdf,
        "BUMP": structs.BSDF_BUMP in bsdf,
        "NORMAL_MAP": structs.BSDF_NORMAL_MAP in bsdf,
        "TWOSIDED": bool((scene.bsdfs["flags"] & structs.BSDF_TWOSIDED).any()),
        "VOLPATH": volpath,
        "MEDIA": len(scene.media) > 0,
        "AREA_LIGHTS": bool(light & surface_lights),
        "TEXTURED_LIGHTS": bool((scene.lights["texture"] != structs.NONE).any()),
        "TRIANGLE_LIGHTS": structs.LIGHT_TRIANGLE in light,
        "SPHERE_LIGHTS": structs.LIGHT_SPHERE in light,
        "DISK_LIGHTS": structs.LIGHT_DISK in light,
        "CYLINDER_LIGHTS": structs.LIGHT_CYLINDER in light,
        "POINT_LIGHTS": structs.LIGHT_POINT in light,
        "SPOT_LIGHTS": structs.LIGHT_SPOT in light,
        "DIRECTIONAL_LIGHTS": structs.LIGHT_DIRECTIONAL in light,
        "CONSTANT_LIGHT": structs.LIGHT_CONSTANT in light,
        "ENVIRONMENT_MAP": structs.LIGHT_ENVIRONMENT_MAP in light,
        "MANY_LIGHTS": len(scene.lights) > 1,
        "LIGHT_TREE": weighs_lights and not lists_lights,
        "LIGHT_LIST": weighs_lights and lists_lights,
        "NEXT_EVENT": next_event,
        "RUSSIAN_ROULETTE": endless or scene.rr_depth < scene.max_depth,
        "HIDE_EMITTERS": scene.hide_emitters,
        "THIN_LENS": bool(scene.camera["kind"][0] == structs.CAMERA_THIN_LENS),
        "ORTHOGRAPHIC": bool(scene.camera["kind"][0] == structs.CAMERA_ORTHOGRAPHIC),
        "FILTER_TABLE": scene.filter != "box",
        **statistics_features(needs),
        "COUNT_TESTS": False,  # a picture never needs it: it is switched on to measure
    }


def statistics_features(needs: Needs) -> dict[str, bool]:
    """Which features the statistics of `needs` ask for: all that the stages `reduce` and `summarise` know."""
    return {
        "MEDIAN": needs.median,
        "BATCHES": needs.median and needs.batch > 1,
        "POWER": needs.power is not None,
        "HALF": needs.half,
    }
