"""What the site says of the scorecard: fragments of pages, the picture, a badge, and the rows as JSON."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from html import escape

from repro_companion.book.after.figures_scorecard import picture_page
from repro_companion.book.after.paper_index import (
    index_page,
    index_path,
    page_titles,
    places,
    read_index,
)
from repro_companion.book.digests import write_if_changed
from repro_companion.book.project import Project
from repro_companion.book.scorecard import KINDS, ScorecardRow, count_kinds, listed
from repro_companion.book.scorecard_page import counts_page, scorecard_page, verdicts_page

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
    """Return a badge as SVG: how many of the published numbers have which verdict."""
    left, right = "published numbers", badge_text(rows)
    edge, width = (round(_CHARACTER_PX * len(text) + pad) for text, pad in ((left, 12), (left + right, 24)))
    title = escape(f"{len(rows)} {left}: {right}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{title}">'
        f'<title>{title}</title><rect width="{width}" height="20" rx="3" fill="#14662b"/>'
        f'<path d="M3 0H{edge}V20H3a3 3 0 0 1-3-3V3a3 3 0 0 1 3-3" fill="#444"/>'
        '<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11" text-anchor="middle">'
        f'<text x="{edge / 2:g}" y="14">{left}</text><text x="{(edge + width) / 2:g}" y="14">{right}</text>'
        "</g></svg>\n"
    )


def badge_text(rows: Sequence[ScorecardRow]) -> str:
    """Return the counts that the badge shows, in the words of the verdicts; those of nothing are left out."""
    return listed(sum(count_kinds(rows).values(), Counter()))


_OTHER_PROGRAMS = """
<p>For other programs: <a href="scorecard.json">all rows as JSON</a> (<code>scorecard.json</code>) and a badge
(<code>scorecard.svg</code>): <img src="scorecard.svg" alt="Badge: {}"></p>
"""
