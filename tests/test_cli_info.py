"""`isonoise info`, and what commands say of files that are no scenes."""

import numpy as np
import pytest

from isonoise.cli import main
from isonoise.film.exr import write_exr

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_info_on_a_scene(capsys):
    assert main(["info", "cornell"]) == 0
    out = capsys.readouterr().out
    labels = [line.split()[0] for line in out.splitlines() if line and line[0] != " "]
    assert labels[:4] == ["file", "cameras", "image", "camera"]
    assert "256x256" in out
    assert "1 parallelogram\n" in out
    assert "DIELECTRIC" not in out
    assert main(["info", "cornell", "--features"]) == 0
    present, absent = capsys.readouterr().out.split("left out")
    assert "TRIANGLES" in present
    assert "DIELECTRIC" in absent


def test_info_on_a_model(capsys, tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert main(["info", "a.obj", "--size", "30x20", "--fov", "50"]) == 0
    out = capsys.readouterr().out
    for text in (
        "a.obj, OBJ",
        "1 triangle",
        "a camera that frames the model, a studio, a ground",
        "30x20",
        "50 x ",
        "(0, 0, 0) to (1, 1, 0)",
    ):
        assert text in out
    assert main(["info", "a.obj", "--camera", "0"]) == 2
    assert "the scene has none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.serialized", b"\x1c\x04", '<shape type="serialized">'),
        ("a.png", b"\x89PNG", "--env"),
        ("a.blend", b"BLENDER", "export it as glTF"),
        ("a.mtl", b"newmtl a", "give the .obj file"),
        ("a", b"glTF\2\0\0\0", "ends in .glb"),
        ("a.txt", b"hello", "no scene that isonoise reads"),
    ],
)
def test_files_that_are_no_scenes_are_named(name, content, message, capsys, tmp_path):
    (tmp_path / name).write_bytes(content)
    for command in (("render", name, "-o", "b.exr"), ("info", name)):
        assert main([*command]) == 2
        err = capsys.readouterr().err
        assert err.startswith("isonoise: ")
        assert err.count("\n") == 1
        assert message in err
        assert ".gltf" in err


def test_info_on_an_image(capsys):
    write_exr("a.exr", {"": np.ones((5, 6, 3), np.float32)}, {"isonoise.seed": 3})
    assert main(["info", "a.exr"]) == 0
    out = capsys.readouterr().out
    assert "6x5" in out
    assert "B, G, R" in out
    assert ["isonoise.seed", "3"] in [line.split() for line in out.splitlines()]
    assert main(["info", "nothing.exr"]) == 2
