"""Documents checked against the code: layers, plugins, strategies, kernels, paths, links, lengths, bytes."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from isonoise.device.opencl import Device
from isonoise.integrator import stages
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import KERNELS, path_bytes
from isonoise.renderer import Renderer
from isonoise.scene.light.light_kinds import light_header
from isonoise.scene.material.bsdf_kinds import bsdf_header
from isonoise.scene.vocabulary import PLUGINS
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.strategies.registry import BUILT_IN, DEFAULT_STRATEGY
from isonoise.strategies.uniform import Uniform

CHECKOUT = Path(__file__).resolve().parent.parent
PACKAGE = CHECKOUT / "host" / "isonoise"
DOCS = CHECKOUT / "host" / "docs"
README = (CHECKOUT / "README.md").read_text("utf-8")
KERNEL_TEXT = (CHECKOUT / "kernels" / "README.md").read_text("utf-8")
FOREIGN_NAMES = ("proportional", "importtime", "shufflevector")
"""Parts of names in the documents that are not in the sources."""
DOCUMENTS = sorted({*CHECKOUT.glob("*.md"), *CHECKOUT.glob("*/README.md"), *DOCS.glob("*.md")})


def layers() -> dict[str, set[str]]:
    """Module -> the modules that it may import: the table of host/docs/modules.md.

    The last column is 'nothing', a list of modules, or 'all above', which may be followed by 'but' and a list.
    """
    text = (DOCS / "modules.md").read_text("utf-8")
    table = text.split("| module | purpose | may import |\n|---|---|---|\n")[1].split("\n\n")[0]
    found: dict[str, set[str]] = {}
    for row in table.splitlines():
        names, _, imported = row.strip("| ").rsplit(" | ", 2)
        listed = set(re.findall(r"`(\w+)`", imported))
        allowed = set(found) - listed if imported.startswith("all above") else listed
        assert allowed <= set(found), f"{names} may import only modules above it"
        found |= {name: allowed | {name} for name in re.findall(r"`(\w+)`", names)}
    return found


def imports(path: Path) -> set[str]:
    """First-level modules of isonoise that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        found |= {name.split(".")[1] for name in names if name.startswith("isonoise.")}
    return found


def test_dependencies_point_one_way():
    allowed = layers()
    modules = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in PACKAGE.rglob("*.py")}
    assert modules - {"__init__", "__main__"} == set(allowed)
    for path in PACKAGE.rglob("*.py"):
        module = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if module in allowed:
            assert imports(path) <= allowed[module], path


def test_every_plugin_is_named():
    """The tables themselves are compared in test_plugins.py."""
    text = (DOCS / "plugins.md").read_text("utf-8")
    for plugin in PLUGINS:
        if plugin.kind != "scene":
            assert f"| `{plugin.name}`" in text, plugin.name


def test_every_strategy_is_named():
    section = README[README.index("## Strategies") : README.index("## Limits")]
    assert sorted(re.findall(r"^\| `([a-z-]+)` \|", section, re.MULTILINE)) == sorted(BUILT_IN)
    assert re.findall(r"^\| `([a-z-]+)` \|.*; the default \|$", section, re.MULTILINE) == [DEFAULT_STRATEGY]


def test_every_kernel_and_header_is_named():
    for kernel in KERNELS:
        assert f"`{kernel}`" in KERNEL_TEXT, kernel
    in_tables = set(re.findall(r'#include "(.*)"', bsdf_header() + light_header()))
    for file in (CHECKOUT / "kernels").rglob("*.h"):
        if str(file.relative_to(CHECKOUT / "kernels")) not in in_tables:
            assert f"`{file.name}`" in KERNEL_TEXT, file.name


def heading_anchor(heading: str) -> str:
    """The anchor that GitHub makes of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(CHECKOUT)))
def test_links_lead_somewhere(path):
    text = re.sub(r"<!-- .*?-->", "", path.read_text("utf-8"), flags=re.DOTALL)
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", text):
        linked = path.parent / target if target else path
        assert linked.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", linked.read_text("utf-8"), re.MULTILINE)
            assert anchor in map(heading_anchor, headings), f"{target}#{anchor}"


def test_every_document_is_listed():
    listed = (CHECKOUT / "host" / "README.md").read_text("utf-8")
    for path in DOCS.glob("*.md"):
        assert f"](docs/{path.name})" in listed, path.name


@pytest.fixture(scope="module")
def source_names():
    """All words of the sources, and the paths of the files."""
    folders = ("host", "kernels", "scenes", "tests")
    files = [file for folder in folders for file in (CHECKOUT / folder).rglob("*") if "__pycache__" not in file.parts]
    sources = [file for file in files if file.suffix in (".py", ".cl", ".h", ".xml", ".j2", ".csv")]
    texts = [file.read_text("utf-8") for file in [*sources, CHECKOUT / "pyproject.toml"] if file != Path(__file__)]
    paths = [f"/{file.relative_to(CHECKOUT)}" for file in files]
    return set(re.findall(r"\w+", "\n".join([*texts, *paths, *generated_headers().values()]))), paths


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(CHECKOUT)))
def test_names_in_backticks_exist(path, source_names):
    """Every word in backticks is in some source, and what looks like a source file is the end of some file's path.

    `<name>` is a placeholder.
    """
    words, paths = source_names
    text = re.sub(r"```.*?```", "", path.read_text("utf-8"), flags=re.DOTALL)
    for quoted in re.findall(r"`([^`]+)`", text):
        if path.name == "CHANGELOG.md" or any(name in quoted for name in FOREIGN_NAMES):
            continue
        for word in re.findall(r"[A-Za-z_]\w{3,}", re.sub(r"\w*<\w+>\w*", "", quoted)):
            assert word in words, quoted
        if re.fullmatch(r"[\w/-]+\.(py|cl|h)", quoted):
            assert any(file.endswith(f"/{quoted}") for file in paths), quoted


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(CHECKOUT)))
def test_documents_are_short(path):
    words = len(path.read_text("utf-8").split())
    assert words <= (1000 if path == CHECKOUT / "README.md" else 2500)


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
    """What `isonoise info` and kernels/README.md say against what is allocated for two pools and two image sizes."""
    (sample_bytes,) = (int(number) for number in re.findall(r"\| (\d+) a path", KERNEL_TEXT))
    pixel_bytes, design_effect_bytes = (int(number) for number in re.findall(r"\| (\d+) a pixel", KERNEL_TEXT))
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
    monkeypatch.setattr(stages, "stage_source", lambda *arguments: ("", ()))
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})

    def allocated(pool: int, size: tuple[int, int]) -> int:
        total = []
        buffer = Device.buffer
        with monkeypatch.context() as patch:

            def counted(self, what, name):
                total.append(what.nbytes if isinstance(what, np.ndarray) else what)
                return buffer(self, what, name)

            patch.setattr(Device, "buffer", counted)
            features.update(Renderer(scene, pool_size=pool, size=size, strategy=strategy).features)
        return sum(total)

    features: dict[str, bool] = {}

    small = allocated(1024, (8, 8))
    blocks = 4 * 1024 / 512  # of the compaction, 4 bytes for 512 paths on a CPU and for 64 on a GPU
    bytes_per_path = sum(path_bytes(features).values()) + sample_bytes
    assert 0 <= allocated(2048, (8, 8)) - small - 1024 * bytes_per_path <= 8 * blocks
    assert allocated(1024, (16, 8)) - small == 64 * (pixel_bytes + design_effect_bytes + more)
