"""What the site says of the scorecard: fragments of pages, the picture, a badge, and the rows as JSON.

In the picture there is a dot for every number, which says what it is and leads to its row.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from typing import Any

from markupsafe import Markup

from edition1_companion.book.after.paper_index import index_page, index_path, page_titles, places, read_index
from edition1_companion.book.digests import write_if_changed
from edition1_companion.book.project import Project
from edition1_companion.book.scorecard import (
    COMPARED,
    KINDS,
    REPEATED,
    WEAK,
    ScorecardRow,
    count_kinds,
    kinds,
    listed,
    telling,
)
from edition1_companion.book.scorecard_page import (
    PAPERS,
    anchor,
    counts_page,
    published_words,
    ratio,
    regenerated_words,
    scorecard_page,
    verdicts_page,
    words,
)
from edition1_companion.book.templates import rendered
from edition1_companion.book.verdicts import band

_NUMBERS = ("published", "published_std", "regenerated", "regenerated_std", "n_seeds", "best")
_CHARACTER_PX = 6.6  # of 11 px sans serif, on average


def write_scorecard_files(project: Project, rows: Sequence[ScorecardRow]) -> None:
    """Write what pages include and what the site serves of the scorecard, to ``book/generated``.

    Parameters
    ----------
    project
        Read are ``data/published/index.csv`` and the titles of the pages that it names.
    rows
        The scorecard.

    Raises
    ------
    InputError
        If the index of the papers is broken.
    """
    index = read_index(index_path(project))
    folder = project.book / "generated"
    texts = {
        "scorecard.md": scorecard_page(rows, places(index)),
        "counts.md": counts_page(rows),
        "papers.md": index_page(index, page_titles(project, index)),
        "scorecard_picture.md": picture_page(rows) + _OTHER_PROGRAMS.format(badge_text(rows)),
        "scorecard.svg": badge(rows),
        "scorecard.json": scorecard_json(rows),
    }
    for paper in count_kinds(rows):
        texts[f"verdicts_{paper}.md"] = verdicts_page([row for row in rows if row.paper == paper])
    for name, text in texts.items():
        write_if_changed(folder / name, text)


def scorecard_json(rows: Sequence[ScorecardRow]) -> str:
    """Return the scorecard as the text of a JSON file: counts of the verdicts by paper, and all rows.

    Numbers are numbers, null where there is none; the digits that were printed stand in ``results/scorecard.csv``.
    """
    counts = count_kinds(rows)
    counts["all"] = sum(counts.values(), Counter())
    return json.dumps(
        {
            "counts": {
                paper: {kind.replace(" ", "_"): count[kind] for kind in KINDS}
                for paper, count in counts.items()
            },
            "rows": [_typed(row) for row in rows],
        },
        indent=1,
        ensure_ascii=False,
    )


def _typed(row: ScorecardRow) -> dict[str, object]:
    texts = asdict(row)
    return {name: _number(text) if name in _NUMBERS else text for name, text in texts.items()}


def _number(text: str) -> int | float | None:
    if not text:
        return None
    return int(text) if text.isdecimal() else float(text)


def badge(rows: Sequence[ScorecardRow]) -> str:
    """Return a badge as SVG: the numbers that count, by verdict; a telephone shows it whole."""
    counts = sum(count_kinds(rows).values(), Counter())
    compared = Counter({kind: counts[kind] for kind in KINDS[:3]})
    left, right = f"{compared.total()} compared", listed(compared) or "none"
    edge, width = (round(_CHARACTER_PX * len(text) + pad) for text, pad in ((left, 12), (left + right, 24)))
    title = escape(f"{len(rows)} published numbers: {badge_text(rows)}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{title}">'
        f'<title>{title}</title><rect width="{width}" height="20" rx="3" fill="#14662b"/>'
        f'<path d="M3 0H{edge}V20H3a3 3 0 0 1-3-3V3a3 3 0 0 1 3-3" fill="#444"/>'
        '<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11" text-anchor="middle">'
        f'<text x="{edge / 2:g}" y="14">{left}</text><text x="{(edge + width) / 2:g}" y="14">{right}</text>'
        "</g></svg>\n"
    )


def badge_text(rows: Sequence[ScorecardRow]) -> str:
    """Return the counts of all rows, which name the badge, in the words of the verdicts."""
    return listed(sum(count_kinds(rows).values(), Counter()))


_OTHER_PROGRAMS = """
<p>For other programs: <a href="scorecard.json">all rows as JSON</a> (<code>scorecard.json</code>) and a badge
(<code>scorecard.svg</code>): <img src="scorecard.svg" alt="Badge: {}"></p>
"""


LOWEST, HIGHEST = 0.1, 10.0
"""Ratios at which the picture ends; what lies beyond stands at its edge."""

TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
MARKS = {
    "reproduced": "M-3.5 0a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0-7 0",
    "better": "M-4-3.5H4L0 4z",
    "differs": "M0-5L4.5 0L0 5L-4.5 0z",
    WEAK: "M-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0",
    REPEATED: "M-3-3H3V3H-3z",
    "not comparable": "M-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0",
    "missing": "M-3-3L3 3M-3 3L3-3",
}
"""Outline of a dot by what the row counts as; its colour stands in ``repro.css``."""
SHORT = {"baaij2023": "Baaij", "mitchell2021": "Mitchell", "martin2022": "Martin"}
LEFT, STEP, TOP, HEIGHT, LEVEL, UPRIGHT = 58.0, 7.6, 10.0, 230.0, 50.0, 150.0
"""Where the first dot stands, from dot to dot, where a line begins, how high it is, and the room for its labels."""
_GAP = 2.5  # dots of room between two artefacts
_NARROW = 14  # an artefact of fewer rows has its label written upright


def picture_page(rows: Sequence[ScorecardRow]) -> str:
    """Return the figure: regenerated over published for every row, with the bands, on two lines of artefacts.

    Parameters
    ----------
    rows
        The scorecard; rows that are missing stand at the lower edge.
    """
    artefacts: dict[tuple[str, str], list[tuple[ScorecardRow, str]]] = {}
    for row, kind in zip(rows, kinds(rows), strict=True):
        artefacts.setdefault((row.paper, row.artefact), []).append((row, kind))
    top, dots, labels, axes = TOP, [], [], []
    for line in _two_lines(artefacts):
        x = LEFT
        for (paper, artefact), members in line.items():
            dots += [_dot(row, kind, x + STEP * k, top) for k, (row, kind) in enumerate(members)]
            label = {
                "text": f"{SHORT.get(paper, paper)}, {artefact}",
                "x": round(x + STEP * (len(members) - 1) / 2, 1),
                "edge": round(x + STEP * (len(members) + (_GAP - 1) / 2), 1),
                "y": top,
                "upright": len(members) < _NARROW,
            }
            labels.append(label)
            x += STEP * (len(members) + _GAP)
        axes.append((top, round(x - STEP * _GAP)))
        top += HEIGHT + (UPRIGHT if any(label["upright"] for label in labels if label["y"] == top) else LEVEL)
    counts: Counter[str] = sum(count_kinds(rows).values(), Counter())
    return rendered(
        "scorecard_picture.html",
        alt=picture_alt(rows),
        dots=dots,
        labels=labels,
        lines=axes,
        ticks=[(f"{tick:g}", height_of(tick)) for tick in TICKS],
        marks=MARKS,
        legend=[(kind, counts[kind]) for kind in KINDS if counts[kind]],
        height=HEIGHT,
        left=LEFT,
        size=(max(end for _, end in axes) + LEFT / 2, top),
    )


def _two_lines(artefacts: Mapping[Any, Sequence[Any]]) -> list[dict[Any, Sequence[Any]]]:
    """Return the artefacts in two groups of about as many rows, in their order; one group where there is one."""
    total, seen = sum(map(len, artefacts.values())), 0
    lines: list[dict[Any, Sequence[Any]]] = [{}, {}]
    for place, members in artefacts.items():
        lines[seen + len(members) / 2 > total / 2][place] = members
        seen += len(members)
    return [line for line in lines if line]


def height_of(value: float) -> float:
    """Return how far below the upper edge a ratio stands."""
    inside = min(max(value, LOWEST), HIGHEST)
    return round(HEIGHT * math.log(HIGHEST / inside) / math.log(HIGHEST / LOWEST), 1)


def _dot(row: ScorecardRow, kind: str, x: float, y: float) -> dict[str, Any]:
    value = ratio(row)
    at = height_of(LOWEST if value is None else value)
    place = f"{PAPERS.get(row.paper, row.paper)}, {row.artefact}, {words(row.row)}, {words(row.quantity)}"
    numbers = f"published {published_words(row)}, regenerated {regenerated_words(row)}"
    verdict = row.verdict.words if kind == row.verdict.words else f"{row.verdict.words} ({kind})"
    edges = None
    if row.verdict in COMPARED and value is not None:
        width = band(row.published, row.published_std, row.regenerated_std) / abs(float(row.published))
        edges = [y + height_of(1 + side * width) for side in (1, -1)]
    return {
        "x": round(x, 1),
        "y": y + at,
        "kind": kind,
        "anchor": anchor(row),
        "title": Markup(f"{place}: {numbers}, {verdict}").striptags(),
        "band": edges,
    }


def picture_alt(rows: Sequence[ScorecardRow]) -> str:
    """Return what the picture shows, in one line with its numbers."""
    counts: Counter[str] = sum(count_kinds(rows).values(), Counter())
    ratios = sorted(found for row in telling(rows) if (found := ratio(row)) is not None)
    text = f"Regenerated over published for {len(rows)} numbers of the papers: {listed(counts)}."
    if not ratios:
        return text
    low, middle, high = ratios[0], ratios[len(ratios) // 2], ratios[-1]
    return (
        text
        + f" The {len(ratios)} ratios that are compared go from {low:.2g} to {high:.2g}, median {middle:.2f}."
    )
