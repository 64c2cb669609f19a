"""Generates scenes of many triangles: a bumpy ring over a floor under an environment map; called by `isonoise bench`.

`python -m isonoise.benchmark.generated_scenes mesh-82k FOLDER` writes FOLDER/mesh-82k.xml with its mesh and environment
map, for any program that reads Mitsuba 3's format.
"""

import sys
from pathlib import Path

import numpy as np

from isonoise.errors import UserError
from isonoise.film.exr import write_exr
from isonoise.film.files import write_atomically

GENERATED_SCENES = {"mesh-82k": (256, 160), "mesh-1.3m": (1024, 640)}
"""Quads around the ring and around its tube: 81,920 and 1,310,720 triangles."""
_TUBE_RADIUS, _BUMP_HEIGHT = 0.42, 0.09  # the radius of the ring is 1

_XML = """<?xml version="1.0" encoding="utf-8"?>
<!-- A bumpy ring of {triangles:,} triangles over a floor, under an environment map. -->
<scene version="3.0.0">
    <integrator type="path">
        <integer name="max_depth" value="8"/>
        <integer name="rr_depth" value="5"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="38"/>
        <transform name="to_world">
            <lookat origin="0.6, 2.9, 3.7" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="multijitter">
            <integer name="sample_count" value="64"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="512"/>
            <integer name="height" value="512"/>
            <string name="pixel_format" value="rgb"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="envmap">
        <string name="filename" value="{name}-sky.exr"/>
    </emitter>
    <shape type="ply">
        <string name="filename" value="{name}.ply"/>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0.7, 0.55, 0.4"/>
        </bsdf>
    </shape>
    <shape type="rectangle">
        <transform name="to_world">
            <rotate x="1" angle="-90"/>
            <scale value="4"/>
            <translate y="-0.55"/>
        </transform>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0.6, 0.6, 0.6"/>
        </bsdf>
    </shape>
</scene>
"""


def write_generated_scene(name: str, folder: Path) -> Path:
    """Write one of `GENERATED_SCENES` into an existing folder; returns the path of its XML file."""
    vertices, faces = bumpy_ring(*GENERATED_SCENES[name])
    write_atomically(folder / f"{name}.ply", lambda path: _write_ply(path, vertices, faces))
    write_exr(folder / f"{name}-sky.exr", {"": sky()}, {})
    xml = _XML.format(name=name, triangles=len(faces))
    write_atomically(folder / f"{name}.xml", lambda path: path.write_text(xml, encoding="utf-8"))
    return folder / f"{name}.xml"


def bumpy_ring(around: int, tube: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed torus with waves of three lengths: vertices (around * tube, 3), faces (2 * around * tube, 3)."""
    u, v = np.meshgrid(np.arange(around) / around, np.arange(tube) / tube, indexing="ij")
    u, v = 2 * np.pi * u, 2 * np.pi * v
    waves = np.sin(9 * u) * np.sin(4 * v) + 0.5 * np.sin(23 * u + 11 * v) + 0.25 * np.sin(61 * u - 37 * v)
    radius = _TUBE_RADIUS + _BUMP_HEIGHT * waves / 1.75
    distance = 1 + radius * np.cos(v)  # from the axis
    vertices = np.stack([distance * np.cos(u), radius * np.sin(v), distance * np.sin(u)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(tube), indexing="ij")
    a, b = i * tube + j, (i + 1) % around * tube + j
    c, d = (i + 1) % around * tube + (j + 1) % tube, i * tube + (j + 1) % tube
    faces = np.stack([np.stack([a, d, c], -1), np.stack([a, c, b], -1)], axis=2).reshape(-1, 3)
    return vertices.astype(np.float32), faces.astype(np.uint32)


def sky(width: int = 512, height: int = 256) -> np.ndarray:
    """Environment map of a clear sky with a soft sun over a dark ground: (height, width, 3) float32."""
    azimuth = 2 * np.pi * (np.arange(width) + 0.5) / width
    elevation = np.pi / 2 - np.pi * (np.arange(height)[:, None] + 0.5) / height
    up = np.sin(elevation)
    towards_sun = np.cos(elevation) * np.cos(0.8) * np.cos(azimuth - 2.0) + up * np.sin(0.8)
    blue = np.clip(up, 0, 1)[..., None] * np.array([0.25, 0.45, 0.9]) + np.array([0.55, 0.6, 0.65])
    ground = np.broadcast_to(np.array([0.2, 0.18, 0.15]), (height, width, 3))
    sun = 200 * np.exp(400 * (towards_sun - 1))[..., None] * np.array([1, 0.92, 0.8])
    return (np.where(up[..., None] > 0, blue + 0 * ground, ground) + sun).astype(np.float32)


def _write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    records["count"], records["corners"] = 3, faces
    path.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + records.tobytes())


def main(arguments: list[str]) -> int:
    if len(arguments) != 2 or arguments[0] not in GENERATED_SCENES:
        print(
            f"usage: python -m isonoise.benchmark.generated_scenes {'|'.join(GENERATED_SCENES)} FOLDER", file=sys.stderr
        )
        return 2
    folder = Path(arguments[1])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        print(write_generated_scene(arguments[0], folder))
    except (OSError, UserError) as error:
        print(f"isonoise: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
