"""The local Sphinx extensions of the book."""

from __future__ import annotations

import importlib
import io
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from sphinx.testing.util import SphinxTestApp

import repro

BOOK = Path(__file__).resolve().parents[2] / "book"


@pytest.fixture(autouse=True)
def extension_path(monkeypatch):
    """Make the extensions importable."""
    monkeypatch.syspath_prepend(str(BOOK / "_ext"))
    yield
    for name in ("repro_cite", "repro_links", "repro_site", "repro_sources"):
        sys.modules.pop(name, None)


def test_the_reference_lists_the_public_names():
    """Each is in a table, and described below it; so are some that stay in their modules."""
    page = (BOOK / "api.md").read_text(encoding="utf-8")
    described = re.findall(r"^\.\. auto(?:class|exception|function):: (\S+)$", page, re.M)
    assert {f"repro.{name}" for name in repro.__all__} <= set(described)
    tables = re.findall(r"^   ~?(repro\.\S+)$", page, re.M)
    assert sorted([*tables, "repro.InputError"]) == sorted(described)
    for name in described:
        module, _, own = name.rpartition(".")
        assert getattr(importlib.import_module(module), own).__doc__


def test_a_name_that_is_not_described_becomes_text(tmp_path):
    """One of ours that exists, and one of another library; one of ours that does not exist stops the build."""
    settings = yaml.safe_load((BOOK / "_config.yml").read_text(encoding="utf-8"))["sphinx"]["config"]
    (tmp_path / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})\n"
        f"extensions = ['sphinx.ext.autodoc', 'repro_links']\nnitpicky = {settings['nitpicky']}\n"
        f"nitpick_ignore_regex = {settings['nitpick_ignore_regex']}\n"
    )
    names = ("repro.chain.place", "repro.no_such_name", "numpy.array")
    (tmp_path / "index.rst").write_text("T\n=\n\n" + "\n".join(f":py:func:`{name}`" for name in names))
    warnings = io.StringIO()
    app = SphinxTestApp("html", srcdir=tmp_path, confoverrides={"html_theme": "basic"}, warning=warnings)
    app.build()
    app.cleanup()
    assert re.findall(r"py:func reference target not found: ([\w.]+)", warnings.getvalue()) == [names[1]]


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
        ('<div data-live="magnets">', ["live/live.css", "repro.css"]),
    ],
)
def test_a_style_comes_where_a_page_has_use_for_it(body, names):
    site = importlib.import_module("repro_site")
    every = ["mystnb.0f.css", "sphinx-design.min.css", "live/live.css", "repro.css"]
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
    every = [f"live/{name}.js" for name in ("figure", "landscape", "landscape_grid", "magnets", "model")]
    cases = {
        '<div data-live="magnets">': ["model", "figure", "magnets"],
        '<div data-live="landscape">': ["model", "figure", "landscape_grid", "landscape"],
        "<p>": [],
    }
    for body, names in cases.items():
        context = {"body": body, "script_files": [script(name) for name in every]}
        site.select_files(None, "page", "page.html", context, None)
        assert context["script_files"] == [f"_static/live/{name}.js" for name in names]


def test_the_search_finds_a_figure_without_its_dot(tmp_path):
    """Beside the entry with it; all else in the index of the search stays."""
    site = importlib.import_module("repro_site")
    index = {"docnames": ["a"], "indexentries": {"fig. 9": [[0, "index-0", True]], "figure": []}}
    (tmp_path / "searchindex.js").write_text(f"Search.setIndex({json.dumps(index)})", encoding="utf-8")
    site.name_without_dots(SimpleNamespace(outdir=tmp_path), None)
    index["indexentries"]["fig 9"] = [[0, "index-0", True]]
    assert (tmp_path / "searchindex.js").read_text() == f"Search.setIndex({json.dumps(index)})"


def test_names_in_cells_lead_to_the_reference():
    """What cells import from the library is known by its name there, and linked once in code."""
    links = importlib.import_module("repro_links")
    cells = [
        {
            "cell_type": "code",
            "source": [
                "from repro import GradientDescent, track as follow\n",
                "import repro\n",
                "repro.smooth(1)",
            ],
        },
        {"cell_type": "code", "source": ["from repro_companion.papers import baaij\n"]},
        {"cell_type": "markdown", "source": ["from nowhere"]},
    ]
    found = {"GradientDescent": "GradientDescent", "follow": "track", "repro.smooth": "smooth"}
    assert links.names_used(cells) == found
    html = '<span class="n">follow</span><span class="p">(</span><span class="n">followed</span>'
    linked = links.linked_code(html, {"follow": "../api.html#track"})
    assert linked.startswith('<a class="api-link" href="../api.html#track"><span class="n">follow</span></a>')
    assert linked.count("<a ") == 1
    assert links.linked_code(linked, {"follow": "../api.html#track"}) == linked
    smooth = '<span class="n">repro</span><span class="o">.</span><span class="n">smooth</span>'
    linked = links.linked_code(f'{smooth}<span class="n">smooth</span>', {"repro.smooth": "#s"})
    assert (
        linked
        == smooth.replace(
            '<span class="n">smooth</span>', '<a class="api-link" href="#s"><span class="n">smooth</span></a>'
        )
        + '<span class="n">smooth</span>'
    )


def test_words_lead_to_the_glossary_once(tmp_path):
    """The first of each on a page, not in titles, code or links."""
    source = tmp_path / "book"
    (source / "chapters").mkdir(parents=True)
    (source / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})\n"
        "extensions = ['myst_parser', 'repro_links']\nmyst_enable_extensions = ['deflist']\n"
    )
    (source / "index.md").write_text("# A\n\n```{toctree}\nnotation\nchapters/x\n```\n")
    (source / "notation.md").write_text(
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


def test_helpers_are_found_where_they_are_written():
    """As they stand in code; a function that another module passes on is found in its own."""
    sources = importlib.import_module("repro_sources")
    code = """
import numpy as np
from repro_companion.plots import style as plots
from repro_companion.papers import baaij as b
from repro_companion.show import project_folder, save

np.eye(3); save(b.stills(plots.WIDTH), "x"); project_folder(); other.stills()
"""
    assert sources.helpers_in(BOOK.parent, code) == {
        "save": ("repro_companion.show", "save"),
        "project_folder": ("repro_companion.run", "project_folder"),
        "b.stills": ("repro_companion.papers.baaij", "stills"),
        "plots.WIDTH": ("repro_companion.plots.style", "WIDTH"),
    }


@pytest.mark.parametrize(
    "page", sorted((BOOK.parent / "notebooks").glob("*.ipynb")), ids=lambda page: page.stem
)
def test_every_helper_of_a_page_has_a_line_in_its_source(page):
    sources = importlib.import_module("repro_sources")
    cells = json.loads(page.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    for module, name in sources.helpers_in(BOOK.parent, code).values():
        source = sources.source_of(BOOK.parent, module).read_text(encoding="utf-8")
        assert name in source.splitlines()[sources.lines_of(source)[name] - 1]


def test_code_links_the_helper_that_is_meant():
    """A module's by its module, an imported one where it stands alone; what is linked already stays."""
    sources = importlib.import_module("repro_sources")
    n, dot = '<span class="n">{}</span>'.format, '<span class="o">.</span>'
    uris = {"rig.load": "rig.html#load", "save": "show.html#save"}
    html = f"{n('rig')}{dot}{n('load')} {n('np')}{dot}{n('load')} {n('save')} {n('x')}{dot}{n('save')}"
    once = sources.linked(html, uris)
    load, save = (
        f'<a class="api-link" href="{uris[name]}">{n(word)}</a>'
        for name, word in zip(uris, ("load", "save"), strict=True)
    )
    assert once == f"{n('rig')}{dot}{load} {n('np')}{dot}{n('load')} {save} {n('x')}{dot}{n('save')}"
    assert sources.linked(once, uris) == once


def test_a_page_is_cited_with_the_paper_that_it_shows():
    """The authors are those of CITATION.cff; the entry of the paper is the one of the bibliography."""
    cite = importlib.import_module("repro_cite")
    cited = yaml.safe_load((BOOK.parent / "CITATION.cff").read_text(encoding="utf-8"))
    entry = cite.entry_of_page(BOOK.parent, "notebooks/live", "50 % & more_or_less")
    assert entry.startswith("@misc{repro_live,\n")
    assert "title = {50 \\% \\& more\\_or\\_less}" in entry
    assert f"author = {{{{{cited['authors'][0]['name']}}}}}" in entry
    assert f"version {cited['version']}}}" in entry
    assert entry.count("{") == entry.count("}")
    known = (BOOK / "references.bib").read_text(encoding="utf-8")
    for page, papers in {"table_2": ["baaij2023"], "imu_markers": ["martin2022"], "live": []}.items():
        found = cite.entries_of_papers(BOOK.parent, f"notebooks/{page}")
        assert re.findall(r"^@\w+\{(\w+),", "\n".join(found), re.M) == papers
        assert all(one in known and one.count("{") == one.count("}") for one in found)


@pytest.mark.parametrize("owner", ["OWNER", "somebody"])
def test_pages_have_a_button_for_binder_once_the_owner_is_named(owner, tmp_path):
    """One setting, in pyproject.toml; a page is then cited with its address too. Other options of the theme stay."""
    cite = importlib.import_module("repro_cite")
    text = (BOOK.parent / "pyproject.toml").read_text(encoding="utf-8").replace("OWNER", owner)
    (tmp_path / "pyproject.toml").write_text(text, encoding="utf-8")
    (tmp_path / "CITATION.cff").symlink_to(BOOK.parent / "CITATION.cff")
    options = {"launch_buttons": {"thebe": False}, "search_bar_text": "Search"}
    config = SimpleNamespace(html_theme_options=dict(options))
    cite.offer_binder(SimpleNamespace(srcdir=tmp_path / "book"), config)
    found, entry = config.html_theme_options, cite.entry_of_page(tmp_path, "notebooks/live", "Live")
    if owner == "OWNER":
        assert found == options
        assert "url" not in entry
    else:
        assert found["launch_buttons"]["binderhub_url"] == cite.BINDER
        assert found["repository_url"] == "https://github.com/somebody/repro"
        assert (found["launch_buttons"]["thebe"], found["search_bar_text"]) == (False, "Search")
        assert "url = {https://somebody.github.io/repro/notebooks/live.html}" in entry


def test_binder_gets_the_environment_of_everybody_else():
    folder = BOOK.parent / ".binder"
    assert (folder / "environment.yml").readlink() == Path("../environment.yml")
    assert (folder / "postBuild").stat().st_mode & 0o111
    targets = re.findall(r"^([.a-z-]+):(?!=)", (BOOK.parent / "Makefile").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"^make (\S+)", (folder / "postBuild").read_text(), re.M)) <= set(targets)
