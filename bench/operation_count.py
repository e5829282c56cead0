"""Operations of a compiled kernel, counted: its own source runs in Python, on numbers that count what they do.

Nothing is counted by hand, so a count cannot miss a loop, and changes with the kernel. Additions and subtractions,
multiplications, divisions, square roots and elementary functions of floating-point numbers are counted; comparisons,
signs and whole numbers are not.
"""

from __future__ import annotations

import math
import types
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np

FUNCTIONS = ("sqrt", "sin", "cos", "exp", "log", "atan2")
"""Functions that are counted by their names; besides ``add``, ``mul`` and ``div``."""


@contextmanager
def counting(module: types.ModuleType, name: str) -> Iterator[Counter[str]]:
    """Count what a kernel of a module does while the context lasts; it gives the same results, slowly.

    Parameters
    ----------
    module
        Module that calls the kernel.
    name
        Name by which it does.
    """
    kernel, tally = getattr(module, name), Counter()
    before, Number.tally = Number.tally, tally
    slow = _in_python(kernel, {})

    def counted(*arguments: Any) -> Any:
        counting_ones = [_number(argument) for argument in arguments]
        result = slow(*counting_ones)
        for given, used in zip(arguments, counting_ones, strict=True):
            _copy_back(given, used)
        return _plain(result)

    setattr(module, name, counted)
    try:
        yield tally
    finally:
        setattr(module, name, kernel)
        Number.tally = before


class Number:
    """A floating-point number that counts its operations in ``Number.tally``."""

    __slots__ = ("value",)
    __array_ufunc__ = None  # NumPy's scalars leave the operation to this class
    tally: ClassVar[Counter[str]] = Counter()

    def __init__(self, value: Any) -> None:
        self.value = float(value)

    def __float__(self) -> float:
        return self.value

    def __int__(self) -> int:
        return int(self.value)

    def __neg__(self) -> Number:
        return Number(-self.value)

    def __abs__(self) -> Number:
        return Number(abs(self.value))

    def __pow__(self, exponent: int) -> Number:
        Number.tally["mul"] += exponent - 1
        return Number(self.value**exponent)

    def __hash__(self) -> int:
        return hash(self.value)


def _operation(name: str, compute: Callable[[float, float], float]) -> Callable[[Number, Any], Number]:
    def operate(self: Number, other: Any) -> Number:
        Number.tally[name] += 1
        return Number(compute(self.value, float(other)))

    return operate


def _comparison(compute: Callable[[float, float], bool]) -> Callable[[Number, Any], bool]:
    return lambda self, other: compute(self.value, float(other))


for _name, _compute in {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "truediv": lambda a, b: float(np.divide(a, b)),
}.items():
    _kind = {"sub": "add", "truediv": "div"}.get(_name, _name)
    setattr(Number, f"__{_name}__", _operation(_kind, _compute))
    setattr(Number, f"__r{_name}__", _operation(_kind, lambda a, b, f=_compute: f(b, a)))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Number, f"__{_name}__", _comparison(getattr(float, f"__{_name}__")))


class _Array(np.ndarray):
    """An array of numbers that count; what is written into it becomes one."""

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(key, Number(value) if isinstance(value, float | int) else value)


class _Numpy:
    """NumPy whose new arrays hold numbers that count."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def zeros(self, shape: Any, dtype: Any = float) -> np.ndarray:
        counts = np.dtype(dtype).kind in "fO"
        return _number(np.zeros(shape)) if counts else np.zeros(shape, dtype)

    empty = zeros

    def ones(self, shape: Any, dtype: Any = float) -> np.ndarray:
        return np.ones(shape, dtype) if dtype is not float else _number(np.ones(shape))


class _Math:
    """The functions of ``math``, counted."""

    def __getattr__(self, name: str) -> Any:
        function = getattr(math, name)
        if name not in FUNCTIONS:
            return function

        def counted(*x: Any) -> Number:
            Number.tally[name] += 1
            return Number(function(*map(float, x)))

        return counted


def _in_python(kernel: Any, known: dict[int, Any]) -> Any:
    """Return a compiled function as one of Python, with all that it calls."""
    if id(kernel) in known:
        return known[id(kernel)]
    source = kernel.py_func
    names = dict(source.__globals__)
    found = types.FunctionType(
        source.__code__, names, source.__name__, source.__defaults__, source.__closure__
    )
    known[id(kernel)] = found
    for name in source.__code__.co_names:
        value = names.get(name)
        if hasattr(value, "py_func"):
            names[name] = _in_python(value, known)
        elif value is np or value is math:
            names[name] = _Numpy() if value is np else _Math()
    return found


def _number(x: Any) -> Any:
    """Numbers that count, in the place of floating-point numbers."""
    if isinstance(x, np.ndarray) and np.issubdtype(x.dtype, np.floating):
        made = np.empty(x.shape, dtype=object).view(_Array)
        made.ravel()[:] = [Number(value) for value in x.ravel().tolist()]
        return made
    if isinstance(x, tuple):
        parts = [_number(part) for part in x]
        return type(x)(*parts) if hasattr(x, "_fields") else tuple(parts)
    return Number(x) if type(x) is float else x


def _plain(x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.dtype == object:
        return x.astype(float).view(np.ndarray)
    if isinstance(x, tuple):
        return tuple(_plain(part) for part in x)
    return x.value if isinstance(x, Number) else x


def _copy_back(given: Any, used: Any) -> None:
    """Write what a kernel left in its arguments into the arrays that it was given."""
    if isinstance(given, np.ndarray) and used is not given:
        given[...] = used.astype(float)
    elif isinstance(given, tuple):
        for one, other in zip(given, used, strict=True):
            _copy_back(one, other)
