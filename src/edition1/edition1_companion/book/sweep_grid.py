"""The grid of a sweep: values for parameters of a notebook, and the points that they span.

On a command line a value is ``2,3,4,6`` or, for whole numbers, ``0:10`` (half-open); lists and dictionaries as
values come from a grid file. Everything is of the type that the notebook declares, or refused.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from edition1.errors import InputError, bad_input, require
from edition1_companion.book.parameters import KINDS, Parameter, check_size, convert, listing

OWNER = "repro sweep"
MOST_POINTS = 100_000
"""Points that a sweep may have; more are taken for a slip."""

_RANGE = re.compile(r"([-+]?\d{1,18}):([-+]?\d{1,18})")


def read_grid(
    given: Iterable[tuple[str, str]],
    file: Path | None,
    declared: Mapping[str, Parameter],
    notebook: str,
) -> dict[str, list[Any]]:
    """Return the values of every parameter that is swept, of the declared types, in the order they were given.

    Parameters
    ----------
    given
        Names and values as typed: ``("sensors", "2,3,4,6")``, ``("seed", "0:10")``.
    file
        A grid file, YAML or (by its ending) JSON: a dictionary from names to lists of values. None without one.
    declared
        From :func:`~edition1_companion.book.parameters.declared_parameters`.
    notebook
        Name of the notebook, for messages.

    Raises
    ------
    InputError
        If nothing is swept, a parameter is not declared or given twice, a value is not of its type or occurs twice,
        or the grid has more than 100000 points.
    """
    grid: dict[str, list[Any]] = {}
    typed = ((name, text, OWNER) for name, text in given)
    filed = ((name, values, file.name) for name, values in _read_file(file).items()) if file else ()
    for name, values, owner in itertools.chain(typed, filed):
        if name not in declared:
            error = bad_input(f"parameter {name}", owner, "one of the parameters listed below", values)
            raise InputError(f"{error}\n{listing(declared, notebook)}")
        require(name not in grid, f"parameter {name}", owner, "given once", f"{values} as well")
        is_text = isinstance(values, str)
        found = (
            from_text(declared[name], values, owner) if is_text else _checked(declared[name], values, owner)
        )
        if repeated := _first_repeated(found):
            raise bad_input(f"parameter {name}", owner, "values that differ", f"{repeated} twice")
        grid[name] = found
    require(grid, "grid", OWNER, "at least one parameter, by -p NAME VALUES or --grid", "none")
    _check_count(math.prod(map(len, grid.values())), "grid")
    return grid


def from_text(parameter: Parameter, text: str, owner: str) -> list[Any]:
    """Return the values that a text such as ``2,3,4,6`` or ``0:10`` stands for.

    Parameters
    ----------
    parameter
        What is to be set.
    text
        Values separated by commas; for an int each may be a half-open range ``first:end``.
    owner
        For messages.

    Raises
    ------
    InputError
        If a value is not of the parameter's type, a range is empty, or the type is list or dict.

    Examples
    --------
    >>> from_text(Parameter("seed", "int", "0", ""), "0:3,7", "x")
    [0, 1, 2, 7]
    >>> from_text(Parameter("noise_mt", "float", "0", ""), "1e-3,2", "x")
    [0.001, 2.0]
    """
    name = f"parameter {parameter.name}"
    if parameter.type in ("list", "dict"):
        raise bad_input(name, owner, f"given by a grid file, because it is a {parameter.type}", text)
    values: list[Any] = []
    for item in text.split(","):
        if parameter.type == "int" and (found := _RANGE.fullmatch(item.strip())):
            first, end = map(int, found.groups())
            require(first < end, name, owner, "a range first:end with first below end", item)
            _check_count(end - first, name)
            values += range(first, end)
        else:
            # a text keeps its blanks
            values.append(convert(parameter, item if parameter.type == "str" else item.strip(), owner))
    return values


def _check_count(count: int, name: str) -> None:
    require(count <= MOST_POINTS, name, OWNER, f"at most {MOST_POINTS} points", count)


def _read_file(file: Path) -> dict[str, Any]:
    form = "a file with a dictionary from parameters to lists of values, each parameter once"
    try:
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".json":
            return json.loads(text, object_pairs_hook=_without_repeats)
        node = yaml.compose(text, yaml.SafeLoader)
        _check_keys(node)
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise bad_input("grid", OWNER, form, file) from error
    check_size(node, f"grid {file}", OWNER)
    try:
        # the reader of -p knows 1e-3 as a number and "on" as a text; plain YAML loaders do not
        return convert(Parameter(str(file), "dict", "", ""), text, OWNER)
    except (ValueError, RecursionError) as error:
        raise bad_input("grid", OWNER, form, file) from error


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    if len(set(names)) < len(names):
        raise ValueError
    return dict(pairs)


def _check_keys(node: Any) -> None:
    keys = [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    if not keys or not all(isinstance(key, str) for key in keys) or len(set(keys)) < len(keys):
        raise ValueError


def _checked(parameter: Parameter, values: Any, owner: str) -> list[Any]:
    """Return values of a grid file, of the parameter's type."""
    name = f"parameter {parameter.name}"
    require(isinstance(values, list) and values, name, owner, "a list of values", values)
    found = []
    for value in values:
        if parameter.type == "float" and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value).__name__ != parameter.type or not _can_be_typed(parameter, value):
            must_be = f"values of the type {parameter.type}: {KINDS[parameter.type]}"
            raise bad_input(name, owner, must_be, repr(value))
        found.append(value)
    return found


def _can_be_typed(parameter: Parameter, value: Any) -> bool:
    """Return whether ``repro run -p NAME TEXT`` gives the notebook this very value."""
    try:
        taken = convert(parameter, value_text(value), OWNER)
        return json.dumps(taken, sort_keys=True) == json.dumps(value, sort_keys=True)
    except (ValueError, RecursionError):
        return False


def _first_repeated(values: Sequence[Any]) -> str:
    seen = set()
    for value in values:
        text = json.dumps(value, sort_keys=True)
        if text in seen:
            return value_text(value)
        seen.add(text)
    return ""


def value_text(value: Any) -> str:
    """Return a value as ``repro run -p`` takes it.

    Examples
    --------
    >>> [value_text(x) for x in (3, 7.1e-4, True, "a b", [1, "x"])]
    ['3', '0.00071', 'true', 'a b', '[1, "x"]']
    """
    if isinstance(value, str):
        return value
    return repr(value) if isinstance(value, float) else json.dumps(value)


def grid_points(grid: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Return all points of a grid; the last parameter varies fastest.

    Examples
    --------
    >>> grid_points({"a": [1, 2], "b": [True]})
    [{'a': 1, 'b': True}, {'a': 2, 'b': True}]
    """
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


def read_part(text: str) -> tuple[int, int]:
    """Return ``(i, n)`` of ``i/n``: the part with the number ``i``, from 1, of ``n`` parts; ``1/1`` of none.

    Raises
    ------
    InputError
        If the text is not such a pair.
    """
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text or "1/1")
    number, parts = map(int, found.groups()) if found else (0, 0)
    require(1 <= number <= parts, "part", OWNER, "i/n, a number from 1 to n and n, such as 2/8", text)
    return number, parts
