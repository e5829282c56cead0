"""How large the code is, and what of the first edition nothing reaches any more: ``make size``."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EDITION1 = ROOT / "src" / "edition1"
PACKAGES = (
    "src/repro",
    "src/repro_board",
    "src/repro_companion",
    "src/edition1/edition1",
    "src/edition1/edition1_live",
    "src/edition1/edition1_companion",
    "tests",
    "bench",
)
ENTRIES = (
    "notebooks/*.ipynb",
    "book/_ext/*.py",
    "src/repro*/**/*.py",
    "scripts/*.py",
    "bench/**/*.py",
    "Makefile",
)
"""Who may use the first edition; its own tests do not count."""


def statements(path: Path) -> int:
    """Return the number of statements of a module, without docstrings."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    docstrings = [
        node
        for node in nodes
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    return sum(isinstance(node, ast.stmt) for node in nodes) - len(docstrings)


def javascript_lines() -> int:
    """Return the number of lines of our own JavaScript, without bundles of others."""
    bundles = {"shape_viewer.js"}
    paths = [path for folder in ("src", "book") for path in (ROOT / folder).rglob("*.*js")]
    own = [path for path in paths if not {"vendor", "_build"} & set(path.parts) and path.name not in bundles]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in own)


def names_used(path: Path) -> Iterator[str]:
    """Yield the dotted names that a file imports or has as a text; each may be a module or a name in one."""
    text = path.read_text(encoding="utf-8")
    if path.name == "Makefile":
        yield from text.split()
        return
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
            if path.name == "__init__.py":  # a package that imports its names when they are first used
                yield f"{path.parent.name}.{node.value}"


def unreached(root: Path = ROOT) -> list[str]:
    """Return the modules of the first edition that no notebook, command, page or benchmark leads to."""
    sources = root / "src" / "edition1"
    modules = {
        ".".join(path.relative_to(sources).with_suffix("").parts).removesuffix(".__init__"): path
        for path in sorted(sources.rglob("*.py"))
    }
    found: set[str] = set()
    todo = [path for pattern in ENTRIES for path in root.glob(pattern)]
    while todo:
        for name in names_used(todo.pop()):
            parts = name.split(".")
            for end in range(1, len(parts) + 1):  # a module brings the packages that it lies in
                module = ".".join(parts[:end])
                if module in modules and module not in found:
                    found.add(module)
                    todo.append(modules[module])
        if not todo:  # the studies of a page are found by the name of their file
            for module in sorted(modules.keys() - found):
                page, _, last = module.rpartition(".")
                if last == "studies" and any(name.startswith(f"{page}.") for name in found):
                    found.add(module)
                    todo.append(modules[module])
    return sorted(name for name in modules.keys() - found if statements(modules[name]))


def main() -> None:
    """Print a line for each package, and what nothing reaches."""
    total = 0
    for package in PACKAGES:
        files = sorted((ROOT / package).rglob("*.py"))
        count = sum(map(statements, files))
        total += count * package.startswith("src")
        print(f"{package:32} {len(files):4} modules {count:7} statements")
    print(f"{'src':32} {total:20} statements")
    print(f"{'JavaScript':32} {javascript_lines():20} lines")
    lost = unreached()
    print(
        "Nothing reaches these modules of the first edition:" if lost else "Every module is reached.", *lost
    )


if __name__ == "__main__":
    main()
