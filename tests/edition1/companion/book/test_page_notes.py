"""What the book adds to a notebook's page: provenance, downloads, vector versions of figures."""

from __future__ import annotations

import base64
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest
from matplotlib.figure import Figure

from edition1_companion.book.after.page_notes import (
    figures_of,
    page_files,
    provenance_line,
    with_notes,
    write_page_files,
)
from edition1_companion.book.digests import combined_digest
from edition1_companion.book.parameters import declared_parameters
from edition1_companion.book.project import find_project
from edition1_companion.book.provenance import read_record, record_path
from edition1_companion.book.runner import read_notebook, run_notebook
from edition1_live.view.style import VECTOR_LIMIT_BYTES, page_figure

PNG = base64.b64encode(b"\x89PNG of the figure").decode()
DRAWS = """\
import matplotlib.pyplot as plt
from edition1_live.view.style import page_figure

@page_figure
def line():
    figure, panel = plt.subplots(figsize=(2, 2))
    panel.plot([0, 1], [0, n])
    return figure

line()"""


@page_figure
def scatter(count: int, fine: bool) -> Figure:
    """Draw points that differ (SVG holds each), or a picture of random pixels (which no form makes small)."""
    figure, panel = plt.subplots()
    values = np.random.default_rng(0).random((2, count))
    if fine:
        figure.set_dpi(1000)
        panel.imshow(np.random.default_rng(0).random((900, 900, 3)), interpolation="none")
    else:
        panel.plot(*values, marker="x", lw=0.3)
    return figure


def bundle(figure: Figure) -> dict[str, str]:
    return figure._repr_mimebundle_()  # pyright: ignore[reportAttributeAccessIssue]


def test_a_vector_version_is_the_same_each_time_and_not_large():
    one, other = bundle(scatter(50, fine=False)), bundle(scatter(50, fine=False))
    assert one == other
    assert list(one) == ["image/svg+xml"]
    assert ET.fromstring(one["image/svg+xml"]).tag.endswith("svg")
    assert "<dc:date>" not in one["image/svg+xml"]


def test_a_large_figure_is_kept_as_pdf_or_not_at_all():
    large = bundle(scatter(30_000, fine=False))
    assert list(large) == ["application/pdf"]
    pdf = base64.b64decode(large["application/pdf"])
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert len(pdf) <= VECTOR_LIMIT_BYTES
    assert bundle(scatter(1, fine=True)) == {}


@pytest.fixture
def page(root, notebook_at, writes_a_table) -> Path:
    """Return the executed notebook of a project, with a figure and a table."""
    source = notebook_at(
        root / "notebooks" / "a.ipynb",
        writes_a_table("t"),
        DRAWS,
        parameters="n: int = 3  # how many\nseed: int = 7  # seed",
    )
    notebook = nbformat.read(source, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_markdown_cell("# Title\n\nText."))
    notebook.cells[-1].metadata["mystnb"] = {
        "figure": {"name": "fig-line", "caption": "A line."},
        "image": {"alt": "A line to 3."},
    }
    nbformat.write(notebook, source)
    project = find_project()
    run_notebook(source, {}, project.executed / "a.ipynb", project.results, project=project)
    return project.executed / "a.ipynb"


def test_everything_that_a_page_offers_is_there(root, page):
    project = find_project()
    files = page_files(project, "a")
    assert sorted(files) == [
        "a.executed.ipynb",
        "a.ipynb",
        "a.provenance.json",
        "fig-line.png",
        "fig-line.svg",
        "t.csv",
    ]
    assert files["a.executed.ipynb"] == page.read_bytes()
    assert files["a.ipynb"] == (root / "notebooks" / "a.ipynb").read_bytes()
    assert files["t.csv"] == b"n,third\n3,1\n"
    assert files["fig-line.png"].startswith(b"\x89PNG")
    assert ET.fromstring(files["fig-line.svg"]).tag.endswith("svg")
    write_page_files(project, "a", root / "site")
    written = {path.name: path.read_bytes() for path in (root / "site" / "downloads" / "a").iterdir()}
    assert written == files

    before = json.loads(page.read_text())
    shown = with_notes(before, project, "a")
    assert before == json.loads(page.read_text())
    drawn = [
        output["data"] for cell in before["cells"] for output in cell.get("outputs", []) if "data" in output
    ]
    assert any({"image/png", "image/svg+xml"} <= set(data) for data in drawn)
    for cell, own in zip(shown["cells"][1:-2], before["cells"][1:], strict=True):
        assert {**cell, "outputs": None} == {**own, "outputs": None}
    assert shown["cells"][0]["source"].startswith('# Title\n\n<p class="page-summary"><a href="#run-it-')
    assert shown["cells"][0]["source"].endswith("</p>\n\n\nText.")
    executed = nbformat.read(page, as_version=4)
    for source, title in (("synthetic", "# Title (synthetic)\n"), ("recorded", "# Title\n")):
        executed.metadata["repro"]["values"] = {"source": source}
        nbformat.write(executed, page)
        assert with_notes(before, project, "a")["cells"][0]["source"].startswith(title)
    form, downloads = (cell["source"] for cell in shown["cells"][-2:])
    assert "\n.venv/bin/repro run notebooks/a.ipynb -p NAME VALUE\n" in form
    assert "\nParameters of a.ipynb:\n  n: int = 3     how many\n  seed: int = 7  seed\n" in form
    for name in files:
        assert f'href="../downloads/a/{name}"' in downloads
    assert "- {numref}`fig-line`: " in downloads
    # every addition is a notebook that myst-nb reads
    nbformat.validate(nbformat.from_dict(shown))

    record = read_record(record_path(project.executed / "a.ipynb"))
    assert record is not None
    line = provenance_line(record, declared_parameters(read_notebook(page), "a.ipynb"))
    assert line in downloads
    for part in (
        "<b>Notebook:</b> notebooks/a.ipynb;",
        "<b>Parameters:</b> its own;",
        "<b>Seed:</b> seed = 7;",
        f"<b>Code:</b> source archive {record.code['source archive'][:12]};",
        "<b>Recordings:</b> none found in REPRO_DATA_DIR;",
        f"<b>All inputs:</b> SHA-256 {record.key[:12]};",
        f"{record.seconds:.1f} s.",
    ):
        assert part in line
    assert "<b>Seed:</b> fixed in the code;" in provenance_line(record, {})


def test_recordings_commit_and_changed_parameters_stand_in_the_line(page):
    from dataclasses import replace

    record = read_record(record_path(find_project().executed / "a.ipynb"))
    assert record is not None
    recordings = {"x/1.csv": "ab" * 32, "x/2.csv": "cd" * 32}
    record = replace(
        record,
        code={"commit": "0123456789abcdef", "dirty": True},
        data={"source": "REPRO_DATA_DIR", "recordings": recordings},
        parameters={"n": "<4>"},
    )
    line = provenance_line(record, declared_parameters(read_notebook(page), "a.ipynb"))
    assert "<b>Parameters:</b> n = &lt;4&gt;;" in line
    assert "<b>Code:</b> commit 0123456789ab with uncommitted changes;" in line
    digest = combined_digest(recordings)[:12]
    found = "found, of all papers: 2 files in REPRO_DATA_DIR"
    assert f"<b>Recordings:</b> {found}, SHA-256 {digest};" in line


def test_a_page_without_parameters_or_record(root, notebook_at):
    """Nothing is claimed that is not known."""
    notebook_at(root / "book" / "notebooks" / "b.ipynb", "1 + 1", parameters=None)
    page = json.loads((root / "book" / "notebooks" / "b.ipynb").read_text())
    shown = with_notes(page, find_project(), "b")
    assert [cell["id"] for cell in shown["cells"]] == ["cell-0", "page-downloads"]
    assert "provenance" not in shown["cells"][-1]["source"].removeprefix("## Provenance and downloads")


def test_figures_in_the_order_of_the_page():
    """Unnamed figures are counted; a second output of a cell gets a name of its own; a 3-D view has its picture.

    Two views may lie in one output.
    """
    notebook = nbformat.v4.new_notebook()
    view = f'<div class="shape-view"><img src="data:image/png;base64,{PNG}" alt="x"></div>'
    pictures = {"image/png": PNG, "image/svg+xml": "<svg/>"}
    for data in (pictures, {"text/plain": "3"}, {"text/html": view + view}):
        cell = nbformat.v4.new_code_cell("")
        cell.outputs = [nbformat.v4.new_output("display_data", data) for _ in range(2)]
        notebook.cells.append(cell)
    notebook.cells[2].metadata["mystnb"] = {"figure": {"name": "fig-view", "caption": "A view."}}
    found = figures_of(notebook)
    views = ["fig-view", "fig-view-2", "fig-view-3", "fig-view-4"]
    assert [figure.name for figure in found] == ["figure-1", "figure-2-2", *views]
    assert [figure.caption for figure in found[2:]] == ["A view.", "", "", ""]  # a label is there once
    assert found[0].files == {"png": b"\x89PNG of the figure", "svg": b"<svg/>"}
    assert found[2].files == {"png": b"\x89PNG of the figure"}


def test_figures_without_a_vector_version_stand_in_one_line(root, page):
    notebook = nbformat.read(page, as_version=4)
    view = f'<div class="shape-view"><img src="data:image/png;base64,{PNG}" alt="x"></div>'
    for name in ("fig-one", "fig-two"):
        cell = nbformat.v4.new_code_cell("")
        cell.outputs = [nbformat.v4.new_output("display_data", {"text/html": view + view})]
        cell.metadata["mystnb"] = {"figure": {"name": name, "caption": "A view."}}
        notebook.cells.append(cell)
    nbformat.write(notebook, page)
    downloads = with_notes(json.loads(page.read_text()), find_project(), "a")["cells"][-1]["source"]
    (line,) = [line for line in downloads.splitlines() if "vector" in line]
    assert line.endswith(": {numref}`fig-one`, {numref}`fig-two`")


def test_a_folded_cell_that_only_gives_values_has_no_bar(root, page):
    notebook = json.loads(page.read_text())
    for source, outputs in (("x = 1\ngive(x=1)", []), ("x = 1", []), ("give(x=1)\nx", [{"data": {}}])):
        metadata = {"tags": ["hide-input"]}
        cell = {"cell_type": "code", "id": "x", "metadata": metadata, "source": source, "outputs": outputs}
        notebook["cells"].append(cell)
    shown = with_notes(notebook, find_project(), "a")["cells"][-5:-2]
    assert ["remove-cell" in cell["metadata"]["tags"] for cell in shown] == [True, False, False]
    assert notebook["cells"][-3]["metadata"]["tags"] == ["hide-input"]


@pytest.mark.parametrize(("svg", "kept"), [("<svg/>", "image/svg+xml"), ("<svg>" + 40 * " ", "image/png")])
def test_a_page_shows_the_lighter_of_two_pictures(root, page, svg, kept):
    notebook = json.loads(page.read_text())
    pictures = {"image/png": PNG, "image/svg+xml": svg, "text/plain": "Figure"}
    output = {"output_type": "display_data", "data": pictures, "metadata": {}}
    notebook["cells"].append(
        {"cell_type": "code", "id": "x", "metadata": {}, "source": "", "outputs": [output]}
    )
    shown = with_notes(notebook, find_project(), "a")
    assert set(shown["cells"][-3]["outputs"][0]["data"]) == {kept, "text/plain"}
    assert output["data"] is pictures  # the notebook keeps both, to download
    assert len(pictures) == 3
