"""Sources of our helpers: a page for each module that a notebook uses, and links to it from the code of the pages.

Names that the reference describes lead there; all others of ours lead to the lines that define them.
"""

from __future__ import annotations

import ast
import json
import pkgutil
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from types import FunctionType

from sphinx.application import Sphinx
from sphinx.util.osutil import relative_uri

OURS = ("repro", "repro_board", "repro_companion")
NOTEBOOKS, SOURCES = "notebooks/", "sources/"
"""Where pages are that use helpers, and where sources are shown."""


def source_of(root: Path, module: str) -> Path | None:
    """Return the file of a module of ours, if it is one."""
    path = (root / "src").joinpath(*module.split("."))
    found = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in found if file.is_file()), None) if module.split(".")[0] in OURS else None


def helpers_in(root: Path, code: str) -> dict[str, tuple[str, str]]:
    """Return module and name of each helper in code by how it stands there: ``rig.load``, or an imported ``save``."""
    modules, found, tree = {}, {}, ast.parse(code)
    for node in ast.walk(tree):
        for one in (
            node.names if isinstance(node, ast.ImportFrom) and source_of(root, node.module or "") else ()
        ):
            whole = f"{node.module}.{one.name}"
            if source_of(root, whole):
                modules[one.asname or one.name] = whole
            else:
                found[one.asname or one.name] = defined_in(node.module, one.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            found[f"{node.value.id}.{node.attr}"] = defined_in(modules[node.value.id], node.attr)
    return found


def defined_in(module: str, name: str) -> tuple[str, str]:
    """Return module and name of where a function or class is written, which others may pass on."""
    value = pkgutil.resolve_name(f"{module}:{name}")
    return (value.__module__, value.__name__) if isinstance(value, type | FunctionType) else (module, name)


def lines_of(source: str) -> dict[str, int]:
    """Return the line, counted from 1, on which each name at the top of a module is defined."""
    lines: dict[str, int] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            lines.setdefault(node.name, node.lineno)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name))
            for name in names:
                lines.setdefault(name, node.lineno)
    return lines


def used_by(app: Sphinx) -> dict[str, dict[str, tuple[str, str]]]:
    """Return the helpers of each notebook's code that the reference does not describe."""
    described = {name.rpartition(".")[2] for name in app.env.get_domain("py").objects}
    root, found = Path(app.srcdir).parent, {}
    for docname in sorted(app.env.found_docs):
        path = Path(app.env.doc2path(docname))
        if docname.startswith(NOTEBOOKS) and path.suffix == ".ipynb":
            cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
            code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
            every = helpers_in(root, code).items()
            in_reference = {
                x for x, (module, name) in every if name in described and module.startswith("repro.")
            }
            found[docname] = {x: where for x, where in every if x not in in_reference}
    return found


def source_pages(app: Sphinx) -> Iterator[tuple[str, dict, str]]:
    """Yield a page for each module in use: its source, with an anchor before every name."""
    for module in sorted({module for names in used_by(app).values() for module, _ in names.values()}):
        path = source_of(Path(app.srcdir).parent, module)
        if path:
            source = path.read_text(encoding="utf-8")
            html = app.builder.highlighter.highlight_block(source, "python", linenos=False)
            before, _, code = html.partition("<pre>")
            lines = code.split("\n")
            for name, number in lines_of(source).items():
                lines[number - 1] = f'<span id="{name}"></span>{lines[number - 1]}'
            body = f"<h1>Source of {escape(module)}</h1>\n{before}<pre>" + "\n".join(lines)
            yield SOURCES + module, {"parents": [], "title": module, "body": body}, "page.html"


def linked(html: str, uris: dict[str, str]) -> str:
    """Return a page whose highlighted code links helpers; what is linked already or is of others stays."""
    for name, uri in uris.items():
        owner, _, word = name.rpartition(".")
        dot = '<span class="o">.</span>'
        before = re.escape(f'<span class="n">{owner}</span>{dot}') if owner else rf"(?<!{re.escape(dot)})"
        found = rf'({before})(<span class="n">{re.escape(word)}</span>)(?!</a>)'
        html = re.sub(found, rf'\1<a class="api-link" href="{uri}">\2</a>', html)
    return html


def link_helpers(app: Sphinx, exception: Exception | None) -> None:
    """Link the helpers in the code of the built pages of notebooks to their sources."""
    if exception is not None or app.builder.format != "html":
        return
    for docname, names in used_by(app).items():
        page = Path(app.outdir) / f"{docname}.html"
        if names and page.is_file():
            to = {
                name: f"{relative_uri(f'{docname}.html', f'{SOURCES}{module}.html')}#{own}"
                for name, (module, own) in names.items()
                if (Path(app.outdir) / f"{SOURCES}{module}.html").is_file()
            }
            page.write_text(linked(page.read_text(encoding="utf-8"), to), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension."""
    app.connect("html-collect-pages", source_pages)
    app.connect("build-finished", link_helpers)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
