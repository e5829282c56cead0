"""What the built pages need to stand on their own: no outside request, no script twice, little weight."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

from fontTools import subset
from page_access import accessible, schematics_in_full
from repro_cite import address_of
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

from repro_companion.build import page_of

VIEWER = "shape_viewer.js"
VIEWER_IN_PACKAGE = f"src/repro_board/page/vendor/{VIEWER}"
ICONS_OF_THEME = "vendor/fontawesome/webfonts/fa-solid-900.ttf"
ICONS = {
    "magnifying-glass": 0xF002,
    "xmark": 0xF00D,
    "download": 0xF019,
    "rocket": 0xF135,
    "list": 0xF03A,
    "circle-half-stroke": 0xF042,
    "arrow-up": 0xF062,
    "triangle-exclamation": 0xF071,
    "chevron-down": 0xF078,
    "bars": 0xF0C9,
    "angle-left": 0xF104,
    "angle-right": 0xF105,
    "file": 0xF15B,
    "sun": 0xF185,
    "moon": 0xF186,
}
"""What pages show of the icons; for one that is not here, a browser loads the whole font of the theme."""
USED_BY = {
    "scorecard.js": 'class="scorecard-filter"',
    "live/live.css": "data-live=",
    "mathjax/": 'class="math ',
    "mystnb.": 'class="cell',
    "sphinx-design.min.css": "sd-",
    "design-tabs.js": "sd-tab",
}
"""Scripts and styles by the beginning of their names, with what a page has that needs them."""
NOT_SERVED = (
    "**/*.map",
    "_static/scripts/fontawesome.js*",
    "_static/*webpack-macros.html",
    "_static/mathjax/mml-*.js",
    "_static/mathjax/tex-svg.js",
    "_static/mathjax/tex-mml-*.js",
    "_static/mathjax/tex-*-full*.js",
)
"""What the theme and MathJax bring along and no page loads; MathJax has its parts once more in other bundles."""
LIVE_FIRST = ("model", "figure")
"""What every live figure is made of, in the order in which it is loaded; its own script comes last."""
LIVE_DATA = {"landscape": "landscape_grid"}
"""What a live figure draws and does not compute, by its name."""
NOTEBOOKS = "notebooks/"
PLACE = re.compile(r"\{\{\s*([a-z_][\w.]*)\s*\}\}")
LIVE = re.compile(r'data-live="(\w+)"')


def is_used(name: str, body: str) -> bool:
    """Return whether a page has use for a script or a style."""
    return all(mark in body for file, mark in USED_BY.items() if name.startswith(file))


def select_files(app: Sphinx, pagename: str, templatename: str, context: dict, doctree) -> None:
    """Keep each script and style once, and only where a page has use for it: all would come with every page."""
    page = context.get("body") or ""
    for kind in ("css_files", "script_files"):
        kept = {}
        for file in context.get(kind, []):
            name = str(getattr(file, "filename", file) or "").removeprefix("_static/")
            later = name.startswith("live/") and name not in USED_BY  # in an order of their own
            if is_used(name, page) and not later:
                kept.setdefault((name, str(getattr(file, "attributes", {}).get("body") or "")), file)
        context[kind] = list(kept.values())
    kept = context["script_files"]
    if 'class="shape-view"' in page:
        kept.append(f"_static/{VIEWER}")
    live = sorted(set(LIVE.findall(page)))
    data = [LIVE_DATA[name] for name in live if name in LIVE_DATA]
    kept += [f"_static/live/{stem}.js" for stem in ((*LIVE_FIRST, *data, *live) if live else ())]


def is_notebook(app: Sphinx, docname: str) -> bool:
    """Return whether a page is made from an executed notebook."""
    return docname.startswith(NOTEBOOKS) and str(app.env.doc2path(docname)).endswith(".ipynb")


def make_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Make the page of an executed notebook; the notebook itself stays as it is."""
    if is_notebook(app, docname):
        name = docname.removeprefix(NOTEBOOKS)
        source[0] = json.dumps(page_of(json.loads(source[0]), Path(app.srcdir).parent, name))


def fill_values(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put results into the text of pages that are no notebooks, where ``{{home.ring_best}}`` names one."""
    if docname.startswith(NOTEBOOKS) or "{{" not in source[0]:
        return
    book = Path(app.srcdir)
    values = {"source": source_of(book.parent)}
    found = book / "generated" / "values.json"
    if found.is_file():
        values |= json.loads(found.read_text(encoding="utf-8"))

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise ExtensionError(f"{docname} names {match[0]}; there is {', '.join(sorted(values))}.")
        return values[match[1]]

    source[0] = PLACE.sub(value, source[0])


def source_of(root: Path) -> str:
    """Return where a reader gets the project, as a sentence; until it is published, from whoever made the site."""
    url = address_of(root, "Repository")
    if not url:
        return "You need the project from which this site was built; ask whoever gave you this site for it."
    return f"The project lies at <{url}>."


def drop_numbers(app: Sphinx, pagename: str, templatename: str, context: dict, doctree) -> None:
    """Take our numbers off the figures: their captions name the figures of the paper."""
    if doctree is not None:
        number = r'<span class="caption-number">.*?</span>'
        context["body"] = re.sub(number, "", context["body"], flags=re.S)


def add_viewer(app: Sphinx, exception: Exception | None) -> None:
    """Put the script that shows shapes where pages find it."""
    if exception is None and app.builder.format == "html":
        shutil.copyfile(Path(app.srcdir).parent / VIEWER_IN_PACKAGE, Path(app.outdir) / "_static" / VIEWER)


def cut_icons(app: Sphinx, exception: Exception | None) -> None:
    """Write the icons that pages show as a font of their own; ``repro.css`` puts it before that of the theme."""
    if exception is None and app.builder.format == "html":
        static = Path(app.outdir) / "_static"
        options = subset.Options(layout_features=[], hinting=False, flavor="woff", recalc_timestamp=False)
        with subset.load_font(str(static / ICONS_OF_THEME), options) as font:
            cutter = subset.Subsetter(options)
            cutter.populate(unicodes=ICONS.values())
            cutter.subset(font)
            subset.save_font(font, str(static / "icons.woff"), options)


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
        new = accessible(re.sub(r"<th>\s*</th>", "<td></td>", new))
        page = path.relative_to(out)
        images = "../" * (len(page.parts) - 1) + "_images/"
        new, drawn = schematics_in_full(new, "-".join(page.with_suffix("").parts), images)
        for name, picture in drawn.items():
            (out / "_images").mkdir(exist_ok=True)
            (out / "_images" / name).write_text(picture, encoding="utf-8")
        if new != text:
            path.write_text(new, encoding="utf-8")
    for pattern in NOT_SERVED:
        for path in out.glob(pattern):
            path.unlink()


def name_without_dots(app: Sphinx, exception: Exception | None) -> None:
    """Let the search find "Fig. 9" where a reader leaves out the dot."""
    path = Path(app.outdir) / "searchindex.js"
    if exception is None and path.is_file():
        before, data, after = re.split(r"(\{.*\})", path.read_text(encoding="utf-8"), maxsplit=1, flags=re.S)
        index = json.loads(data)
        named = index["indexentries"]
        named |= {f"fig {name[5:]}": found for name, found in named.items() if name.startswith("fig. ")}
        path.write_text(before + json.dumps(index, ensure_ascii=False) + after, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    # Jupyter Book sets it, although sphinx_comments is left out
    app.add_config_value("comments_config", {}, "html")
    app.connect("html-page-context", select_files, priority=900)
    app.connect("html-page-context", drop_numbers)
    app.connect("source-read", make_page)
    app.connect("source-read", fill_values)
    app.connect("build-finished", add_viewer)
    app.connect("build-finished", cut_icons)
    app.connect("build-finished", tidy)
    app.connect("build-finished", name_without_dots)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
