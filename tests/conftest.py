"""What the tests share: where scenes from elsewhere lie."""

import os
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def public_scenes() -> Path:
    """Folder of scenes that others made: ISONOISE_TEST_SCENES, or ../shared/scenes/public beside the checkout."""
    folder = Path(os.environ.get("ISONOISE_TEST_SCENES") or CHECKOUT.parent / "shared" / "scenes" / "public")
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: set ISONOISE_TEST_SCENES to the folder with the public test scenes")
    return folder
