"""The scorecard: every number that a paper prints, what we regenerate, and the verdict.

With s_pub and s_reg the standard deviations over three seeds (0 where there is none) and half a unit of the last
printed digit h, the band around a printed number is max(3 sqrt((s_pub^2 + s_reg^2)/3), h). Its edge belongs to it. Of
a number that was read off a figure, s_pub is how well it can be read.

There are two states of the card: without the authors' own files, and with them, where numbers from them are known.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd

from repro.common import bad_input
from repro_companion.show import KEY, ROW_COLUMNS, project_folder, results_folder

PUBLISHED = Path("data/published/published.csv")
COLUMNS = [
    *KEY, "published", "published_std", "regenerated", "regenerated_std", "n_seeds", "setting", "verdict", "weak",
    "near_edge", "best", "best_method", "note",
]  # fmt: skip
WITH_FILES = ["with_files", "with_files_std", "with_files_setting", "with_files_verdict", "with_files_note"]
"""Columns of the numbers that were computed with the authors' files."""
COMPARED = ("reproduced", "better", "differs")
KINDS = [*COMPARED, "weak", "printed again", "not comparable", "missing"]
"""As what a printed number can count."""
ERRORS = {
    "baaij2023": r"e_u|delta_[xyL](_\d)?|kappa_\d|phi|mean",
    "mitchell2021": r"rmse_position",
    "martin2022": r"median|q3",
}
"""Quantities of each paper that are errors: of these alone less is better. Any other agrees or differs."""
AUTHORS = "authors' files"
"""How the setting of a row begins whose number was computed with the authors' own files."""
TIMING = "benchmark"
"""Setting of rows that are timings: these depend on the computer and are never compared."""


def printed_numbers(path: Path) -> pd.DataFrame:
    """Return all printed numbers of a file as texts."""
    return _once(_read(path, [*KEY, "value", "std"], value=True, std=False), "lists")


def published(paper: str, artefact: str = "") -> pd.DataFrame:
    """Return printed numbers of a paper, or of one artefact in it: value and std, and both as they are printed."""
    frame = printed_numbers(project_folder() / PUBLISHED)
    own = frame[(frame["paper"] == paper) & (not artefact or frame["artefact"] == artefact)]
    texts = own.reset_index(drop=True).rename(columns={"value": "printed", "std": "printed_std"})
    return texts.assign(value=pd.to_numeric(texts["printed"]), std=pd.to_numeric(texts["printed_std"]))


def scorecard(published: Path, files: Iterable[Path], *sources: Iterable[Path]) -> pd.DataFrame:
    """Return every printed number beside what ``*.rows.csv`` regenerate, as texts, with its verdict.

    From each group of further files the comparable rows about the authors' files take the place of what was there.

    Raises
    ------
    ValueError
        If a table is broken, a number is regenerated twice or is not a printed one, or one that differs has no note.
    """
    printed = printed_numbers(published).rename(columns={"value": "published", "std": "published_std"})
    further = pd.concat([_rows([]), *map(_rows, sources)])
    about_files = further["setting"].str.startswith(AUTHORS) & (further["comparable"] != "false")
    ours = pd.concat([_rows(files), further[about_files]]).drop_duplicates(KEY, keep="last")
    card = printed.drop(columns="file").merge(ours, "outer", KEY, indicator=True, sort=False)
    for _, row in card[card["_merge"] == "right_only"].iterrows():
        raise ValueError(f"{row['file']} regenerates what {published.name} does not list: {_name(row)}.")
    card = printed[KEY].merge(card, "left", KEY).fillna(dict.fromkeys(ROW_COLUMNS, ""))
    card = _judged(card)
    for _, row in card[(card["verdict"] == "differs") & (card["note"] == "")].iterrows():
        raise ValueError(f"A number that differs must have a note: {_name(row)} of {row['file']} has none.")
    return card[COLUMNS]


def of_page(name: str, artefact: str) -> pd.DataFrame:
    """Return the lines of one artefact, from what a page has just written as ``<name>.rows.csv``."""
    card = scorecard(project_folder() / PUBLISHED, [results_folder() / f"{name}.rows.csv"])
    return card[card["artefact"] == artefact]


def _rows(files: Iterable[Path]) -> pd.DataFrame:
    """Return all rows of some files, each of another number."""
    numbers = {"regenerated": True, "regenerated_std": False, "n_seeds": False, "best": False}
    none = pd.DataFrame(columns=[*ROW_COLUMNS, "file"], dtype=str)
    return _once(pd.concat([none, *(_read(file, ROW_COLUMNS, **numbers) for file in files)]), "regenerate")


def _once(frame: pd.DataFrame, does: str) -> pd.DataFrame:
    for _, twice in frame[frame.duplicated(KEY, keep=False)].groupby(KEY, sort=False):
        raise ValueError(f"{' and '.join(twice['file'])} {does} one number twice: {_name(twice.iloc[0])}.")
    return frame


def _read(path: Path, columns: list[str], **needed: bool) -> pd.DataFrame:
    """Return a table as texts with its file's name; columns in ``needed`` hold numbers, or may be empty."""
    if not path.is_file():
        raise ValueError(f"There is no table {path}.")
    try:
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
    except ValueError as error:
        raise bad_input("file", str(path), "a table in UTF-8 with commas", error) from error
    if list(frame) != columns:
        raise ValueError(
            f"{path.name} must have the columns {', '.join(columns)}; it has {', '.join(frame)}."
        )
    for column, always in needed.items():
        finite = np.isfinite(pd.to_numeric(frame[column], errors="coerce"))
        for _, row in frame[~finite & (always | (frame[column] != ""))].iterrows():
            raise ValueError(
                f"{column} of {path.name} must be a number in {_name(row)}; it is {row[column]!r}."
            )
    return frame.assign(file=path.name)


def _name(row: pd.Series) -> str:
    return " / ".join(row[KEY])


def _judged(card: pd.DataFrame) -> pd.DataFrame:
    """Return the table with its verdicts, with what is weak and what is near the edge of its band."""
    printed, ours = (pd.to_numeric(card[name]) for name in ("published", "regenerated"))
    difference, width = (ours - printed).abs(), band(card)
    within = difference <= width
    comparable = (card["comparable"] != "false") & (card["setting"] != TIMING)
    better = (ours < printed) & np.array([is_error(row) for _, row in card.iterrows()], dtype=bool)
    cases = [card["regenerated"] == "", ~comparable, within, better]
    verdict = np.select(cases, ["missing", "not_comparable", "reproduced", "better"], "differs")
    near = (difference <= 1.05 * width) & (difference > 0.95 * width)
    compared = np.isin(verdict, COMPARED)
    return card.assign(
        verdict=verdict, weak=_truths(printed.abs() <= width), near_edge=_truths(near & compared)
    )


def is_error(row: pd.Series) -> bool:
    """Return whether the quantity of a row is an error, by its paper; of a paper that is not listed none is."""
    return re.fullmatch(ERRORS.get(row["paper"], ""), row["quantity"]) is not None


def band(card: pd.DataFrame) -> pd.Series:
    """Return how far from the printed number a regenerated one may be; a billionth more, for rounding."""
    variance = sum(
        pd.to_numeric(card[name]).fillna(0.0) ** 2 for name in ("published_std", "regenerated_std")
    )
    half = [10.0 ** int(Decimal(text).as_tuple().exponent) / 2 for text in card["published"]]
    return np.maximum(np.sqrt(3 * variance), half) * (1 + 1e-9)


def _truths(values: pd.Series) -> pd.Series:
    return values.map({True: "true", False: "false"})


def kinds(card: pd.DataFrame) -> pd.Series:
    """Return as what each number counts: by its verdict, or apart where that would say little.

    A weak number would also hold if ours were zero. A number is printed again if one before it has the same
    regenerated value to all digits: both print one run.
    """
    compared, weak = card["verdict"].isin(COMPARED), card["weak"] == "true"
    run = ["paper", "quantity", "unit", "regenerated", "regenerated_std"]
    again = card[compared & ~weak].duplicated(run).reindex(card.index, fill_value=False)
    found = card["verdict"].str.replace("_", " ").mask(compared & weak, "weak")
    return found.mask(again, "printed again")


def counts(card: pd.DataFrame) -> pd.DataFrame:
    """Return how many numbers of each paper count as what, and all together."""
    table = pd.crosstab(card["paper"], kinds(card)).reindex(card["paper"].unique()).reindex(columns=KINDS)
    table = table.fillna(0).astype(int)
    table.loc["all"] = table.sum()
    return table.assign(all=table.sum(axis=1)).rename_axis(columns=None)


def beside(card: pd.DataFrame, real: pd.DataFrame) -> pd.DataFrame:
    """Return the card without the authors' files, and as further columns what the one with them has from them."""
    known = real["setting"].str.startswith(AUTHORS) & real["verdict"].isin(COMPARED)
    second = real[["regenerated", "regenerated_std", "setting", "verdict", "note"]].set_axis(
        WITH_FILES, axis=1
    )
    return card.join(second.where(known, ""))


def papers_of_files(both: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Return of which papers the authors' files decided a number, and of which others measured numbers wait."""
    waits = (both["verdict"] == "not_comparable") & (both["setting"] != TIMING)
    known, waiting = (list(both[rows]["paper"].unique()) for rows in (both["with_files"] != "", waits))
    return known, [paper for paper in waiting if paper not in known]


def summary(card: pd.DataFrame, real: pd.DataFrame) -> str:
    """Return the counts without the authors' files, and with them, as texts."""
    known, waiting = papers_of_files(beside(card, real))
    second = [counts(real).loc[known].to_string()] if known else []
    second += [f"{paper}: not computed here; repro fetch {paper}, then make book" for paper in waiting]
    return "\n".join(["Without the authors' files:", counts(card).to_string(), "\nWith them:", *second])


def write(card: pd.DataFrame, path: Path) -> None:
    """Write the scorecard as a CSV file."""
    path.write_text(card.to_csv(index=False, lineterminator="\n"), encoding="utf-8")


def changed(card: pd.DataFrame, reference: Path) -> list[str]:
    """Return one line for each number whose verdict is not that in a reference, or that only one of both lists."""
    then = _read(reference, [*KEY, "verdict"])
    both = then.merge(card, "outer", KEY, suffixes=("_then", ""), sort=False)
    both = both[both["verdict_then"] != both["verdict"]].fillna(
        {"verdict_then": "not listed", "verdict": "not listed"}
    )
    return [
        f"{_name(row)}: was {row['verdict_then']}, is {row['verdict']}".replace("_", " ")
        + (" (within 5 % of the edge of its band)" if row["near_edge"] == "true" else "")
        for _, row in both.iterrows()
    ]
