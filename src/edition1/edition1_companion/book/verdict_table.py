"""Published and regenerated numbers side by side on the page of the notebook that regenerates them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import pandas as pd

from edition1_companion.book.formatted import LONGEST
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.book.results import results_dir
from edition1_companion.book.scorecard import ScorecardRow, compare_files
from edition1_companion.book.scorecard_page import scorecard_page


@dataclass(frozen=True, repr=False)
class VerdictTable:
    """Rows of the scorecard that a notebook shows as a table."""

    rows: Sequence[ScorecardRow]

    def __repr__(self) -> str:
        """Show the table as tab-separated text."""
        lines = [(*row.key, row.published, row.regenerated, row.verdict.words) for row in self.rows]
        return "\n".join("\t".join(line) for line in lines)

    def _repr_html_(self) -> str:
        """Show a long table folded, as every table of the book."""
        page = scorecard_page(self.rows)
        if len(self.rows) <= LONGEST:
            return page
        words = f"All {len(self.rows)} numbers, published and regenerated"
        return f"<details><summary>{words}</summary>{page}</details>"

    def cells(self, unit: str) -> pd.DataFrame:
        """Rows of this unit that are regenerated, as numbers: columns of ``ScorecardRow``."""
        table = pd.DataFrame([asdict(row) for row in self.rows if row.unit == unit and row.regenerated])
        numbers = ["published", "published_std", "regenerated", "regenerated_std", "best"]
        return table.assign(**{name: pd.to_numeric(table[name]) for name in numbers if name in table})


def verdict_table(name: str, *artefacts: str) -> VerdictTable:
    """Compare what this notebook has written as scorecard rows with the published numbers.

    Parameters
    ----------
    name
        As given to :func:`~edition1_companion.book.results.write_scorecard_rows`.
    artefacts
        Tables or sections whose published numbers are listed, those that are missing included.

    Raises
    ------
    InputError
        If the rows cannot be read.
    """
    published = read_published(find_project().published)
    rows = compare_files([results_dir() / f"{name}.rows.csv"], published)
    return VerdictTable([row for row in rows if row.artefact in artefacts])
