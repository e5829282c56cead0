"""How large the code is, and which functions ask a reader to hold much in mind: ``make size``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("src/repro", "src/repro_board", "src/repro_companion", "tests", "bench")
STATEMENTS, ARGUMENTS, NAMES = 40, 8, 30
"""What a function should not exceed. Names are those that are assigned or passed, in nested functions too."""
KERNEL_ARGUMENTS = 15
"""Arguments of a compiled function, whose names nobody counts."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


def is_docstring(node: ast.AST) -> bool:
    """Whether a node is a text that stands alone."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def count(tree: ast.AST) -> int:
    """Return the number of statements in a tree, without docstrings."""
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in ast.walk(tree))


def parsed(path: Path) -> ast.Module:
    """Return the tree of a module."""
    return ast.parse(path.read_text(encoding="utf-8"))


def arguments_of(function: Function) -> list[str]:
    """Return the names of the arguments, without those of the object or class itself."""
    a = function.args
    names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg) if x is not None]
    return [name for name in names if name not in ("self", "cls")]


def local_names(function: Function) -> set[str]:
    """Return the names that a function assigns or takes, with those of nested functions."""
    found = set[str]()
    for node in ast.walk(function):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, Function):
            found |= {*arguments_of(node)} | ({node.name} if node is not function else set())
        elif isinstance(node, ast.ExceptHandler) and node.name:
            found.add(node.name)
    return found


def outermost(tree: ast.AST, public: bool = True) -> Iterator[tuple[Function, bool]]:
    """Yield functions and methods, without those within functions, and whether they are public."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Function):
            yield node, public and (node.name == "__init__" or not node.name.startswith("_"))
        elif isinstance(node, ast.ClassDef):
            yield from outermost(node, public and not node.name.startswith("_"))


def has_much(function: Function, public: bool) -> str:
    """Return in words what of a function is too much; a public one's options do not count as arguments."""
    kernel = any("kernel" in ast.unparse(x) or "njit" in ast.unparse(x) for x in function.decorator_list)
    options = len(function.args.defaults) + sum(x is not None for x in function.args.kw_defaults)
    found = {
        "statements": (count(function) - 1, STATEMENTS),
        "arguments": (
            len(arguments_of(function)) - options * public,
            KERNEL_ARGUMENTS if kernel else ARGUMENTS,
        ),
        "names": (0 if kernel else len(local_names(function)), NAMES),
    }
    return ", ".join(f"{n} {name}" for name, (n, most) in found.items() if n > most)


def javascript_lines() -> int:
    """Return the number of lines of our own JavaScript, without bundles of others."""
    bundles = {"shape_viewer.js"}
    paths = [path for folder in ("src", "book") for path in (ROOT / folder).rglob("*.*js")]
    own = [path for path in paths if not {"vendor", "_build"} & set(path.parts) and path.name not in bundles]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in own)


def main() -> None:
    """Print a line for each package, and one for each function that has much of something."""
    total, much = 0, []
    for package in PACKAGES:
        files = sorted((ROOT / package).rglob("*.py"))
        trees = {path: parsed(path) for path in files}
        statements = sum(map(count, trees.values()))
        total += statements * package.startswith("src")
        print(f"{package:32} {len(files):4} modules {statements:7} statements")
        for path, tree in trees.items() if package.startswith("src") else ():
            words = [(node, has_much(node, public)) for node, public in outermost(tree)]
            much += [
                f"{path.relative_to(ROOT / 'src')}:{node.lineno} {node.name}: {x}" for node, x in words if x
            ]
    print(f"{'src':32} {total:20} statements")
    print(f"{'JavaScript':32} {javascript_lines():20} lines")
    print(f"Functions above {STATEMENTS} statements, {ARGUMENTS} arguments or {NAMES} names: {len(much)}")
    print(*much, sep="\n")


if __name__ == "__main__":
    main()
