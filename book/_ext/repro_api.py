"""The API reference: one page per folder of the public packages, written before Sphinx looks for its sources.

The list of modules is read off the source tree at every build, so a new module appears by itself. References
to this package that cannot be resolved stay warnings (errors in our build); names of other libraries are set as
plain text, because their inventories would have to come from the network.
"""

from __future__ import annotations

import ast
import importlib
import re
import textwrap
from pathlib import Path

from sphinx.application import Sphinx

# In the order in which one reads them. The book's own code is private.
PACKAGES = {
    "edition1": ("se3", "kinematics", "sensing", "estimation", "kernels", "robot_file"),
    "edition1_live": ("wire", "record", "follow", "robot", "own", "emulate", "view"),
}
"""Public packages and their folders; a folder that is not named here comes last."""
OURS = tuple(f"{package}." for package in PACKAGES)


def modules_of(root: Path) -> dict[str, list[str]]:
    """Return the dotted names of all modules of a package with content, grouped by the folder that they lie in."""
    order = PACKAGES.get(root.name, ())
    groups: dict[str, list[str]] = {}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        if any(part.startswith("_") and part != "__init__" for part in parts):
            continue
        if parts[-1] == "__init__":
            parts = parts[:-1]
        if not parts or not path.read_text(encoding="utf-8").strip():
            continue
        folder = parts if path.name == "__init__.py" else parts[:-1] or parts
        groups.setdefault(".".join(folder), []).append(".".join((root.name, *parts)))

    def place(group: str) -> tuple[int, str]:
        first = group.split(".")[0]
        return order.index(first) if first in order else len(order), group

    return {group: groups[group] for group in sorted(groups, key=place)}


def first_line(root: Path, module: str) -> str:
    """Return the first line of a module's docstring as Markdown, without importing it."""
    parts = module.split(".")[1:]
    path = root.joinpath(*parts)
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    line = re.sub(r":math:`([^`]*)`", r"$\1$", docstring.split("\n")[0])
    return re.sub(r":[\w:]+:`~?([^`]*)`", r"`\1`", line)


def page(package: str, modules: list[str]) -> str:
    """Return the MyST source of one page, on a folder."""
    # a long name would be broken within a word in the sidebar
    lines = [f"# {package}" if package.count(".") < 2 else f"# {package.split('.', 1)[1]}", ""]
    for module in modules:
        if module != package:
            lines += [f"## {module.removeprefix(package + '.')}", ""]
        lines += [
            "```{eval-rst}",
            f".. automodule:: {module}",
            "   :members:",
            "   :ignore-module-all:",
            "```",
            "",
        ]
    return "\n".join(lines)


def write_if_changed(path: Path, text: str) -> None:
    """Write a file, leaving its modification time alone when nothing changed."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def write_pages(book: Path) -> None:
    """Write ``api/*.md`` and the list of modules that ``api.md`` includes; remove pages that are obsolete."""
    folder = book / "api"
    names = {}
    lines = []
    for package in PACKAGES:
        root = book.parent / "src" / "edition1" / package
        for group, modules in modules_of(root).items():
            name = f"{package}.{group}"
            names[f"{name}.md"] = page(name, modules)
            lines += ["", f"### {name}", ""]
            for module in modules:
                lines.append(f"- [`{module}`](/api/{name}.md): {first_line(root, module)}")
    for old in folder.glob("*.md"):
        if old.name not in names:
            old.unlink()
    for name, text in names.items():
        write_if_changed(folder / name, text)
    write_if_changed(book / "generated" / "modules.md", "\n".join(lines[1:]) + "\n")


def write_placeholders(book: Path) -> None:
    """Give the pages something to include when the figures have not been computed yet."""
    text = textwrap.dedent(
        """\
        :::{note}
        These figures have not been computed in this copy: `make book` writes them.
        :::
        """
    )
    verdicts = [f"verdicts_{paper}.md" for paper in ("baaij2023", "mitchell2021", "martin2022")]
    for name in ("counts.md", "scorecard.md", "scorecard_picture.md", "papers.md", *verdicts):
        if not (book / "generated" / name).exists():
            write_if_changed(book / "generated" / name, text)


def home_of(target: str, module: str | None) -> str | None:
    """Return the full name of the place where a name of this package is defined.

    ``target`` is tried as it stands and relative to ``module``; names that a package passes on resolve to the
    module that defines them.
    """
    candidates = [target] if target.startswith(OURS) else []
    if module:
        candidates.append(f"{module}.{target}")
    for candidate in candidates:
        parts = candidate.split(".")
        for cut in range(len(parts) - 1, 0, -1):
            try:
                found = importlib.import_module(".".join(parts[:cut]))
            except ImportError:
                continue
            try:
                for part in parts[cut:]:
                    found = getattr(found, part)
            except AttributeError:
                break
            owner, name = getattr(found, "__module__", None), getattr(found, "__qualname__", None)
            if owner and name and owner.split(".")[0] in PACKAGES:
                return f"{owner}.{name}"
            break
    return None


def resolve(app: Sphinx, env, node, contnode):
    """Resolve what Sphinx could not: our names under another path; names of other libraries become text."""
    if node.get("refdomain") != "py":
        return None
    target, module = node["reftarget"], node.get("py:module")
    full = home_of(target, module)
    objects = env.get_domain("py").objects
    if full not in objects:
        # a short name that only one thing of this package has
        named = [name for name in objects if name.endswith(f".{target}")]
        full = named[0] if len(named) == 1 else full
    if full in objects:
        return _link(app, env, node, objects[full], contnode)
    ours = target.startswith(OURS) and not _is_parameter(target)
    if ours and full is None:
        return None  # a warning: nothing of that name exists
    if node.get("refexplicit") or node.get("reftype") in ("func", "meth", "attr", "data", "mod"):
        # written by hand: must exist, here or in an installed library
        return contnode if full or _importable(target) else None
    return contnode


def _link(app, env, node, entry, contnode):
    from sphinx.util.nodes import make_refnode

    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, [contnode], entry.node_id)


def _is_parameter(target: str) -> bool:
    """Tell whether a name is a type variable, such as the ``_S`` of a protocol."""
    return len(target.rsplit(".", 1)[-1].removeprefix("_")) == 1


def _importable(target: str) -> bool:
    parts = target.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except Exception:  # some libraries raise other errors for odd names
            continue
        try:
            for part in parts[cut:]:
                found = getattr(found, part)
        except AttributeError:
            return False
        return True
    return hasattr(__import__("builtins"), parts[0])


def skip_member(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out the fields of named tuples: their docstring describes them, as attributes."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension; the pages are written here, before the table of contents is read."""
    book = Path(app.srcdir)
    write_pages(book)
    write_placeholders(book)
    app.connect("missing-reference", resolve)
    app.connect("autodoc-skip-member", skip_member)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
