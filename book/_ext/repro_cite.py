"""What a reader takes away from a page: how to cite it, and a button that opens its notebook on Binder."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path

import yaml
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx_design.icons import get_octicon

BINDER = "https://mybinder.org"
FOLD = """<details class="sd-sphinx-override sd-dropdown sd-card sd-mb-3 cite">
<summary class="sd-summary-title sd-card-header"><span class="sd-summary-text">Cite this page</span>
<span class="sd-summary-state-marker sd-summary-chevron-right">{mark}</span></summary>
<div class="sd-summary-content sd-card-body docutils">{entries}</div></details>
"""
"""As sphinx-design writes a dropdown. It is added to the written page, so that the search does not find it."""


def address_of(root: Path, name: str) -> str:
    """Return an address of the project, such as its repository; empty until pyproject.toml names the owner."""
    urls = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    return "" if "OWNER" in urls[name] else urls[name]


def entry_of_page(root: Path, docname: str, title: str) -> str:
    """Return the BibTeX entry of a page, by those whom CITATION.cff names."""
    project = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    site = address_of(root, "Documentation")
    fields = {
        "author": " and ".join(f"{{{one['name']}}}" for one in project["authors"]),
        "title": re.sub(r"([&%$#_])", r"\\\1", title),
        "howpublished": f"{project['title']}, version {project['version']}",
        "year": str(project["date-released"])[:4],
        "url": f"{site}/{docname}.html" if site else "",
    }
    lines = [f"  {name} = {{{value}}}" for name, value in fields.items() if value]
    return ",\n".join([f"@misc{{repro_{Path(docname).name}", *lines]) + "\n}"


def entries_of_papers(root: Path, docname: str) -> list[str]:
    """Return the entries of the papers whose tables and figures a notebook shows, as references.bib has them."""
    with (root / "data/published/index.csv").open(encoding="utf-8", newline="") as stream:
        papers = {row["paper"] for row in csv.DictReader(stream) if row["page"] == docname}
    known = (root / "book/references.bib").read_text(encoding="utf-8")
    found = re.findall(r"^(@\w+\{(\w+),.*?^\})", known, re.DOTALL | re.MULTILINE)
    return [entry for entry, key in found if key in papers]


def cite(app: Sphinx, pagename: str, templatename: str, context: dict, doctree) -> None:
    """Add a fold at the end of a page: how to cite it, and the paper that it is about."""
    if doctree is None:
        return
    root = Path(app.srcdir).parent
    entries = [entry_of_page(root, pagename, app.env.titles[pagename].astext())]
    if pagename.startswith("notebooks/"):
        entries += entries_of_papers(root, pagename)
    shown = app.builder.highlighter.highlight_block("\n\n".join(entries), "bibtex")
    block = f'<div class="highlight-bibtex notranslate">{shown}</div>'
    context["body"] += FOLD.format(mark=get_octicon("chevron-right", height="1.5em"), entries=block)


def offer_binder(app: Sphinx, config: Config) -> None:
    """Let pages of notebooks have a button for Binder, once pyproject.toml names the repository."""
    repository = address_of(Path(app.srcdir).parent, "Repository")
    if repository:
        options = config.html_theme_options
        buttons = options.get("launch_buttons", {}) | {
            "binderhub_url": BINDER,
            "notebook_interface": "jupyterlab",
        }
        own = {"repository_url": repository, "repository_branch": "main", "launch_buttons": buttons}
        config.html_theme_options = options | own


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("config-inited", offer_binder)
    app.connect("html-page-context", cite)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
