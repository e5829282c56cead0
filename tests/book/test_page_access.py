"""The corrections that pages get after Sphinx has written them."""

from __future__ import annotations

import importlib
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import pytest

BOOK = Path(__file__).resolve().parents[2] / "book"
pytest.importorskip("sphinx")


@pytest.fixture
def extension(monkeypatch):
    """Import a module of the book's extensions."""
    monkeypatch.syspath_prepend(str(BOOK / "_ext"))
    yield importlib.import_module
    for name in ("page_access", "repro_site"):
        sys.modules.pop(name, None)


def test_names_and_tab_stops(extension):
    """The search button is named by its text, arrows by a label; twice changes nothing."""
    accessible = extension("page_access").accessible
    page = (
        '<button class="btn search-button-field pst-js-only" title="Search" aria-label="Search" data-x="1">'
        "Search</button>"
        '<button class="btn other" aria-label="Close"></button>'
        '<summary><span class="toctree-toggle"></span></summary>'
    )
    expected = (
        '<button class="btn search-button-field pst-js-only" title="Search" data-x="1">Search</button>'
        '<button class="btn other" aria-label="Close"></button>'
        '<summary aria-label="Pages below"><span class="toctree-toggle"></span></summary>'
    )
    assert accessible(page) == expected
    assert accessible(expected) == expected


def test_no_line_breaks_between_a_formula_and_its_comma(extension):
    """Once only, and not where a word follows."""
    accessible = extension("page_access").accessible
    formula = r'<span class="math notranslate nohighlight">\\(s\\)</span>'
    kept = f'<span class="together">{formula},</span> the noise, and {formula} is small'
    assert accessible(f"{formula}, the noise, and {formula} is small") == kept
    assert accessible(kept) == kept


def test_what_unfolds_a_cell_is_named_by_its_text(extension):
    folded = (
        '<details><summary aria-label="Toggle hidden content">\nShow code cell source</summary></details>'
    )
    assert extension("page_access").accessible(folded).startswith("<details><summary>\nShow")


@pytest.mark.parametrize(
    ("body", "expected"), [("<p>", set()), ('<div class="scorecard-filter"></div>', {"scorecard.js"})]
)
def test_scripts_come_where_they_are_used(extension, body, expected):
    scripts = [SimpleNamespace(filename="_static/scorecard.js", attributes={"body": ""})]
    context = {"body": body, "meta": {}, "script_files": scripts}
    extension("repro_site").select_files(None, "page", "page.html", context, None)
    assert {script.filename.removeprefix("_static/") for script in context["script_files"]} == expected


def test_cells_of_cards_have_their_headings(extension):
    """Also in the second row; an empty heading stays one, other tables stay, and twice changes nothing.

    A cell that is a dash is marked, one that has a dash is not.
    """
    row = "<tr><td><p>a —</p></td><td><p>—</p></td></tr>"
    head = '<thead><tr><th class="head"><p>in "words"</p></th><th></th></tr></thead>'
    page = f'<table class="as-cards table">{head}<tbody>{row}{row}</tbody></table><table class="table">{row}</table>'
    headed = extension("page_access").with_headings(page)
    assert (
        headed.count(
            '<td data-heading="in &quot;words&quot;"><p>a —</p></td><td data-heading="" data-missing>'
        )
        == 2
    )
    assert headed.endswith(f'<table class="table">{row}</table>')
    assert extension("page_access").with_headings(headed) == headed


def test_each_cell_has_the_heading_of_its_column(extension):
    """Cells that take several columns or rows, rows with a heading of their own, and cells marked before."""
    head = (
        '<tr><th rowspan="2">a</th><th colspan="3">of all</th><th rowspan="2">e</th></tr>'
        '<tr><th>b</th><th colspan="2">c, d</th></tr>'
    )
    rows = (
        '<tr><th rowspan="2">1</th><td data-missing>–</td><td class="x">3</td><td rowspan="3">4</td><td>5</td></tr>'
        '<tr><td colspan="2">2 and 3</td><td>5</td></tr>'
        "<tr><td>1</td><td>2</td><td><p>—</p></td><td>5</td></tr>"
    )
    page = f'<table class="as-cards"><thead>{head}</thead><tbody>{rows}</tbody></table>'
    headed = extension("page_access").with_headings(page)
    assert re.findall(r'<td data-heading="([^"]*)"', headed) == [
        *("b", "c, d", "c, d", "e"),
        *("b", "e"),
        *("a", "b", "c, d", "e"),
    ]
    assert '<td data-heading="b" data-missing>–</td><td data-heading="c, d" class="x">' in headed
    assert headed.count("data-missing") == 2
    assert extension("page_access").with_headings(headed) == headed


def test_options_stay_whole(extension):
    """In commands and within a line; a minus in a program or a name stays as it is."""
    whole_options = extension("page_access").whole_options
    command = (
        '<div class="highlight-sh notranslate"><pre>live a-b -p x<span class="w"> </span>--lag 2</pre></div>'
    )
    assert whole_options(command) == command.replace("-p", '<span class="whole">-p</span>').replace(
        "--lag", '<span class="whole">--lag</span>'
    )
    assert whole_options('<code><span class="pre">--lag</span></code>').count('class="pre whole"') == 1
    program = '<div class="highlight-python"><pre>x -y</pre></div><span class="pre">-1.5</span>'
    assert whole_options(program) == program


def test_a_schematic_leads_to_a_file_of_its_own(extension):
    """The file is a picture by itself, as large as its window; other drawings on the page stay as they are."""
    svg = '<svg role="img" viewBox="0 0 2 1" width="100%" style="max-width: 2px"><path d="M0,0"/></svg>'
    page = f'<figure class="schematic">\n{svg}\n<figcaption>c</figcaption></figure><p>{svg}</p>'
    linked, files = extension("page_access").schematics_in_full(page, "chapters-imus", "../_images/")
    assert list(files) == ["chapters-imus-1.svg"]
    root = ET.fromstring(files["chapters-imus-1.svg"])
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("style") is None
    link = f'<a class="in-full" href="../_images/chapters-imus-1.svg" title="In full">{svg}</a>'
    assert linked == page.replace(svg, link, 1)
