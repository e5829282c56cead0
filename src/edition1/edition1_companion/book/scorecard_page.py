"""The scorecard as parts of pages: a card for each number, and the counts for the landing page and the chapters."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from html import escape
from typing import Any
from urllib.parse import urlencode

from markupsafe import Markup

from edition1_companion.book.formatted import MISSING
from edition1_companion.book.scorecard import (
    COMPARED,
    KINDS,
    REPEATED,
    WEAK,
    ScorecardRow,
    count_kinds,
    geometric_mean_ratio,
    kinds,
    listed,
    telling,
)
from edition1_companion.book.templates import rendered
from edition1_companion.book.verdicts import band

PAPERS = {
    "baaij2023": "Baaij et al. (2023)",
    "mitchell2021": "Mitchell et al. (2021)",
    "martin2022": "Martin et al. (2022)",
}
"""Papers as they are named in running text."""

READ_OFF = frozenset({("martin2022", "Fig. 3"), ("martin2022", "Fig. 5")})
"""Figures whose numbers are printed nowhere and were read off them; those of Fig. 4 stand in the text."""

_WORDS = (
    (r"\bd_s_r\b", "<i>d</i><sub>s,r</sub>"),
    (r"\bpsi_s\b", "ψ"),
    (r"\b([ne])_([a-z])\b", r"<i>\1</i><sub>\2</sub>"),
    (r"\bdelta_L\b", "δ<i>L</i>"),
    (r"\bdelta_L_(\d)\b", r"δ<i>L</i><sub>\1</sub>"),
    (r"\bdelta_([xy])\b", r"Δ<i>\1</i>"),
    (r"\bdelta_([xy])_(\d)\b", r"Δ<i>\1</i><sub>\2</sub>"),
    (r"\bkappa_(\d)\b", r"κ<sub>\1</sub>"),
    (r"\bphi\b", "φ"),
    (r"(?<=\d) pi\b|\bpi\b", "π"),
    (r"\bsigma\b", "σ"),
    (r"\bq3\b", "third quartile"),
    (r"\brmse_position\b", "RMSE of the position"),
    (r"\bupdate_rate\b", "update rate"),
    (r"(\d)deg\b", r"\1°"),
    (r"(\d)mm\b", "\\1\N{NO-BREAK SPACE}mm"),
    (r" ?= ?(?=[\d(])", " = "),
    ("-&gt;", " → "),
    (r"\^2", "²"),
    (r"\b(\d[\d.]*)e-0?(\d+)\b", r"\1 × 10<sup>−\2</sup>"),
    (r"(?<![\w)-])-(?=\d)", "−"),
)
"""Names of rows, quantities and units, and small numbers, in files, and how a page writes them."""


def scorecard_page(rows: Sequence[ScorecardRow], places: Mapping[tuple[str, str], str] | None = None) -> str:
    """Return rows of the scorecard as cards: one HTML table per table, figure or section of a paper.

    Parameters
    ----------
    rows
        Of the scorecard.
    places
        Given for the page of the scorecard itself: where an artefact (paper and artefact) is shown, to which each row
        of it leads. Rows then have addresses, and ``scorecard.js`` finds a place for its filter. On any other page a
        row leads to its address there.

    Returns
    -------
    str
        HTML that a MyST page can include. A row is a ``tbody`` of one or two lines, with what it counts as, its ratio
        and its distance from print in bands as data; a verdict is a word in a ``span`` of the class ``verdict``.
    """
    # Rows of one artefact need not stand together in the file; artefacts keep the order of their first row.
    groups: dict[tuple[str, str], list[ScorecardRow]] = {}
    for row in rows:
        groups.setdefault((row.paper, row.artefact), []).append(row)
    counts = count_kinds(rows, lambda row: (row.paper, row.artefact))
    kind = dict(zip(rows, kinds(rows), strict=True))
    tables = [
        {
            "paper": PAPERS.get(paper, paper),
            "artefact": artefact,
            "place": (places or {}).get((paper, artefact), ""),
            "counts": listed(counts[paper, artefact]) + "." + _ratios(group),
            "setting": words(_shared(map(_setting, group))),
            "best_method": words(_shared(row.best_method for row in group)),
            "cards": [_card(row, kind[row]) for row in group],
        }
        for (paper, artefact), group in groups.items()
    ]
    return rendered("scorecard.html", tables=tables, own=places is not None)


def _card(row: ScorecardRow, kind: str) -> dict[str, Any]:
    return {
        "row": row,
        "kind": kind,
        "anchor": anchor(row),
        "name": words(row.row),
        "quantity": words(row.quantity),
        "numbers": (published_words(row), regenerated_words(row), band_words(row)),
        "ratio": ratio(row),
        "bands_away": _bands_away(row),
        "setting": words(_setting(row)),
        "best": with_unit(_rounded(row.best, row.published), "", row.unit) if row.best else "",
        "best_method": words(row.best_method),
        "note": words(_sentence(row.note)),
    }


def anchor(row: ScorecardRow) -> str:
    """Return the address of a row within the page of the scorecard."""
    return re.sub(r"[^a-z0-9]+", "-", f"row {row.key}".lower().replace("-", " minus ")).strip("-")


def words(name: str) -> Markup:
    """Return the name of a row, quantity or unit, or a note, with the letters of the notation page, as HTML.

    Examples
    --------
    >>> words("psi_s=10deg"), words("delta_x_1")
    (Markup('ψ = 10°'), Markup('Δ<i>x</i><sub>1</sub>'))
    >>> words("noise 7.1e-4 mT")
    Markup('noise 7.1 × 10<sup>−4</sup> mT')
    """
    text = escape(" ".join(name.split()))
    for pattern, written in _WORDS:
        text = re.sub(pattern, written, text)
    return Markup(text)


def published_words(row: ScorecardRow) -> Markup:
    """Return the published number with its unit, as printed."""
    return with_unit(row.published, row.published_std, row.unit)


def regenerated_words(row: ScorecardRow) -> Markup:
    """Return the regenerated number with its unit; a dash where there is none."""
    number, std = (_rounded(text, row.published) for text in (row.regenerated, row.regenerated_std))
    return with_unit(number, std, row.unit) if number else Markup(MISSING)


def band_words(row: ScorecardRow) -> Markup:
    """Return how far from print a number may be to count as reproduced; a dash where nothing is compared."""
    if row.verdict not in COMPARED:
        return Markup(MISSING)
    width = band(row.published, row.published_std, row.regenerated_std)
    return with_unit(f"±\N{NO-BREAK SPACE}{_two_digits(width)}", "", row.unit)


def with_unit(number: str, std: str, unit: str) -> Markup:
    """Return a number, its standard deviation where it has one, and its unit on the same line."""
    return (
        Markup(f"{number} ±\N{NO-BREAK SPACE}{std}" if std else number).replace("-", "−")
        + "\N{NO-BREAK SPACE}"
        + words(unit)
    )


def ratio(row: ScorecardRow) -> float | None:
    """Return regenerated over published; none where one of them is missing or nothing was published but zero."""
    if not row.regenerated or not float(row.published):
        return None
    return float(row.regenerated) / float(row.published)


def _bands_away(row: ScorecardRow) -> float | None:
    """Return the difference in bands: beyond 1 lies what is not reproduced; none where nothing is compared."""
    if row.verdict not in COMPARED:
        return None
    difference = abs(float(row.regenerated) - float(row.published))
    return difference / band(row.published, row.published_std, row.regenerated_std)


def _setting(row: ScorecardRow) -> str:
    seeds = f"{row.n_seeds} seed{'' if row.n_seeds == '1' else 's'}" if row.n_seeds else ""
    return ", ".join(filter(None, (row.setting, seeds)))


def _shared(texts: Iterable[str]) -> str:
    """Return what several rows have in common, to be said once; nothing where they differ or only one is given."""
    given = [text for text in texts if text]
    return given[0] if len(given) > 1 and len(set(given)) == 1 else ""


def _ratios(rows: list[ScorecardRow]) -> str:
    left = telling(rows)
    mean, count = geometric_mean_ratio(left, lambda row: row.regenerated, lambda row: row.published)
    if not count:
        return ""
    text = f" Regenerated / published, geometric mean of {count}: {mean:.2f}"
    mean, count = geometric_mean_ratio(left, lambda row: row.regenerated_std, lambda row: row.published_std)
    return text + (f"; of {count} standard deviations: {mean:.2f}." if count else ".")


def _rounded(text: str, printed: str) -> str:
    """Return a number with a decimal more than the printed one, at most four digits, or two where that is zero."""
    if not text or not float(text):
        return text and "0"
    decimals = max(0, -int(Decimal(printed).as_tuple().exponent)) + 1
    digits_before = Decimal(text).adjusted() + 1
    rounded = f"{float(text):.{max(0, min(decimals, 4 - digits_before))}f}"
    return rounded if float(rounded) else _two_digits(float(text))


def _two_digits(value: float) -> str:
    """Return a number with two digits, never with ``e``."""
    return f"{Decimal(f'{value:#.2g}'):f}"


def _sentence(note: str) -> str:
    text = " ".join(note.split())
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def counts_page(rows: Sequence[ScorecardRow]) -> str:
    """Return a few sentences with the counts of the verdicts and a table of them by paper, in MyST.

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
    named = [(PAPERS.get(paper, paper), count, PAPERS.get(paper, paper)) for paper, count in counts.items()]
    columns = [*named, ("All", total, "")]
    lines = [
        f"Of the {len(rows)} numbers that the papers {numbers}, {compared} can be compared. {total[WEAK]} of these"
        f" are weak, since zero would pass too, and {total[REPEATED]} print a run again."
        f" **Of the {len(left)} left, {total['reproduced']} are reproduced, {total['better']} better, and"
        f" {total['differs']} differ.** {total['not comparable']} are not comparable, {total['missing']} missing.",
        "",
        f"The bias: {below} of the {len(left)} lie below the published number; the geometric mean of regenerated over"
        f" published is {mean:.2f} ({count} numbers)."
        ' <a href="scorecard.html#scorecard-bias">What is known of it</a>.',
        "",
        f"| | {' | '.join(name for name, _, _ in columns)} |",
        "|---|" + "---:|" * len(columns),
    ]
    for kind in KINDS:
        cells = (_count_link(count[kind], kind, paper) for _, count, paper in columns)
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def verdicts_page(rows: Sequence[ScorecardRow]) -> str:
    """Return one paragraph with the counts of the verdicts by table, figure or section, for the chapter of a paper.

    Parameters
    ----------
    rows
        Those of one paper.
    """
    counts = count_kinds(rows, lambda row: row.artefact)
    parts = [f"{artefact}: {listed(count)}" for artefact, count in counts.items()]
    return "Verdicts of the scorecard: " + "; ".join(parts) + ".\n"


def _count_link(count: int, kind: str, paper: str) -> str:
    """Return a count that leads to the rows that it counts: the scorecard, filtered."""
    if not count:
        return "0"
    chosen = {"paper": paper, "verdict": kind} if paper else {"verdict": kind}
    label = f"{count} {kind}" + (f" of {paper}" if paper else " of all")
    return f'<a href="scorecard.html?{escape(urlencode(chosen))}" aria-label="{label}">{count}</a>'
