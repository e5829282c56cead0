"""What the built pages need to stand on their own: no outside request, no script twice, little weight."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

MATHJAX = "vendor/mathjax/"


def select_scripts(app: Sphinx, pagename: str, templatename: str, context: dict, doctree) -> None:
    """Keep each script once, MathJax only where there are formulas, other vendored files on request.

    Jupyter Book adds every ``.js`` file below ``_static`` to every page; a page names the vendored ones it needs
    in its front matter: ``scripts: vendor/three/viewer.js``.
    """
    # Sphinx's own answer would count the pages below this one as well
    has_formulas = re.search(r'class="[^"]*\bmath\b', context.get("body") or "") is not None
    wanted = str((context.get("meta") or {}).get("scripts", "")).split()
    kept, seen = [], set()
    for script in context.get("script_files", []):
        name = str(getattr(script, "filename", script) or "").removeprefix("_static/")
        attributes = getattr(script, "attributes", {})
        body = str(attributes.get("body", "") or "")
        is_mathjax = name.startswith(MATHJAX) or body.startswith("window.MathJax")
        if is_mathjax and not has_formulas:
            continue
        if name.startswith("vendor/") and not is_mathjax and name not in wanted:
            continue
        if is_mathjax and name and not {"defer", "async"} & set(attributes):
            continue  # Jupyter Book's copy; Sphinx's own entry is deferred and comes after the configuration
        key = (name, body)
        if key in seen:
            continue
        seen.add(key)
        kept.append(script)
    context["script_files"] = kept


def tidy(app: Sphinx, exception: Exception | None) -> None:
    """Correct the written pages where neither the theme nor an extension offers a setting."""
    if exception is not None or app.builder.format != "html":
        return
    out = Path(app.outdir)
    for path in out.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        new = text.replace('<div role="list" class="citation-list">', '<div class="citation-list">')
        new = re.sub(r'(<div class="citation"[^>]*?) role="doc-biblioentry"', r"\1", new)
        # pandas leaves the corner cells of a table's head empty: not a header, then
        new = re.sub(r"<th>\s*</th>", "<td></td>", new)
        if new != text:
            path.write_text(new, encoding="utf-8")
    for pattern in ("**/*.map", "_static/scripts/fontawesome.js*", "_static/*webpack-macros.html"):
        for path in out.glob(pattern):
            path.unlink()


def forget_modules_without_source(app: Sphinx) -> list[tuple[str, dict, str]]:
    """Leave modules that have no source page (``builtins``) out of the index of sources, which would link to them."""
    modules = getattr(app.env, "_viewcode_modules", {})
    for name in [name for name, entry in modules.items() if not entry]:
        del modules[name]
    return []


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    # Jupyter Book sets it, although sphinx_comments is left out
    app.add_config_value("comments_config", {}, "html")
    app.connect("html-page-context", select_scripts, priority=900)
    app.connect("html-collect-pages", forget_modules_without_source, priority=100)
    app.connect("build-finished", tidy)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
