"""Parameters of a notebook: what it declares, and values from a command line converted to the declared type.

A notebook declares them in its cell tagged ``parameters``, one a line:
``name: type = value  # meaning [unit]``. A comment may end in the values that are allowed, see
:mod:`edition1_companion.book.allowed`; many choices, or those that papermill does not read in its line, stand in
lines of their own at the end of the cell: ``# name, one of: n_b=1, n_b=2,`` and ``#   n_b=3``.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import yaml

from edition1.errors import InputError, bad_input, require
from edition1_companion.book.allowed import Rule, rule_of

if TYPE_CHECKING:
    from nbformat import NotebookNode

KINDS = {
    "int": "a whole number, such as 3",
    "float": "a number, such as 1e-3",
    "str": "a text",
    "bool": "true or false",
    "list": "a list in YAML, such as [1, 2]",
    "dict": "a dictionary in YAML with texts as keys, such as {a: 1}",
}
"""Types that a parameter can have, and what a value of each must be."""
MOST_VALUES = 1_000_000
"""Values that a list or dictionary may hold, those within its values included."""


@dataclass(frozen=True)
class Parameter:
    """A parameter as its notebook declares it."""

    name: str
    type: str
    """One of :data:`KINDS`."""
    default: str
    """The default as it stands in the notebook."""
    meaning: str
    """The comment behind it."""

    @cached_property
    def rule(self) -> Rule | None:
        """What its values must keep to."""
        return rule_of(self.type, self.default, self.meaning)


def declared_parameters(notebook: NotebookNode, owner: str) -> dict[str, Parameter]:
    """Return the parameters that a notebook declares, as papermill reads them.

    Parameters
    ----------
    notebook
        The notebook.
    owner
        Its name, for messages.

    Raises
    ------
    InputError
        If there is no cell tagged ``parameters``, or a parameter in it has no type that can be converted
        to or is written in a way that papermill does not read.
    """
    from papermill.translators import PythonTranslator

    cells = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    require(cells, "notebook", "repro run", "a notebook with a cell tagged parameters", owner)
    form = "written as name: type = value  # meaning, with one of the types " + ", ".join(KINDS)
    found = {}
    for item in PythonTranslator.inspect(cells[0]):
        # list[float] is declared and checked as a list
        kind = item.inferred_type_name.partition("[")[0].strip()
        if kind not in KINDS:
            raise bad_input(
                f"parameter {item.name}", owner, form, f"{item.inferred_type_name} = {item.default}"
            )
        alone = re.search(rf"^# {item.name}(, one of: .+(?:\n#   .+)*)", cells[0].source, re.MULTILINE)
        meaning = item.help + (alone[1].replace("\n#  ", "") if alone else "")
        found[item.name] = Parameter(item.name, kind, item.default, meaning)
    # papermill skips a line it cannot read (one with a second "=", for instance) with no more than a warning
    for name in _assigned_names(cells[0].source, owner):
        require(name in found, f"parameter {name}", owner, form, "a line that papermill does not read")
    return found


def _assigned_names(source: str, owner: str) -> list[str]:
    try:
        body = ast.parse(source).body
    except SyntaxError as error:
        raise bad_input("parameters cell", owner, "valid Python", error) from error
    names = [node.target for node in body if isinstance(node, ast.AnnAssign)]
    names += [target for node in body if isinstance(node, ast.Assign) for target in node.targets]
    return [target.id for target in names if isinstance(target, ast.Name)]


def convert_all(
    given: Iterable[tuple[str, str]], declared: Mapping[str, Parameter], owner: str
) -> dict[str, Any]:
    """Return values for parameters, converted to their declared types.

    Parameters
    ----------
    given
        Names and values as typed.
    declared
        From :func:`declared_parameters`.
    owner
        Name of the notebook, for messages.

    Raises
    ------
    InputError
        If a parameter is not declared, given twice, or its value not of its type. The message lists what
        may be given.
    """
    values: dict[str, Any] = {}
    try:
        for name, text in given:
            if name not in declared:
                raise bad_input(
                    f"parameter {name}", owner, "one of the parameters listed below", f"{name} = {text}"
                )
            require(name not in values, f"parameter {name}", owner, "given once", f"{name} = {text} as well")
            values[name] = convert(declared[name], text, owner)
    except InputError as error:
        raise InputError(f"{error}\n{listing(declared, owner)}") from error
    return values


def listing(declared: Mapping[str, Parameter], owner: str) -> str:
    """Return the parameters of a notebook with types, defaults and meanings, one a line."""
    if not declared:
        return f"{owner} has no parameters."
    heads = [f"{parameter.name}: {parameter.type} = {parameter.default}" for parameter in declared.values()]
    width = max(map(len, heads))
    lines = [
        f"  {head.ljust(width)}  {parameter.meaning}".rstrip()
        for head, parameter in zip(heads, declared.values(), strict=True)
    ]
    return "\n".join([f"Parameters of {owner}:", *lines])


def convert(parameter: Parameter, text: str, owner: str) -> Any:
    """Return a typed text as a value of the parameter's type, and one of those that its comment allows.

    Parameters
    ----------
    parameter
        What is to be set.
    text
        As typed: ``1e-3`` is a float, ``true`` a bool; a list or dict is YAML.
    owner
        Name of the notebook, for messages.

    Raises
    ------
    InputError
        If the text is not such a value, or not allowed. Nothing is rounded: 1.5 is no int.

    Examples
    --------
    >>> convert(Parameter("gains", "list", "[]", ""), "[1e-3, 2, on]", "x.ipynb")
    [0.001, 2, 'on']
    """
    value = _of_its_type(parameter, text, owner)
    if parameter.rule and not parameter.rule.allows(value):
        raise bad_input(f"parameter {parameter.name}", owner, parameter.rule.must_be, text)
    return value


def _of_its_type(parameter: Parameter, text: str, owner: str) -> Any:
    refusal = bad_input(
        f"parameter {parameter.name}", owner, f"{parameter.type}: {KINDS[parameter.type]}", text
    )
    match parameter.type:
        case "str":
            return text
        case "bool" if text.lower() in ("true", "false"):
            return text.lower() == "true"
        case "int" if re.fullmatch(r"[-+]?[0-9]{1,1000}", text):
            return int(text)
        case "float" if re.fullmatch(r"[-+]?([0-9.]+(e[-+]?[0-9]+)?|inf|nan)", text, re.IGNORECASE):
            try:
                return float(text)
            except ValueError:
                raise refusal from None
        case "list" | "dict":
            try:
                check_size(yaml.compose(text, _CoreLoader), f"parameter {parameter.name}", owner)
                value = yaml.load(text, _CoreLoader)
            except InputError:
                raise
            except (yaml.YAMLError, ValueError, RecursionError):
                raise refusal from None
            if isinstance(value, list if parameter.type == "list" else dict) and _is_plain(value, depth=20):
                return value
    raise refusal


def check_size(node: yaml.Node | None, name: str, owner: str) -> None:
    """Refuse YAML that a few aliases of aliases make too large to be written out, or endless.

    Raises
    ------
    InputError
        If there are more than :data:`MOST_VALUES` values, each counted as often as it is named.
    """
    sizes: dict[int, float] = {}

    def size(node: Any) -> int | float:
        if id(node) not in sizes:
            sizes[id(node)] = math.inf  # of a node within itself
            parts = node.value if isinstance(node, yaml.CollectionNode) else ()
            pairs = (part if isinstance(part, tuple) else (part,) for part in parts)
            sizes[id(node)] = 1 + sum(size(item) for pair in pairs for item in pair)
        return sizes[id(node)]

    if size(node) > MOST_VALUES:
        raise bad_input(
            name, owner, f"at most {MOST_VALUES} values, aliases counted as often as used", "more"
        )


def _is_plain(value: Any, depth: int) -> bool:
    """Return whether a value is made of what a cell can be given; a list within itself never ends."""
    if depth == 0:
        return False
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(item, depth - 1) for key, item in value.items())
    if isinstance(value, list):
        return all(_is_plain(item, depth - 1) for item in value)
    return value is None or isinstance(value, (bool, int, float, str))


class _CoreLoader(yaml.SafeLoader):
    """YAML with the core schema of version 1.2: PyYAML's own reads ``1e-3`` as a text and ``on`` as true."""

    yaml_implicit_resolvers: dict = {}  # noqa: RUF012  replaces an attribute of the parent


for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
):
    _CoreLoader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first)
# PyYAML's own takes 012 as octal and 1:30 as base 60
_CoreLoader.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(str(node.value)))
