"""What the search reads: the words of every page as a script, because a page from disk can load nothing else."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

INDEX = "search_pages.js"
"""Below ``_static``; loaded on the page of the search only."""
KINDS = ("chapters/", "", "notebooks/", "api/")
"""Where pages lie, in the order in which the search lists them at equal rank."""
_WITHOUT_WORDS = (
    nodes.title,
    nodes.literal_block,
    nodes.doctest_block,
    nodes.math,
    nodes.math_block,
    nodes.raw,
    nodes.comment,
    addnodes.toctree,
    addnodes.index,
)
_SIGNED = ("class", "function", "exception", "data")

Part = tuple[str, str, str]
"""Anchor, heading and text of a part of a page."""


def collect(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Keep the words of a page while its tree is there."""
    if app.builder.format != "html":
        return
    title = next(iter(doctree.findall(nodes.title)), None)
    if title is not None:
        topics = app.env.metadata.get(docname, {}).get("topics", "")
        place = max((kind for kind in KINDS if docname.startswith(kind)), key=len)
        uri = app.builder.get_target_uri(docname)
        page = [uri, _plain(title), topics, KINDS.index(place), list(_parts(doctree))]
        app.env.repro_words = getattr(app.env, "repro_words", {}) | {docname: page}


def _parts(doctree: nodes.document) -> Iterator[Part]:
    """Yield the parts of a page: its sections, and in the reference each name with the first line about it."""
    for number, section in enumerate(doctree.findall(nodes.section)):
        heading = _plain(section.next_node(nodes.title)) if number else ""
        yield section["ids"][0] if number else "", heading, " ".join(_words(section))
    for description in doctree.findall(addnodes.desc):
        signature = description.next_node(addnodes.desc_signature)
        if description.get("objtype") in _SIGNED and signature and signature["ids"]:
            first = next(iter(description[-1].findall(nodes.paragraph)), None)
            name = signature.get("fullname") or signature["ids"][0].rsplit(".", 1)[-1]
            yield signature["ids"][0], name, _plain(first) if first else ""


def _words(node: nodes.Node) -> Iterator[str]:
    """Yield the paragraphs of a section without those of its sections, formulas, code and pictures."""
    for child in node.children:
        if isinstance(child, (*_WITHOUT_WORDS, nodes.section, addnodes.desc)):
            continue
        if isinstance(child, (nodes.TextElement, nodes.Text)):
            if text := _plain(child):
                yield text
        else:
            yield from _words(child)


def _plain(node: nodes.Node) -> str:
    """Return the text of a paragraph or title in one line, with a gap for each of its formulas."""
    texts = [node] if isinstance(node, nodes.Text) else node.findall(nodes.Text)
    kept = (
        "…" if isinstance(text.parent, nodes.math) else text.astext()
        for text in texts
        if not isinstance(text.parent, (nodes.raw, nodes.comment))
    )
    return " ".join("".join(kept).split())


def write_index(app: Sphinx, exception: Exception | None) -> None:
    """Write the words of all pages beside the script that searches them, and leave out the index of Sphinx."""
    if exception is not None or app.builder.format != "html":
        return
    out = Path(app.outdir)
    pages = list(getattr(app.env, "repro_words", {}).values())
    text = json.dumps(pages, ensure_ascii=False, separators=(",", ":"))
    (out / "_static" / INDEX).write_text(f"window.searchPages = {text};\n", encoding="utf-8")
    for name in ("searchindex.js", "_static/searchtools.js", "_static/language_data.js"):
        (out / name).unlink(missing_ok=True)


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("doctree-resolved", collect)
    app.connect("build-finished", write_index)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": False}
