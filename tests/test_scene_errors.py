"""Invalid scenes raise one SceneError that names file, line and element, and never another error."""

import math

import numpy as np
import pytest

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description

SPHERE = '<shape type="sphere">{}</shape>'
FLOAT = '<float name="radius" value="{}"/>'

THIN_LENS = (
    '<sensor type="thinlens"><float name="aperture_radius" value="{}"/>'
    '<float name="focus_distance" value="{}"/></sensor>'
)
ORTHOGRAPHIC = '<sensor type="orthographic">{}</sensor>'

ELEMENTS = [
    # names
    ('<bsdf type="difuse"/>', "unknown bsdf 'difuse'; did you mean 'diffuse'"),
    (
        '<bsdf type="measured"/>',
        "'measured' is not supported .*: needs measured data: fit a principled or roughconductor",
    ),
    ('<shape type="serialized"/>', "shape 'serialized' needs a 'filename'"),
    ('<emitter type="envmap"/>', "emitter 'envmap' needs a 'filename'"),
    ('<emitter type="sunsky"/>', "emitter 'sunsky' is not supported .*: .* render it to an envmap"),
    ('<sensor type="distant"/>', "sensor 'distant' is not supported .*supported: orthographic, perspective, thinlens"),
    ('<sensor type="thinlens"/>', "sensor 'thinlens' needs a 'aperture_radius'"),
    (THIN_LENS.format("-1", "1"), r"'aperture_radius' has to be in \[0, inf\), got -1.0"),
    (THIN_LENS.format("1", "0"), r"'focus_distance' has to be in \(0, inf\), got 0.0"),
    (THIN_LENS.format("1", "1e-30"), "aperture_radius exceeds 1e.18 . focus_distance"),
    (ORTHOGRAPHIC.format('<float name="fov" value="40"/>'), "no parameter 'fov'"),
    (ORTHOGRAPHIC.format('<transform name="to_world"><scale x="0"/></transform>'), "cannot be inverted"),
    (ORTHOGRAPHIC.format('<float name="near_clip" value="1e5"/>'), "near_clip has to be smaller"),
    (
        '<integrator type="prbvolpath"/>',
        "integrator 'prbvolpath' is not supported .*: isonoise does not compute derivatives: use volpath",
    ),
    ('<sensor type="perspective"><film type="specfilm"/></sensor>', "film 'specfilm' is not supported"),
    ("<sphere/>", 'unknown element; did you mean <shape type="sphere">'),
    ('<shap type="sphere"/>', "unknown element; did you mean <shape>"),
    (SPHERE.format('<flaot name="radius" value="1"/>'), "unknown element; did you mean <float>"),
    (SPHERE.format('<float name="radus" value="1"/>'), "no parameter 'radus'; did you mean 'radius'"),
    ('<shape type="sphere" foo="1"/>', "unexpected attribute 'foo'"),
    ("<shape/>", "attribute 'type' is missing"),
    (SPHERE.format('<float value="1"/>'), "attribute 'name' is missing"),
    (SPHERE.format('<ref id="nothing"/>'), "there is no object with the id 'nothing'"),
    ('<bsdf type="diffuse" id="a"/><bsdf type="diffuse" id="a"/>', "the id 'a' is already used by"),
    ('<alias id="a" as="b"/>', "the alias 'b' refers to 'a', which does not exist"),
    (SPHERE.format(FLOAT.format("$r")), "undefined parameter \\$r"),
    ('<include filename="nothing.xml"/>', "there is no 'nothing.xml'"),
    ('<path value="nothing"/>', "there is no 'nothing'"),
    ('<shape type="obj"/>', "needs a 'filename'"),
    ('<shape type="obj"><string name="filename" value="no.obj"/></shape>', "there is no 'no.obj'"),
    # numbers
    (SPHERE.format(FLOAT.format("1cm")), "'1cm' is not a finite number"),
    (SPHERE.format(FLOAT.format("nan")), "'nan' is not a finite number"),
    (SPHERE.format(FLOAT.format("inf")), "'inf' is not a finite number"),
    (SPHERE.format(FLOAT.format("1e400")), "'1e400' is not a finite number"),
    (SPHERE.format(FLOAT.format("")), "'' is not a finite number"),
    (SPHERE.format(FLOAT.format("0")), r"'radius' has to be in \(0, inf\), got 0.0"),
    (SPHERE.format('<string name="radius" value="1"/>'), "'radius' has to be a finite number within 3.4e38, got '1'"),
    (SPHERE.format('<point name="center" x="1" y="2"/>'), "attribute 'z' is missing"),
    (SPHERE.format('<point name="center" value="1 2"/>'), "one or three numbers, got 2"),
    (SPHERE.format('<boolean name="flip_normals" value="1"/>'), "'1' is neither true nor false"),
    ('<integrator type="path"><integer name="max_depth" value="4.0"/></integrator>', "'4.0' is not a whole number"),
    ('<integrator type="path"><float name="max_depth" value="4"/></integrator>', "has to be a whole number"),
    ('<integrator type="path"><integer name="max_depth" value="-2"/></integrator>', r"has to be in \[-1, "),
    ('<integrator type="path"><integer name="rr_depth" value="0"/></integrator>', r"has to be in \[1, "),
    # transforms
    (SPHERE.format('<transform name="to_world"><scale value="0"/></transform>'), "to_world cannot be inverted"),
    (SPHERE.format('<transform name="to_world"><matrix value="1 2 3"/></transform>'), "16 or 9 numbers, got 3"),
    (SPHERE.format('<transform name="to_world"><rotate angle="3"/></transform>'), "axis of a rotation cannot be zero"),
    (SPHERE.format('<transform name="to_world"><shear/></transform>'), "a transform consists of translate"),
    (SPHERE.format('<transform name="to_world"><lookat origin="0 0 0" target="0 0 0"/></transform>'), "target equals"),
    (SPHERE.format('<scale value="2"/>'), "has to be inside a <transform>"),
    (
        '<sensor type="perspective"><transform name="to_world"><scale value="2"/></transform></sensor>',
        "only be translated",
    ),
    # colours
    ('<bsdf type="diffuse"><rgb name="reflectance" value="1 2 3"/></bsdf>', "a reflectance is at most 1"),
    ('<bsdf type="diffuse"><rgb name="reflectance" value="0 -1 0"/></bsdf>', "a reflectance cannot be negative"),
    ('<bsdf type="diffuse"><rgb name="reflectance" value="1 2"/></bsdf>', "one or three numbers, got 2"),
    ('<bsdf type="diffuse"><rgb name="reflectance" value="#ff0000"/></bsdf>', "'#ff0000' is not a finite number"),
    ('<bsdf type="diffuse"><spectrum name="reflectance" value="500:1"/></bsdf>', "at least two pairs"),
    ('<bsdf type="diffuse"><spectrum name="reflectance" value="600:1, 500:1"/></bsdf>', "have to increase"),
    ('<bsdf type="diffuse"><spectrum name="reflectance" value="400:1, x"/></bsdf>', "'x' is not a pair"),
    ('<bsdf type="diffuse"><spectrum name="reflectance" value="1 2"/></bsdf>', "one number or pairs"),
    ('<bsdf type="diffuse"><texture type="bitmap" name="reflectance"/></bsdf>', "texture 'bitmap' needs a 'filename'"),
    ('<bsdf type="diffuse"><texture type="volume" name="reflectance"/></bsdf>', "texture 'volume' is not supported"),
    ('<emitter type="point"><texture type="checkerboard" name="intensity"/></emitter>', "cannot contain a texture"),
    ('<emitter type="constant"><rgb name="radiance" value="-1"/></emitter>', "a radiance cannot be negative"),
    (
        '<bsdf type="conductor"><string name="material" value="Gold"/></bsdf>',
        r"unknown conductor 'Gold' \(known: .*Au,",
    ),
    (
        '<bsdf type="dielectric"><string name="int_ior" value="bk8"/></bsdf>',
        "unknown material 'bk8'; did you mean 'bk7'",
    ),
    ('<bsdf type="dielectric"><float name="int_ior" value="0"/></bsdf>', "index of refraction is a positive number"),
    ('<bsdf type="roughplastic"><float name="int_ior" value="1.000277"/></bsdf>', "int_ior and ext_ior have to differ"),
    # structure
    (
        '<bsdf type="twosided"><bsdf type="dielectric"/></bsdf>',
        "twosided cannot contain the transmissive bsdf 'dielectric'",
    ),
    (
        '<bsdf type="twosided"><bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="diffuse"/>'
        '<bsdf type="null"/></bsdf></bsdf>',
        "twosided cannot contain the transmissive bsdf 'null'",
    ),
    (
        '<bsdf type="twosided"><bsdf type="principled"><float name="spec_trans" value="0.1"/></bsdf></bsdf>',
        "twosided cannot contain the transmissive bsdf 'principled'",
    ),
    ('<bsdf type="twosided"/>', "needs a nested bsdf"),
    (
        '<bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="conductor"/><bsdf type="plastic"/></bsdf>',
        "twosided can contain only 2 bsdfs",
    ),
    ('<bsdf type="twosided" id="a"><ref id="a"/></bsdf>', "refers to itself"),
    (SPHERE.format('<bsdf type="diffuse"/><bsdf type="diffuse"/>'), "can contain only one bsdf"),
    (SPHERE.format('<emitter type="point"/>'), "sphere cannot contain an emitter 'point'"),
    ('<emitter type="area"/>', "an emitter 'area' of the scene itself has no effect: move it into a shape"),
    ('<film type="hdrfilm"/>', "a film 'hdrfilm' of the scene itself has no effect: move it into a sensor, or give"),
    ('<rfilter type="box"/>', "move it into a film, or give it an id"),
    (SPHERE.format('<sensor type="perspective"/>'), "cannot contain a sensor"),
    ('<integrator type="path"/><integrator type="direct"/>', "a scene can have only one integrator"),
    ('<emitter type="constant"/><emitter type="constant"/>', "only one constant emitter"),
    ('<integrator type="moment"/>', "needs a nested integrator"),
    (SPHERE.format('<float name="radius" value="1"><float name="a" value="1"/></float>'), "cannot be inside <float>"),
    (SPHERE.format(FLOAT.format(1) * 2), "'radius' is given twice"),
    (SPHERE.format("text"), "text between elements"),
    ('<shape type="cylinder"><point name="p1" value="0"/></shape>', "p0 and p1 have to differ"),
    ('<emitter type="directional"><vector name="direction" value="0"/></emitter>', "the direction is zero"),
    (
        '<emitter type="point"><point name="position" value="0"/><transform name="to_world"/></emitter>',
        "give 'position' or 'to_world', not both",
    ),
]
SENSOR = [
    ('<float name="fov" value="180"/>', r"'fov' has to be in \(0, 180\)"),
    ('<float name="fov" value="40"/><string name="focal_length" value="50mm"/>', "give 'fov' or 'focal_length'"),
    ('<string name="focal_length" value="50 inch"/>', "focal_length has to be millimetres"),
    ('<string name="fov_axis" value="z"/>', "'fov_axis' is one of x, y, diagonal"),
    ('<float name="near_clip" value="2"/><float name="far_clip" value="1"/>', "near_clip has to be smaller"),
    ('<film type="hdrfilm"><integer name="width" value="0"/></film>', r"'width' has to be in \[1, 65536\]"),
    (
        '<film type="hdrfilm"><integer name="crop_offset_x" value="1"/></film>',
        "the crop window extends beyond the film",
    ),
    ('<film type="hdrfilm"><rfilter type="lanczos"/></film>', "rfilter 'lanczos' is not supported"),
    ('<film type="hdrfilm"><rfilter type="box"><float name="radius" value="1"/></rfilter></film>', "it has none"),
    ('<sampler type="sobol"/>', "unknown sampler 'sobol'"),
    ('<sampler type="independent"><integer name="sample_count" value="0"/></sampler>', "'sample_count' has to be in"),
    ('<string name="srf" value="x"/>', "parameter 'srf' of sensor 'perspective' is not supported .Mitsuba 3 has it"),
]


@pytest.mark.parametrize(
    ("inside", "message"), [*ELEMENTS, *((f'<sensor type="perspective">{x}</sensor>', m) for x, m in SENSOR)]
)
def test_invalid_elements(inside, message, scene_of):
    with pytest.raises(SceneError, match=message) as error:
        scene_of(inside)
    assert "scene.xml:" in str(error.value)


def test_errors_name_the_line(scene_of):
    with pytest.raises(SceneError, match=r'scene\.xml:4: <float name="radus">: shape \'sphere\' has no parameter'):
        scene_of('<shape type="disk"/>\n<shape type="sphere">\n<float name="radus" value="1"/></shape>')


ENTITY_BOMB = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
    '<scene version="3.0.0">&b;</scene>'
)
FILES = [
    (b"", "the file contains no scene"),
    (b"   \n", "the file contains no scene"),
    (bytes(range(256)) * 50, "not well-formed XML"),
    (b"\x89PNG\r\n\x1a\n" + bytes(5000), "not well-formed XML"),
    (b'<scene version="3.0.0"><shape type="sphere">', "not well-formed XML .no element found|unclosed"),
    (b'<scene version="3.0.0"><shape type="sph', "not well-formed XML"),
    (b'<scene version="3.0.0"></shape></scene>', "not well-formed XML .mismatched tag"),
    (b"<html><body/></html>", "needs a version"),
    (b'<html version="3.0.0"><body/></html>', r"unknown element \(known: scene, integrator"),
    (b'<shape version="3.0.0" type="sphere"/>', "the root of a scene has to be of type 'scene', not 'sphere'"),
    (b'<scene version="4.0.0"/>', "version 4.0.0 is not supported; isonoise reads files up to version 3"),
    (b'<scene version="0.5.0"/>', "the scene has no sensor"),
    (b'<scene version="3.0.0"/>', "the scene has no sensor"),
    (b'<scene version="3.0.0">' + b"<a>" * 100_000, "nested more than 64 levels deep"),
    (ENTITY_BOMB.encode(), "remove the <!DOCTYPE>"),
    (b'<?xml version="1.0" encoding="nonsense"?><scene version="3.0.0"/>', "not "),
    ('<scene version="3.0.0">é</scene>'.encode("latin-1"), "not well-formed XML"),
]


@pytest.mark.parametrize(("content", "message"), FILES)
def test_invalid_files(content, message, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message) as error:
        load_description(path)
    assert str(path) in str(error.value)


def test_truncated_scenes(tmp_path):
    """A scene truncated anywhere raises SceneError."""
    text = '<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere"/></scene>'
    path = tmp_path / "scene.xml"
    for length in range(len(text)):
        path.write_text(text[:length])
        with pytest.raises(SceneError):
            load_description(path)


def test_include_cycles_and_exponential_includes(tmp_path):
    scene = '<scene version="3.0.0">{}</scene>'
    (tmp_path / "a.xml").write_text(scene.format('<include filename="b.xml"/>'))
    (tmp_path / "b.xml").write_text(scene.format('<include filename="a.xml"/>'))
    with pytest.raises(SceneError, match="includes itself"):
        load_description(tmp_path / "a.xml")
    for number in range(14):  # 2^14 files without a limit
        (tmp_path / f"{number}.xml").write_text(scene.format(f'<include filename="{number + 1}.xml"/>' * 2))
    (tmp_path / "14.xml").write_text(scene.format(""))
    with pytest.raises(SceneError, match="too many includes"):
        load_description(tmp_path / "0.xml")


def test_exponential_parameters(scene_of):
    names = "".join(f'<default name="p{i + 1}" value="{f"$p{i}" * 16}"/>' for i in range(20))
    with pytest.raises(SceneError, match="exceeds a million characters"):
        scene_of(f'<default name="p0" value="aaaaaaaa"/>{names}')


def nested_dict(depth: int) -> dict:
    bsdf = {"type": "diffuse"}
    for _ in range(depth):
        bsdf = {"type": "twosided", "bsdf": bsdf}
    return bsdf


def cyclic_dict() -> dict:
    scene = {"type": "scene"}
    scene["again"] = scene
    return scene


DICTS = [
    ({}, "a scene object is a dict with a 'type' entry"),
    ({"type": 3}, "a scene object is a dict with a 'type' entry"),
    ({"type": "sphere"}, "the root of a scene has to be of type 'scene'"),
    ({"type": "scene", 3: {"type": "sphere"}}, "keys of a scene object have to be strings"),
    ({"type": "scene", "a": {"type": "spere"}}, "a: unknown type 'spere'; did you mean 'sphere'"),
    ({"type": "scene", "a": {"type": "measured"}}, "a: bsdf 'measured' is not supported"),
    ({"type": "scene", "a": {"type": "sphere", "radius": "1"}}, "a.radius: 'radius' has to be a finite number"),
    ({"type": "scene", "a": {"type": "sphere", "radius": True}}, "'radius' has to be a finite number"),
    ({"type": "scene", "a": {"type": "sphere", "radius": math.nan}}, "'radius' has to be a finite number"),
    ({"type": "scene", "a": {"type": "sphere", "center": [1, 2]}}, "'center' has to be three finite numbers"),
    ({"type": "scene", "a": {"type": "sphere", "center": object()}}, "'center' has to be three finite numbers"),
    ({"type": "scene", "a": {"type": "sphere", "to_world": np.eye(3)}}, "'to_world' has to be a transform"),
    ({"type": "scene", "a": {"type": "sphere", "to_world": np.eye(4) * 1e39}}, "'to_world' has to be a transform"),
    ({"type": "scene", "a": {"type": "sphere", "b": {"type": "ref"}}}, "a.b: a reference needs the 'id'"),
    ({"type": "scene", "a": {"type": "sphere", "b": {"type": "ref", "id": "c"}}}, "there is no object with the id 'c'"),
    ({"type": "scene", "a": {"type": "diffuse", "reflectance": [0.1, 0.2, 0.3]}}, "a colour is a number, an rgb value"),
    ({"type": "scene", "a": {"type": "diffuse", "reflectance": {"type": "rgb"}}}, "an rgb colour is one or three"),
    ({"type": "scene", "a": {"type": "diffuse", "reflectance": {"type": "rgb", "value": "x"}}}, "one or three finite"),
    (
        {"type": "scene", "a": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": "x"}}},
        "a spectrum is one",
    ),
    ({"type": "scene", "a": nested_dict(100)}, "nested more than 64 levels deep"),
    (cyclic_dict(), "nested more than 64 levels deep"),
    ({"type": "scene", "a": {"type": "ply", "filename": 3}}, "'filename' has to be a file name"),
]


@pytest.mark.parametrize(("source", "message"), DICTS)
def test_invalid_dicts(source, message):
    with pytest.raises(SceneError, match=message):
        load_description(source)


def test_missing_files_and_folders(tmp_path):
    for source in (tmp_path, tmp_path / "none.xml", "no-such-scene", "\0", "x" * 5000, ""):
        with pytest.raises(SceneError):
            load_description(source)
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "a": {"type": "ply", "filename": "/no/where.ply"}}
    with pytest.raises(SceneError, match=r"/no/where.ply: cannot be read"):
        compile_scene(load_description(scene))


TINY, HUGE = np.diag([1e-60, 1e-60, 1e-60, 1]), np.diag([1e38, 1e38, 1e38, 1])


def test_shapes_out_of_range():
    for shape in (
        {"type": "sphere", "radius": 1e30},
        {"type": "cube", "to_world": np.diag([1e30, 1, 1, 1])},
        {"type": "rectangle", "to_world": np.diag([1e38, 1, 1, 1])},
    ):
        # among shapes of usual size: alone it would be scaled down
        usual = {f"near {i}": {"type": "rectangle"} for i in range(3)}
        with pytest.raises(SceneError, match=r"shape 'far' extends beyond 1e\+18"):
            compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "far": shape, **usual}))
    for shape in (
        {"type": "cylinder", "radius": 1e38, "p1": [0, 0, 1e38], "to_world": HUGE},
        {"type": "disk", "to_world": TINY},
    ):
        with pytest.raises(SceneError, match="shape 'odd': its size exceeds the range"):
            compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "odd": shape}))


def test_nested_twosided():
    """Mitsuba 3 accepts it; the back of the inner one is never visible."""
    red, blue = ({"type": "diffuse", "reflectance": {"type": "rgb", "value": c}} for c in ([0.5, 0, 0], [0, 0, 0.5]))

    def compiled(bsdf: dict):
        ball = {"type": "sphere", "bsdf": bsdf}
        return compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "ball": ball}))

    plain = compiled({"type": "twosided", "a": red})
    assert compiled({"type": "twosided", "a": {"type": "twosided", "b": red}}).bsdfs[-1] == plain.bsdfs[-1]
    both = {"type": "twosided", "front": red, "back": blue}
    assert len(compiled({"type": "twosided", "a": both, "b": blue}).bsdfs) >= 3
