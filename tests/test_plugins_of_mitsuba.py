"""The vocabulary against Mitsuba 3: the same plugins, parameters and defaults."""

import re
from pathlib import Path

import pytest
from plugin_cases import CHECKERBOARD, PARAMETERS, SUPPORTED_PLUGINS, case_id, plugin_and_value, write_files
from scalar_mitsuba import as_mitsuba, import_mitsuba

from isonoise.scene.vocabulary import UNSUPPORTED_PLUGINS
from isonoise.scene.vocabulary.plugin import COLOURS, SUPPORTED

ISONOISE_PLUGINS = ("mesh",)  # not in Mitsuba
ISONOISE_PARAMETERS = ("exposure",)
REMOVED_PARAMETERS = ("high_quality_edges",)  # parameters of older versions of Mitsuba
PYTHON_PLUGINS = re.compile("prb|_projective")  # plugins that Mitsuba implements in Python: they have no file
KIND_OF_OBJECT_TYPE = {
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


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


def test_mitsuba_has_the_same_plugins():
    """Each plugin of Mitsuba is declared as supported or unsupported, and no others are."""
    mitsuba = import_mitsuba()
    manager = mitsuba.PluginManager.instance()
    if not hasattr(manager, "plugin_type"):
        pytest.skip("needs Mitsuba 3.7 or newer, which reports the kind of a plugin")
    folder = Path(mitsuba.__file__).parent / "plugins"
    names = {path.name.split(".")[0] for path in [*folder.glob("*.so"), *folder.glob("*.dylib"), *folder.glob("*.dll")]}
    theirs = {(KIND_OF_OBJECT_TYPE[str(manager.plugin_type(name)).split(".")[-1]], name) for name in names}
    ours = {(plugin.kind, plugin.name) for plugin in SUPPORTED_PLUGINS if plugin.name not in ISONOISE_PLUGINS}
    ours |= {
        (kind, name)
        for kind, absent in UNSUPPORTED_PLUGINS.items()
        for name in absent
        if not PYTHON_PLUGINS.search(name)
    }
    assert ours == theirs


@pytest.mark.parametrize(
    ("plugin", "parameter"),
    [
        (plugin, parameter)
        for plugin, parameter in PARAMETERS
        if plugin.name not in ISONOISE_PLUGINS
        and parameter.name not in ISONOISE_PARAMETERS
        and parameter.type not in ("any", "image")
    ],
    ids=case_id,
)
def test_mitsuba_has_the_same_parameters_and_defaults(plugin, parameter, files):
    """Mitsuba rejects unknown parameters and textures that are not allowed, and prints the values that it has read."""
    mitsuba = import_mitsuba()

    def loaded(**more):
        return mitsuba.load_dict(as_mitsuba(mitsuba, description | more))

    description, value = plugin_and_value(plugin, parameter, files)
    if parameter.type == "texture" and not parameter.texture:
        value = {parameter.name: {"type": "bitmap", "filename": str(files / "a.png")}}
    before = str(loaded())
    if parameter.name in REMOVED_PARAMETERS:
        with pytest.raises(RuntimeError, match="unreferenced"):
            loaded(**value)
        return
    loaded(**value)
    if parameter.default is not None and parameter.status == SUPPORTED:
        default = parameter.default if not isinstance(parameter.default, tuple) else list(parameter.default)
        assert normalise_printed(str(loaded(**{parameter.name: default}))) == normalise_printed(before)
    if parameter.type in (*COLOURS, "float", "index") and parameter.status == SUPPORTED:
        if parameter.texture:
            loaded(**{parameter.name: CHECKERBOARD})
        elif plugin.kind not in ("medium", "volume"):  # these accept a texture, and use its value at the corner
            with pytest.raises(Exception, match=r"."):
                loaded(**{parameter.name: CHECKERBOARD})


def normalise_printed(printed: str) -> str:
    """The text that Mitsuba prints for a plugin, without differences in how the same value was given."""
    printed = re.sub(r"SRGB\w+\[\s*value = \[1, 1, 1\]\s*\]", "UniformSpectrum[value=1.000000]", printed)
    return re.sub(
        r"0x[0-9a-f]+|specular_(reflectance|transmittance) = UniformSpectrum\[value=1.000000\],?\s*", "", printed
    )
