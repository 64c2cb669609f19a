"""Small valid files of every supported format, as bytes, for the fuzzer and other tests."""

import io
import re
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np

NUMBER = re.compile(rb"[-+]?[0-9]+(\.[0-9]+)?")
"""Matches a number in a text."""

_POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.1], [1, 1, 1e-3]])
_FACES = np.array([[0, 1, 2], [2, 1, 3]])
_UVS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])


def obj(shift: float = 0.0, relative: bool = False) -> bytes:
    """`shift` is added to all positions, here and below.

    `relative` adds a face with negative indices, and one with empty fields, which Mitsuba rejects.
    """
    lines = [
        "mtllib a.mtl",
        *(f"v {x} {y} {z} 1 0.5 {x}" for x, y, z in _POINTS + shift),
        *(f"vt {u} {v}" for u, v in _UVS),
    ]
    lines += [
        "vn 0 0 1",
        "# a comment",
        "usemtl red",
        "f 1/1/1 2/2/1 3/3/1",
        "usemtl lamp",
        "f 3/3 2/2 4/4",
        *(["f -4 -3 -1", "usemtl glass", "s off", "f 1/ 2//1 4 3"] if relative else []),
    ]
    return "\n".join(lines).encode() + b"\n"


def vol(shift: float = 0.0, channels: int = 1) -> bytes:
    """A grid of 2 x 3 x 4 cells in a box of 2 x 2 x 2."""
    header = b"VOL\x03" + struct.pack("<5i6f", 1, 4, 3, 2, channels, -1, -1, -1, 1, 1, 1)
    return header + (0.25 * np.arange(24 * channels) % 1.0 + shift).astype("<f4").tobytes()


def mtl() -> bytes:
    return (
        b"newmtl red\nKd 0.8 0.1 0.1\nKs 0.5 0.5 0.5\nNs 40\nillum 2\nmap_Kd -s 2 2 -o 0.5 0 -clamp on a.png\n"
        b"map_d -imfchan g a.png\nmap_Bump -bm 0.5 a.png\nnewmtl lamp\nKd 0 0 0\nKe 5 5 4\nPr 0.3\nPm 1\n"
        b"map_Pr -mm 0 0.5 a.png\nnewmtl glass\nillum 7\nNi 1.5\nTf 1 0.5 0.5\n"
    )


def ply(binary: bool = True, shift: float = 0.0) -> bytes:
    """With normals, texture coordinates, vertex colours and a face attribute."""
    form = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {form} 1.0\nelement vertex 4\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v")
    )
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += "element face 2\nproperty list uchar int vertex_indices\nproperty float heat_x\nend_header\n"
    body = b""
    for number, (point, uv) in enumerate(zip(_POINTS + shift, _UVS, strict=True)):
        values = [*point, 0, 0, 1, *uv]
        colour = [40 * number, 255 - 40 * number, 99]
        body += (
            struct.pack("<8f3B", *values, *colour) if binary else (" ".join(map(str, values + colour)) + "\n").encode()
        )
    for number, face in enumerate(_FACES):
        body += (
            struct.pack("<B3if", 3, *face, number) if binary else f"3 {face[0]} {face[1]} {face[2]} {number}\n".encode()
        )
    return head.encode() + body


def ply_textured() -> bytes:
    """With a texture, coordinates of corners, colours with alpha and a concave quadrilateral."""
    colours = "".join(f"property float {name}\n" for name in ("r", "g", "b", "a"))
    head = "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 4\n"
    head += "property float x\nproperty float y\nproperty float z\n" + colours
    head += "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    body = "0 0 0 1 1 1 1\n1 -1 0 1 0 0 0.5\n0.5 0 0 1 1 1 1\n1 1 0 1 1 1 1\n"
    return (head + body + "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n3 0 1 2 6 0 0 1 0 1 1\n").encode()


def serialized(meshes: int = 2, version: int = 4, shift: float = 0.0) -> bytes:
    parts = []
    for number in range(meshes):
        data = struct.pack("<I", 0x1 | 0x2 | 0x8 | 0x1000) + (b"part\0" if version == 4 else b"")
        data += struct.pack("<QQ", len(_POINTS), len(_FACES)) + (_POINTS + number + shift).astype("<f4").tobytes()
        data += np.tile([0, 0, 1], (4, 1)).astype("<f4").tobytes() + _UVS.astype("<f4").tobytes()
        data += np.full((4, 3), 0.5).astype("<f4").tobytes() + _FACES.astype("<u4").tobytes()
        parts.append(struct.pack("<HH", 0x041C, version) + zlib.compress(data))
    offsets = np.cumsum([0, *map(len, parts)])[:-1].astype({3: "<u4", 4: "<u8"}[version])
    return b"".join(parts) + offsets.tobytes() + struct.pack("<I", meshes)


def serialized_uncompressed() -> bytes:
    """A file with stored instead of compressed blocks, so that mutations reach the content."""
    whole, stored = serialized(1), zlib.compressobj(0)
    return whole[:4] + stored.compress(zlib.decompress(whole[4:-12])) + stored.flush() + whole[-12:]


def from_trimesh(kind: str) -> bytes:
    """An 'stl', 'stl_ascii' or 'glb' file written by trimesh."""
    import trimesh

    mesh = trimesh.Trimesh(_POINTS, _FACES, process=False)
    data = mesh.export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


def pixels(width: int = 9, height: int = 5, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def image_file(format_: str, seed: int = 0, mode: str = "RGB") -> bytes:
    """A 'PNG', 'JPEG', 'BMP' or 'TGA' file written by pillow."""
    import PIL.Image

    file = io.BytesIO()
    PIL.Image.fromarray(pixels(seed=seed)).convert(mode).save(file, format_)
    return file.getvalue()


def png_chunk(name: bytes, data: bytes) -> bytes:
    """A chunk of a PNG file."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png_16_bit() -> bytes:
    """16 bits per channel."""
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels().astype(np.uint16) * 257)
    head = struct.pack(">2I5B", 9, 5, 16, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", head)
        + png_chunk(b"IDAT", zlib.compress(rows))
        + png_chunk(b"IEND", b"")
    )


def exr(seed: int = 0, packed: bool = True) -> bytes:
    import OpenEXR

    planes = {name: np.ascontiguousarray(pixels(seed=seed)[..., i], np.float32) for i, name in enumerate("RGB")}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION if packed else OpenEXR.NO_COMPRESSION,
        "type": OpenEXR.scanlineimage,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.exr"
        OpenEXR.File(header, planes).write(str(path))
        return path.read_bytes()


def hdr(packed: bool = True) -> bytes:
    """Radiance HDR, uncompressed or with run-length encoded lines."""
    rgbe = np.concatenate([pixels(), np.full((5, 9, 1), 129, np.uint8)], axis=2)
    body = b""
    for row in rgbe:
        if packed:
            body += b"\x02\x02\x00\x09" + b"".join(bytes([9]) + row[:, i].tobytes() for i in range(3)) + b"\x89\x81"
        else:
            body += row.tobytes()
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 5 +X 9\n" + body


def textured_glb() -> bytes:
    """With a material, a texture and nested nodes."""
    import PIL.Image
    import trimesh

    picture = PIL.Image.fromarray(pixels())
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, emissiveFactor=[0, 0.5, 0])
    mesh = trimesh.Trimesh(_POINTS, _FACES, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=_UVS, material=material)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="outer", transform=np.diag([2, 1, 1, 1.0]))
    scene.add_geometry(mesh.copy(), node_name="inner", parent_node_name="outer")
    return scene.export(file_type="glb")


def write_images(folder: Path) -> Path:
    """Write 7 x 5 texels as `rgb.png`, `grey.png`, `deep.png` (16 bits) and `linear.exr`; returns the folder."""
    from PIL import Image

    from isonoise.film.exr import write_exr

    random = np.random.default_rng(4)
    rgb = random.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(folder / "rgb.png")
    Image.fromarray(rgb[..., 0]).save(folder / "grey.png")
    Image.fromarray(random.integers(0, 65536, (5, 7), dtype=np.uint16)).save(folder / "deep.png")
    write_exr(folder / "linear.exr", {"": random.random((5, 7, 3), dtype=np.float32)}, {})
    return folder
