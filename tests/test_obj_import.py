"""OBJ and MTL files as scenes: polygons, materials, textures, vertex colours, and reports of what is left out."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from isonoise.errors import SceneError
from isonoise.scene.formats.obj import read as obj_format
from isonoise.scene.formats.obj.mtl import read_mtl
from isonoise.scene.formats.obj.support import SUPPORT
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.load import load_description
from isonoise.scene.mesh.obj import read_obj
from isonoise.scene.mesh.polygons import triangle_fans, triangulate
from isonoise.scene.spectra import srgb_to_linear

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


def read(folder: Path, obj: str, mtl: str = "") -> tuple[dict, list[str]]:
    """The scene dict of an OBJ file and the texts about what is left out. The dict is valid."""
    (folder / "a.mtl").write_text(mtl)
    (folder / "a.obj").write_text(obj)
    report = ImportReport("a.obj", SUPPORT)
    scene = obj_format.read(folder / "a.obj", folder.resolve(), report)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load_description(folder / "a.obj")
    return scene, report.loss_texts()


def read_material(folder: Path, statements: str, face: str = FACE) -> tuple[dict, list[str]]:
    """The shape of a square of a material with these statements, and the texts about what is left out."""
    scene, losses = read(folder, f"mtllib a.mtl\n{QUAD}usemtl m\n{face}", f"newmtl m\n{statements}\n")
    return scene["part_0"], losses


def bsdf_of(folder: Path, statements: str) -> dict:
    """The bsdf of a material that is mapped without losses; its `twosided` is removed."""
    shape, losses = read_material(folder, statements)
    assert losses == []
    return shape["bsdf"].get("bsdf", shape["bsdf"]) if shape["bsdf"]["type"] == "twosided" else shape["bsdf"]


def polygon_area(points: np.ndarray) -> float:
    x, y = points.T
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


@pytest.mark.parametrize("corners", [4, 5, 9, 40])
def test_triangles_of_concave_polygons_cover_them_once(corners):
    """The areas of the triangles, all of one orientation, sum to the polygon's: of random star-shaped outlines."""
    rng = np.random.default_rng(corners)
    outlines, sizes = [], np.full(20, corners)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for _ in sizes:
        angle = 2 * np.pi * (np.arange(corners) + 0.6 * rng.random(corners)) / corners
        outlines.append((rng.uniform(0.2, 1, corners) * [np.cos(angle), np.sin(angle)]).T)
    points = np.pad(np.concatenate(outlines), ((0, 0), (0, 1))) @ rotation
    triangles = triangulate(points, sizes)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas = np.einsum("ij,j->i", np.cross(b - a, c - a), rotation[2]) * 0.5 * np.linalg.det(rotation)
    np.testing.assert_allclose(areas.reshape(20, -1).sum(axis=1), [polygon_area(p) for p in outlines], rtol=1e-9)
    assert (areas > -1e-9).all()
    assert (np.sort(triangles.reshape(20, -1), axis=1)[:, [0, -1]] // corners == np.arange(20)[:, None]).all()


def test_convex_polygons_are_fans():
    angle = 2 * np.pi * np.arange(7) / 7
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    sizes = np.array([7, 3, 4])
    corners = np.concatenate([points, points[:3], points[[0, 2, 4, 5]]])
    np.testing.assert_array_equal(triangulate(corners, sizes), triangle_fans(sizes))


def test_a_polygon_with_a_hole_joined_by_a_bridge():
    """The outline visits the bridge's two ends twice: an area of 16 - 4."""
    outline = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    points = np.pad(np.array(outline, float), ((0, 0), (0, 1)))
    a, b, c = (points[triangulate(points, np.array([10]))[:, i]] for i in range(3))
    assert np.abs(0.5 * np.cross(b - a, c - a)[:, 2]).sum() == pytest.approx(12)


@pytest.mark.parametrize("face", ["f 1/1/ 2/2/ 3/3/", "f 1/ 2// 3", "f -4/-4/ -3/-3/ -2/-2", "f 1 2 \\\n 3"])
def test_corners_with_empty_fields(face, tmp_path):
    (tmp_path / "a.obj").write_text(QUAD + face + "\n")
    mesh = read_obj(tmp_path / "a.obj").mesh
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[0]], [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    if "1/1" in face or "-4/-4" in face:
        np.testing.assert_array_equal(mesh.uvs[mesh.faces[0]], [[0, 1], [1, 1], [1, 0]])


def test_faces_of_one_or_two_corners_are_left_out(tmp_path):
    scene, losses = read(tmp_path, f"{QUAD}f 1 2\n{FACE}f 3\nf 1/1 2/2\n")
    assert scene["part_0"]["faces"].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert len(losses) == 1
    assert "faces of one or two corners" in losses[0]
    with pytest.raises(SceneError, match="no faces, only vertices"):
        read(tmp_path, f"{QUAD}f 1 2\n")
    with pytest.raises(SceneError, match=r"a\.obj:9: a face has fewer"):
        read_obj(tmp_path / "a.obj")


def test_errors_name_the_line(tmp_path):
    for text, line in (
        (QUAD + "f 1 2 9\n", 9),
        ("v 0 0 \\\n0\nv 1 0 x\nf 1 2 2\n", 3),
        ("\n# a\nv 0 nan 0\nf 1 1 1", 3),
    ):
        (tmp_path / "a.obj").write_text(text)
        with pytest.raises(SceneError, match=rf"a\.obj:{line}: "):
            read_obj(tmp_path / "a.obj")
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 x\n")
    with pytest.raises(SceneError, match=r"a\.mtl:2: Kd: not a colour: '1 0 x'"):
        read_mtl(tmp_path / "a.mtl")


def test_the_exponent_becomes_a_roughness(tmp_path):
    """alpha² = 2 / (Ns + 2)."""
    bsdf = bsdf_of(tmp_path, "Kd 0.5 0.25 0.125\nKs 0.4 0.3 0.2\nNs 48\nNi 1.4\nillum 2")
    assert (bsdf["type"], bsdf["alpha"], bsdf["int_ior"]) == ("roughplastic", pytest.approx(0.2), 1.4)
    assert bsdf["diffuse_reflectance"]["value"] == [0.5, 0.25, 0.125]
    assert bsdf["specular_reflectance"]["value"] == [0.4, 0.3, 0.2]
    metal = bsdf_of(tmp_path, "Kd 0 0 0\nKs 0.9 0.6 0.3\nNs 198")
    assert (metal["type"], metal["alpha"]) == ("roughconductor", pytest.approx(0.1))
    assert metal["specular_reflectance"]["value"] == [0.9, 0.6, 0.3]


def test_materials_without_reflections_are_diffuse(tmp_path):
    for statements in ("Kd 0.5 0.5 0.5", "Kd 0.5 0.5 0.5\nKs 0 0 0\nillum 2", "Kd 0.5 0.5 0.5\nKs 1 1 1\nillum 1"):
        assert bsdf_of(tmp_path, statements) == {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}}
    maya = "illum 4\nKd 0.5 0.5 0.5\nTf 1 1 1\nNi 1"  # what Maya writes for an opaque surface
    assert bsdf_of(tmp_path, maya)["type"] == "diffuse"


def test_mirrors_and_glass(tmp_path):
    mirror = bsdf_of(tmp_path, "illum 5\nKd 0.01 0.01 0.01\nKs 0.95 0.95 0.95\nNs 1000")
    assert (mirror["type"], mirror["specular_reflectance"]["value"]) == ("conductor", [0.95] * 3)
    shape, losses = read_material(tmp_path, "illum 7\nKd 0 0 0\nNi 1.33\nTf 1 0.25 0.0625")
    assert shape["bsdf"]["type"] == "dielectric"  # without twosided
    assert shape["bsdf"]["int_ior"] == 1.33
    assert shape["bsdf"]["specular_transmittance"]["value"] == [1, 0.5, 0.25]  # squared by the two surfaces
    assert losses == []
    assert "only the hue of Tf" in read_material(tmp_path, "illum 7\nNi 1.5\nTf 0.1 0.1 0.1")[1][0]


def test_a_partial_mirror_keeps_its_colours(tmp_path):
    """Weights times colours are Kd and Ks; a sum above 1 is reduced to 1."""
    bsdf = bsdf_of(tmp_path, "illum 3\nKd 0.4 0.2 0\nKs 0.5 0.5 0.1")
    weight = bsdf["weight"]
    np.testing.assert_allclose((1 - weight) * np.array(bsdf["first"]["reflectance"]["value"]), [0.4, 0.2, 0])
    np.testing.assert_allclose(weight * np.array(bsdf["second"]["specular_reflectance"]["value"]), [0.5, 0.5, 0.1])
    shape, losses = read_material(tmp_path, "illum 3\nKd 1 1 1\nKs 0.6 0.6 0.6")
    parts = shape["bsdf"]["bsdf"]
    assert (1 - parts["weight"]) * parts["first"]["reflectance"]["value"][0] == pytest.approx(1 / 1.6)
    assert "exceeds 1" in losses[0]


def test_the_pbr_extension_is_principled(tmp_path):
    statements = "Kd 0.8 0.4 0.2\nPr 0.3\nPm 0.9\nPs 0.5\nPc 0.25\nPcr 0.2\naniso 0.7\nNi 1.6"
    bsdf = bsdf_of(tmp_path, statements)
    numbers = {key: bsdf[key] for key in ("roughness", "metallic", "sheen", "clearcoat", "anisotropic", "eta")}
    assert numbers == {
        "roughness": 0.3,
        "metallic": 0.9,
        "sheen": 0.5,
        "clearcoat": 0.25,
        "anisotropic": 0.7,
        "eta": 1.6,
    }
    # the alpha of principled's clearcoat is 0.1 at gloss 0 and 0.001 at gloss 1
    assert 0.1 + bsdf["clearcoat_gloss"] * (0.001 - 0.1) == pytest.approx(0.2**2)


def test_materials_of_blender(tmp_path):
    """Ns = 1000 (1 - roughness)², and Ka is the metalness where illum is 3."""
    statements = "Ns 250\nKa 0.75 0.75 0.75\nKd 0.8 0.8 0.8\nKs 0.5 0.5 0.5\nNi 1.45\nd 1\nillum 3\n"
    obj = f"mtllib a.mtl\n{QUAD}usemtl m\n{FACE}"
    scene, losses = read(tmp_path, obj, f"# Blender 4.0.2 MTL File: 'None'\nnewmtl m\n{statements}")
    bsdf = scene["part_0"]["bsdf"]["bsdf"]
    assert (bsdf["type"], bsdf["roughness"], bsdf["metallic"], bsdf["specular"]) == ("principled", 0.5, 0.75, 0.5)
    assert losses == []


@pytest.mark.parametrize(("statements", "opacity"), [("d 0.25", 0.25), ("Tr 0.75", 0.25), ("d 0.25\nTr 0", 0.25)])
def test_opacity_becomes_a_mask(statements, opacity, tmp_path):
    bsdf = bsdf_of(tmp_path, f"Kd 1 1 1\n{statements}")
    assert (bsdf["type"], bsdf["opacity"], bsdf["bsdf"]["type"]) == ("mask", opacity, "twosided")


def test_halos_are_reported(tmp_path):
    shape, losses = read_material(tmp_path, "d -halo 0.25")
    assert shape["bsdf"]["opacity"] == 0.25
    assert "-halo is left out" in losses[0]
    assert bsdf_of(tmp_path, "d -halo 1")["type"] == "diffuse"


def test_opaque_by_either_meaning_of_tr(tmp_path):
    for statements in ("d 1\nTr 0", "Tr 1", "Tr 0", "d 1"):
        assert bsdf_of(tmp_path, statements)["type"] == "diffuse"


def test_emission(tmp_path):
    shape, losses = read_material(tmp_path, "Ke 3 2 1")
    assert shape["emitter"] == {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    assert losses == []
    assert "emitter" not in read_material(tmp_path, "Ke 0 0 0")[0]


def test_emissive_textures(tmp_path):
    """Ke times the image; a Ke of 0 beside an image is meant as no factor."""
    linear = srgb_to_linear(save_image(tmp_path / "a.png") / 255)
    for statements, factor in (("Ke 2 1 0.5\nmap_Ke a.png", (2, 1, 0.5)), ("Ke 0 0 0\nmap_Ke a.png", 1)):
        shape, losses = read_material(tmp_path, statements)
        np.testing.assert_allclose(shape["emitter"]["radiance"]["bitmap"].linear(), linear * factor, rtol=1e-5)
        assert losses == []


def save_image(path: Path, mode: str = "RGB") -> np.ndarray:
    pixels = np.random.default_rng(3).integers(0, 256, (3, 4, len(mode)), dtype=np.uint8)
    Image.fromarray(pixels if len(mode) > 1 else pixels[..., 0], mode).save(path)
    return pixels


def test_textures_are_multiplied_and_transformed(tmp_path):
    (tmp_path / "tex dir").mkdir()
    pixels = save_image(tmp_path / "tex dir" / "a b.PNG")
    statement = "Kd 0.5 1 1\nmap_Kd -s 2 3 1 -o 0.25 -0.5 -clamp on -blendu on tex dir\\A b.png"
    texture = bsdf_of(tmp_path, statement)["reflectance"]
    np.testing.assert_allclose(
        texture["bitmap"].linear(), srgb_to_linear(pixels / 255) * np.float32([0.5, 1, 1]), rtol=1e-6
    )
    assert texture["wrap_mode"] == "clamp"
    u, v = 0.3, 0.9  # of the file, whose v points up
    uv = texture["to_uv"] @ [u, 1 - v, 0, 1]
    np.testing.assert_allclose([uv[0], 1 - uv[1]], [2 * u + 0.25, 3 * v - 0.5])


def test_opacity_textures(tmp_path):
    """The alpha of an image that has one, otherwise its luminance."""
    pixels, grey = save_image(tmp_path / "rgba.png", "RGBA"), save_image(tmp_path / "grey.png", "L")
    for name, expected in (("rgba.png", pixels[..., 3:]), ("grey.png", grey)):
        bsdf = bsdf_of(tmp_path, f"map_d {name}")
        assert bsdf["type"] == "mask"
        assert bsdf["opacity"]["raw"]
        np.testing.assert_array_equal(bsdf["opacity"]["bitmap"].pixels, expected)


def test_textures_of_numbers(tmp_path):
    pixels = save_image(tmp_path / "a.png") / 255
    bsdf = bsdf_of(tmp_path, "Pr 0.5\nmap_Pr -imfchan g a.png\nmap_Pm -mm 0.5 0.5 -imfchan b a.png")
    np.testing.assert_allclose(bsdf["roughness"]["bitmap"].linear(True)[..., 0], 0.5 * pixels[..., 1], atol=1e-6)
    np.testing.assert_allclose(bsdf["metallic"]["bitmap"].linear(True)[..., 0], 0.5 + 0.5 * pixels[..., 2], atol=1e-6)
    bsdf = bsdf_of(tmp_path, "Ks 0.5 0.5 0.5\nNs 100\nmap_Ns -imfchan r a.png")
    alpha = np.sqrt(2 / (100 * pixels[..., 0] + 2))
    np.testing.assert_allclose(bsdf["roughness"]["bitmap"].linear(True)[..., 0] ** 2, alpha, rtol=1e-5)


def test_bump_and_normal_maps(tmp_path):
    """An image of normals is a normal map, whatever the statement says."""
    Image.fromarray(np.full((4, 4, 3), (120, 133, 250), np.uint8)).save(tmp_path / "n.png")
    save_image(tmp_path / "h.png", "L")
    for statement in ("map_Bump -bm 1 n.png", "norm n.png"):
        assert bsdf_of(tmp_path, statement)["type"] == "normalmap"
    square, losses = read_material(tmp_path, "bump -bm 2 h.png")
    bsdf = square["bsdf"]["bsdf"]
    assert losses == []
    # white is 2 (-bm) times 1 % of the length of a unit of uv, which is 1 here
    assert (bsdf["type"], bsdf["scale"]) == ("bumpmap", pytest.approx(0.02))


def test_missing_files_are_reported(tmp_path):
    assert "map.png" in read_material(tmp_path, "map_Kd map.png")[1][0]
    (tmp_path / "bad.png").write_bytes(b"not an image")
    assert "image" in read_material(tmp_path, "map_Kd bad.png")[1][0]
    _, losses = read(tmp_path, f"mtllib b.mtl\n{QUAD}usemtl m\n{FACE}")
    assert len(losses) == 1
    assert "b.mtl: there is no such file" in losses[0]
    _, losses = read(tmp_path, f"mtllib a.mtl\n{QUAD}usemtl m\n{FACE}l 1 2\np 1\n")
    assert len(losses) == 2
    assert "material 'm': no MTL file defines it" in losses[1]
    (tmp_path / "in").mkdir()
    save_image(tmp_path / "a.png")
    (tmp_path / "a #1.png").write_bytes((tmp_path / "a.png").read_bytes())
    for name in ("a.png # a comment", "a #1.png"):
        assert read_material(tmp_path, f"map_Kd {name}")[1] == []
    with pytest.raises(SceneError, match=r"a\.png' is outside the scene's folder"):
        read_material(tmp_path / "in", "map_Kd ../a.png")


def test_comments_after_names_and_names_of_no_material(tmp_path):
    text = f"mtllib a.mtl # of a\n{QUAD}usemtl m #1 # red\n{FACE}usemtl None\n{FACE}usemtl (null)\n{FACE}"
    scene, losses = read(tmp_path, text, "newmtl m #1\nKd 0.125 0 0\n")
    assert losses == []
    assert scene["part_0"]["bsdf"]["bsdf"]["reflectance"]["value"] == [0.125, 0, 0]


def test_several_libraries_and_names_with_blanks(tmp_path):
    (tmp_path / "my b.mtl").write_text("newmtl Material #25\nKd 0.125 0 0\n")
    for statement in ("mtllib a.mtl my b.mtl", "mtllib a.mtl\nmtllib C:\\work\\My b.mtl"):
        scene, losses = read(tmp_path, f"{statement}\n{QUAD}usemtl Material #25\n{FACE}usemtl x\n{FACE}", "newmtl x\n")
        assert losses == []
        assert scene["part_0"]["bsdf"]["bsdf"]["reflectance"]["value"] == [0.125, 0, 0]


def test_long_lines_take_linear_time(tmp_path):
    """Of 500 kB each: quadratic time would be minutes."""
    words = "-a b " * 100_000
    _, losses = read(tmp_path, f"mtllib {words}a.mtl\n{QUAD}usemtl m\n{FACE}", f"newmtl m\nmap_Kd {words}\n")
    assert "there is no such file" in losses[0]


def test_names_with_unusual_characters(tmp_path):
    """A next-line character, which Latin-1 files have in the place of an ellipsis, ends no line."""
    (tmp_path / "b.mtl").write_bytes(b"newmtl m\x85n\nKd 0.125 0 0\n")
    (tmp_path / "b.obj").write_bytes(f"mtllib b.mtl\n{QUAD}usemtl m\x85n\n{FACE}".encode("latin-1"))
    report = ImportReport("b.obj", SUPPORT)
    scene = obj_format.read(tmp_path / "b.obj", tmp_path.resolve(), report)
    assert report.warnings() == []
    assert scene["part_0"]["bsdf"]["bsdf"]["reflectance"]["value"] == [0.125, 0, 0]


def test_vertex_colours_are_srgb_times_kd(tmp_path):
    quad = "v 0 0 0 1 0.5 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\n"
    scene, losses = read(tmp_path, f"mtllib a.mtl\n{quad}usemtl m\nf 1 2 3\n", "newmtl m\nKd 0.5 1 1\n")
    expected = srgb_to_linear(np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])) * (0.5, 1, 1)
    np.testing.assert_allclose(scene["part_0"]["attributes"]["vertex_color"], expected, rtol=1e-6)
    assert scene["part_0"]["bsdf"]["bsdf"]["reflectance"] == {"type": "mesh_attribute", "name": "vertex_color"}
    assert losses == []
    white = QUAD.replace(" 0\nv", " 0 1 1 1\nv")
    assert "attributes" not in read(tmp_path, white + FACE)[0]["part_0"]


def test_smoothing_groups(tmp_path):
    """`s off` is flat shading where there are no normals."""
    scene, _ = read(tmp_path, f"{QUAD}s 1\nf 1 2 3\ns off\nf 1 3 4\n")
    assert [scene[f"part_{i}"]["face_normals"] for i in range(2)] == [False, True]
    scene, _ = read(tmp_path, f"{QUAD}vn 0 0 1\ns off\nf 1//1 2//1 3//1\n")
    assert not scene["part_0"]["face_normals"]


def test_public_cornell_boxes(public_scenes):
    """A mirror and a glass ball, without a warning but that of the glass's filter."""
    report = ImportReport("a.obj", SUPPORT)
    path = public_scenes / "obj" / "CornellBox-Water.obj"
    scene = obj_format.read(path, path.parent.resolve(), report)
    types = [part["bsdf"].get("bsdf", part["bsdf"])["type"] for name, part in scene.items() if name != "type"]
    assert types == ["conductor", "dielectric", *["diffuse"] * 6, "dielectric"]
    assert len(report.warnings()) == 1
    assert math.isclose(scene["part_8"]["bsdf"]["int_ior"], 1.33)
