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
_IDENTIFIER = re.compile(r"(?![A-Za-z]_\w{1,2}$)[A-Za-z]\w*_\w+")
"""A name with underscores, other than a letter with its index."""
_WITH_INDEX = re.compile(r"\b([A-Za-z])_([A-Za-z0-9]{1,2})\b")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SMALLEST, _LARGEST = 1e-4, 1e7
"""Between these a number is written without a power of ten."""


def table_html(
    table: DataFrame,
    headings: Mapping[str, str] | None = None,
    *,
    exact: Sequence[str] = (),
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
    folded
        For a long table: the words on which to click to see it. A table of more than 15 rows is always folded.
    caption
        What stands above it.
    """
    from IPython.display import HTML
    from pandas.api.types import is_numeric_dtype

    if any(table.index.names) or not is_numeric_dtype(table.index.dtype):
        table = table.reset_index(names=None if any(table.index.names) else "")
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
    if not _IDENTIFIER.fullmatch(text := str(name)):
        return text
    *words, last = text.split("_")
    unit = UNITS.get(last.lower(), "") if words else ""
    return f"{' '.join(words)} [{unit}]" if unit else " ".join([*words, last])


def shown_value(value: Any, *, exact: bool = False) -> str:
    """Return a cell: a number with three significant digits, a dash for none, words without underscores."""
    from pandas import isna

    if isna(value) or value == "":
        return MISSING
    if str(value) in ("True", "False"):
        return "yes" if str(value) == "True" else "no"
    if not _is_number(value):
        return heading(str(value))
    return f"{value:g}" if exact else shown_number(float(value))


def _is_number(value: Any) -> bool:
    return isinstance(value, Number) and str(value) not in ("True", "False")


def _html(text: str) -> str:
    """Escape, and set letters with an index as the papers do: n_b."""
    return _WITH_INDEX.sub(r"<i>\1</i><sub>\2</sub>", escape(text))


def shown_number(value: float, digits: int = DIGITS) -> str:
    """Return a number with some significant digits, never with ``e``: 0.0123, 44000, 6.94 × 10⁻⁹."""
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
        return f"{sign}{mantissa} × 10{str(power).translate(_SUPERSCRIPTS)}"
    # whole numbers end where they end; others keep the digits that are known
    if float(value).is_integer():
        return f"{sign}{rounded:.0f}"
    return f"{sign}{rounded:.{max(0, digits - 1 - power)}f}"


def _right(number: bool, *, exact: bool = False) -> str:
    return (' class="number exact"' if exact else ' class="number"') if number else ""
