"""CompiledScene: the flat arrays that `compile_scene` makes and that the integrator uploads to the device."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isonoise.scene.light.envmap import EnvironmentMap

if TYPE_CHECKING:
    from isonoise.scene.volume.heterogeneous import HeterogeneousMedia


@dataclass(frozen=True)
class CompiledScene:
    """A scene as flat arrays. Emitters are multiplied by `radiance_scale`.

    Primitives of the world come first, in world space. Primitives of shape groups follow, each in its group's space;
    instances place them in the world. Arrays are C-contiguous. Record dtypes are in `structs`. An array is empty, not
    None, if the scene has nothing for it.
    """

    camera: np.ndarray  # (1,) structs.CAMERA
    filter: str  # 'box', 'tent' or 'gaussian'
    max_depth: int  # -1: unlimited
    rr_depth: int  # depth from which Russian roulette may end a path
    hide_emitters: bool
    volumetric: bool  # paths see media, and pass through pass-through surfaces without a path vertex
    sensor_medium: int  # index of the medium around the camera, or MEDIUM_NONE
    sampler: str  # one of samplers.SAMPLERS
    sample_count: int  # the scene's samples per pixel, default of --spp
    exposure: float | None  # factor on radiance in previews; None: by the image's brightness
    vertices: np.ndarray  # (V, 3) float32
    faces: np.ndarray  # (T, 3) uint32
    vertex_normals: np.ndarray  # (V, 3) float32 if a shape has SHAPE_VERTEX_NORMALS, else (0, 3)
    triangle_shape: np.ndarray  # (T,) uint32: index into shapes
    analytics: np.ndarray  # (A,) structs.ANALYTIC
    shapes: np.ndarray  # (S,) structs.SHAPE
    instances: np.ndarray  # (I,) structs.INSTANCE
    group_offsets: np.ndarray  # (G + 1, 2) uint32: first triangle and analytic primitive of each group; then the totals
    bsdfs: np.ndarray  # (B,) structs.BSDF
    media: np.ndarray  # (M,) structs.MEDIUM; empty unless the integrator is volumetric
    heterogeneous: "HeterogeneousMedia | None"  # None unless a medium is heterogeneous
    rough_transmittances: np.ndarray  # (t, rough_transmittance.NODES) float32: of rough plastics, by cosine
    # (T,) bool: the corners are in reverse order of the mesh file; (0,) if all meshes have uvs
    reversed_winding: np.ndarray
    uvs: np.ndarray  # (V, 2) float32 if they are needed and a shape has SHAPE_UVS, else (0, 2)
    textures: np.ndarray  # (X,) textures.TEXTURE
    texel_bytes: np.ndarray  # (b, 4) uint8: texels of 8-bit images
    texel_floats: np.ndarray  # (f, 4) float32: texels of all other images
    attributes: np.ndarray  # (a, 3) float32: mesh attributes that textures read
    lights: np.ndarray  # (L,) structs.LIGHT; power_pmf sums to 1
    projections: np.ndarray  # (P,) structs.PROJECTION: of the textures that lights project
    light_cdf: np.ndarray  # (L, 2) float32: a + 2^-24 b is the sum of power_pmf of the lights before
    environment_light: int  # index of the LIGHT_CONSTANT or LIGHT_ENVIRONMENT_MAP light, -1 if there is none
    environment: EnvironmentMap | None
    bounds: np.ndarray  # (2, 3) float32: corners of the box around all surfaces; zeros if there are none
    radiance_scale: float  # power of two: device radiance = true radiance * radiance_scale
    hash: str  # hex digest of the arrays and settings: changes whenever the image may change

    @property
    def film_window(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """(width, height) of the film, the pixel (x, y) of it where the image begins, (width, height) of the image."""
        return tuple(tuple(self.camera[name][0].tolist()) for name in ("film_size", "crop_offset", "crop_size"))

    @property
    def width(self) -> int:
        """Of the image, in pixels."""
        return int(self.camera["crop_size"][0, 0])

    @property
    def height(self) -> int:
        """Of the image, in pixels."""
        return int(self.camera["crop_size"][0, 1])
