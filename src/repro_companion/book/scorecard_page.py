"""The scorecard as parts of pages: the full tables, and the counts for the landing page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from html import escape
from urllib.parse import urlencode

from repro_companion.book.scorecard import ScorecardRow, count_verdicts, geometric_mean_ratio
from repro_companion.book.templates import rendered
from repro_companion.book.verdicts import Verdict

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
    filters = {
        "counts": lambda rows: _counts_in_words(Counter(row.verdict for row in rows)),
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
    counts = count_verdicts(rows)
    total: Counter[Verdict] = sum(counts.values(), Counter())
    read_off = sum((row.paper, row.artefact) in READ_OFF for row in rows)
    numbers = f"print, or show in figures ({read_off} were read off)" if read_off else "print"
    lines = [
        f"Of the {len(rows)} numbers that the papers {numbers}, {_counts_in_words(total)}.",
        "",
        "| Paper | " + " | ".join(verdict.words for verdict in Verdict) + " |",
        "|---|" + "---:|" * len(Verdict),
    ]
    lines += [_counts_line(name, count, name) for name, count in _named(counts)]
    lines.append(_counts_line("All", total))
    return "\n".join(lines) + "\n"


def verdicts_page(rows: Iterable[ScorecardRow]) -> str:
    """Return one paragraph with the counts of the verdicts by table, figure or section, for the chapter of a paper.

    Parameters
    ----------
    rows
        Those of one paper.
    """
    counts: dict[str, Counter[Verdict]] = {}
    for row in rows:
        counts.setdefault(row.artefact, Counter())[row.verdict] += 1
    parts = [
        f"{artefact}: "
        + _joined(f"{count[verdict]} {verdict.words}" for verdict in Verdict if count[verdict])
        for artefact, count in counts.items()
    ]
    return "Verdicts of the scorecard: " + "; ".join(parts) + ".\n"


def _named(counts: Mapping[str, Counter[Verdict]]) -> list[tuple[str, Counter[Verdict]]]:
    return [(PAPERS.get(paper, paper), count) for paper, count in counts.items()]


def _counts_line(name: str, count: Counter[Verdict], paper: str = "") -> str:
    cells = (_count_link(count[verdict], verdict, paper) for verdict in Verdict)
    return f"| {name} | " + " | ".join(cells) + " |"


def _count_link(count: int, verdict: Verdict, paper: str) -> str:
    """Return a count that leads to the rows that it counts: the scorecard, filtered."""
    if not count:
        return "0"
    chosen = {"paper": paper, "verdict": verdict.words} if paper else {"verdict": verdict.words}
    label = f"{count} {verdict.words}" + (f" of {paper}" if paper else " of all")
    return f'<a href="scorecard.html?{escape(urlencode(chosen))}" aria-label="{label}">{count}</a>'


def _counts_in_words(count: Counter[Verdict]) -> str:
    parts = [
        (count[Verdict.REPRODUCED], "reproduced"),
        (count[Verdict.BETTER], "better"),
        (count[Verdict.DIFFERS], "different"),
        (count[Verdict.NOT_COMPARABLE], "not comparable"),
    ]
    return _joined(f"{n} {'is' if n == 1 else 'are'} {word}" for n, word in parts) + (
        f", and {count[Verdict.MISSING]} {'is' if count[Verdict.MISSING] == 1 else 'are'} missing"
    )


def _joined(parts: Iterable[str]) -> str:
    return ", ".join(parts)
