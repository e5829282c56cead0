"""How every table of the book is shown: headings in words, three digits, no row numbers, a dash for none."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from numbers import Number
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from IPython.display import HTML
    from pandas import DataFrame

DIGITS = 3
UNITS = {
    "mm": "mm", "m": "m", "um": "µm", "nm": "nm", "deg": "°", "rad": "rad", "mt": "mT", "ut": "µT", "s": "s",
    "ms": "ms", "us": "µs", "hz": "Hz", "percent": "%", "kpa": "kPa", "pa": "Pa",
    "n": "N", "g": "g", "mib": "MiB", "kb": "kB",
}  # fmt: skip
"""Unit by the ending of a column's name."""
MISSING = "–"
LONGEST = 15
"""Rows of a table that is not folded."""
_IDENTIFIER = re.compile(r"(?![^\W\d]_\w{1,2}$)[^\W\d]\w*_\w+")
"""A name with underscores, other than a letter with its index."""
_WITH_INDEX = re.compile(r"\b([^\W\d_])_([A-Za-z0-9]{1,2})\b")
_LETTERS = {
    "delta_x": "Δx",
    "delta_y": "Δy",
    "delta_L": "δL",
    "kappa": "κ",
    "phi": "φ",
    "psi": "ψ",
    "sigma": "σ",
}
_LETTER = re.compile(rf"(?<![A-Za-z])({'|'.join(_LETTERS)})(?:_(\d))?(?![A-Za-z\d])")
_AS_COMPUTED = re.compile(
    r"(?P<kept>`[^`]*`|\$[^$]*\$)|(?<![\w).-])(?P<number>-?\d+(?:\.\d+)?e[-+]?\d+|-\d+(?:\.\d+)?)(?![\w])"
)
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SMALLEST, _LARGEST = 1e-4, 1e7
"""Between these a number is written without a power of ten."""
_GROUPED = 1e4
"""From here on the thousands are set off, as in the text."""


def table_html(
    table: DataFrame,
    headings: Mapping[str, str] | None = None,
    *,
    exact: Sequence[str] = (),
    first: Sequence[str] = (),
    folded: str = "",
    caption: str = "",
) -> HTML:
    """Return a table as a page shows it.

    Parameters
    ----------
    table
        As it was written, or pivoted: an index that is more than row numbers becomes the first columns.
    headings
        Words for a column, by its name; any other column gets :func:`heading`.
    exact
        Columns of settings and names, whose numbers keep all digits.
    first
        Of a wide table, the columns that answer the question: they are shown, all columns are folded below.
    folded
        For a long table: the words on which to click to see it. A table of more than 15 rows is always folded.
    caption
        What stands above it.
    """
    from IPython.display import HTML
    from pandas.api.types import is_numeric_dtype

    if any(table.index.names) or not is_numeric_dtype(table.index.dtype):
        table = table.reset_index(names=None if any(table.index.names) else "")
    if first:
        whole = folded or f"All {len(table.columns)} columns"
        shown = table_html(table[list(first)], headings, exact=exact, caption=caption)
        return HTML(shown.data + table_html(table, headings, exact=exact, folded=whole).data)
    words = {name: (headings or {}).get(str(name), heading(name)) for name in table.columns}
    columns = [
        [(shown_value(value, exact=name in exact), _is_number(value)) for value in table[name]]
        for name in table.columns
    ]
    numeric = [all(number or text == MISSING for text, number in column) for column in columns]
    head = "".join(
        f'<th scope="col"{_right(number)}>{_html(words[name])}</th>' if words[name] else "<td></td>"
        for name, number in zip(table.columns, numeric, strict=True)
    )
    rows = "".join(
        "<tr>"
        + "".join(
            f"<td{_right(number, exact=name in exact)}>{_html(text)}</td>"
            for name, (text, number) in zip(table.columns, row, strict=True)
        )
        + "</tr>"
        for row in zip(*columns, strict=True)
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    html = f"<table>{above}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    # what scrolls must be reachable by keyboard, and then needs a name
    name = escape(caption or f"Table: {', '.join(filter(None, words.values()))}", quote=True)
    html = f'<div class="formatted" tabindex="0" role="group" aria-label="{name}">{html}</div>'
    folded = folded or (f"All {len(table)} rows" if len(table) > LONGEST else "")
    return HTML(f"<details><summary>{escape(folded)}</summary>{html}</details>" if folded else html)


def heading(name: object) -> str:
    """Return a column's name in words with its unit: ``tip_error_mm`` is *tip error [mm]*."""
    if isinstance(name, tuple):  # of a pivoted table
        return ", ".join(filter(None, map(heading, name)))
    if isinstance(name, float):
        return shown_number(name)
    if not _IDENTIFIER.fullmatch(text := _with_letters(str(name))):
        return text
    *words, last = text.split("_")
    unit = UNITS.get(last.lower(), "") if words else ""
    return f"{' '.join(words)} [{unit}]" if unit else " ".join([*words, last])


def _with_letters(text: str) -> str:
    """Return a text with the papers' letters and numbers as people write them: ``delta_x_1_mm`` with Δx₁."""
    text = text.replace("->", " → ")
    text = _LETTER.sub(lambda found: _LETTERS[found[1]] + (found[2] or "").translate(_SUBSCRIPTS), text)
    return as_read(text)


def as_read(text: str) -> str:
    """Return a text with its numbers as people write them: powers of ten for ``e``, a minus for a hyphen.

    Code and formulas stay.

    Examples
    --------
    >>> as_read("2e-16 m, -3 to 5 mT, `-p n -3`")
    '2 × 10⁻¹⁶ m, −3 to 5 mT, `-p n -3`'
    """
    return _AS_COMPUTED.sub(lambda found: found["kept"] or _number_as_read(found["number"]), text)


def _number_as_read(number: str) -> str:
    mantissa, _, power = number.partition("e")
    if not float(mantissa):
        return mantissa.strip("-")
    return (
        shown_number(float(number), len(mantissa.strip("-").replace(".", ""))) if power else f"−{number[1:]}"
    )


def shown_value(value: Any, *, exact: bool = False) -> str:
    """Return a cell: a number with three significant digits, a dash for none, words without underscores."""
    from pandas import isna

    if isna(value) or value == "":
        return MISSING
    if str(value) in ("True", "False"):
        return "yes" if str(value) == "True" else "no"
    if not _is_number(value):
        return heading(str(value))
    return all_digits(float(value)) if exact else shown_number(float(value))


def all_digits(value: float) -> str:
    """Return a number that is a setting: with all its digits, never with ``e``."""
    mantissa, _, power = f"{value:g}".partition("e")
    return mantissa.replace("-", "−") + (f" × {_power_of_ten(int(power))}" if power else "")


def _power_of_ten(power: int) -> str:
    return f"10{str(power).translate(_SUPERSCRIPTS)}"


def _is_number(value: Any) -> bool:
    return isinstance(value, Number) and str(value) not in ("True", "False")


def _html(text: str) -> str:
    """Escape, and set letters with an index as the papers do: n_b."""
    return _WITH_INDEX.sub(r"<i>\1</i><sub>\2</sub>", escape(text))


def shown_number(value: float, digits: int = DIGITS) -> str:
    """Return a number with some significant digits, never with ``e``: 0.0123, 44,000, 6.94 × 10⁻⁹."""
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, _, exponent = f"{abs(value):.{digits - 1}e}".partition("e")
    sign, power = "−" if value < 0 else "", int(exponent)
    rounded = float(f"{mantissa}e{exponent}")
    if not _SMALLEST <= rounded < _LARGEST:
        return f"{sign}{mantissa} × {_power_of_ten(power)}"
    # whole numbers end where they end; others keep the digits that are known
    decimals = 0 if float(value).is_integer() else max(0, digits - 1 - power)
    return f"{sign}{rounded:{',' if rounded >= _GROUPED else ''}.{decimals}f}"


def _right(number: bool, *, exact: bool = False) -> str:
    return (' class="number exact"' if exact else ' class="number"') if number else ""
