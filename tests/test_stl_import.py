"""STL files as scenes: binary and ASCII, several solids, colours of facets."""

import struct
from pathlib import Path

import numpy as np
import pytest

from isonoise.errors import SceneError
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.formats.stl import read as stl_format
from isonoise.scene.formats.stl.support import SUPPORT
from isonoise.scene.load import load_description
from isonoise.scene.spectra import srgb_to_linear

TRIANGLES = np.arange(18, dtype="<f4").reshape(2, 3, 3) ** 2


def binary(attributes=(0, 0), header: bytes = b"") -> bytes:
    facets = (
        np.zeros(3, "<f4").tobytes() + t.tobytes() + struct.pack("<H", a)
        for t, a in zip(TRIANGLES, attributes, strict=True)
    )
    return header.ljust(80, b" ") + struct.pack("<I", 2) + b"".join(facets)


def ascii_text(name: str, triangle: np.ndarray, extra: str = "") -> str:
    corners = "".join(f"      vertex {x} {y:e} {z}\n" for x, y, z in triangle)
    facet = f"  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet\n"
    return f"solid {name}\n{extra}{facet}endsolid {name}\n"


def read(folder: Path, data: bytes) -> tuple[dict, ImportReport]:
    """The mesh of the scene dict, which is valid, and the report."""
    (folder / "a.stl").write_bytes(data)
    report = ImportReport("a.stl", SUPPORT)
    scene = stl_format.read(folder / "a.stl", folder, report)
    load_description({**scene, "sensor": {"type": "perspective"}})
    return scene["mesh"], report


def test_binary_and_ascii_files(tmp_path):
    """A binary file may begin with 'solid', an ASCII file may have several solids and capital letters."""
    text = ascii_text("a b", TRIANGLES[0]) + ascii_text("", TRIANGLES[1]).upper()
    solid = binary(header=b"solid x")
    for data, solids in ((binary(), 1), (solid, 1), (binary() + b"more", 1), (solid + b"more", 1), (text.encode(), 2)):
        mesh, report = read(tmp_path, data)
        np.testing.assert_array_equal(mesh["vertices"][mesh["faces"]], TRIANGLES)
        assert mesh["face_normals"]
        assert "attributes" not in mesh
        assert report.counts == {"triangles": 2, "solids": solids}
        assert not report.warnings()


def test_colours_of_facets(tmp_path):
    """VisCAM: blue in the lowest bits, bit 15 set; Magics: red in the lowest bits, bit 15 for the object's colour."""
    expected = srgb_to_linear(np.array([[31, 16, 4], [0, 0, 0]]) / 31)
    expected[1] = 0.5
    mesh, report = read(tmp_path, binary((1 << 15 | 31 << 10 | 16 << 5 | 4, 0)))
    np.testing.assert_allclose(mesh["attributes"]["face_color"], expected, rtol=1e-6)
    expected[1] = srgb_to_linear(np.array([10, 20, 30]) / 255)
    mesh, report = read(tmp_path, binary((31 | 16 << 5 | 4 << 10, 1 << 15), b"COLOR=\x0a\x14\x1e\xff"))
    np.testing.assert_allclose(mesh["attributes"]["face_color"], expected, rtol=1e-6)
    assert not report.warnings()
    text = ascii_text("a", TRIANGLES[0], "color 1 0 0\n")
    assert "colours in ASCII files" in read(tmp_path, text.encode())[1].warnings()[0]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (binary()[:-1], "shorter than its header states"),
        (ascii_text("a", TRIANGLES[0])[:-11].encode(), "it ends before 'endsolid'"),
        (ascii_text("a", TRIANGLES[0]).replace("vertex 0.0", "vertex x").encode(), "not a readable STL file"),
        (ascii_text("a", TRIANGLES[0]).replace("vertex", "", 1).encode(), "not a readable STL file"),
        (ascii_text("a", TRIANGLES[0]).replace("vertex 0.0", "vertex nan").encode(), "not a finite number"),
    ],
)
def test_damaged_files(data, message, tmp_path):
    with pytest.raises(SceneError, match=message):
        read(tmp_path, data)
