"""Links that nobody types: names of the library in cells lead to the reference, words to the glossary once a page."""

from __future__ import annotations

import ast
import json
import pkgutil
import re
from pathlib import Path

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx

LIBRARY = "repro"
"""The library that the reference describes."""
GLOSSARY = "notation"
TRAJECTORIES = f"{GLOSSARY}.html#glossary-trajectories"
TRAJECTORY = re.compile(r"\bT[0-5]\b")
PLACES = ("notebooks/", "chapters/")
"""Pages whose words are linked."""
_NOT_WITHIN = (
    nodes.reference,
    nodes.title,
    nodes.literal,
    nodes.math,
    nodes.raw,
    nodes.caption,
    pending_xref,
)


def link_words(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Link the first T0 to T5 and the first of each word of the glossary, outside of titles, links and code."""
    if not docname.startswith(PLACES) or GLOSSARY not in app.env.found_docs:
        return
    terms = {
        name: node_id
        for name, _, kind, _, node_id, _ in app.env.get_domain("std").get_objects()
        if kind == "term"
    }
    if not terms:
        return
    words = re.compile(
        r"(?<![\w-])(?:" + "|".join(map(re.escape, sorted(terms, key=len, reverse=True))) + r")(?![\w-])"
    )
    page = app.builder.get_relative_uri(docname, GLOSSARY)
    linked: set[str] = set()
    for text in list(doctree.findall(nodes.Text)):
        if any(isinstance(above, _NOT_WITHIN) for above in _ancestors(text)):
            continue
        parts, last = [], 0
        found = sorted([*TRAJECTORY.finditer(text), *words.finditer(text)], key=lambda match: match.start())
        for match in found:
            target = terms.get(match[0], "glossary-trajectories")
            if target in linked or match.start() < last:
                continue
            linked.add(target)
            parts += [nodes.Text(text[last : match.start()]), _link(match[0], f"{page}#{target}")]
            last = match.end()
        if parts:
            text.parent.replace(text, [*parts, nodes.Text(text[last:])])


def _ancestors(node: nodes.Node) -> list[nodes.Node]:
    above = []
    while node.parent is not None:
        node = node.parent
        above.append(node)
    return above


def _link(word: str, uri: str) -> nodes.reference:
    return nodes.reference("", word, internal=True, refuri=uri, classes=["glossary-link"])


def names_used(cells: list[dict]) -> dict[str, str]:
    """Return the names of the library in cells, by how they stand there: ``repro.track``, or as they are imported."""
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    found = {}
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(f"{LIBRARY}."):
            found |= {name.asname or name.name: name.name for name in node.names}
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == LIBRARY:
            found[f"{LIBRARY}.{node.attr}"] = node.attr
    return found


def link_calls(app: Sphinx, exception: Exception | None) -> None:
    """Link the names of the library in the code of the built pages of notebooks to the reference."""
    if exception is not None or app.builder.format != "html":
        return
    objects = app.env.get_domain("py").objects
    public = {
        name.rpartition(".")[2]: entry
        for name, entry in objects.items()
        if entry.objtype in ("class", "function", "exception")
    }
    for docname in sorted(app.env.found_docs):
        source = Path(app.env.doc2path(docname))
        if not docname.startswith("notebooks/") or source.suffix != ".ipynb":
            continue
        names = names_used(json.loads(source.read_text(encoding="utf-8"))["cells"])
        known = {name: public[home] for name, home in names.items() if home in public}
        page = Path(app.outdir) / f"{docname}.html"
        if known and page.is_file():
            text = page.read_text(encoding="utf-8")
            uris = {
                name: f"{app.builder.get_relative_uri(docname, entry.docname)}#{entry.node_id}"
                for name, entry in known.items()
            }
            page.write_text(linked_code(text, uris), encoding="utf-8")


def linked_code(html: str, uris: dict[str, str]) -> str:
    """Return a page whose highlighted code links names; what is linked already stays."""
    names = "|".join({re.escape(name.rpartition(".")[2]) for name in uris})
    of_library = rf'<span class="n">{LIBRARY}</span><span class="o">\.</span>'

    def link(match: re.Match[str]) -> str:
        uri = uris.get(f"{LIBRARY}.{match[2]}" if match[1] else match[2])
        word = f'<span class="n">{match[2]}</span>'
        return f'{match[1] or ""}<a class="api-link" href="{uri}">{word}</a>' if uri else match[0]

    return re.sub(rf'({of_library})?<span class="n">({names})</span>(?!</a>)', link, html)


def name_as_text(app: Sphinx, env, node: pending_xref, contnode: nodes.Element) -> nodes.Element | None:
    """Write a name of ours that the reference does not describe as text; one that does not exist stays broken."""
    if node.get("refdomain") == "py" and node["reftarget"].startswith(LIBRARY):
        try:
            pkgutil.resolve_name(node["reftarget"])
        except (AttributeError, ImportError):
            return None
        return contnode
    return None


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("missing-reference", name_as_text)
    app.connect("doctree-resolved", link_words)
    app.connect("build-finished", link_calls)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
