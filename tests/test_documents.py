"""What the READMEs say, where it can be checked: layers, plugins, strategies, kernels, links, bytes."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.integrator.kernel_table import KERNELS
from isonoise.renderer import Renderer
from isonoise.scene.vocabulary import PLUGINS
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.strategies.registry import _BUILT_IN, DEFAULT_STRATEGY
from isonoise.strategies.uniform import Uniform

CHECKOUT = Path(__file__).resolve().parent.parent
PACKAGE = CHECKOUT / "host" / "isonoise"
README = (CHECKOUT / "README.md").read_text()
SCENES = (CHECKOUT / "scenes" / "README.md").read_text()
KERNEL_TEXT = (CHECKOUT / "kernels" / "README.md").read_text()

LAYERS = {  # what each may import beside itself; the table in host/README.md
    "errors": set(),
    "luminance": set(),
    "student_t": set(),
    "argument_types": set(),
    "progress": set(),
    "statistics": {"errors"},
    "device": {"errors"},
    "scene": {"errors", "luminance"},
    "strategies": {"errors", "statistics", "student_t"},
    "integrator": {"device", "scene", "statistics"},
    "error": {"errors", "luminance", "statistics", "strategies", "student_t"},
    "film": {"errors", "error", "luminance", "statistics", "strategies"},
    "renderer": {"errors", "statistics", "device", "scene", "strategies", "integrator"},
    "loop": {"errors", "error", "film", "luminance", "renderer", "statistics", "strategies"},
    "comparison": {
        *("errors", "statistics", "student_t", "device", "scene", "strategies", "integrator", "film"),
        *("renderer", "loop", "error", "luminance", "progress"),
    },
    "benchmark": {
        *("errors", "statistics", "student_t", "device", "scene", "strategies", "integrator", "film"),
        *("renderer", "loop", "error", "luminance", "progress", "comparison"),
    },
    "selftest": {
        *("errors", "statistics", "device", "scene", "strategies", "integrator", "film", "renderer"),
    },
}


def imports(path: Path) -> set[str]:
    """First-level modules of isonoise that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        found |= {name.split(".")[1] for name in names if name.startswith("isonoise.")}
    return found


def test_dependencies_point_one_way():
    for layer, allowed in LAYERS.items():
        files = [PACKAGE / f"{layer}.py"] if (PACKAGE / f"{layer}.py").exists() else (PACKAGE / layer).rglob("*.py")
        for path in files:
            assert imports(path) <= allowed | {layer}, path.name


def test_every_plugin_is_named():
    """The tables themselves are compared in test_plugins.py."""
    for plugin in PLUGINS:
        if plugin.kind != "scene":
            assert f"| `{plugin.name}`" in SCENES, plugin.name


def test_every_strategy_is_named():
    section = README[README.index("## Strategies") : README.index("## Comparing")]
    assert sorted(re.findall(r"^\| `([a-z-]+)` \|", section, re.MULTILINE)) == sorted(_BUILT_IN)
    assert re.findall(r"^\| `([a-z-]+)` \|.*; the default \|$", section, re.MULTILINE) == [DEFAULT_STRATEGY]


def test_every_kernel_and_header_is_named():
    for kernel in KERNELS:
        assert f"`{kernel}`" in KERNEL_TEXT, kernel
    for file in (CHECKOUT / "kernels").glob("*.h"):
        assert f"`{file.name}`" in KERNEL_TEXT, file.name


def test_links_between_the_documents_lead_somewhere():
    for path in [CHECKOUT / "README.md", *CHECKOUT.glob("*/README.md")]:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", path.read_text()):
            assert (path.parent / target).exists(), f"{path}: {target}"


@pytest.mark.parametrize(
    ("needs", "more"),
    [
        (BASIC_NEEDS, 0),
        (Needs(median=True), 24),
        (Needs(median=True, chunk=7, batch=3), 32 + 8),
        (Needs(power=1.5), 8),
        (Needs(half=True), 24),
    ],
)
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.parametrize("foggy", [False, True])
def test_bytes_of_a_path_and_of_a_pixel(monkeypatch, foggy, instanced, lit, needs, more):
    """The table in kernels/README.md against what is allocated for two pools and two image sizes."""
    stated = [int(number) for number in re.findall(r"\| (\d+) a path", KERNEL_TEXT)]
    path_bytes = sum(stated) - (0 if lit else 44) - (0 if instanced else 8) - (0 if foggy else 16 + 12)
    path_bytes -= 4 if foggy and not lit else 0  # of a shadow ray in a medium
    (pixel_bytes,) = (int(number) for number in re.findall(r"\| (\d+) a pixel", KERNEL_TEXT))
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
        "ball": {"type": "sphere"},
    }
    if lit:
        scene["light"] = {"type": "point", "intensity": 1.0}
    if foggy:
        scene["integrator"]["type"] = "volpath"
        scene["ball"]["interior"] = {"type": "homogeneous"}
    if instanced:
        scene["ball"] = {"type": "instance", "group": {"type": "shapegroup", "ball": scene["ball"]}}
    strategy = Uniform()
    strategy.needs = needs
    # this is about buffers alone: no kernel is built
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})

    def allocated(pool: int, size: tuple[int, int]) -> int:
        total = []
        buffer = Device.buffer
        with monkeypatch.context() as patch:

            def counted(self, what, name):
                total.append(what.nbytes if isinstance(what, np.ndarray) else what)
                return buffer(self, what, name)

            patch.setattr(Device, "buffer", counted)
            Renderer(scene, pool_size=pool, size=size, strategy=strategy)
        return sum(total)

    small = allocated(1024, (8, 8))
    blocks = 4 * 1024 / 512  # of the compaction, 4 bytes for 512 paths on a CPU and for 64 on a GPU
    assert 0 <= allocated(2048, (8, 8)) - small - 1024 * path_bytes <= 8 * blocks
    assert allocated(1024, (16, 8)) - small == 64 * (pixel_bytes + more)
