"""Every plugin and parameter in the vocabulary compiles, and has the status, default and interval that it declares."""

import re
from pathlib import Path

import numpy as np
import pytest
from plugin_cases import (
    CHECKERBOARD,
    PARAMETERS,
    SUPPORTED_PLUGINS,
    case_id,
    minimal_plugin,
    plugin_and_value,
    scene_with,
    write_files,
)

from isonoise import Renderer
from isonoise.commands import info
from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.scene import load
from isonoise.scene.vocabulary import UNSUPPORTED_PLUGINS, plugins_of
from isonoise.scene.vocabulary.plugin import COLOURS, IGNORED, SUPPORTED, UNSUPPORTED, Plugin


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


def compiled(plugin: Plugin, description: dict, files: Path) -> tuple:
    """What has to differ if the scene differs."""
    result = compile_scene(load_description(scene_with(plugin, description, files)))
    return result.hash, result.sample_count, result.filter, result.exposure


@pytest.mark.parametrize("plugin", SUPPORTED_PLUGINS, ids=case_id)
def test_every_plugin_compiles(plugin, files):
    assert plugin.meaning
    description = info.describe_scene(
        compile_scene(load_description(scene_with(plugin, minimal_plugin(plugin, files), files)))
    )
    assert all(description.values())
    assert plugin.status in (SUPPORTED, IGNORED)


@pytest.mark.parametrize(("plugin", "parameter"), PARAMETERS, ids=case_id)
def test_every_parameter_has_its_declared_status_default_and_interval(plugin, parameter, files):
    assert parameter.meaning
    description, value = plugin_and_value(plugin, parameter, files)
    if parameter.status == UNSUPPORTED:
        with pytest.raises(SceneError, match=f"'{parameter.name}' of .* is not supported"):
            compiled(plugin, description | value, files)
        return
    before = compiled(plugin, description, files)
    after = compiled(plugin, description | value, files)
    assert (before != after) == (parameter.status == SUPPORTED)
    if parameter.default is not None:
        default = parameter.default if not isinstance(parameter.default, tuple) else list(parameter.default)
        assert compiled(plugin, description | {parameter.name: default}, files) == before
    if parameter.type in (*COLOURS, "float", "index") and parameter.status == SUPPORTED:
        if parameter.texture:
            assert compiled(plugin, description | {parameter.name: CHECKERBOARD}, files) not in (before, after)
        else:
            with pytest.raises(SceneError):
                compiled(plugin, description | {parameter.name: CHECKERBOARD}, files)
    for outside in (0.0, -1.5, 1.5, 1e5) if parameter.interval and parameter.status == SUPPORTED else ():
        number = outside if parameter.type == "float" else int(outside)
        if not parameter.admits(number):
            with pytest.raises(SceneError, match=rf"'{parameter.name}' has to be in "):
                compiled(plugin, description | {parameter.name: number}, files)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, names in UNSUPPORTED_PLUGINS.items() for name in names]
)
def test_unsupported_plugins_are_rejected_with_the_reason(kind, name, scene_of):
    assert name not in plugins_of(kind)
    assert UNSUPPORTED_PLUGINS[kind][name]
    with pytest.raises(
        SceneError,
        match=f"{kind} '{name}' is not supported .Mitsuba 3 has it.: {re.escape(UNSUPPORTED_PLUGINS[kind][name])}",
    ):
        scene_of(plugin_in_scene(kind, name))


@pytest.mark.parametrize("kind", UNSUPPORTED_PLUGINS)
def test_plugins_that_errors_advise_are_supported(kind):
    """Any word that is a plugin's name counts; those of supported plugins load in `test_every_plugin_compiles`."""
    unsupported = {name for names in UNSUPPORTED_PLUGINS.values() for name in names}
    for name, advice in UNSUPPORTED_PLUGINS[kind].items():
        assert not set(re.findall(r"\w+", advice)) & unsupported - {name}
        for advised in re.findall(r"\buse (\w+)", advice):
            assert advised in plugins_of(kind) or advised == "the"


def plugin_in_scene(kind: str, name: str) -> str:
    """XML of a scene's content with this plugin in a valid position."""
    text = f'<{kind} type="{name}"/>'
    if kind in ("film", "sampler"):
        return f'<sensor type="perspective">{text}</sensor>'
    if kind == "rfilter":
        return f'<sensor type="perspective"><film type="hdrfilm">{text}</film></sensor>'
    if kind == "texture":
        return f'<bsdf type="diffuse"><texture type="{name}" name="reflectance"/></bsdf>'
    return text


@pytest.mark.long
@pytest.mark.parametrize("plugin", SUPPORTED_PLUGINS, ids=case_id)
def test_every_plugin_renders(plugin, files):
    renderer = Renderer(
        scene_with(plugin, minimal_plugin(plugin, files), files), size=None if plugin.kind == "film" else (4, 4)
    )
    renderer.step()
    assert np.isfinite(renderer.image()).all()


@pytest.mark.parametrize("plugin", SUPPORTED_PLUGINS, ids=case_id)
def test_every_value_can_be_read_and_set_by_path(plugin, files):
    scene = load(scene_with(plugin, minimal_plugin(plugin, files), files))
    before = scene.compile().hash
    for path, value in scene.params().items():
        if not path.endswith(".crop"):  # sets what is not set
            scene[path] = value
    assert scene.compile().hash == before
