"""The support tables of formats: `isonoise formats` and scenes/formats.md."""

from pathlib import Path

import pytest

from isonoise.cli import main
from isonoise.scene.formats import tables
from isonoise.scene.formats.registry import FORMATS
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.formats.support import FEATURES, NO, PARTLY, YES, Support

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


def test_report_names_what_is_exact_and_what_is_not():
    support = {"triangles": Support(YES), "tangents": Support(PARTLY, "computed"), "curves": Support(NO, "left out")}
    report = ImportReport("a.glb", support)
    report.count("triangles", 2000)
    for noun in ("meshes", "copies of meshes", "lights", "bilinear patches"):
        report.count(noun)
    report.count("meshes")
    for feature in ("triangles", "tangents", "curves"):
        report.use(feature)
    report.limit("tangents", "bent", "mesh 'a'")
    report.limit("tangents", "bent", "mesh 'b'")
    curves, tangents = "curves and subdivision surfaces: left out", "tangents of mesh 'a' and 1 more: bent"
    assert report.rows() == [
        ("found", "2,000 triangles, 2 meshes, 1 copy of meshes, 1 light, 1 bilinear patch"),
        ("mapped", "triangles"),
        ("not exact", curves),
        ("", tangents),
    ]
    assert report.warnings() == [f"a.glb: {curves}", f"a.glb: {tangents}"]
