"""Constant textures in scenes: a parameter gets the value that Mitsuba 3 evaluates."""

import numpy as np
import pytest

from isonoise.errors import SceneError
from isonoise.integrator.features import features
from isonoise.scene import compile_scene, load_description
from isonoise.scene.spectra import colour_to_rgb

RGB = {"type": "rgb", "value": [0.1, 0.2, 0.6]}
TEXTURES = [
    {"type": "rawconstant", "value": 0.3},
    {"type": "rawconstant", "value": [0.5, 0.25, 0.75]},
    {"type": "uniform", "value": 0.4},
    {"type": "srgb", "color": RGB},
    {"type": "d65", "scale": 0.5},
    {"type": "d65", "color": RGB},
]
PLACES = {  # colours: a parameter of a BSDF, of a texture, of emitters
    "reflectance": {"type": "diffuse"},
    "normalmap": {"type": "normalmap", "inner": {"type": "diffuse"}},
    "color0": {"type": "checkerboard"},
    "radiance": {"type": "constant"},
    "intensity": {"type": "point"},
}


def loaded(name: str, plugin: dict) -> dict:
    """The plugin in a scene, as it is compiled."""
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "plugin": plugin}
    return load_description(scene)["plugin"]


@pytest.mark.parametrize("texture", TEXTURES, ids=str)
def test_colours_and_numbers_are_mitsubas(mitsuba, texture):
    theirs, si = mitsuba.load_dict(texture), mitsuba.SurfaceInteraction3f()
    for name, plugin in PLACES.items():
        value = loaded(name, plugin | {name: texture})[name]
        assert colour_to_rgb(value, "unbounded") == pytest.approx(np.array(theirs.eval(si)), rel=1e-6)
    rough = {"type": "principled", "roughness": texture}
    if isinstance(texture.get("value"), list):
        with pytest.raises(RuntimeError):
            theirs.eval_1(si)
        with pytest.raises(SceneError, match="'roughness' has to be a number, and this rawconstant has three"):
            loaded("roughness", rough)
    else:
        assert loaded("roughness", rough)["roughness"] == pytest.approx(theirs.eval_1(si), rel=1e-6)


def test_references_and_xml(scene_of):
    scene = scene_of(
        '<texture type="rawconstant" id="flat"><vector name="value" value="0.5 0.5 1"/></texture>'
        '<bsdf type="normalmap" id="map"><ref name="normalmap" id="flat"/><bsdf type="diffuse">'
        '<spectrum type="d65" name="reflectance"><float name="scale" value="0.5"/></spectrum></bsdf></bsdf>'
    )
    assert scene["map"]["normalmap"] == {"type": "rgb", "value": [0.5, 0.5, 1.0]}
    assert scene["map"]["bsdf"]["reflectance"] == 0.5


def test_a_constant_normal_map_needs_no_textures():
    inner = {"type": "diffuse"}
    flat = {"type": "normalmap", "normalmap": {"type": "rawconstant", "value": [0.5, 0.5, 1.0]}, "inner": inner}
    compiled = compile_scene(
        load_description({"type": "scene", "a": {"type": "perspective"}, "b": {"type": "sphere", "c": flat}})
    )
    on = features(compiled)
    assert on["NORMAL_MAP"]
    assert on["UVS"]
    assert not on["TEXTURES"]


@pytest.mark.parametrize(
    "value", ['<rgb name="normalmap" value="0.5 0.4 0.6"/>', '<float name="normalmap" value="0.5"/>']
)
def test_a_normal_map_takes_colours_as_mitsuba_does(mitsuba, scene_of, value):
    text = f'<bsdf {{}} type="normalmap" id="map">{value}<bsdf type="diffuse"/></bsdf>'
    theirs = mitsuba.traverse(mitsuba.load_string(text.format('version="3.0.0"')))
    (expected,) = (theirs[key] for key in ("normalmap.value", "normalmap.color") if key in theirs)
    ours = scene_of(text.format(""))["map"]["normalmap"]["value"]
    assert ours == pytest.approx(np.broadcast_to(np.array(expected), 3))


@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        ({"type": "spot", "texture": {"type": "uniform", "value": 0.5}}, "the texture of a spot has to vary"),
        ({"type": "normalmap", "normalmap": "a.png", "a": {"type": "diffuse"}}, "has to be a nested texture"),
        ({"type": "diffuse", "reflectance": {"type": "rawconstant", "value": 1.5}}, "a reflectance is at most 1"),
        ({"type": "diffuse", "reflectance": {"type": "rawconstant", "value": "0.5"}}, "finite number or a vector of"),
        ({"type": "roughplastic", "alpha": {"type": "rawconstant", "value": 0.5}}, "cannot contain a texture"),
        (
            {"type": "bumpmap", "a": {"type": "rawconstant", "value": 0.5}, "b": {"type": "diffuse"}},
            "a bumpmap needs a texture whose heights vary",
        ),
    ],
    ids=str,
)
def test_errors(plugin, message):
    with pytest.raises(SceneError, match=message):
        loaded("", plugin)
