"""The registry cannot lie: every plugin and parameter in it is read as it says, and Mitsuba 3 has it so too."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import small_files
from scalar_mitsuba import import_mitsuba

from isonoise import Renderer
from isonoise.cli import main
from isonoise.commands import info
from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load
from isonoise.scene.parse import plugin_tables
from isonoise.scene.vocabulary import PLUGINS, UNSUPPORTED_PLUGINS, plugins_of
from isonoise.scene.vocabulary.plugin import COLOURS, IGNORED, SUPPORTED, UNSUPPORTED, Parameter, Plugin

CHECKOUT = Path(__file__).resolve().parent.parent
OWN = ("mesh",)  # isonoise's own plugins
OLDER = ("high_quality_edges",)  # parameters that only older versions of Mitsuba have
IN_PYTHON = re.compile("prb|_projective")  # plugins of Mitsuba that are written in Python: no file, no type
READ = [plugin for plugin in PLUGINS if plugin.kind != "scene"]
PARAMETERS = [(plugin, parameter) for plugin in READ for parameter in plugin.parameters]

CHECKS = {"type": "checkerboard", "color0": 0.9, "color1": 0.1}
COLOUR = {"type": "rgb", "value": [0.2, 0.3, 0.4]}
TURNED = np.array([[1, 0, 0, 0.25], [0, 0, -1, 0.5], [0, 1, 0, -0.125], [0, 0, 0, 1.0]])
SHEARED = np.array([[2, 0.5, 0, 0.25], [0, 3, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1.0]])
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with a file a.* and another b.* of each format."""
    folder = tmp_path_factory.mktemp("files")
    for number, name in enumerate("ab"):
        content = {
            "png": small_files.encoded("PNG", number),
            "obj": small_files.obj(number),
            "ply": small_files.ply(shift=number),
            "serialized": small_files.serialized(shift=number),
        }
        for suffix, data in content.items():
            (folder / f"{name}.{suffix}").write_bytes(data)
    return folder


def base(plugin: Plugin, files: Path) -> dict:
    """The least that this plugin needs."""
    name, matt = plugin.name, {"type": "diffuse"}
    suffix = {"bitmap": "png", "envmap": "png"}.get(name, name)
    needs = {
        "filename": str(files / f"a.{suffix}"),
        "vertices": TRIANGLE,
        "faces": np.array([[0, 1, 2]]),
        "aperture_radius": 0.1,
        "weight": 0.4,
        "normalmap": CHECKS,
        "name": "vertex_color",
    }
    result = {"type": name}
    for parameter in plugin.parameters:
        if parameter.required:
            assert parameter.name in needs, f"say here what a '{parameter.name}' of {name} is"
            result[parameter.name] = needs[parameter.name]
    for child in plugin.children:
        nested = {
            "bsdf": matt,
            "texture": CHECKS,
            "integrator": {"type": "path"},
            "shape": {"type": "shapegroup", "inside": {"type": "cube"}} if name == "instance" else {"type": "cube"},
        }
        for number in range(child.min_count):
            assert child.kind in nested, f"say here what a {child.kind} of {name} is"
            result[f"{child.kind}_{number}"] = nested[child.kind]
    return result


def scene(plugin: Plugin, thing: dict, files: Path) -> dict:
    """A scene in which a plugin of this kind counts."""
    sampler, film = {"type": "independent"}, {"type": "hdrfilm", "width": 4, "height": 3}
    lens, integrator, matt = (
        {"type": "perspective"},
        {"type": "path", "max_depth": 9},
        {"type": "diffuse", "reflectance": CHECKS},
    )
    mesh = {"type": "ply", "filename": str(files / "a.ply"), "bsdf": matt}
    light, extra = {"type": "point", "position": [0, 0, -2]}, {}
    if plugin.kind == "integrator":
        integrator = thing
    elif plugin.kind == "sensor":
        lens = thing
    elif plugin.kind == "film":
        film = thing
    elif plugin.kind == "rfilter":
        film = film | {"rfilter": thing}
    elif plugin.kind == "sampler":
        sampler = thing
    elif plugin.kind == "bsdf":
        mesh["bsdf"] = thing
    elif plugin.kind == "texture":
        mesh["bsdf"] = {"type": "diffuse", "reflectance": thing}
    elif plugin.kind == "emitter" and plugin.name == "area":
        mesh["emitter"] = thing
    elif plugin.kind == "emitter":
        light = thing
    elif plugin.name == "shapegroup":
        mesh = {"type": "instance", "group": thing}
    elif plugin.name == "instance":
        mesh = thing
    elif plugin.kind == "shape":
        mesh = thing | {"bsdf": matt}
    elif plugin.kind in ("medium", "phase", "volume"):
        integrator = {"type": "volpath", "max_depth": 9}
        medium = {"type": "homogeneous"}
        medium = (
            thing if plugin.kind == "medium" else medium | {"albedo" if plugin.kind == "volume" else "inside": thing}
        )
        mesh = {"type": "sphere", "interior": medium, "bsdf": {"type": "null"}}
    else:
        raise AssertionError(f"say here how a scene uses a {plugin.kind}")
    sensor = lens | {"film": film, "sampler": sampler}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "mesh": mesh, "light": light, **extra}


def with_value(plugin: Plugin, parameter: Parameter, files: Path) -> tuple[dict, dict]:
    """The plugin with what the parameter needs beside it, and the parameter's value: another one than before."""
    beside = {
        "fov_axis": {"fov": 40.0},
        "crop_offset_x": {"width": 9, "crop_width": 3},
        "crop_offset_y": {"height": 9, "crop_height": 3},
        "crop_width": {"width": 9},
        "crop_height": {"height": 9},
        "shutter_open": {"shutter_close": 5.0},
        "aovs": {"aovs": "depth:depth"},
        "alpha_u": {"alpha_u": 0.4, "alpha_v": 0.4},
        "alpha_v": {"alpha_u": 0.4, "alpha_v": 0.4},
    }
    special = {
        "focal_length": "35mm",
        "fov_axis": "y",
        "material": "Au",
        "name": "face_heat",
        "shape_index": 1,
        "to_uv": SHEARED,
        "vertices": TRIANGLE * 2,
        "faces": np.array([[0, 2, 1]]),
        "normals": np.array([[0, 0, 1], [0, 0.6, 0.8], [0.6, 0, 0.8]]),
        "format": "fp16",
        "pixel_format": "rgba",
        "component_format": "float32",
        "file_format": "openexr",
        "aovs": "n:sh_normal",
        "filename": base(plugin, files).get("filename", "").replace("a.", "b."),
    }
    value = special.get(parameter.name)
    if value is None:
        value = generic(parameter)
    return base(plugin, files) | beside.get(parameter.name, {}), {parameter.name: value}


def generic(parameter: Parameter):
    if parameter.type in COLOURS:
        return COLOUR
    if parameter.choices:
        return next(choice for choice in parameter.choices if choice != parameter.default)
    if parameter.type in ("float", "integer"):
        numbers = (0.3, 0.7, 3.5, 30.0) if parameter.type == "float" else (2, 3, 1)
        return next(number for number in numbers if parameter.admits(number) and number != parameter.default)
    return {
        "boolean": not parameter.default,
        "index": 1.7,
        "vector": [0.3, 0.2, 0.9],
        "transform": TURNED,
        "texture": CHECKS | {"color0": 0.6},
        "any": "x",
    }[parameter.type]


def compiled(plugin: Plugin, thing: dict, files: Path) -> tuple:
    """Everything that the device gets, as far as it can differ."""
    result = compile_scene(load(scene(plugin, thing, files)))
    return result.hash, result.sample_count, result.filter


def ids(case) -> str:
    return f"{case.kind}-{case.name}" if isinstance(case, Plugin) else getattr(case, "name", "")


@pytest.mark.parametrize("plugin", READ, ids=ids)
def test_every_plugin_compiles(plugin, files):
    assert plugin.meaning
    description = info.describe_scene(compile_scene(load(scene(plugin, base(plugin, files), files))))
    assert all(description.values())
    assert plugin.status in (SUPPORTED, IGNORED)


@pytest.mark.parametrize(("plugin", "parameter"), PARAMETERS, ids=ids)
def test_every_parameter_does_what_the_registry_says(plugin, parameter, files):
    assert parameter.meaning
    thing, value = with_value(plugin, parameter, files)
    if parameter.status == UNSUPPORTED:
        with pytest.raises(SceneError, match=f"'{parameter.name}' of .* is not supported"):
            compiled(plugin, thing | value, files)
        return
    before = compiled(plugin, thing, files)
    after = compiled(plugin, thing | value, files)
    assert (before != after) == (parameter.status == SUPPORTED)
    if parameter.default is not None:
        default = parameter.default if not isinstance(parameter.default, tuple) else list(parameter.default)
        assert compiled(plugin, thing | {parameter.name: default}, files) == before
    if parameter.type in (*COLOURS, "float", "index") and parameter.status == SUPPORTED:
        if parameter.texture:
            assert compiled(plugin, thing | {parameter.name: CHECKS}, files) not in (before, after)
        else:
            with pytest.raises(SceneError):
                compiled(plugin, thing | {parameter.name: CHECKS}, files)
    for outside in (0.0, -1.5, 1.5, 1e5) if parameter.interval and parameter.status == SUPPORTED else ():
        number = outside if parameter.type == "float" else int(outside)
        if not parameter.admits(number):
            with pytest.raises(SceneError, match=rf"'{parameter.name}' has to be in "):
                compiled(plugin, thing | {parameter.name: number}, files)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, names in UNSUPPORTED_PLUGINS.items() for name in names]
)
def test_what_is_elsewhere_is_said_to_be(kind, name, scene_of):
    assert name not in plugins_of(kind)
    assert UNSUPPORTED_PLUGINS[kind][name]
    with pytest.raises(
        SceneError,
        match=f"{kind} '{name}' is not supported .Mitsuba 3 has it.: {re.escape(UNSUPPORTED_PLUGINS[kind][name])}",
    ):
        scene_of(_placed(kind, name))


def _placed(kind: str, name: str) -> str:
    """The inside of a scene that has this plugin where its kind belongs."""
    text = f'<{kind} type="{name}"/>'
    if kind in ("film", "sampler"):
        return f'<sensor type="perspective">{text}</sensor>'
    if kind == "rfilter":
        return f'<sensor type="perspective"><film type="hdrfilm">{text}</film></sensor>'
    if kind == "texture":
        return f'<bsdf type="diffuse"><texture type="{name}" name="reflectance"/></bsdf>'
    return text


@pytest.mark.long
@pytest.mark.parametrize("plugin", READ, ids=ids)
def test_every_plugin_renders(plugin, files):
    renderer = Renderer(scene(plugin, base(plugin, files), files), size=None if plugin.kind == "film" else (4, 4))
    renderer.step()
    assert np.isfinite(renderer.image()).all()


# --- Mitsuba's own words

KINDS = {
    "Integrator": "integrator",
    "Sensor": "sensor",
    "Film": "film",
    "ReconstructionFilter": "rfilter",
    "Sampler": "sampler",
    "BSDF": "bsdf",
    "Texture": "texture",
    "Emitter": "emitter",
    "Shape": "shape",
    "Medium": "medium",
    "PhaseFunction": "phase",
    "Volume": "volume",
}


def test_mitsuba_has_the_same_plugins():
    """Each of its plugins is here as one that is read or as one that is not, and nothing else is."""
    mitsuba = import_mitsuba()
    manager = mitsuba.PluginManager.instance()
    if not hasattr(manager, "plugin_type"):
        pytest.skip("needs Mitsuba 3.7 or newer: older ones do not tell the kind of a plugin")
    folder = Path(mitsuba.__file__).parent / "plugins"
    names = {path.name.split(".")[0] for path in [*folder.glob("*.so"), *folder.glob("*.dylib"), *folder.glob("*.dll")]}
    theirs = {(KINDS[str(manager.plugin_type(name)).split(".")[-1]], name) for name in names}
    ours = {(plugin.kind, plugin.name) for plugin in READ if plugin.name not in OWN}
    ours |= {
        (kind, name) for kind, absent in UNSUPPORTED_PLUGINS.items() for name in absent if not IN_PYTHON.search(name)
    }
    assert ours == theirs


def as_mitsuba(mitsuba, value, name: str = ""):
    if isinstance(value, dict):
        return {key: as_mitsuba(mitsuba, inner, key) for key, inner in value.items()}
    if isinstance(value, np.ndarray) and name in ("to_world", "to_uv"):
        return mitsuba.ScalarTransform4f(value)
    return value


@pytest.mark.parametrize(
    ("plugin", "parameter"), [case for case in PARAMETERS if case[0].name not in OWN and case[1].type != "any"], ids=ids
)
def test_mitsuba_has_the_same_parameters_and_defaults(plugin, parameter, files):
    """It refuses parameters that it has not, and textures where it takes none; it prints what it has read."""
    mitsuba = import_mitsuba()

    def loaded(**more):
        return mitsuba.load_dict(as_mitsuba(mitsuba, thing | more))

    thing, value = with_value(plugin, parameter, files)
    if parameter.type == "texture" and not parameter.texture:
        value = {parameter.name: {"type": "bitmap", "filename": str(files / "a.png")}}
    before = str(loaded())
    if parameter.name in OLDER:
        with pytest.raises(RuntimeError, match="unreferenced"):
            loaded(**value)
        return
    loaded(**value)
    if parameter.default is not None and parameter.status == SUPPORTED:
        default = parameter.default if not isinstance(parameter.default, tuple) else list(parameter.default)
        assert _read(str(loaded(**{parameter.name: default}))) == _read(before)
    if parameter.type in (*COLOURS, "float", "index") and parameter.status == SUPPORTED:
        if parameter.texture:
            loaded(**{parameter.name: CHECKS})
        elif plugin.kind not in ("medium", "volume"):  # these take one, and see its corner alone
            with pytest.raises(Exception, match=r"."):
                loaded(**{parameter.name: CHECKS})


def _read(printed: str) -> str:
    """What Mitsuba prints of a plugin, without what differs by the way in which the same value is given."""
    printed = re.sub(r"SRGB\w+\[\s*value = \[1, 1, 1\]\s*\]", "UniformSpectrum[value=1.000000]", printed)
    return re.sub(
        r"0x[0-9a-f]+|specular_(reflectance|transmittance) = UniformSpectrum\[value=1.000000\],?\s*", "", printed
    )


# --- the listings

TABLES = (CHECKOUT / "host" / "docs" / "plugins.md").read_text("utf-8")


def test_the_tables_are_those_of_the_registry():
    assert plugin_tables.update_tables(TABLES) == TABLES, (
        "write them anew: python -m isonoise.scene.parse.plugin_tables host/docs/plugins.md"
    )
    for kind in plugin_tables.KINDS:
        for name, status, meaning in plugin_tables.list_plugins(kind):
            assert f"`{name}`" in TABLES
            assert meaning
            assert status in plugin_tables.STATUS.values()


def test_the_kinds_are_complete():
    assert set(plugin_tables.KINDS) == {plugin.kind for plugin in READ} | set(UNSUPPORTED_PLUGINS)
    for kind in plugin_tables.KINDS:
        names = [row[0] for row in plugin_tables.list_plugins(kind)]
        assert len(set(names)) == len(names)


def test_the_command_lists_them(capsys):
    assert main(["plugins"]) == 0
    listed = capsys.readouterr().out
    for kind in plugin_tables.KINDS:
        assert re.search(rf"^{kind}$", listed, re.MULTILINE)
        for name, status, _ in plugin_tables.list_plugins(kind):
            assert re.search(rf"^  {name} +{status}  ", listed, re.MULTILINE), name
    assert main(["plugins", "emitter"]) == 0
    listed = capsys.readouterr().out
    assert "sunsky" in listed
    assert "roughplastic" not in listed


@pytest.mark.parametrize("plugin", READ, ids=ids)
def test_the_command_describes_a_plugin(plugin, capsys):
    assert main(["plugins", plugin.name]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"{plugin.kind} '{plugin.name}' ({plugin_tables.STATUS[plugin.status]}): ")
    for parameter in plugin.parameters:
        assert re.search(rf"^  {parameter.name}  ", text, re.MULTILINE), parameter.name


def test_the_command_describes_what_is_not_supported(capsys):
    assert main(["plugins", "sunsky"]) == 0
    assert "emitter 'sunsky': not supported (Mitsuba 3 has it): " in capsys.readouterr().out
    assert main(["plugins", "roughconducter"]) == 2
    assert "did you mean 'roughconductor'?" in capsys.readouterr().err


def test_the_command_prints_json(capsys):
    assert main(["plugins", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert len(facts) == sum(len(plugin_tables.list_plugins(kind)) for kind in plugin_tables.KINDS)
    assert main(["plugins", "sphere", "--json"]) == 0
    (sphere,) = json.loads(capsys.readouterr().out)
    radius = next(parameter for parameter in sphere["parameters"] if parameter["name"] == "radius")
    assert radius == {
        "name": "radius",
        "type": "number",
        "values": "(0, inf)",
        "default": "1",
        "texture": False,
        "status": "supported",
        "meaning": "before to_world",
    }
