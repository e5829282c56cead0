"""How large the code is: ``make size``. Documentation, blank lines and comments are free."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST = 300
"""Lines of a module."""


def statements(tree: ast.AST) -> int:
    """Statements of a module, without docstrings."""
    text = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
    return sum(isinstance(node, ast.stmt) for node in ast.walk(tree)) - sum(1 for _ in text)


def public_names(tree: ast.Module) -> list[str]:
    """Functions, classes and constants of a module whose names do not begin with an underscore."""
    names = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names += [name.id for t in targets for name in ast.walk(t) if isinstance(name, ast.Name)]
    return [name for name in names if not name.startswith("_")]


def is_private(path: Path) -> bool:
    """Whether a module is of no concern to who imports the package: a part of its path begins with one underscore."""
    return any(part.startswith("_") and not part.startswith("__") for part in path.relative_to(ROOT).parts)


def main() -> None:
    """Print a line for each package, and the modules that are too long."""
    total, long = 0, []
    for package in ("src/repro", "src/repro_live", "src/repro_companion", "bench", "soak"):
        files = sorted((ROOT / package).rglob("*.py"))
        trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files]
        count = sum(map(statements, trees))
        public = [tree for path, tree in zip(files, trees, strict=True) if not is_private(path)]
        names = sum(len(public_names(tree)) for tree in public)
        lines = [len(path.read_text(encoding="utf-8").splitlines()) for path in files]
        total += count * package.startswith("src")
        long += [
            f"{path.relative_to(ROOT)}: {n} lines"
            for path, n in zip(files, lines, strict=True)
            if n > LONGEST
        ]
        print(
            f"{package:22} {len(files):4} modules {sum(lines):7} lines {count:7} statements {names:6} public names"
        )
    print(f"{'src':22} {total:36} statements")
    print("\n".join(long) or f"No module is longer than {LONGEST} lines.")


if __name__ == "__main__":
    main()
