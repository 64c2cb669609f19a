"""Bare PLY files as scenes: colours, textures, seams and reports of what is left out."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from isonoise.errors import SceneError
from isonoise.scene.formats.ply import read as ply_format
from isonoise.scene.formats.ply.support import SUPPORT
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.load import load_description
from isonoise.scene.spectra import srgb_to_linear

SQUARE = ("0 0 0", "1 0 0", "1 1 0", "0 1 0")


def ply_text(properties: str, vertices, faces, face_properties: str = "", comment: str = "") -> str:
    lines = ["ply", "format ascii 1.0", *([f"comment {comment}"] if comment else [])]
    lines += [f"element vertex {len(vertices)}", *(f"property float {axis}" for axis in "xyz")]
    lines += [f"property {text}" for text in filter(None, properties.split(";"))]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    lines += [f"property {text}" for text in filter(None, face_properties.split(";"))]
    return "\n".join([*lines, "end_header", *vertices, *faces]) + "\n"


def read(folder: Path, text: str) -> tuple[dict, list[str]]:
    """The mesh of the scene dict, which is valid, and the texts about what is left out."""
    path = folder / "a.ply"
    path.write_text(text)
    report = ImportReport("a.ply", SUPPORT)
    scene = ply_format.read(path, folder.resolve(), report)
    load_description({**scene, "sensor": {"type": "perspective"}})
    return scene["mesh"], report.loss_texts()


def test_vertex_colours(tmp_path):
    """Bytes are sRGB, floats are linear; an alpha that is not opaque is reported."""
    vertices = [
        f"{point} {colour}" for point, colour in zip(SQUARE, ("255 0 0", "0 51 0", "0 0 9", "7 7 7"), strict=True)
    ]
    mesh, losses = read(tmp_path, ply_text("uchar red;uchar green;uchar blue", vertices, ["4 0 1 2 3"]))
    expected = srgb_to_linear(np.array([[255, 0, 0], [0, 51, 0], [0, 0, 9], [7, 7, 7]]) / 255)
    np.testing.assert_allclose(mesh["attributes"]["vertex_color"], expected, rtol=1e-6)
    assert mesh["bsdf"]["bsdf"]["reflectance"] == {"type": "mesh_attribute", "name": "vertex_color"}
    assert losses == []
    rgba = [f"{point} 0.5 0.25 0.125 {alpha}" for point, alpha in zip(SQUARE, (1, 1, 0.5, 1), strict=True)]
    mesh, losses = read(tmp_path, ply_text("float r;float g;float b;float a", rgba, ["3 0 1 2"]))
    np.testing.assert_array_equal(mesh["attributes"]["vertex_color"], np.tile([0.5, 0.25, 0.125], (4, 1)))
    assert losses == ["opacity: the alpha of colours is left out"]


def test_face_colours(tmp_path):
    """Each triangle has the colour of its polygon. Floats above 1 are bytes."""
    colours = ["float red;float green;float blue", ["4 0 1 2 3 255 0 0", "3 0 1 2 0 0 255"]]
    mesh, losses = read(tmp_path, ply_text("", SQUARE, colours[1], colours[0]))
    np.testing.assert_allclose(mesh["attributes"]["face_color"], [[1, 0, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    assert losses == []


@pytest.mark.parametrize("binary", [False, True])
def test_concave_polygons(binary, tmp_path):
    """An arrow head of area 0.5: a fan from its first corner would cover 1.5."""
    points = ("0 0 0", "1 -1 0", "0.5 0 0", "1 1 0")
    if binary:
        head = ply_text("", points, ["x"]).partition("end_header\n")[0].replace("ascii", "binary_little_endian")
        body = (
            np.array([point.split() for point in points], "<f4").tobytes() + b"\4" + np.arange(4, dtype="<i4").tobytes()
        )
        (tmp_path / "a.ply").write_bytes(f"{head}end_header\n".encode() + body)
        scene = ply_format.read(tmp_path / "a.ply", None, ImportReport("a.ply", SUPPORT))
        mesh = scene["mesh"]
    else:
        mesh, _ = read(tmp_path, ply_text("", points, ["4 0 1 2 3"]))
    a, b, c = (mesh["vertices"][mesh["faces"][:, i]] for i in range(3))
    assert 0.5 * np.abs(np.cross(b - a, c - a)[:, 2]).sum() == pytest.approx(0.5)


def test_textures_with_coordinates_of_vertices_or_corners(tmp_path):
    pixels = np.random.default_rng(1).integers(0, 256, (3, 5, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a b.png")
    vertices = [f"{point} {point[:3]}" for point in SQUARE]
    mesh, losses = read(tmp_path, ply_text("float s;float t", vertices, ["4 0 1 2 3"], comment="TextureFile a b.png"))
    np.testing.assert_array_equal(mesh["bsdf"]["bsdf"]["reflectance"]["bitmap"].pixels, pixels)
    np.testing.assert_array_equal(mesh["texcoords"], [[0, 1], [1, 1], [1, 0], [0, 0]])
    assert losses == []
    windows = ply_text("float s;float t", vertices, ["4 0 1 2 3"], comment="TextureFile C:\\models\\A b.PNG")
    np.testing.assert_array_equal(read(tmp_path, windows)[0]["bsdf"]["bsdf"]["reflectance"]["bitmap"].pixels, pixels)
    corners = ["3 0 1 2 6 0 0 1 0 1 1", "3 0 2 3 6 0 0 1 1 0 0.5"]
    text = ply_text("", SQUARE, corners, "list uchar float texcoord", "TextureFile a b.png")
    mesh, losses = read(tmp_path, text)
    np.testing.assert_array_equal(
        mesh["texcoords"][mesh["faces"]], [[[0, 1], [1, 1], [1, 0]], [[0, 1], [1, 0], [0, 0.5]]]
    )
    assert len(mesh["vertices"]) == 4  # corners with equal values are shared
    assert losses == []


def test_a_texture_replaces_colours(tmp_path):
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(tmp_path / "a.png")
    for colour, reported in (("1 1 1", 0), ("1 0 1", 1)):
        vertices = [f"{point} 0 0 {colour}" for point in SQUARE]
        properties = "float u;float v;float r;float g;float b"
        mesh, losses = read(tmp_path, ply_text(properties, vertices, ["3 0 1 2"], comment="TextureFile a.png"))
        assert "attributes" not in mesh
        assert len(losses) == reported


def test_what_is_left_out_is_reported(tmp_path):
    text = ply_text("", SQUARE, ["3 0 1 2"], comment="TextureFile a.png")
    assert "no texture coordinates" in read(tmp_path, text)[1][0]
    vertices = [f"{point} 0 0" for point in SQUARE]
    text = ply_text("float u;float v", vertices, ["3 0 1 2"], comment="TextureFile a.png")
    assert "a.png: there is no such file" in read(tmp_path, text)[1][0]
    with pytest.raises(SceneError, match="point cloud"):
        read(tmp_path, ply_text("", SQUARE, []))


def test_meshes_without_colours_are_grey(tmp_path):
    mesh, losses = read(tmp_path, ply_text("float heat_x", [f"{point} 3" for point in SQUARE], ["3 0 1 2"]))
    assert mesh["bsdf"]["bsdf"]["reflectance"] == 0.5
    assert "attributes" not in mesh
    assert losses == []
