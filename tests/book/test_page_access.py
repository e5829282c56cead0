"""The corrections that pages get after Sphinx has written them."""

from __future__ import annotations

import importlib
import sys
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


def test_what_unfolds_a_cell_is_named_by_its_text(extension):
    folded = (
        '<details><summary aria-label="Toggle hidden content">\nShow code cell source</summary></details>'
    )
    assert extension("page_access").accessible(folded).startswith("<details><summary>\nShow")


def test_no_page_loads_the_search_of_sphinx(extension):
    site = extension("repro_site")
    kept = '<script src="../_static/doctools.js?v=1"></script>'
    page = (
        f'{kept}\n  <script src="../_static/searchtools.js"></script>\n<script src="searchindex.js"></script>'
    )
    assert site.without_search_of_sphinx(page) == kept


@pytest.mark.parametrize(
    ("pagename", "body", "expected"),
    [
        ("index", "<p>", set()),
        ("scorecard", '<div class="scorecard-filter"></div>', {"scorecard.js"}),
        ("search", "<p>", {"search_pages.js", "offline_search.js"}),
    ],
)
def test_scripts_come_where_they_are_used(extension, pagename, body, expected):
    names = ("scorecard.js", "offline_search.js")
    scripts = [SimpleNamespace(filename=f"_static/{name}", attributes={"body": ""}) for name in names]
    context = {"body": body, "meta": {}, "script_files": scripts}
    extension("repro_site").select_files(None, pagename, "page.html", context, None)
    loaded = [str(getattr(script, "filename", script)) for script in context["script_files"]]
    assert {name.removeprefix("_static/") for name in loaded} == expected


def test_scorecard_is_served_once_computed(extension, tmp_path):
    """JSON and badge lie at the root of the site; a first build without them says nothing."""
    site = extension("repro_site")
    source, out = tmp_path / "book", tmp_path / "html"
    (source / "generated").mkdir(parents=True)
    out.mkdir()
    app = SimpleNamespace(srcdir=source, outdir=out, builder=SimpleNamespace(format="html"))
    site.add_scorecard_files(app, None)
    assert list(out.iterdir()) == []
    (source / "generated" / "scorecard.json").write_text("{}")
    site.add_scorecard_files(app, None)
    assert (out / "scorecard.json").read_text() == "{}"
