"""What the site shows of the scorecard: index of the papers, counts, all rows, and the numbers of the home page."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from html import escape
from itertools import groupby, product
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pandas as pd

from repro_companion.artifact_page import MEASURED, appendix
from repro_companion.claims import CLAIM, CLAIMS, claims_of, claims_table, headlines
from repro_companion.papers.fetch import Source, amount, read_sources
from repro_companion.run import recordings
from repro_companion.scorecard import COMPARED, KINDS, band, beside, counts, is_error, kinds, papers_of_files
from repro_companion.show import KEY, number, rendered

PAPERS = {
    "baaij2023": "Baaij et al. (2023)",
    "mitchell2021": "Mitchell et al. (2021)",
    "martin2022": "Martin et al. (2022)",
}
FOLDED = {"equation": "Equations", "trajectory": "Trajectories", "section": "Numbers in the text"}
"""Kinds of entries of the index that stand in a fold of their own; tables and figures are open."""
INDEX_HEAD = ["In the paper", "Shows", "Page", "Verdict"]
ROW_HEAD = ["Number", "Published", "Regenerated", "Band", "Verdict"]
REAL = "With the authors' files"
"""Heading of what was computed with these files; only tables with such a number have the column."""
CAPTION = {"Setting": "setting", "Setting with files": "with_files_setting", "Our method": "best_method"}
"""What the caption of a table of rows says, by its heading."""
STUDIES = {
    "table_1_noise": ["row", "noise_mt", "method", "error_percent"],
    "table_2_networks": ["row", "quantity", "unit", "error"],
}
"""Studies that the home page needs, with the columns that it reads; another project may not have them."""
AXES = {"delta_x": "Δx", "delta_y": "Δy"}
LETTERS = (
    (r"\bd_s_r\b", "<i>d</i><sub>s,r</sub>"),
    (r"\bpsi_s\b", "ψ"),
    (r"\b([ne])_([a-z])\b", r"<i>\1</i><sub>\2</sub>"),
    (r"\bdelta_([xyL])(_\d)?\b", r"delta_<i>\1</i>\2"),
    (r"delta_(<i>[xy])", r"Δ\1"),
    (r"delta_<i>L", "δ<i>L"),
    (r"(</i>|\bkappa)_(\d)\b", r"\1<sub>\2</sub>"),
    (r"\bkappa\b", "κ"),
    (r"\bphi\b", "φ"),
    (r"\bsigma\b", "σ"),
    (r"(?<=\d) pi\b|\bpi\b", "π"),
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
    (r"(?<=\w)_(?=\w)(?!\w*\.\w)", " "),
)
"""Names and numbers as files have them, and how the page writes them; names without letters come last."""


def write_pages(root: Path, card: pd.DataFrame, real: pd.DataFrame) -> None:
    """Write what the pages *Scorecard and index*, *Home* and *Commands* include, to ``book/generated``.

    Both states of the scorecard are given: without the authors' files, and with them.
    """
    card = beside(card, real).assign(name=card["paper"].replace(PAPERS), kind=kinds(card), width=band(card))
    known, _ = papers_of_files(card)
    card["real_kind"] = kinds(real).where(card["paper"].isin(known), "")
    index = pd.read_csv(root / "data" / "published" / "index.csv", dtype=str, keep_default_na=False)
    found = index["paper"].isin({name.partition("/")[0] for name in recordings()})
    index = index.assign(
        name=index["paper"].replace(PAPERS),
        place=index["page"] + ".html#" + index["anchor"],
        real=found & index["note"].str.contains("recordings where they are found"),
    )
    titles = {page: title(root, page) for page in index["page"].unique()}
    stored = {root / "data" / "studies" / f"{name}.csv": columns for name, columns in STUDIES.items()}
    noise, networks = (
        pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=columns)
        for path, columns in stored.items()
    )
    places = {(row["name"], row["artefact"]): row["place"].rstrip("#") for _, row in index.iterrows()}
    home = findings(card, noise, networks)
    claims = claims_of(root, card, home) if (root / CLAIMS).is_file() else pd.DataFrame(columns=CLAIM)
    texts = {
        "index.md": index_page(index, titles, card),
        "find.md": finder_page(index[index["status"] != "not reproduced"]),
        "counts.md": counts_page(card[real.columns], real),
        "rows.md": rows_page(card, places),
        "files.md": files_page(read_sources(root / "data" / "sources.json")),
        "values.json": json.dumps(home, ensure_ascii=False),
        "claims.md": headlines(claims, titles, PAPERS),
    }
    if (root / MEASURED).is_file():
        texts |= appendix(root, claims, titles, PAPERS)
    for page in claims["page"].unique():
        texts[f"claims_{Path(page).name}.md"] = claims_table(claims, page)
    for name, text in texts.items():
        path = root / "book" / "generated" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def title(root: Path, page: str) -> str:
    """Return the title of a page, of a notebook or not."""
    notebook = root / f"{page}.ipynb"
    if notebook.is_file():
        text = "".join(json.loads(notebook.read_text(encoding="utf-8"))["cells"][0]["source"])
    else:
        text = (root / "book" / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(r"^# (.+)$", text, re.MULTILINE)[0]


def words(text: str) -> str:
    """Return the name of a row, a quantity, a unit or a note with the letters of the papers, as HTML."""
    text = escape(" ".join(text.split()), quote=False)
    for pattern, written in LETTERS:
        text = re.sub(pattern, written, text)
    return text


def rows_link(text: object, **chosen: str) -> str:
    """Return a link to the rows of the scorecard that are chosen by paper, artefact and verdict."""
    label = escape(", ".join([str(text), *chosen.values()]))
    return f'<a href="scorecard.html?{escape(urlencode(chosen))}#all-rows" aria-label="{label}">{text}</a>'


def verdict_in_a_word(found: pd.Series) -> str:
    """Return what a table or figure comes to whose numbers count as given; what says little only if all do."""
    agree, differ = found.isin(["reproduced", "better"]).sum(), (found == "differs").sum()
    if agree + differ == 0:
        return found.mode()[0]
    return "differs" if differ >= agree else "mostly reproduced" if differ else "reproduced"


def index_page(index: pd.DataFrame, titles: Mapping[str, str], card: pd.DataFrame) -> str:
    """Return the index: for each paper a table of its tables and figures, and folds of all else."""
    entries = index.assign(
        title=index["page"].map(titles),
        fold=index["kind"].map(FOLDED).fillna(""),
        verdict=[verdict_of(entry, card) for _, entry in index.iterrows()],
    )
    return rendered("index.md", papers=entries.groupby("name", sort=False), head=INDEX_HEAD, words=words)


def verdict_of(entry: pd.Series, card: pd.DataFrame) -> str:
    """Return the last cell of an entry of the index: what its numbers come to, or the word of the index."""
    found = card[(card["paper"] == entry["paper"]) & (card["artefact"] == entry["artefact"])]
    if len(found):
        chosen = {"paper": entry["name"], "artefact": entry["artefact"]}
        verdict = rows_link(verdict_in_a_word(found["kind"]), **chosen)
        if (found["with_files"] != "").any():
            again = rows_link(verdict_in_a_word(found["real_kind"]), **chosen)
            verdict += f"; with the authors' files: {again}"
        return verdict
    if "synthetic" in entry["note"]:
        return entry["status"] + ("" if entry["real"] else " (synthetic)")
    code = f"<code>{entry['code'].rsplit('.')[-1]}</code>" * (entry["status"] == "implemented")
    said = "; ".join(filter(None, [code, words(entry["note"])]))
    return entry["status"] + f' <span class="setting">({said})</span>' * bool(said)


def finder_page(index: pd.DataFrame) -> str:
    """Return a table that leads to the tables and figures of each paper by their numbers."""
    return rendered("find.md", papers=index.groupby("name", sort=False))


def counts_page(card: pd.DataFrame, real: pd.DataFrame) -> str:
    """Return a table of how many numbers of each paper count as what, without the authors' files and with them.

    Each count leads to its rows. Where numbers wait for files that are not here, it says how to get these.
    """
    known, waiting = papers_of_files(beside(card, real))
    without, having = counts(card), counts(real).loc[known]
    shown = [kind for kind in KINDS if without.loc["all", kind] or having[kind].any()]
    tables = {"verdict": (without, "without their files"), "files": (having, "with them")}
    lines = []
    for paper, (key, (table, state)) in product(card["paper"].unique(), tables.items()):
        if paper in table.index:
            name = PAPERS.get(paper, paper)
            found = table.loc[paper, shown].items()
            cells = [rows_link(n, **{"paper": name, key: kind}) if n else "0" for kind, n in found]
            lines.append((f"{name}, {state}" if paper in known + waiting else name, cells))
    names = {paper: PAPERS.get(paper, paper) for paper in waiting}
    return rendered("counts.md", shown=shown, lines=lines, waiting=names)


def rows_page(card: pd.DataFrame, places: Mapping[tuple[str, str], str]) -> str:
    """Return all rows as HTML: a fold for each table, figure or section of a paper, a ``tbody`` for each number."""
    by_paper = card.sort_values("paper", key=lambda papers: pd.factorize(papers)[0], kind="stable")
    groups = by_paper.groupby(["name", "artefact"], sort=False)
    return rendered("rows.md", parts=[_part(rows, places[names]) for names, rows in groups], words=words)


def _part(rows: pd.DataFrame, place: str) -> dict[str, object]:
    """Return what the page shows of one table, figure or section."""
    total = rows["kind"].value_counts().reindex(KINDS).dropna()
    plural = {kind: kind.replace("differs", "differ") for kind in KINDS}
    given = {heading: "; ".join(filter(None, rows[column].unique())) for heading, column in CAPTION.items()}
    real = bool((rows["with_files"] != "").any())
    return {
        **rows.iloc[0][["name", "artefact"]],
        "place": place,
        "said": ", ".join(f"{n:.0f} {kind if n == 1 else plural[kind]}" for kind, n in total.items()),
        "settings": {heading: text for heading, text in given.items() if text},
        "real": real,
        "head": [*ROW_HEAD, *[REAL] * real],
        "rows": [row | _numbers(row) for row in rows.to_dict("records")],
    }


def _numbers(row: Mapping[str, str]) -> dict[str, object]:
    """Return what the page shows of one row: its numbers, and what is known of it in a second line."""
    unit = "\N{NO-BREAK SPACE}" + words(row["unit"])
    printed = " ± ".join(row[name].replace("-", "−") for name in ("published", "published_std") if row[name])
    ours, real = (_with_spread(row, name, unit) for name in ("regenerated", "with_files"))
    width = f"±\N{NO-BREAK SPACE}{number(row['width'], 2)}{unit}" if row["verdict"] in COMPARED else "–"
    verdict, kind = row["verdict"].replace("_", " "), row["kind"]
    apart = f" ({verdict})" * (kind != verdict) + ", near the edge" * (row["near_edge"] == "true")
    remarks = _sentence(row["note"])
    if row["with_files_note"]:
        remarks += _sentence(f"{REAL}: {row['with_files_note']}")
    if row["best"]:
        better = is_error(row) and float(row["best"]) < float(row["regenerated"])
        remarks += f"<b>Our {'best' if better else 'method'}: {number(float(row['best']))}{unit}.</b>"
    address = " ".join(["row", *(row[name] for name in KEY)]).lower().replace("-", " minus ")
    return {
        "id": re.sub(r"[^a-z0-9]+", "-", address).strip("-"),
        "cells": [printed + unit, ours or "–", width],
        "shown": kind,
        "apart": apart,
        "real": real,
        "remarks": remarks,
    }


def _with_spread(row: Mapping[str, str], name: str, unit: str) -> str:
    """Return a number of a row and its deviation, empty if there is none."""
    numbers = [number(float(row[column])) for column in (name, f"{name}_std") if row[column]]
    return " ± ".join(numbers) + unit if numbers else ""


def _sentence(text: str) -> str:
    return words(f"{text[:1].upper()}{text[1:]}.") + " " if text else ""


def files_page(sources: Iterable[Source]) -> str:
    """Return a table of the files that can be fetched: how many, and which page reads them for what."""
    groups = groupby(sources, lambda source: (source.paper, source.page, source.use))
    return rendered("files.md", groups=[(*about, amount(files)) for about, files in groups])


def findings(card: pd.DataFrame, noise: pd.DataFrame, networks: pd.DataFrame) -> dict[str, str]:
    """Return what the home page says in numbers, by name; a dash for a paper that the scorecard lacks.

    The study of the noise has the calibrated robots of Table 1 with the noise that the paper prints, that of the
    networks the errors of Table 2 on robots whose readings are the authors' networks.
    """
    numbers = card.assign(
        **{name: pd.to_numeric(card[name]) for name in ("published", "regenerated", "best")}
    )
    ring = numbers[
        (numbers["artefact"] == "Table 1") & (numbers["row"] == "n_b=1") & (numbers["unit"] == "%")
    ]
    bend = numbers[numbers["quantity"] == "rmse_position"]
    in_mm = numbers["quantity"].str.startswith("delta") & (numbers["unit"] == "mm")
    table_2 = numbers[in_mm & (numbers["artefact"] == "Table 2")].set_index(["row", "quantity"])
    errors = networks[networks["unit"] == "mm"].groupby(["row", "quantity"])["error"].mean()
    rig, robots = (errors / table_2["published"] for errors in (table_2["regenerated"], errors))
    cells = [
        f"{row.rpartition('->')[2].partition('.')[0]}, {AXES[axis]}" for row, axis in rig.sort_values().index
    ]
    cells = cells or ["–"]  # where there is no such number
    noisy = noise[(noise["row"] == "n_b=1") & (noise["method"] == "calibrated") & (noise["noise_mt"] > 0.01)]
    ours = card[card["paper"] == "baaij2023"]
    tally = kinds(ours).value_counts().reindex(KINDS, fill_value=0 if len(ours) else np.nan)
    return {
        "home.reproduced": number(tally["reproduced"]),
        "home.compared": number(tally.drop(["not comparable", "missing"]).sum(skipna=False)),
        "home.outside": number(tally[["better", "differs"]].sum(skipna=False)),
        "home.smaller": number(tally["better"]),
        "home.ring_paper": number(ring["regenerated"].mean(), 1),
        "home.ring_best": number(ring["best"].mean(), 1),
        "home.ring_noisy": number(noisy["error_percent"].mean(), 1),
        "home.rig_least": number(rig.min(), 2),
        "home.rig_least_on": cells[0],
        "home.rig_most": number(rig.max(), 2),
        "home.rig_most_on": cells[-1],
        "home.networks_least": number(robots.min(), 2),
        "home.networks_most": number(robots.max(), 2),
        "home.bend_paper": number(bend["regenerated"].mean(), 1),
        "home.bend_printed": number(bend["published"].mean(), 2),
    }
