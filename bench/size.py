"""How large the code is: ``make size``."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("src/repro", "src/repro_board", "src/repro_companion", "tests", "bench")


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


def main() -> None:
    """Print a line for each package."""
    total = 0
    for package in PACKAGES:
        files = sorted((ROOT / package).rglob("*.py"))
        count = sum(map(statements, files))
        total += count * package.startswith("src")
        print(f"{package:32} {len(files):4} modules {count:7} statements")
    print(f"{'src':32} {total:20} statements")
    print(f"{'JavaScript':32} {javascript_lines():20} lines")


if __name__ == "__main__":
    main()
