"""The form on a page of the book that prints the command for a run with a reader's own parameters.

It is made from the parameters that the notebook declares. The script ``book/_static/run_form.js`` fills in the
commands as the reader types; without it the page shows the commands for the notebook as it is.
"""

from __future__ import annotations

import ast
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from edition1.errors import InputError, bad_input

from edition1_companion.book.parameters import KINDS, Parameter, convert

REPRO, PAPERMILL = ".venv/bin/repro", ".venv/bin/papermill"
"""Programs as they are called from the folder of the repository."""


def form_html(notebook: str, declared: Mapping[str, Parameter]) -> str:
    """Return the form and the commands of a notebook as HTML without blank lines, so that MyST keeps it whole.

    Parameters
    ----------
    notebook
        Its path relative to the project, with ``/``.
    declared
        From :func:`edition1_companion.book.parameters.declared_parameters`.

    Raises
    ------
    InputError
        If a default is more than a plain value: a form cannot show what has to be computed first.
    """
    stem = notebook.rpartition("/")[2].removesuffix(".ipynb")
    defaults = {name: default_value(parameter, notebook) for name, parameter in declared.items()}
    yaml = parameters_yaml(defaults)
    plain = f"{PAPERMILL} {notebook} my_run.ipynb"
    blocks = (
        ("repro", "Checked, with a record of what it was made from", command_line(notebook, {})),
        ("papermill", "The same with plain papermill", plain),
        ("yaml", f"All parameters as YAML, for papermill’s option <code>-f {escape(stem)}.yaml</code>", yaml),
    )
    lines = [
        f'<div class="run-form" data-notebook="{escape(notebook)}">',
        f'<form hidden novalidate autocomplete="off" aria-label="Parameters of {escape(notebook)}">',
        *[_field(parameter, defaults[name], notebook) for name, parameter in declared.items()],
        '<p class="run-form-foot"><button type="reset">Back to the notebook’s own values</button>',
        '<span role="status"></span></p>',
        "</form>",
        "<noscript><p>Without JavaScript: the commands for the notebook’s own values.</p></noscript>",
        '<p class="run-form-refused" hidden>Correct the marked value first; then the commands appear here.</p>',
        '<div class="run-form-commands">',
    ]
    for key, title, text in blocks:
        lines += [
            f'<p class="run-form-title">{title}</p>',
            # the classes that bring a button to copy; a box that scrolls must be reachable by keyboard
            '<div class="highlight-none notranslate"><div class="highlight">'
            f'<pre tabindex="0" data-command="{key}">{escape(text)}</pre></div></div>',
        ]
    link = f"data:text/yaml;charset=utf-8,{quote(yaml)}"
    lines.append(f'<p><a class="run-form-yaml" download="{escape(stem)}.yaml" href="{link}">')
    lines += [f"Download {escape(stem)}.yaml</a></p>", "</div>", "</div>"]
    return "\n".join(line for line in lines if line)


def default_value(parameter: Parameter, owner: str) -> Any:
    """Return the value of a parameter's default.

    Raises
    ------
    InputError
        If it is not written as a value of its type.
    """
    refusal = bad_input(
        f"parameter {parameter.name}", owner, f"given as {KINDS[parameter.type]}", parameter.default
    )
    if parameter.type == "float" and "(" in parameter.default:
        # float("inf"): the one number that Python writes as a call
        try:
            return float(parameter.default.removeprefix("float(").removesuffix(")").strip("\"'"))
        except ValueError:
            raise refusal from None
    try:
        value = ast.literal_eval(parameter.default)
    except (ValueError, SyntaxError):
        raise refusal from None
    if parameter.type == "float" and type(value) is int:
        return float(value)
    if type(value).__name__ != parameter.type:
        raise refusal
    return value


def command_line(notebook: str, parameters: Mapping[str, Any]) -> str:
    r"""Return the command that runs a notebook with parameters, for any POSIX shell.

    Examples
    --------
    >>> command_line("notebooks/table_1.ipynb", {"rows": ["n_b=1"], "fast": True})
    '.venv/bin/repro run notebooks/table_1.ipynb -p rows \'["n_b=1"]\' -p fast true'
    """
    typed = {name: x if isinstance(x, str) else _yaml(x) for name, x in parameters.items()}
    given = "".join(f" -p {name} {shlex.quote(text)}" for name, text in typed.items())
    return f"{REPRO} run {notebook}{given}"


def parameters_yaml(values: Mapping[str, Any]) -> str:
    """Return values as YAML that readers of version 1.1 and 1.2 understand alike.

    Examples
    --------
    >>> print(parameters_yaml({"noise_mt": 1e-05, "rows": ["n=6", 2], "fast": False}), end="")
    noise_mt: 1.0e-05
    rows: ["n=6", 2]
    fast: false
    """
    return "".join(f"{_key(name)}: {_yaml(value)}\n" for name, value in values.items())


def _key(name: str) -> str:
    return json.dumps(name) if name.lower() in ("yes", "no", "on", "off", "true", "false", "null") else name


def _yaml(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case None:
            return "null"
        case float() if not math.isfinite(value):
            return ".nan" if math.isnan(value) else f"{'-' if value < 0 else ''}.inf"
        case float():
            mantissa, e, exponent = repr(value).partition("e")
            # version 1.1 takes 1e-05 for a text
            return (mantissa if "." in mantissa else mantissa + ".0") + e + exponent
        case list():
            return f"[{', '.join(map(_yaml, value))}]"
        case dict():
            return f"{{{', '.join(f'{json.dumps(k, ensure_ascii=False)}: {_yaml(v)}' for k, v in value.items())}}}"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value)


def _field(parameter: Parameter, value: Any, owner: str) -> str:
    name, rule = escape(parameter.name), parameter.rule
    place = f"run-form-{name}"
    described = f"{place}-meaning {place}-error"
    common = f'id="{place}" data-name="{name}" data-type="{parameter.type}" aria-describedby="{described}"'
    common += rule.attributes() if rule else ""
    if rule and rule.choices and parameter.type == "list":
        field = _boxes(rule.choices, value, common, place)
        label = f'<span class="run-form-name" id="{place}-name">{name}</span>'
    else:
        field = _one_field(parameter, value, common, owner)
        label = f'<label for="{place}">{name}</label>'
    return (
        f'<div class="run-form-field">{label}{field}'
        f'<span class="run-form-meaning" id="{place}-meaning">{escape(_hint(parameter))}</span>'
        f'<span class="run-form-error" id="{place}-error" role="alert"></span></div>'
    )


def _one_field(parameter: Parameter, value: Any, common: str, owner: str) -> str:
    kind, rule, text = parameter.type, parameter.rule, escape(_as_typed(parameter, value, owner))
    if kind == "bool":
        return f'<input type="checkbox" {common}{" checked" if value else ""}>'
    if rule and rule.choices:
        options = [
            f"<option{' selected' if choice == value else ''}>{escape(str(choice))}</option>"
            for choice in rule.choices
        ]
        return f"<select {common}>{''.join(options)}</select>"
    if kind in ("list", "dict"):  # as long as it is, in as many lines as that takes
        return f'<textarea rows="1" spellcheck="false" {common}>{text}</textarea>'
    shape = {"int": ' step="1"', "float": ' step="any"'}.get(kind, ' spellcheck="false"')
    if rule:
        ends = {"min": rule.low, "max": rule.high}
        shape += "".join(f' {name}="{end:g}"' for name, end in ends.items() if math.isfinite(end))
    as_number = kind == "int" or (kind == "float" and math.isfinite(value))
    return f'<input type="{"number" if as_number else "text"}"{shape} {common} value="{text}">'


def _boxes(choices: Sequence[Any], chosen: Sequence[Any], common: str, place: str) -> str:
    """Return a box to tick for each value that a list may have."""
    boxes = [
        f'<label><input type="checkbox" value="{escape(_yaml(choice))}"{" checked" if choice in chosen else ""}>'
        f"{escape(str(choice))}</label>"
        for choice in choices
    ]
    return f'<div class="run-form-boxes" role="group" aria-labelledby="{place}-name" {common}>{"".join(boxes)}</div>'


def _hint(parameter: Parameter) -> str:
    if parameter.rule and parameter.rule.choices:  # which stand in the field
        return parameter.meaning.replace(f", {parameter.rule.said}", "")
    kind = {"int": "whole number", "float": "number", "str": "text", "bool": "yes or no"}.get(
        parameter.type, f"{parameter.type} in YAML"
    )
    return f"{parameter.meaning} ({kind})" if parameter.meaning else kind


def _as_typed(parameter: Parameter, value: Any, owner: str) -> str:
    """Return a default as a reader would type it: as in the notebook where that means the same."""
    if parameter.type == "str":
        return value
    try:
        if convert(parameter, parameter.default, owner) == value:
            return parameter.default
    except InputError:
        pass
    if parameter.type == "float":
        return str(value)
    return _yaml(value)
