"""How many floating-point operations an evaluation and a fit take: counted in a process of its own, by `bench.py`.

Without numba the kernels are Python. We wrap every ``+ - * /`` of their source in a function that counts one for each
floating-point number in the result. Functions such as the square root do not count. This is arranged before any
module of the library is loaded.
"""

from __future__ import annotations

import ast
import builtins
import sys
from functools import partial
from importlib.machinery import SourceFileLoader
from typing import Any

import numpy as np


def count(n_b: int) -> None:
    """Print how many operations one evaluation with slopes takes, and one fit of three iterations."""
    early = [name for name in sys.modules if name == "repro" or name.startswith("repro.")]
    assert not early, "a module that is loaded before is not counted"
    total: list[int] = []

    def counted(result: Any) -> Any:
        total.append(np.size(result) if np.asarray(result).dtype == np.float64 else 0)
        return result

    def get_code(loader: SourceFileLoader, name: str) -> Any:
        tree = ast.parse(loader.get_data(loader.path))
        tree = _Counting().visit(tree) if name.startswith("repro.") else tree
        return compile(ast.fix_missing_locations(tree), loader.path, "exec", dont_inherit=True)

    builtins.counted, SourceFileLoader.get_code = counted, get_code
    import repro
    from bench.bench import NOISE_MT, batch, paper_robot

    robot, low, high = paper_robot(n_b)
    sensing, q = repro.Sensing(robot), 0.4 * high
    fit = repro.LevenbergMarquardt(sensing, low, high, NOISE_MT, iterations=3, tolerance=1e-12)
    for work in (partial(sensing.linearise, q), batch(fit, q, sensing(1.1 * q))):
        total.clear()
        work()
        print(sum(total))


class _Counting(ast.NodeTransformer):
    """Wraps every arithmetic operation in a call that counts it."""

    def visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.AugAssign):
            place: Any = ast.parse(ast.unparse(node.target), mode="eval").body
            node = ast.Assign([node.target], ast.BinOp(place, node.op, node.value))
        self.generic_visit(node)
        counts = isinstance(getattr(node, "op", None), ast.Add | ast.Sub | ast.Mult | ast.Div)
        return ast.Call(ast.Name("counted", ast.Load()), [node], []) if counts else node
