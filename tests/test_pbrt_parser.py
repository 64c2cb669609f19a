"""The tokenizer and the grammar of pbrt files: values, positions of errors, included files."""

import gzip

import pytest
import small_files
from pbrt_files import TRIANGLE, objects, only, read_text, read_world

import isonoise
from isonoise.errors import SceneError
from isonoise.scene.formats.pbrt.tokens import CLOSE, END, OPEN, STRING, WORD, Source, Tokenizer

TEXT = 'Shape "a \\"b\\"" # comment "x"\n\t[ 1 -2.5e3]true#\r\n"c"'


def test_tokens_have_lines_and_columns(tmp_path):
    tokenizer = Tokenizer(Source(tmp_path / "f.pbrt", TEXT))
    tokens = []
    while not tokens or tokens[-1].kind != END:
        tokens.append(tokenizer.next())
    assert [(token.kind, token.text) for token in tokens] == [
        (WORD, "Shape"),
        (STRING, 'a "b"'),
        (OPEN, "["),
        (WORD, "1"),
        (WORD, "-2.5e3"),
        (CLOSE, "]"),
        (WORD, "true"),
        (STRING, "c"),
        (END, ""),
    ]
    places = [str(token.position).rsplit(":", 2)[1:] for token in tokens]
    assert places[:4] == [["1", "1"], ["1", "7"], ["2", "2"], ["2", "4"]]
    assert places[-2:] == [["3", "1"], ["3", "4"]]


ERRORS = [
    ('Shap "sphere"', "1:1", "unknown directive 'Shap'; did you mean 'Shape'?"),
    ('"sphere"', "1:1", 'expected a directive such as Shape, got the string "sphere"'),
    ("Translate 1 2\nWorldBegin", "2:1", "Translate needs 3 finite numbers; got 'WorldBegin' as number 3"),
    ("Scale 1 nan 1", "1:9", "finite numbers"),
    ("Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 5]", "1:44", "closing bracket"),
    ('Film "rgb\n', "1:6", "no closing quote"),
    ("Camera perspective", "1:8", "Camera needs a name in quotes here, got 'perspective'"),
    ('Film "rgb" "integer" 3', "1:12", "a parameter is a type and a name"),
    ('Film "rgb" "number x" 3', "1:12", "unknown type 'number'"),
    ('Film "rgb" "integer xresolution" [3', "1:36", "closing bracket before the end of the file"),
    ('Film "rgb" "integer xresolution" [3 x]', "1:37", "'xresolution' needs a number here, got 'x'"),
    ('Film "rgb" "integer xresolution" ["a" 3]', "1:39", "mixes texts with '3'"),
    ('Film "rgb" "integer xresolution" 3.5', "1:12", "whole numbers"),
    ('Film "rgb" "integer xresolution" 1e12', "1:12", "exceeds 32 bits"),
    ('Film "rgb" "integer xresolution" [1e400]', "1:12", "not finite"),
    ('Film "rgb" "rgb x" [1 2]', "1:12", "no multiple of 3"),
    ('Film "rgb" "bool x" "maybe"', "1:12", "true or false"),
    ('Film "rgb" "string x" 3', "1:12", "needs a text"),
    ('Film "rgb" "float x" "a"', "1:12", "needs numbers"),
    ('Film "rgb" "float xresolution" 3 WorldBegin', "1:12", "has the type 'float' and needs integer"),
    ('Film "rgb" "integer xresolution" [3 4] WorldBegin', "1:12", "needs one value, got 2"),
    ('Film "rgb" "integer xresolution" [] WorldBegin', "1:12", "has no value"),
    ('Film "rgb" "integer xresolution" 0 WorldBegin', "1:12", "0 x 720 pixels"),
    (TRIANGLE, "1:1", "Shape has to be after WorldBegin"),
    ('WorldBegin Camera "perspective"', "1:12", "Camera has to be before WorldBegin"),
    ("WorldBegin AttributeEnd", "1:12", "AttributeEnd without AttributeBegin"),
    ("WorldBegin AttributeBegin ObjectEnd", "1:27", "ObjectEnd without ObjectBegin; AttributeBegin is open"),
    ('WorldBegin NamedMaterial "a"', "1:12", "no material named 'a'"),
    ('WorldBegin ObjectInstance "a"', "1:12", "no object named 'a'"),
    ('WorldBegin CoordSysTransform "wrld"', "1:12", "did you mean 'world'?"),
    ('WorldBegin Material "difuse"', "1:12", "did you mean 'diffuse'?"),
    ('WorldBegin Shape "spere"', "1:12", "did you mean 'sphere'?"),
    ('WorldBegin Shape "sphere" "float radius" -1', "1:27", "the radius has to be above 0"),
    ('WorldBegin Shape "trianglemesh"', "1:12", 'needs vertices: "point3 P"'),
    (
        'WorldBegin\nShape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0]\n "integer indices" [0 1 3]',
        "3:2",
        "an index is outside 0 to 2",
    ),
    ('WorldBegin LightSource "pont"', "1:12", "did you mean 'point'?"),
    ("WorldBegin Scale 0 1 1\n" + TRIANGLE, "2:1", "cannot be inverted"),
    ('WorldBegin Texture "t" "float" "imagemap"', "1:12", '"string filename"'),
    ('WorldBegin MediumInterface "fog" ""\n' + TRIANGLE, "2:1", "no medium named 'fog'"),
    ('WorldBegin Attribute "shapes" "float radius" 1', "1:12", "did you mean 'shape'?"),
    (f'WorldBegin Material "diffuse" "spectrum reflectance" "{"a" * 300}"', "1:31", "unknown spectrum 'aaa"),
    ('ColorSpace "adobe"', "1:1", "unknown colour space 'adobe'"),
    ('Camera "perspective" "float fov" 180 WorldBegin', "1:22", "below 180 degrees"),
    ('Scale 1 1 0 Camera "perspective" WorldBegin', "1:13", "cannot be inverted"),
]


@pytest.mark.parametrize(("text", "place", "message"), ERRORS)
def test_errors_name_file_line_and_column(tmp_path, text, place, message):
    with pytest.raises(SceneError) as error:
        read_text(tmp_path, text)
    assert str(error.value).startswith(f"{tmp_path / 'scene.pbrt'}:{place}: "), error.value
    assert message in str(error.value)


def test_shapes_on_one_line_have_keys_of_their_own(tmp_path):
    """The time to find a key does not grow with the number of shapes on the line."""
    scene, _ = read_text(tmp_path, "WorldBegin " + TRIANGLE.strip() * 3)
    names = [f"trianglemesh_line_1{number}" for number in ("", "_2", "_3")]
    assert [name for name in scene if name.startswith("trianglemesh")] == names


def test_a_byte_order_mark_is_skipped(tmp_path):
    (tmp_path / "part.pbrt").write_text("\ufeff" + TRIANGLE, "utf-8")
    only(read_text(tmp_path, '\ufeffWorldBegin Include "part.pbrt"')[0], "mesh")


def test_open_blocks_and_a_missing_world_are_errors(tmp_path):
    with pytest.raises(SceneError, match=r"AttributeBegin, have an end \(1 too few"):
        read_text(tmp_path, "WorldBegin AttributeBegin")
    for text in ("", 'Film "rgb"'):
        with pytest.raises(SceneError, match="no WorldBegin"):
            read_text(tmp_path, text)


def test_values_may_be_bracketed_or_not(tmp_path):
    options = (
        'Film ["rgb"] "integer xresolution" 32 "integer yresolution" [ 16 ]\nSampler "halton" "integer pixelsamples" 9'
    )
    scene, report = read_text(tmp_path, options + '\nOption "bool disablepixeljitter" false\nWorldBegin\n')
    assert (scene["sensor"]["film"]["width"], scene["sensor"]["film"]["height"]) == (32, 16)
    assert scene["sensor"]["sampler"]["sample_count"] == 9
    assert not report.warnings()


def test_files_are_included_relative_to_the_first_one(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.pbrt").write_text('Include "parts/b.pbrt"\n' + TRIANGLE)
    (tmp_path / "parts" / "b.pbrt").write_text(TRIANGLE + "\n\nShape")
    with pytest.raises(SceneError, match=r"b\.pbrt:4:6: Shape needs a name"):
        read_world(tmp_path, 'Include "parts/a.pbrt"')
    (tmp_path / "parts" / "b.pbrt").write_text(TRIANGLE)
    scene, _ = read_world(tmp_path, 'Include "parts/a.pbrt" Import "parts/b.pbrt"')
    assert len(objects(scene, "mesh")) == 3


def test_includes_that_cannot_be_read_are_errors(tmp_path):
    (tmp_path / "self.pbrt").write_text('Include "self.pbrt"')
    (tmp_path / "inside").mkdir()
    (tmp_path / "outside.pbrt").write_text("")
    for number in range(40):
        (tmp_path / f"{number}.pbrt").write_text(f'Include "{number + 1}.pbrt"')
    for name, message in {
        "none.pbrt": "does not exist",
        "self.pbrt": r"self\.pbrt:1:1: 'self.pbrt' includes itself",
        "0.pbrt": "more than 32 levels deep",
        "a.pbrt.gz": "does not exist",
        "": "empty",
    }.items():
        with pytest.raises(SceneError, match=message):
            read_world(tmp_path, f'Include "{name}"')
    path = tmp_path / "inside" / "scene.pbrt"
    path.write_text('WorldBegin Include "../outside.pbrt"')
    with pytest.raises(SceneError, match="outside the scene's folder"):
        isonoise.load(path)
    assert isonoise.load(path, allow_outside=True)["sensor"]["type"] == "perspective"


def test_compressed_files(tmp_path):
    (tmp_path / "a.pbrt.gz").write_bytes(gzip.compress(TRIANGLE.encode()))
    (tmp_path / "a.ply.gz").write_bytes(gzip.compress(small_files.ply()))
    scene, _ = read_world(tmp_path, 'Include "a.pbrt.gz"\nShape "plymesh" "string filename" "a.ply.gz"')
    assert len(objects(scene, "mesh")) == 2
    for data, message in (
        (b"ply", "is damaged"),
        (gzip.compress(TRIANGLE.encode())[:-9], "is damaged"),
        (gzip.compress(bytes(5_000_000)), "100 times as large"),
    ):
        (tmp_path / "a.pbrt.gz").write_bytes(data)
        with pytest.raises(SceneError, match=rf"a\.pbrt\.gz: .*({message})"):
            read_world(tmp_path, 'Include "a.pbrt.gz"')


def test_unknown_parameters_are_reported_once(tmp_path):
    _, report = read_world(tmp_path, 'Shape "sphere" "float radios" 2\nShape "sphere" "float radios" 2')
    (warning,) = report.warnings()
    assert "the parameter 'radios' of the shape 'sphere' is unknown and ignored" in warning
    assert "1 more" in warning


def test_the_scene_loads_through_the_public_interface(tmp_path):
    path = tmp_path / "scene.pbrt"
    path.write_text('Film "rgb" "integer xresolution" 8 "integer yresolution" 8\nWorldBegin\nShape "sphere"\n')
    scene = isonoise.load(path)
    assert only(scene.description, "sphere")["bsdf"]["type"] == "twosided"
    assert scene["integrator"]["max_depth"] == 6  # pbrt's default is five bounces
