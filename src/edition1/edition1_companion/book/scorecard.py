"""The scorecard: every published number, what was regenerated, and the verdict."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from edition1.errors import bad_input, require
from edition1_companion.book.project import Project
from edition1_companion.book.published import (
    ROW_COLUMNS,
    Published,
    RowKey,
    check_row,
    csv_text,
    read_csv,
    read_published,
    row_key,
)
from edition1_companion.book.verdicts import HOLDS, Verdict, is_near_edge, is_weak, verdict


@dataclass(frozen=True)
class ScorecardRow:
    """One published number beside what was regenerated; numbers are texts, empty where there is none."""

    paper: str
    artefact: str
    row: str
    quantity: str
    unit: str
    published: str
    published_std: str
    regenerated: str
    regenerated_std: str
    n_seeds: str
    setting: str
    verdict: Verdict
    weak: bool
    near_edge: bool
    best: str
    best_method: str
    note: str

    @property
    def key(self) -> RowKey:
        """What identifies the row."""
        return RowKey(self.paper, self.artefact, self.row, self.quantity, self.unit)


COLUMNS = tuple(ScorecardRow.__dataclass_fields__)
REFERENCE_COLUMNS = (*RowKey._fields, "verdict")
COMPARED = HOLDS | {Verdict.DIFFERS}
"""Verdicts of rows that were compared."""


WEAK, REPEATED = "weak", "printed again"
KINDS = ("reproduced", "better", "differs", WEAK, REPEATED, "not comparable", "missing")
"""As what a row can count."""


def kinds(rows: Iterable[ScorecardRow]) -> list[str]:
    """Return as what each row counts: by its verdict, or, where that would say little, as *weak* or *printed again*.

    A weak row would also hold if the regenerated number were zero. A row is printed again if a row before it has the
    same regenerated number of the same quantity, to all digits: both print one run of the paper.
    """
    seen, found = set(), []
    for row in rows:
        run = (row.paper, row.quantity, row.unit, row.regenerated, row.regenerated_std)
        compared = row.verdict in COMPARED
        apart = WEAK if row.weak else REPEATED if run in seen else ""
        found.append(apart if compared and apart else row.verdict.words)
        if compared and not row.weak:
            seen.add(run)
    return found


def telling(rows: Sequence[ScorecardRow]) -> list[ScorecardRow]:
    """Return the rows that count by a comparison: those that are neither weak nor printed again."""
    words = {verdict.words for verdict in COMPARED}
    return [row for row, kind in zip(rows, kinds(rows), strict=True) if kind in words]


def compute_scorecard(project: Project) -> list[ScorecardRow]:
    """Return the scorecard from the rows that notebooks wrote.

    Parameters
    ----------
    project
        Read are ``data/published/published.csv`` and ``results/*.rows.csv``.

    Returns
    -------
    list of ScorecardRow
        One per published number, in the order of the file.

    Raises
    ------
    InputError
        If a file is broken, two files regenerate the same number, or a row that differs has no note.
    """
    rows = compare_files(sorted(project.results.glob("*.rows.csv")), read_published(project.published))
    unexplained = [row.key for row in rows if row.verdict is Verdict.DIFFERS and not row.note]
    if unexplained:
        without = "none for " + "; ".join(map(str, unexplained))
        raise bad_input("note", "the scorecard", "given where a number differs", without)
    return rows


def compare_files(files: Iterable[Path], published: Mapping[RowKey, Published]) -> list[ScorecardRow]:
    """Compare published numbers with the rows in some files; a number in none of them is missing.

    Raises
    ------
    InputError
        If a file is broken, or two files regenerate the same number.
    """
    regenerated = _read_rows(files, published)
    return [_compare(key, printed, regenerated.get(key, {})) for key, printed in published.items()]


def _read_rows(files: Iterable[Path], published: Mapping[RowKey, Published]) -> dict[RowKey, dict[str, str]]:
    found: dict[RowKey, dict[str, str]] = {}
    source: dict[RowKey, str] = {}
    for file in files:
        for line in read_csv(file, ROW_COLUMNS):
            key = row_key(line)
            if key in found:
                raise bad_input(
                    f"row {key}", "the scorecard", "regenerated once", f"{source[key]} and {file.name}"
                )
            found[key] = check_row(line, file.name, published)
            source[key] = file.name
    return found


def _compare(key: RowKey, printed: Published, row: Mapping[str, str]) -> ScorecardRow:
    regenerated, std = row.get("regenerated", ""), row.get("regenerated_std", "")
    setting = row.get("setting", "")
    found = verdict(
        key.quantity,
        printed.value,
        printed.std,
        regenerated,
        std,
        setting=setting,
        comparable=row.get("comparable", "true") == "true",
    )
    return ScorecardRow(
        *key,
        published=printed.value,
        published_std=printed.std,
        regenerated=regenerated,
        regenerated_std=std,
        n_seeds=row.get("n_seeds", ""),
        setting=setting,
        verdict=found,
        weak=is_weak(printed.value, printed.std, std),
        near_edge=found in COMPARED and is_near_edge(printed.value, printed.std, regenerated, std),
        best=row.get("best", ""),
        best_method=row.get("best_method", ""),
        note=row.get("note", ""),
    )


def scorecard_csv(rows: Iterable[ScorecardRow], columns: Sequence[str] = COLUMNS) -> str:
    """Return the scorecard as the text of a CSV file; truth values are ``true`` and ``false``."""
    truths = ("weak", "near_edge")
    lines = (asdict(row) | {name: str(getattr(row, name)).lower() for name in truths} for row in rows)
    return csv_text(lines, columns)


def changed_verdicts(rows: Iterable[ScorecardRow], reference: Path) -> list[str]:
    """Return the rows whose verdict is not that of a reference, for the better or for the worse.

    Parameters
    ----------
    rows
        The scorecard of today.
    reference
        CSV file with the columns ``paper, artefact, row, quantity, unit, verdict``.

    Returns
    -------
    list of str
        One line per such row: its key, the verdict then and now, and whether it is near the edge of its band; rows
        that only one of both lists are among them.

    Raises
    ------
    InputError
        If the reference is missing or broken.
    """
    now = {row.key: row for row in rows}
    changed = []
    for line in read_csv(reference, REFERENCE_COLUMNS):
        row, then = now.pop(row_key(line), None), line["verdict"]
        require(then in set(Verdict), "verdict", reference.name, "one of " + ", ".join(Verdict), then)
        if row is None:
            changed.append(f"{row_key(line)}: was {Verdict(then).words}, is not listed")
        elif row.verdict != then:
            edge = " (within 5 % of the edge of its band)" if row.near_edge else ""
            changed.append(f"{row.key}: was {Verdict(then).words}, is {row.verdict.words}{edge}")
    return changed + [
        f"{key}: is not in {reference.name}, is {row.verdict.words}" for key, row in now.items()
    ]


def count_kinds(
    rows: Sequence[ScorecardRow], of: Callable[[ScorecardRow], Any] = lambda row: row.paper
) -> dict[Any, Counter[str]]:
    """Return the number of rows of each of :data:`KINDS`, by paper or by what is asked, in their order."""
    counts: dict[Any, Counter[str]] = {}
    for row, kind in zip(rows, kinds(rows), strict=True):
        counts.setdefault(of(row), Counter())[kind] += 1
    return counts


def listed(count: Counter[str]) -> str:
    """Return counts in words, in the order of :data:`KINDS`; those of nothing are left out.

    Examples
    --------
    >>> listed(Counter({"differs": 2, "reproduced": 1}))
    '1 reproduced, 2 differ'
    """
    return ", ".join(
        f"{count[kind]} {'differ' if kind == 'differs' and count[kind] > 1 else kind}"
        for kind in KINDS
        if count[kind]
    )


def summary(rows: Sequence[ScorecardRow]) -> str:
    """Return the counts by verdict and paper as a table of text."""
    counts = count_kinds(rows)
    lines = [("", *KINDS, "all")]
    for paper, count in [*counts.items(), ("all", sum(counts.values(), Counter()))]:
        lines.append((paper, *(str(count[kind]) for kind in KINDS), str(count.total())))
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        line[0].ljust(widths[0])
        + "".join("  " + cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        for line in lines
    )


def geometric_mean_ratio(
    rows: Iterable[ScorecardRow],
    over: Callable[[ScorecardRow], str],
    under: Callable[[ScorecardRow], str],
) -> tuple[float, int]:
    """Return the geometric mean of a ratio over comparable rows, and how many rows it is of.

    Parameters
    ----------
    rows
        Rows; those without a verdict of reproduced, better or differs are left out, and so are those where
        either number is missing or not positive.
    over, under
        What to divide, and by what.

    Returns
    -------
    tuple of float and int
        The mean (1 where there is no row) and the number of rows.
    """
    logs = []
    for row in rows:
        if row.verdict in COMPARED:
            numbers = float(over(row) or 0), float(under(row) or 0)
            if min(numbers) > 0:
                logs.append(math.log(numbers[0] / numbers[1]))
    return (math.exp(math.fsum(logs) / len(logs)) if logs else 1.0), len(logs)
