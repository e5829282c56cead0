"""The two local Sphinx extensions of the book."""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

BOOK = Path(__file__).resolve().parents[2] / "book"
pytest.importorskip("sphinx")


@pytest.fixture(autouse=True)
def extension_path(monkeypatch):
    """Make the extensions importable."""
    monkeypatch.syspath_prepend(str(BOOK / "_ext"))
    yield
    for name in ("repro_api", "repro_links", "repro_site"):
        sys.modules.pop(name, None)


def test_pages_follow_the_source_tree(tmp_path):
    """A new module gets its page, a removed one loses it, an unchanged page is not written again."""
    api = importlib.import_module("repro_api")
    package = tmp_path / "src" / "edition1" / "edition1"
    (package / "sensing").mkdir(parents=True)
    (package / "__init__.py").write_text('"""The package."""\n')
    (package / "se3.py").write_text('"""Rigid motions."""\n')
    (package / "sensing" / "__init__.py").write_text("")
    (package / "sensing" / "magnets.py").write_text('"""Magnets."""\n')
    (package / "sensing" / "_private.py").write_text('"""Not shown."""\n')
    (package / "sensing" / "hall").mkdir()
    (package / "sensing" / "hall" / "__init__.py").write_text('"""Hall sensors."""\n')
    (package / "sensing" / "hall" / "cube.py").write_text('"""Their cube."""\n')
    book = tmp_path / "book"
    api.write_pages(book)
    pages = sorted(path.name for path in (book / "api").iterdir())
    assert pages == ["edition1.se3.md", "edition1.sensing.hall.md", "edition1.sensing.md"]
    modules = (book / "generated" / "modules.md").read_text().splitlines()
    assert [line for line in modules if line.startswith("###")] == [
        "### edition1.se3",
        "### edition1.sensing",
        "### edition1.sensing.hall",
    ]
    hall = (book / "api" / "edition1.sensing.hall.md").read_text()
    assert hall.index("# sensing.hall\n") < hall.index("## cube\n")
    assert ".. automodule:: edition1.sensing.magnets" in (book / "api" / "edition1.sensing.md").read_text()
    assert (
        "- [`edition1.se3`](/api/edition1.se3.md): Rigid motions."
        in (book / "generated" / "modules.md").read_text()
    )

    before = (book / "api" / "edition1.se3.md").stat().st_mtime_ns
    (package / "sensing" / "magnets.py").unlink()
    shutil.rmtree(package / "sensing" / "hall")
    api.write_pages(book)
    assert [path.name for path in (book / "api").iterdir()] == ["edition1.se3.md"]
    assert (book / "api" / "edition1.se3.md").stat().st_mtime_ns == before


def test_placeholders_never_replace_computed_fragments(tmp_path):
    """The includes of a first build exist; later they are left alone."""
    api = importlib.import_module("repro_api")
    (tmp_path / "generated").mkdir()
    (tmp_path / "generated" / "counts.md").write_text("7 reproduced")
    api.write_placeholders(tmp_path)
    assert (tmp_path / "generated" / "counts.md").read_text() == "7 reproduced"
    assert "make book" in (tmp_path / "generated" / "scorecard.md").read_text()
    included = [
        name
        for page in (*BOOK.glob("*.md"), *BOOK.glob("chapters/*.md"))
        for name in re.findall(r"generated/(\w+\.md)", page.read_text())
    ]
    written = {path.name for path in (tmp_path / "generated").iterdir()}
    assert set(included) - {"modules.md"} <= written


def test_names_resolve_where_they_are_defined():
    """A name under another path of this package is found; one that does not exist is not."""
    api = importlib.import_module("repro_api")
    assert api.home_of("edition1.errors.InputError", None) == "edition1.errors.InputError"
    assert api.home_of("InputError", "edition1.errors") == "edition1.errors.InputError"
    assert api.home_of("edition1.errors.NoSuchError", None) is None


def script(name="", body="", **attributes):
    """Return a stand-in for Sphinx's record of a script."""
    return SimpleNamespace(filename=name and f"_static/{name}", attributes={"body": body, **attributes})


def test_a_script_comes_once():
    site = importlib.import_module("repro_site")
    context = {
        "body": "<p>",
        "script_files": [script("a.js"), script("a.js"), script(body="1"), script(body="2")],
    }
    site.select_files(None, "page", "page.html", context, None)
    assert [item.filename or item.attributes["body"] for item in context["script_files"]] == [
        "_static/a.js",
        "1",
        "2",
    ]


@pytest.mark.parametrize(
    ("body", "names"),
    [
        ("<p>", ["repro.css"]),
        ('<div class="cell docutils">', ["mystnb.0f.css", "repro.css"]),
        ('<details class="sd-dropdown">', ["sphinx-design.min.css", "repro.css"]),
        ('<div data-live="imus">', ["live/live.css", "repro.css"]),
    ],
)
def test_a_style_comes_where_a_page_has_use_for_it(body, names):
    site = importlib.import_module("repro_site")
    every = ["mystnb.0f.css", "sphinx-design.min.css", "page_notes.css", "live/live.css", "repro.css"]
    context = {"body": body, "css_files": [script(name) for name in every]}
    site.select_files(None, "page", "page.html", context, None)
    assert [item.filename for item in context["css_files"]] == [f"_static/{name}" for name in names]


def test_the_script_of_the_viewer_comes_with_a_view():
    site = importlib.import_module("repro_site")
    context = {"body": '<div class="shape-view">', "script_files": [script("a.js")]}
    site.select_files(None, "page", "page.html", context, None)
    assert str(context["script_files"][-1]) == "_static/shape_viewer.js"


def test_the_scripts_of_a_live_figure_come_with_it_and_in_order():
    site = importlib.import_module("repro_site")
    every = ["live/figure.js", "live/imus.js", "live/magnets.js", "live/model.js"]
    for body, names in (('<div data-live="imus">', ["model", "figure", "imus"]), ("<p>", [])):
        context = {"body": body, "script_files": [script(name) for name in every]}
        site.select_files(None, "page", "page.html", context, None)
        assert context["script_files"] == [f"_static/live/{name}.js" for name in names]


def test_names_in_cells_lead_to_the_reference():
    """What cells import from a public package is known by where it is defined, and linked once in code."""
    links = importlib.import_module("repro_links")
    cells = [
        {
            "cell_type": "code",
            "source": ["from edition1 import GradientDescent, track as follow\n", "import numpy as np"],
        },
        {"cell_type": "code", "source": ["from edition1_companion.pages.table_1 import figures\n"]},
        {"cell_type": "markdown", "source": ["from nowhere"]},
    ]
    homes = links.imported_names(cells)
    assert homes == {
        "GradientDescent": "edition1.estimation.gradient_descent.GradientDescent",
        "follow": "edition1.estimation.base.track",
    }
    html = '<span class="n">follow</span><span class="p">(</span><span class="n">followed</span>'
    linked = links.linked_code(html, {"follow": "../api/x.html#track"})
    assert linked.startswith(
        '<a class="api-link" href="../api/x.html#track"><span class="n">follow</span></a>'
    )
    assert linked.count("<a ") == 1
    assert links.linked_code(linked, {"follow": "../api/x.html#track"}) == linked


def test_words_lead_to_the_glossary_once(tmp_path):
    """The first of each on a page, not in titles, code or links."""
    from sphinx.testing.util import SphinxTestApp

    source = tmp_path / "book"
    (source / "chapters").mkdir(parents=True)
    (source / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})\n"
        "extensions = ['myst_parser', 'repro_links']\nmyst_enable_extensions = ['deflist']\n"
    )
    (source / "index.md").write_text("# A\n\n```{toctree}\nglossary\nchapters/x\n```\n")
    (source / "glossary.md").write_text(
        "# G\n\n(glossary-trajectories)=\n## T0 to T5\n\nText.\n\n```{glossary}\nNEES\n  An error.\n```\n"
    )
    (source / "chapters" / "x.md").write_text(
        "# On T3\n\n`T3`, T3 and T4 and NEES; again NEES, T13 and xNEES.\n"
    )
    app = SphinxTestApp("html", srcdir=source, confoverrides={"html_theme": "basic"})
    app.build()
    text = (Path(app.outdir) / "chapters" / "x.html").read_text()
    assert text.count('class="glossary-link reference internal"') == 2
    assert re.search(r'<a class="glossary-link[^>]*glossary-trajectories">T3</a> and T4', text)
    assert re.search(r'term-NEES">NEES</a>; again NEES', text)
    app.cleanup()
