"""Shared fixtures: the program cache, and the folder of public scenes."""

import os
from contextlib import contextmanager
from pathlib import Path

import pytest

from isonoise.device import failures, pocl_cache, precompile, program_cache

CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session", autouse=True)
def program_cache_of_session(tmp_path_factory):
    """A program cache for the session: the user's own is neither read nor written.

    Programs are compiled in one process: in so new a cache all seem new, although PoCL may have compiled them before.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(program_cache.FOLDER_VARIABLE, "off")
        pocl_cache.pocl_folder()  # PoCL uses its own folder, whose kernels last from one test run to the next
        patch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path_factory.mktemp("programs")))
        patch.setattr(precompile, "worker_limit", lambda: 1)
        patch.setattr(failures, "log_folders", [str(tmp_path_factory.mktemp("logs"))])
        yield


@pytest.fixture(autouse=True)
def unchecked_driver(request, monkeypatch):
    """Renders do not check the driver, which would take longer than most of them. test_driver_check.py tests it."""
    if request.path.name != "test_driver_check.py":
        monkeypatch.setattr("isonoise.integrator.set_up.check_driver", lambda *_: None)
    os.environ[program_cache.FOLDER_VARIABLE] = "off"  # nothing is stored at exit


@pytest.fixture
def in_tmp_path(tmp_path, monkeypatch):
    """The test runs in its `tmp_path`."""
    monkeypatch.chdir(tmp_path)


@contextmanager
def without_compare_report():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isonoise.comparison.report.write_report", lambda directory: None)
        patch.setattr("isonoise.comparison.summary.summary_text", lambda directory: "the table")
        yield


@pytest.fixture(scope="module")
def no_compare_report():
    """`isonoise compare` makes no report; test_compare_report.py tests it."""
    with without_compare_report():
        yield


@pytest.fixture(scope="session")
def finished_comparison(tmp_path_factory) -> Path:
    """Folder of a comparison that was not interrupted, with the default options of compare_command.py."""
    from compare_command import compare, options

    directory = tmp_path_factory.mktemp("finished") / "out"
    with without_compare_report():
        assert compare(*options(directory)) == 0
    return directory


@pytest.fixture(scope="session")
def public_scenes() -> Path:
    """Folder of public scenes: ISONOISE_TEST_SCENES, or ../shared/scenes/public beside the checkout."""
    folder = Path(os.environ.get("ISONOISE_TEST_SCENES") or CHECKOUT.parent / "shared" / "scenes" / "public")
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: set ISONOISE_TEST_SCENES to the folder with the public test scenes")
    return folder


@pytest.fixture(scope="session")
def mitsuba():
    """The module Mitsuba 3 with the variant scalar_rgb; skips the test if it is not installed."""
    from scalar_mitsuba import import_mitsuba

    return import_mitsuba()


@pytest.fixture
def notebook_outputs(monkeypatch) -> list[list[dict[str, str]]]:
    """Outputs of a notebook's cell in the order in which they appear, each with its contents so far; no IPython."""
    import sys
    from types import SimpleNamespace

    outputs = []

    class DisplayHandle:
        def display(self, content, raw):
            assert raw
            self.contents = [content]
            outputs.append(self.contents)

        def update(self, content, raw):
            assert raw
            self.contents.append(content)

    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(DisplayHandle=DisplayHandle))
    return outputs


@pytest.fixture
def write_file(tmp_path):
    """Writes a file of this name and content to `tmp_path`; returns its path."""

    def write(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def scene_of(tmp_path):
    """Loads a scene from the content of its <scene> element; adds a sensor if it has none."""
    from isonoise.scene import load_description

    def make(inside: str, **parameters) -> dict:
        sensor = "" if "<sensor" in inside else '<sensor type="perspective"/>'
        path = tmp_path / "scene.xml"
        path.write_text(f'<scene version="3.0.0">\n{inside}\n{sensor}\n</scene>')
        return load_description(path, parameters)

    return make


@pytest.fixture
def one_lane(monkeypatch):
    """A work-item takes one path, as on GPUs. Such kernels compile in a third of the time.

    That the number of lanes changes no bit is tested in test_renderer.py.
    """
    from isonoise.device.form import FORMS
    from isonoise.device.opencl import Device

    # other programs stay those of the default form, which most tests share
    monkeypatch.setattr(Device, "form", FORMS["lanes"]._replace(lanes=1, shade_lanes=1))
