"""What compiling a scene description yields: flat arrays for the device and the facts that decide the features."""

from dataclasses import dataclass

import numpy as np

from isonoise.scene.light.envmap import EnvironmentMap


@dataclass(frozen=True)
class CompiledScene:
    """A scene as flat arrays, in world space, with emitters scaled by `radiance_scale`.

    Primitives of groups, which instances place in the world, are in the group's space; they come after all others.
    Arrays are C-contiguous; dtypes of records are in `structs`. Absent things are empty arrays, not None.
    """

    camera: np.ndarray  # (1,) structs.CAMERA
    filter: str  # 'box', 'tent' or 'gaussian'
    max_depth: int  # -1: no end
    rr_depth: int
    hide_emitters: bool
    volumetric: bool  # media are seen, and boundaries that let light through unturned are no vertices of a path
    sensor_medium: int  # index of the medium around the camera, MEDIUM_NONE
    sample_count: int  # the scene's samples per pixel, default of --spp
    vertices: np.ndarray  # (V, 3) float32
    faces: np.ndarray  # (T, 3) uint32
    vertex_normals: np.ndarray  # (V, 3) float32 where some shape has SHAPE_VERTEX_NORMALS, else (0, 3)
    triangle_shape: np.ndarray  # (T,) uint32: index into shapes
    analytics: np.ndarray  # (A,) structs.ANALYTIC
    shapes: np.ndarray  # (S,) structs.SHAPE
    instances: np.ndarray  # (I,) structs.INSTANCE
    group_offsets: np.ndarray  # (G + 1, 2) uint32: first triangle, analytic primitive of each group; their numbers
    bsdfs: np.ndarray  # (B,) structs.BSDF
    media: np.ndarray  # (M,) structs.MEDIUM that paths can be in: none unless the integrator is volumetric
    rough_transmittances: np.ndarray  # (t, boundaries.NODES) float32: transmittances of rough plastics over the cosine
    reversed_winding: (
        np.ndarray
    )  # (T,) bool: corners in the order opposite to the mesh's; (0,) where all meshes have uvs
    uvs: np.ndarray  # (V, 2) float32 where a material reads them and some shape has SHAPE_UVS, else (0, 2)
    textures: np.ndarray  # (X,) textures.TEXTURE
    texel_bytes: np.ndarray  # (b, 4) uint8: texels of 8-bit images
    texel_floats: np.ndarray  # (f, 4) float32: texels of others
    attributes: np.ndarray  # (a, 3) float32: mesh attributes that a texture reads
    lights: np.ndarray  # (L,) structs.LIGHT; pick probabilities sum to 1
    light_alias: np.ndarray  # (L,) structs.ALIAS
    environment_light: int  # index of the LIGHT_CONSTANT or LIGHT_ENVIRONMENT_MAP light, -1 if there is none
    environment: EnvironmentMap | None  # the map of the latter
    bounds: np.ndarray  # (2, 3) float32: corners of the box around all surfaces; zeros if there are none
    radiance_scale: float  # power of two: device radiance = true radiance * radiance_scale
    hash: str  # hex digest of the description: changes when the picture may

    @property
    def width(self) -> int:
        return int(self.camera["crop_size"][0, 0])

    @property
    def height(self) -> int:
        return int(self.camera["crop_size"][0, 1])
