"""The support tables of formats: `isonoise formats` and scenes/formats.md."""

from pathlib import Path

import pytest

from isonoise.cli import main
from isonoise.scene.formats import tables
from isonoise.scene.formats.registry import FORMATS
from isonoise.scene.formats.support import FEATURES, NO, PARTLY, YES

PAGE = Path(__file__).resolve().parent.parent / "scenes" / "formats.md"


def test_page_is_current():
    assert PAGE.read_text("utf-8") == tables.page(), (
        "update it: python -m isonoise.scene.formats.tables scenes/formats.md"
    )


@pytest.mark.parametrize("format_", FORMATS, ids=lambda format_: format_.package)
def test_tables_are_complete(format_):
    """What is missing has a note with the reason; a cell of a Markdown table has no bar and no line break."""
    assert set(format_.support) <= set(FEATURES)
    for support in format_.support.values():
        assert support.status in (YES, PARTLY, NO)
        assert support.note or support.status == YES
        assert not set("|\n") & set(support.note)


def test_command_lists_formats(capsys):
    assert main(["formats"]) == 0
    listed = capsys.readouterr().out
    assert all(title in listed for title, *_ in tables.overview_rows())
    assert main(["formats", "glb"]) == 0
    assert capsys.readouterr().out.startswith("glTF 2.0\n  feature")
    assert main(["formats", "fbx"]) == 2
    assert "unknown format 'fbx'; one of glb, gltf, obj" in capsys.readouterr().err
