"""Files of Mitsuba 0.x: renamed parameters, a published scene against its upgraded file, and Mitsuba's parser."""

import re
from pathlib import Path

import numpy as np
import pytest

from isonoise.errors import SceneError
from isonoise.scene import load_description
from isonoise.scene.parse.elements import Element, Reference
from isonoise.scene.parse.xml_reader import read_xml
from isonoise.scene.parse.xml_upgrade import snake_case


@pytest.fixture
def read(tmp_path):
    """A function that reads a scene, given the content of its <scene> element."""

    def make(inside: str, version: str = "0.6.0", name: str = "scene.xml", parameters=()) -> Element:
        path = tmp_path / name
        path.write_text(f'<scene version="{version}">{inside}</scene>')
        return read_xml(path, dict(parameters))

    return make


def values(element: Element) -> dict:
    assert len({name for name, _, _ in element.entries}) == len(element.entries)
    return {name: value for name, value, _ in element.entries}


def first(scene: Element) -> Element:
    return scene.entries[0][1]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *(("toWorld", "to_world"), ("maxDepth", "max_depth"), ("intIOR", "int_ior"), ("sigmaS", "sigma_s")),
        *(("alphaU", "alpha_u"), ("shapeIndex", "shape_index"), ("flipTexCoords", "flip_tex_coords")),
        *(("fov", "fov"), ("high_quality_edges", "high_quality_edges"), ("color0", "color0"), ("", "")),
        # Not names of parameters; the results are Mitsuba 3.9.1's.
        *(("toWORLDAbc", "to_worldabc"), ("aBc1D", "a_bc1D"), ("ABc", "ABc"), ("x_Yy", "x_Yy"), ("a1B", "a1B")),
    ],
)
def test_snake_case(old, new):
    assert snake_case(old) == new


def test_parameter_names(read):
    scene = read(
        '<bsdf type="roughplastic" id="myPaint"><float name="intIOR" value="1.5"/>'
        '<rgb name="specularReflectance" value="1 .5 .2"/><ref name="diffuseReflectance" id="myWood"/></bsdf>'
        '<texture type="bitmap" id="myWood"><string name="filterType" value="nearestSome"/></texture>'
        '<shape type="sphere"><transform name="toWorld"><scale x="2"/></transform>'
        '<bsdf name="myBsdf" type="diffuse"/></shape>'
    )
    paint, wood, sphere = (value for _, value, _ in scene.entries)
    assert (paint.id, values(paint)["int_ior"], set(values(sphere))) == ("myPaint", 1.5, {"to_world", "my_bsdf"})
    assert values(paint)["specular_reflectance"] == {"type": "rgb", "value": [1, 0.5, 0.2]}
    assert values(paint)["diffuse_reflectance"] == Reference("myWood")
    assert values(wood) == {"filter_type": "nearestSome"}  # values do not change


def test_reflectance_of_diffuse(read):
    inside = '<bsdf type="{}"><float name="diffuseReflectance" value=".3"/></bsdf>'
    assert values(first(read(inside.format("diffuse")))) == {"reflectance": 0.3}
    assert values(first(read(inside.format("plastic")))) == {"diffuse_reflectance": 0.3}


@pytest.mark.parametrize(
    ("given", "matrix"),
    [  # Mitsuba 3 translates before it scales
        ({"uscale": 2, "vscale": 4}, [[2, 0, 0], [0, 4, 0]]),
        ({"uoffset": 0.5}, [[1, 0, 0.5], [0, 1, 0]]),
        ({"uoffset": 0.5, "voffset": 3, "uscale": 2}, [[2, 0, 1], [0, 1, 3]]),
    ],
)
@pytest.mark.parametrize("tag", ["float", "integer"])
def test_offsets_and_scales_of_textures(given, matrix, tag, read):
    if tag == "integer":
        given = {name: int(np.ceil(value)) for name, value in given.items()}
        matrix = [[2, 0, 0], [0, 4, 0]] if "vscale" in given else [[1 + ("uscale" in given), 0, 1], [0, 1, 0]]
        matrix = [[2, 0, 2], [0, 1, 3]] if "voffset" in given else matrix
    inside = "".join(f'<{tag} name="{name}" value="{value}"/>' for name, value in given.items())
    result = values(first(read(f'<texture type="checkerboard">{inside}</texture>')))
    assert set(result) == {"to_uv"}
    expected = np.eye(4)
    expected[:2, [0, 1, 3]] = matrix
    np.testing.assert_array_equal(result["to_uv"], expected)


def test_uv_parameters_after_substitution(read):
    inside = '<default name="tilesPerSide" value="4"/><texture type="bitmap"><float name="{}" value="$tilesPerSide"/>'
    scene = read(inside.format("uscale") + "</texture>", parameters={"tilesPerSide": "8"})
    assert values(first(scene))["to_uv"][0, 0] == 8


def test_look_at(read):
    inside = '<sensor type="perspective"><transform name="toWorld"><{} origin="1,2,3" target="4,6,5" up="0,1,0"/>'
    old, new = (
        values(first(read(inside.format(n) + "</transform></sensor>")))["to_world"] for n in ("lookAt", "lookat")
    )
    np.testing.assert_array_equal(old, new)


def test_each_included_file_has_its_own_version(read, tmp_path):
    (tmp_path / "old.xml").write_text('<bsdf version="0.5.0" type="plastic"><float name="intIOR" value="2"/></bsdf>')
    include = '<include filename="old.xml"/><bsdf type="plastic"><float name="extIOR" value="1"/></bsdf>'
    for version, name in (("2.1.0", "extIOR"), ("3.0.0", "extIOR"), ("0.4.0", "ext_ior")):
        old, own = (value for _, value, _ in read(include, version).entries)
        assert values(old) == {"int_ior": 2.0}
        assert values(own) == {name: 1.0}


@pytest.mark.parametrize("version", ["0.1.0", "0.4.0", "0.5.0", "0.6.0", " 0.6.0", "1.9.9", "0.5", "0"])
def test_old_versions(version, read):
    assert set(values(first(read('<shape type="cube"><float name="aB" value="1"/></shape>', version)))) == {"a_b"}


@pytest.mark.parametrize("version", ["2.0.0", "2.2.1", "3.0.0", "3.9.1", "3"])
def test_versions_that_need_no_upgrade(version, read):
    assert set(values(first(read('<shape type="cube"><float name="aB" value="1"/></shape>', version)))) == {"aB"}


@pytest.mark.parametrize(
    "version", ["4.0.0", "12", "", "new", "-1.0.0", "0.5.x", "0.5.0.1", "3.0.0a", "\u0661.0.0", "9" * 5000]
)
def test_unknown_versions(version, read):
    with pytest.raises(SceneError, match=r"scene\.xml:1: <scene>: (version .* is not supported|'.*' is not a version)"):
        read("", version)


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<texture type="bitmap"><string name="uscale" value="2"/></texture>', "<string .*'uscale' has to be a number"),
        ('<texture type="bitmap"><boolean name="voffset" value="true"/></texture>', "'voffset' has to be a number"),
        ('<texture type="bitmap"><texture name="uoffset" type="bitmap"/></texture>', "'uoffset' has to be a number"),
        (
            '<texture type="bitmap"><float name="uscale" value="2"/><float name="uscale" value="2"/></texture>',
            "'uscale' is given twice",
        ),
        (
            '<bsdf type="dielectric"><float name="intIOR" value="2"/><float name="int_ior" value="2"/></bsdf>',
            "'int_ior' is given twice",
        ),
        ('<camera type="perspective"/>', "was removed in Mitsuba 3.*write <sensor>"),
        ('<shape type="sphere"><luminaire type="area"/></shape>', "was removed in Mitsuba 3.*write <emitter>"),
        ('<bsdf type="diffuse"><srgb name="reflectance" value="#fff"/></bsdf>', "write <rgb> with linear values"),
        ('<bsdf type="diffuse"><float name="reflectanse" value="1"/></bsdf>', "did you mean 'reflectance'"),
    ],
)
def test_errors(inside, message, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="0.5.0">\n{inside}<sensor type="perspective"/></scene>')
    with pytest.raises(SceneError, match=rf"scene\.xml:2: .*{message}"):
        load_description(path)


def flatten(scene: Element) -> list[Element]:
    """All elements in file order."""
    nested = [flatten(value) for _, value, _ in scene.entries if isinstance(value, Element)]
    return [scene, *(element for elements in nested for element in elements)]


def test_published_scene_equals_its_upgraded_file(public_scenes):
    """The published file of staircase2 and the upgraded one differ only in render settings."""
    folder = public_scenes / "staircase2"
    old, new = (flatten(read_xml(folder / name, {})) for name in ("scene-v0.5.xml", "scene.xml"))
    compared = [[e for e in side if e.kind not in ("scene", "film", "integrator", "rfilter")] for side in (old, new)]
    assert len(compared[0]) == len(compared[1]) == 91
    for a, b in zip(*compared, strict=True):
        assert (a.kind, a.type, a.id) == (b.kind, b.type, b.id)
        if a.kind == "sensor":
            continue
        for (name_a, value_a, _), (name_b, value_b, _) in zip(a.entries, b.entries, strict=True):
            assert name_a == name_b == snake_case(name_a)
            if not isinstance(value_a, Element):
                np.testing.assert_equal(value_a, value_b)
    assert values(old[1])["max_depth"] == 65
    film = next(e for e in old if e.kind == "film")
    names = {"width", "height", "file_format", "pixel_format", "banner", "rfilter", "high_quality_edges"}
    assert set(values(film)) == names


SNIPPETS = """
<integrator type="volpath"><integer name="maxDepth" value="65"/><boolean name="hideEmitters" value="true"/></integrator>
<sensor type="thinlens"><float name="apertureRadius" value="0.1"/><float name="focusDistance" value="3"/>
  <float name="fov" value="40"/><string name="fovAxis" value="x"/>
  <transform name="toWorld"><lookat origin="1, 2, 3" target="0, 0, 0" up="0, 1, 0"/>
  <scale x="-1"/></transform><sampler type="independent"><integer name="sampleCount" value="9"/></sampler>
  <film type="hdrfilm"><string name="fileFormat" value="openexr"/><rfilter name="rfilter" type="tent"/></film></sensor>
<texture type="checkerboard" id="tiles"><float name="uscale" value="4"/><float name="vscale" value="2.5"/>
  <float name="uoffset" value="0.25"/><rgb name="color0" value="0.4, 0.3, 0.2"/></texture>
<texture type="checkerboard" id="shifted"><integer name="voffset" value="3"/></texture>
<bsdf type="diffuse" id="floorPaint"><ref name="diffuseReflectance" id="tiles"/></bsdf>
<bsdf type="roughplastic" id="plastic"><ref name="diffuseReflectance" id="tiles"/><float name="intIOR" value="1.5"/>
  <string name="distribution" value="ggx"/><rgb name="specularReflectance" value="1"/></bsdf>
<bsdf type="bumpmap"><texture name="bumpTexture" type="checkerboard"><float name="uscale" value="2"/></texture>
  <bsdf type="roughconductor"><float name="alphaU" value=".2"/><float name="alphaV" value=".1"/></bsdf></bsdf>
<shape type="sphere"><point name="center" x="1" y="2" z="3"/><boolean name="flipNormals" value="true"/>
  <ref id="floorPaint"/><emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter>
  <medium name="interior" type="homogeneous"><rgb name="sigmaT" value=".1 .2 .3"/><phase type="hg"/></medium></shape>
<emitter type="spot"><float name="cutoffAngle" value="40"/><float name="beamWidth" value="10"/></emitter>
"""


@pytest.mark.parametrize(
    "source",
    [
        *("staircase2/scene-v0.5.xml", "staircase2/scene.xml", "bunny-box/scene.xml", "veach-mis/scene.xml"),
        *("0.4.0", "0.5.0", "0.6.0", "2.1.0", "3.0.0"),
    ],
)
def test_against_mitsubas_parser(source, request, tmp_path, mitsuba):
    """All objects and parameters of a file are those of Mitsuba 3 after its upgrade."""
    if not hasattr(mitsuba, "parser"):
        pytest.skip("needs a Mitsuba version with a public parser")
    path = tmp_path / "scene.xml"
    if source.endswith(".xml"):
        path = request.getfixturevalue("public_scenes") / source
    else:
        path.write_text(f'<scene version="{source}">{SNIPPETS}</scene>')
    config = mitsuba.parser.ParserConfig("scalar_rgb")
    state = mitsuba.parser.parse_file(config, str(path))
    mitsuba.parser.transform_upgrade(config, state)
    ours = flatten(read_xml(path, {}))
    assert len(ours) == len(state.nodes)
    for element, node in zip(ours, state.nodes, strict=True):
        assert (element.type, element.id) == (node.props.plugin_name(), node.props.id())
        theirs = [(re.sub("^_arg_.*", "", key), node.props[key]) for key in list(node.props.keys())]
        pairs = zip(sorted(element.entries, key=by_name), sorted(theirs, key=by_name), strict=True)
        for (name, value, _), (their_name, their_value) in pairs:
            assert name == their_name
            assert_same(value, their_value, state)


def by_name(entry) -> str:
    return entry[0]


def assert_same(ours, theirs, state):
    kind = type(theirs).__name__
    if kind == "ResolvedReference":
        assert isinstance(ours, Element)
        assert ours.type == state.nodes[int(re.findall(r"\d+", repr(theirs))[0])].props.plugin_name()
    elif isinstance(ours, Reference):
        assert repr(theirs) == f"Reference[{ours.id}]"
    elif isinstance(ours, np.ndarray):
        np.testing.assert_allclose(ours, np.array(theirs.matrix, float), rtol=1e-12, atol=1e-12)
    elif isinstance(ours, dict):
        np.testing.assert_array_equal(np.broadcast_to(ours["value"], 3), np.array(theirs, float))
    elif isinstance(ours, tuple):
        np.testing.assert_array_equal(ours, np.array(theirs, float))
    elif isinstance(theirs, str) and ours != theirs:
        assert Path(ours).parts[-len(Path(theirs).parts) :] == Path(theirs).parts  # isonoise has resolved file names
    else:
        assert (type(ours), ours) == (type(theirs), theirs)


def test_mitsuba_loads_the_snippets(mitsuba):
    """Mitsuba 3 accepts every parameter of the snippets."""
    scene = mitsuba.load_string(f'<scene version="0.6.0">{SNIPPETS}</scene>')
    parameters = mitsuba.traverse(scene)
    found = [np.array(parameters[key].matrix, float) for key in parameters.keys() if key.endswith("to_uv")]  # noqa: SIM118
    for expected in ([[4, 0, 1], [0, 2.5, 0]], [[2, 0, 0], [0, 1, 0]]):
        assert any(np.allclose(matrix[:2], expected, rtol=1e-6) for matrix in found)
