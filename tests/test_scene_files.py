"""Which files a scene may read, and the record of those that it has read."""

import json
import os
import socket
import struct
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import small_files

from isonoise.cli import main
from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.builtin import find_scene
from isonoise.scene.files import record_files

SCENE = '<scene version="3.0.0"><sensor type="perspective"/>{}</scene>'
SHAPE = '<shape type="{}"><string name="filename" value="{}"/>{}</shape>'
BITMAP = '<texture type="bitmap" name="reflectance"><string name="filename" value="{}"/></texture>'
TEXTURE = f'<bsdf type="diffuse">{BITMAP}</bsdf>'
ENVMAP = '<emitter type="envmap"><string name="filename" value="{}"/></emitter>'
NAMING = {
    "include": ('<include filename="{}"/>', SCENE.format("").encode()),
    "obj": (SHAPE.format("obj", "{}", ""), small_files.obj()),
    "ply": (SHAPE.format("ply", "{}", ""), small_files.ply()),
    "serialized": (SHAPE.format("serialized", "{}", ""), small_files.serialized()),
    "texture": ('<shape type="rectangle">' + TEXTURE + "</shape>", small_files.image_file("PNG")),
    "environment map": (ENVMAP, small_files.exr()),
}
"""What names a file -> how a scene does it, a valid content."""
CAN_LINK = pytest.mark.skipif(sys.platform == "win32", reason="needs symbolic links")
CAN_PIPE = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")


def write(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def write_scene(path: Path, case: str, name: str) -> Path:
    """A scene file that names the file `name`."""
    inside = NAMING[case][0].format(name)
    return write(path, f'<scene version="3.0.0">{inside}</scene>' if case == "include" else SCENE.format(inside))


def files_of(scene, **options) -> list[Path]:
    with record_files() as files:
        compile_scene(load_description(scene, **options))
    return list(files)


def glb_with_files(buffer: str, image: str) -> tuple[bytes, bytes]:
    """A GLB file whose buffer and image are files of these names, and the content of the buffer."""
    data = small_files.textured_glb()
    length = int.from_bytes(data[12:16], "little")
    header, content = json.loads(data[20 : 20 + length]), data[20 + length + 8 :]
    header["buffers"][0]["uri"] = buffer
    header["images"] = [{"uri": image}]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text, content


def test_every_file_is_recorded_once(tmp_path):
    """In the order of reading, with links resolved."""
    shapes = [SHAPE.format("obj", "part.obj", ""), SHAPE.format("ply", "sub/part.ply", TEXTURE.format("sub/t.png"))] * 2
    inside = ['<include filename="more.xml"/>', *shapes, ENVMAP.format("sky.exr")]
    top = write(tmp_path / "main.xml", SCENE.format("".join(inside)))
    more = write(tmp_path / "more.xml", '<scene version="3.0.0"></scene>')
    obj = write(tmp_path / "part.obj", small_files.obj())
    ply = write(tmp_path / "sub" / "part.ply", small_files.ply())
    texture = write(tmp_path / "sub" / "t.png", small_files.image_file("PNG"))
    sky = write(tmp_path / "sky.exr", small_files.exr())
    assert files_of(top) == [file.resolve() for file in (top, more, obj, ply, texture, sky)]


def test_files_of_bare_meshes_are_recorded(tmp_path):
    obj, mtl = write(tmp_path / "a.obj", small_files.obj()), write(tmp_path / "a.mtl", small_files.mtl())
    assert files_of(obj) == [obj.resolve(), mtl.resolve()]
    glb, content = glb_with_files("b.bin", "t.png")
    glb, buffer = write(tmp_path / "b.glb", glb), write(tmp_path / "b.bin", content)
    texture = write(tmp_path / "t.png", small_files.image_file("PNG"))
    assert set(files_of(glb)) == {glb.resolve(), buffer.resolve(), texture.resolve()}


def test_threads_record_their_own_files(tmp_path):
    paths = [write(tmp_path / str(number) / "a.ply", small_files.ply()) for number in range(8)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(files_of, paths)) == [[path.resolve()] for path in paths]
    assert files_of("cornell")[0].name == "cornell.xml"
    assert files_of({"type": "scene", "sensor": {"type": "perspective"}}) == []


@pytest.mark.parametrize("case", NAMING)
def test_files_outside_the_folder_are_refused(case, tmp_path):
    """By a path upwards, an absolute path, and a path that goes upwards in the middle."""
    file = write(tmp_path / "other" / "file", NAMING[case][1])
    write(tmp_path / "scene" / "sub" / "file", NAMING[case][1])
    for name in ("../other/file", str(file), "sub/../../other/file"):
        path = write_scene(tmp_path / "scene" / "main.xml", case, name)
        with pytest.raises(SceneError, match=r"main\.xml:1.*is outside the scene's folder .*--allow-outside"):
            load_description(path)
        if case != "include":
            compile_scene(load_description(path, allow_outside=True))
    for name in ("sub/file", "../scene/sub/file", str(tmp_path / "scene" / "sub" / "file")):
        path = write_scene(tmp_path / "scene" / "main.xml", case, name)
        if case != "include":
            assert len(files_of(path)) == 2


@CAN_LINK
@pytest.mark.parametrize("case", NAMING)
def test_links_that_lead_outside_are_refused(case, tmp_path):
    write(tmp_path / "other" / "file", NAMING[case][1])
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "link").symlink_to(tmp_path / "other" / "file")
    (scene / "folder").symlink_to(tmp_path / "other")
    for name in ("link", "folder/file"):
        with pytest.raises(SceneError, match="is outside the scene's folder"):
            load_description(write_scene(scene / "main.xml", case, name))


@CAN_LINK
def test_links_inside_the_folder_are_followed(tmp_path):
    """The folder itself may be named by a link, and the scene file may be one: its folder is that of its name."""
    write(tmp_path / "real" / "deep" / "file", small_files.ply())
    write_scene(tmp_path / "real" / "main.xml", "ply", "link")
    (tmp_path / "real" / "link").symlink_to(tmp_path / "real" / "deep" / "file")
    (tmp_path / "alias").symlink_to(tmp_path / "real")
    real = (tmp_path / "real").resolve()
    assert files_of(tmp_path / "alias" / "main.xml") == [real / "main.xml", real / "deep" / "file"]
    write(tmp_path / "here" / "link", small_files.ply())
    (tmp_path / "here" / "main.xml").symlink_to(real / "main.xml")
    assert files_of(tmp_path / "here" / "main.xml") == [real / "main.xml", (tmp_path / "here" / "link").resolve()]


def test_folders_of_included_files_stay_inside(tmp_path):
    """A file that is included from a folder may name files beside and above it, as far as the scene's folder."""
    write(tmp_path / "scene" / "meshes" / "a.ply", small_files.ply())
    write(tmp_path / "a.ply", small_files.ply())
    top = write(tmp_path / "scene" / "main.xml", SCENE.format('<include filename="parts/part.xml"/>'))
    part = tmp_path / "scene" / "parts" / "part.xml"
    inside = '<scene version="3.0.0">' + SHAPE.format("ply", "{}", "") + "</scene>"
    write(part, inside.format("../meshes/a.ply"))
    assert len(files_of(top)) == 3
    write(part, inside.format("../../a.ply"))
    with pytest.raises(SceneError, match=r"part\.xml:1.*is outside the scene's folder"):
        load_description(top)
    assert len(files_of(top, allow_outside=True)) == 3
    write(top, '<scene version="3.0.0"><path value=".."/></scene>')
    with pytest.raises(SceneError, match=r"<path.*is outside the scene's folder"):
        load_description(top)


def test_material_files_outside_the_folder_are_refused(tmp_path):
    """If there is one of the same name beside the OBJ file, it is read instead."""
    outside = write(tmp_path / "a.mtl", small_files.mtl())
    for name in ("../a.mtl", str(outside)):
        obj = write(tmp_path / "scene" / "a.obj", small_files.obj().replace(b"a.mtl", name.encode()))
        with pytest.raises(SceneError, match=r"a\.obj: .*a\.mtl' is outside the scene's folder"):
            load_description(obj)
        assert files_of(obj, allow_outside=True) == [obj.resolve(), outside.resolve()]
        beside = write(tmp_path / "scene" / "a.mtl", small_files.mtl())
        assert files_of(obj) == [obj.resolve(), beside.resolve()]
        beside.unlink()


@pytest.mark.parametrize("kind", ["buffer", "image"])
def test_files_of_a_glb_outside_the_folder_are_refused(kind, tmp_path):
    names = {"buffer": "b.bin", "image": "t.png"}
    glb, content = glb_with_files(**names | {kind: f"../{names[kind]}"})
    for folder in (tmp_path, tmp_path / "scene"):
        write(folder / "b.bin", content)
        write(folder / "t.png", small_files.image_file("PNG"))
    path = write(tmp_path / "scene" / "a.glb", glb)
    with pytest.raises(SceneError, match="is outside the scene's folder"):
        load_description(path)
    assert (tmp_path / names[kind]).resolve() in files_of(path, allow_outside=True)


def test_a_dict_may_name_any_file(tmp_path, monkeypatch):
    """It has no folder: the files that it names are the caller's choice."""
    file = write(tmp_path / "far" / "a.ply", small_files.ply())
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for name in (str(file), "../far/a.ply"):
        scene = {"type": "scene", "sensor": {"type": "perspective"}, "it": {"type": "ply", "filename": name}}
        assert files_of(scene) == [file.resolve()]


@CAN_PIPE
@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "link to a device"])
@pytest.mark.parametrize("case", NAMING)
def test_only_regular_files_are_read(case, kind, tmp_path, monkeypatch):
    """Wherever they are: even with allow_outside."""
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    name = "file"
    server = None
    if kind == "pipe":
        os.mkfifo(name)
    elif kind == "socket":
        server = socket.socket(socket.AF_UNIX)
        server.bind(name)
    elif kind == "link to a device":
        os.symlink("/dev/zero", name)
    else:
        name = "/dev/zero"
    with pytest.raises(SceneError, match="it is not a regular file"):
        compile_scene(load_description(write_scene(tmp_path / "main.xml", case, name), allow_outside=True))
    if server:
        server.close()


@CAN_PIPE
def test_bare_meshes_read_only_regular_files(tmp_path):
    """A pipe as the file of a GLB's image or buffer, or as an MTL file."""
    os.mkfifo(tmp_path / "a.mtl")
    with pytest.raises(SceneError, match="it is not a regular file"):
        load_description(write(tmp_path / "a.obj", small_files.obj()))
    for buffer, image in (("a.mtl", "t.png"), ("b.bin", "a.mtl")):
        glb, content = glb_with_files(buffer, image)
        write(tmp_path / "b.bin", content)
        with pytest.raises(SceneError, match="it is not a regular file"):
            load_description(write(tmp_path / "a.glb", glb))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc on this system")
@pytest.mark.parametrize("case", NAMING)
def test_files_of_proc_are_read_up_to_their_size(case, tmp_path):
    """Their size is 0. Some, such as /proc/kmsg, are regular files and have no end."""
    with pytest.raises(SceneError):
        compile_scene(
            load_description(write_scene(tmp_path / "main.xml", case, "/proc/self/status"), allow_outside=True)
        )


def test_no_scene_names_code(tmp_path):
    """A strategy or module in a scene file is an unknown element: nothing is imported."""
    write(tmp_path / "evil.py", "raise SystemExit('imported')")
    for inside in (
        '<string name="strategy" value="evil:Strategy"/>',
        '<integrator type="path"><string name="strategy" value="evil:Strategy"/></integrator>',
        '<sensor type="perspective"><sampler type="evil:Strategy"/></sensor>',
        '<integrator type="evil:Strategy"/>',
        '<strategy type="evil:Strategy"/>',
        '<default name="strategy" value="evil:Strategy"/><integrator type="$strategy"/>',
        SHAPE.format("evil:Strategy", "evil.py", ""),
    ):
        sensor = "" if "<sensor" in inside else '<sensor type="perspective"/>'
        with pytest.raises(SceneError, match=r"strategy|evil:Strategy"):
            load_description(write(tmp_path / "main.xml", f'<scene version="3.0.0">{sensor}{inside}</scene>'))
    assert "evil" not in sys.modules


def test_the_command_line_allows_files_outside(tmp_path, capsys):
    write(tmp_path / "a.ply", small_files.ply())
    path = write_scene(tmp_path / "scene" / "main.xml", "ply", "../a.ply")
    assert main(["info", str(path)]) == 2
    assert "outside the scene's folder" in capsys.readouterr().err
    assert main(["info", str(path), "--allow-outside"]) == 0


@pytest.mark.parametrize("option", ["-o", "--log", "--checkpoint"])
@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_no_output_replaces_a_file_of_the_scene(option, link, tmp_path, capsys):
    """An included file, by its name or by a link to it. Nothing is written."""
    part = write(tmp_path / "part.exr", find_scene("cornell").read_bytes())
    path = write(tmp_path / "main.xml", '<scene version="3.0.0"><include filename="part.exr"/></scene>')
    output = part
    if link:
        output = tmp_path / "other.exr"
        link(part, output)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    options = ["-o", str(tmp_path / "a.exr"), option, str(output)]
    assert main(["render", str(path), "--size", "8x6", "--spp", "1", *options]) == 2
    message = "the scene was read from this file" if option != "--checkpoint" else f"{output} exists"
    assert message in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
