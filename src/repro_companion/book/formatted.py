"""How every table of the book is shown: headings in words, three digits, no row numbers, a dash for none."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
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
        As it was written; its index is not shown.
    headings
        Words for a column, by its name; any other column gets :func:`heading`.
    exact
        Columns of settings and names, whose numbers keep all digits.
    folded
        For a long table: the words on which to click to see it.
    caption
        What stands above it.
    """
    from IPython.display import HTML

    words = {name: (headings or {}).get(name, heading(str(name))) for name in table.columns}
    numeric = {name: table[name].dtype.kind in "fiu" for name in table.columns}
    head = "".join(
        f'<th scope="col"{_right(numeric[name])}>{escape(words[name])}</th>' for name in table.columns
    )
    rows = "".join(
        "<tr>"
        + "".join(
            f"<td{_right(numeric[name])}>{escape(shown_value(value, exact=name in exact))}</td>"
            for name, value in zip(table.columns, row, strict=True)
        )
        + "</tr>"
        for row in table.itertuples(index=False, name=None)
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    html = f'<div class="formatted"><table>{above}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    return HTML(f"<details><summary>{escape(folded)}</summary>{html}</details>" if folded else html)


def heading(name: str) -> str:
    """Return a column's name in words with its unit: ``tip_error_mm`` is *tip error [mm]*."""
    parts = name.split("_")
    if len(parts) > 1 and parts[-1].lower() in UNITS:
        return f"{' '.join(parts[:-1])} [{UNITS[parts[-1].lower()]}]"
    return " ".join(parts)


def shown_value(value: Any, *, exact: bool = False) -> str:
    """Return a cell: a number with three significant digits, a dash for none, words without underscores."""
    if value is None or (isinstance(value, float) and math.isnan(value)) or str(value) in ("<NA>", "NaT", ""):
        return "–"
    if str(value) in ("True", "False"):
        return "yes" if str(value) == "True" else "no"
    if isinstance(value, str):
        return re.sub(r"(?<=\w)_(?=\w)", " ", value)
    return f"{value:g}" if exact else shown_number(float(value))


def shown_number(value: float, digits: int = DIGITS) -> str:
    """Return a number with some significant digits, never with ``e``: 0.0123, 44000, 6.94 × 10⁻⁹."""
    if math.isnan(value):
        return "–"
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


def _right(number: bool) -> str:
    return ' class="number"' if number else ""
