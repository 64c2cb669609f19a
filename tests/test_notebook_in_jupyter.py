"""A notebook run by Jupyter's kernel: what its cells show, and how a browser draws it on a desktop and a phone."""

import pytest
from headless_chromium import headless_chromium

CELLS = """
import isonoise
scene = isonoise.load("cornell")
scene["film.size"] = (96, 72)
scene
---
renderer = isonoise.Renderer(scene, strategy="relative-mean")
for wave in isonoise.watch(renderer, spp=40):
    pass
---
wave
---
outcome = isonoise.render(scene, spp=400, error=0.25)
---
outcome
---
isonoise.render("cornell", spp=1, size=(8, 6), progress=False);
---
scene.params()
"""


@pytest.fixture(scope="module")
def notebook(tmp_path_factory):
    """The notebook with the outputs of its cells."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.v4.new_notebook()
    notebook.cells = [nbformat.v4.new_code_cell(source.strip()) for source in CELLS.split("---")]
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(
        cwd=str(tmp_path_factory.mktemp("notebook"))
    )
    return notebook


def html_of(cell) -> list[str]:
    """The HTML that a cell shows, without outputs that are empty by now."""
    assert [output for output in cell.outputs if output.output_type in ("stream", "error")] == []
    return [html for output in cell.outputs if (html := output.data.get("text/html", ""))]


@pytest.mark.long
def test_cells_show_scenes_waves_and_outcomes(notebook):
    scene, watched, wave, render, outcome, silent, parameters = map(html_of, notebook.cells)
    assert "96x72 pixels" in scene[0]
    assert len(watched) == 1  # the bar is gone, the picture stays
    assert watched == wave
    assert wave[0].count("data:image/png") == 3
    assert render == []  # the bar is gone
    assert "stated error" in outcome[0]
    assert outcome[0].count("data:image/png") == 3
    assert "data:image/svg" in outcome[0]
    assert silent == []
    assert parameters[0].startswith("<table")
    assert len(notebook.cells[3].outputs) == 1  # where the bar was
    assert len(notebook.cells[5].outputs) == 0


@pytest.mark.long
@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_draws_all_of_it(notebook, tmp_path, width):
    """Every picture is there, and none reaches beyond the page."""
    outputs = [html for cell in notebook.cells for html in html_of(cell)]
    page = tmp_path / "page.html"
    head = '<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    page.write_text(f"{head}<body style='margin:8px;font-family:sans-serif'>{'<hr>'.join(outputs)}", "utf-8")
    with headless_chromium(tmp_path, width, 900) as driver:
        driver.get(page.as_uri())
        size = "[...document.images].map(i => [i.naturalWidth, i.getBoundingClientRect().right, i.width])"
        images = driver.execute_script(f"return {size}")
        assert len(images) == 3 + 3 + 4
        for natural_width, right, shown_width in images:
            assert natural_width > 0
            assert shown_width > 150
            assert right <= width
        driver.save_screenshot(str(tmp_path / "page.png"))
