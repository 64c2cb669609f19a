"""What the tests share: where scenes from elsewhere lie."""

import os
from pathlib import Path

import pytest

from isonoise.device import program_cache

CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session", autouse=True)
def program_cache_of_session(tmp_path_factory):
    """Compiled programs are kept for the session: nothing of the user's is read or written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path_factory.mktemp("programs")))
        yield
    os.environ[program_cache.FOLDER_VARIABLE] = "off"  # at its end the process has nothing to keep


@pytest.fixture(scope="session")
def public_scenes() -> Path:
    """Folder of scenes that others made: ISONOISE_TEST_SCENES, or ../shared/scenes/public beside the checkout."""
    folder = Path(os.environ.get("ISONOISE_TEST_SCENES") or CHECKOUT.parent / "shared" / "scenes" / "public")
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: set ISONOISE_TEST_SCENES to the folder with the public test scenes")
    return folder


@pytest.fixture
def scene_of(tmp_path):
    """Loads a scene from the inside of its <scene> element; a sensor is added where there is none."""
    from isonoise.scene import load

    def make(inside: str, **parameters) -> dict:
        sensor = "" if "<sensor" in inside else '<sensor type="perspective"/>'
        path = tmp_path / "scene.xml"
        path.write_text(f'<scene version="3.0.0">\n{inside}\n{sensor}\n</scene>')
        return load(path, parameters)

    return make
