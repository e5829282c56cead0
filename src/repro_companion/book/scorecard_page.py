"""The scorecard as parts of pages: the full tables, and the counts for the landing page."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from decimal import Decimal
from html import escape
from urllib.parse import urlencode

from repro_companion.book.scorecard import (
    KINDS,
    REPEATED,
    WEAK,
    ScorecardRow,
    count_kinds,
    geometric_mean_ratio,
    kinds,
    telling,
)
from repro_companion.book.templates import rendered

PAPERS = {
    "baaij2023": "Baaij et al. (2023)",
    "mitchell2021": "Mitchell et al. (2021)",
    "martin2022": "Martin et al. (2022)",
}
"""Papers as they are named in running text."""

READ_OFF = frozenset({("martin2022", "Fig. 3"), ("martin2022", "Fig. 5")})
"""Figures whose numbers are printed nowhere and were read off them; those of Fig. 4 stand in the text."""

_HEADER = ("Row", "Quantity", "Unit", "Published", "Regenerated", "Verdict", "Setting", "Best", "Note")


def scorecard_page(
    rows: Sequence[ScorecardRow],
    places: Mapping[tuple[str, str], str] | None = None,
    *,
    filtered: bool = False,
) -> str:
    """Return the full scorecard: one HTML table per table, figure or section of a paper.

    Parameters
    ----------
    rows
        The scorecard.
    places
        Where an artefact (paper and artefact) is shown, as a link; every row of it leads there.
    filtered
        Whether to leave a place for the filter that ``scorecard.js`` puts in front of the tables.

    Returns
    -------
    str
        HTML that a MyST page can include. Tables have the class ``scorecard`` and scroll inside a
        ``scorecard-scroll``; a verdict is a word in a ``span`` of the classes ``verdict`` and
        ``verdict-reproduced``, ``-better``, ``-differs``, ``-not-comparable`` or ``-missing``.
    """
    # Rows of one artefact need not stand together in the file; artefacts keep the order of their first row.
    tables: dict[tuple[str, str], list[ScorecardRow]] = {}
    for row in rows:
        tables.setdefault((row.paper, row.artefact), []).append(row)
    kind = dict(zip(rows, kinds(rows), strict=True))
    filters = {
        "counts": lambda rows: _listed(Counter(kind[row] for row in rows)),
        "kind": kind.__getitem__,
        "anchor": anchor,
        "ratios": _ratios,
        "line": lambda text: " ".join(text.split()),
        "cells": _numbers,
        "remarks": _remarks,
    }
    return rendered(
        "scorecard.html",
        filters,
        tables=tables,
        links=places or {},
        papers=PAPERS,
        header=_HEADER,
        filtered=filtered,
    )


def anchor(row: ScorecardRow) -> str:
    """Return the address of a row within the page of the scorecard."""
    return re.sub(r"[^a-z0-9]+", "-", f"row {row.key}".lower().replace("-", " minus ")).strip("-")


def _ratios(rows: list[ScorecardRow]) -> str:
    mean, count = geometric_mean_ratio(rows, lambda row: row.regenerated, lambda row: row.published)
    if not count:
        return ""
    text = f" Regenerated / published, geometric mean of {count}: {mean:.2f}"
    mean, count = geometric_mean_ratio(rows, lambda row: row.regenerated_std, lambda row: row.published_std)
    return text + (f"; of {count} standard deviations: {mean:.2f}." if count else ".")


def _numbers(row: ScorecardRow) -> tuple[str, ...]:
    """Return the cells before the verdict."""
    regenerated, std = (_rounded(text, row.published) for text in (row.regenerated, row.regenerated_std))
    published = _with_std(row.published, row.published_std)
    return row.quantity, row.unit, published, _with_std(regenerated, std)


def _remarks(row: ScorecardRow) -> tuple[str, ...]:
    """Return the cells after the verdict."""
    seeds = f", {row.n_seeds} seed{'' if row.n_seeds == '1' else 's'}" if row.n_seeds else ""
    best = f"{_rounded(row.best, row.published)} ({row.best_method})" if row.best else ""
    return row.setting + seeds, best, row.note


def _with_std(value: str, std: str) -> str:
    return f"{value} ± {std}" if value and std else value


def _rounded(text: str, printed: str) -> str:
    """Return a number with one decimal more than the printed one, or two digits where that shows zero."""
    if not text:
        return ""
    decimals = max(0, -int(Decimal(printed).as_tuple().exponent)) + 1
    rounded = f"{float(text):.{decimals}f}"
    return rounded if float(rounded) or not float(text) else f"{float(text):.2g}"


def counts_page(rows: Sequence[ScorecardRow]) -> str:
    """Return one sentence with the counts of the verdicts and a table of them by paper, in MyST.

    Parameters
    ----------
    rows
        The scorecard.
    """
    counts = count_kinds(rows)
    total: Counter[str] = sum(counts.values(), Counter())
    read_off = sum((row.paper, row.artefact) in READ_OFF for row in rows)
    numbers = f"print, or show in figures ({read_off} were read off)" if read_off else "print"
    left = telling(rows)
    compared = len(left) + total[WEAK] + total[REPEATED]
    mean, count = geometric_mean_ratio(left, lambda row: row.regenerated, lambda row: row.published)
    below = sum(float(row.regenerated) < float(row.published) for row in left)
    lines = [
        f"Of the {len(rows)} numbers that the papers {numbers}, {compared} can be compared. {total[WEAK]} of these"
        f" are weak, since zero would pass too, and {total[REPEATED]} print a run again."
        f" **Of the {len(left)} left, {total['reproduced'] + total['better']} hold**"
        f" ({total['reproduced']} reproduced, {total['better']} better) and {total['differs']} differ."
        f" {total['not comparable']} are not comparable, {total['missing']} missing.",
        "",
        f"The bias: {below} of the {len(left)} lie below the published number; the geometric mean of regenerated over"
        f" published is {mean:.2f} ({count} numbers).",
        "",
        "| Paper | " + " | ".join(KINDS) + " |",
        "|---|" + "---:|" * len(KINDS),
    ]
    lines += [_counts_line(name, count, name) for name, count in _named(counts)]
    lines.append(_counts_line("All", total))
    return "\n".join(lines) + "\n"


def verdicts_page(rows: Sequence[ScorecardRow]) -> str:
    """Return one paragraph with the counts of the verdicts by table, figure or section, for the chapter of a paper.

    Parameters
    ----------
    rows
        Those of one paper.
    """
    counts: dict[str, Counter[str]] = {}
    for row, kind in zip(rows, kinds(rows), strict=True):
        counts.setdefault(row.artefact, Counter())[kind] += 1
    parts = [f"{artefact}: {_listed(count)}" for artefact, count in counts.items()]
    return "Verdicts of the scorecard: " + "; ".join(parts) + ".\n"


def _named(counts: Mapping[str, Counter[str]]) -> list[tuple[str, Counter[str]]]:
    return [(PAPERS.get(paper, paper), count) for paper, count in counts.items()]


def _counts_line(name: str, count: Counter[str], paper: str = "") -> str:
    cells = (_count_link(count[kind], kind, paper) for kind in KINDS)
    return f"| {name} | " + " | ".join(cells) + " |"


def _count_link(count: int, kind: str, paper: str) -> str:
    """Return a count that leads to the rows that it counts: the scorecard, filtered."""
    if not count:
        return "0"
    chosen = {"paper": paper, "verdict": kind} if paper else {"verdict": kind}
    label = f"{count} {kind}" + (f" of {paper}" if paper else " of all")
    return f'<a href="scorecard.html?{escape(urlencode(chosen))}" aria-label="{label}">{count}</a>'


def _listed(count: Counter[str]) -> str:
    return ", ".join(f"{count[kind]} {kind}" for kind in KINDS if count[kind])
