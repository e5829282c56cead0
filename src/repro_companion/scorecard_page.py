"""What the site shows of the scorecard: index of the papers, counts, all rows, and the numbers of the home page."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from html import escape
from itertools import groupby
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pandas as pd

from repro_companion.papers.fetch import Source, amount, read_sources
from repro_companion.run import recordings
from repro_companion.scorecard import COMPARED, KINDS, band, beside, counts, is_error, kinds, papers_of_files
from repro_companion.show import KEY, number

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
NOISE_COLUMNS = ["row", "noise_mt", "method", "error_percent"]
"""Columns of the study of the noise of Table 1 that the home page needs; another project may not have the study."""
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
    study = root / "data" / "studies" / "table_1_noise.csv"
    noise = pd.read_csv(study) if study.is_file() else pd.DataFrame(columns=NOISE_COLUMNS)
    places = {(row["name"], row["artefact"]): row["place"].rstrip("#") for _, row in index.iterrows()}
    texts = {
        "index.md": index_page(index, titles, card),
        "find.md": finder_page(index[index["status"] != "not reproduced"]),
        "counts.md": counts_page(card[real.columns], real),
        "rows.md": rows_page(card, places),
        "files.md": files_page(read_sources(root / "data" / "sources.json")),
        "values.json": json.dumps(findings(card, noise), ensure_ascii=False),
    }
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


def table(caption: str, head: Iterable[str], rows: Iterable[str], about: str) -> str:
    """Return a table as HTML, its rows given as HTML."""
    cells = "".join(f'<th scope="col">{one}</th>' for one in head)
    return (
        f'<table class="scorecard {about}><caption>{caption}</caption><thead><tr>{cells}</tr></thead>\n'
        + "\n".join(rows)
        + "</table>\n"
    )


def folded(summary: str, text: str) -> str:
    """Return a part of a page that a reader opens."""
    return f'<details class="fold"><summary>{summary}</summary>\n{text}</details>\n'


def index_page(index: pd.DataFrame, titles: Mapping[str, str], card: pd.DataFrame) -> str:
    """Return the index: for each paper a table of its tables and figures, and folds of all else."""
    parts = []
    for name, of_paper in index.groupby("name", sort=False):
        parts.append(f"### {name}\n")
        for heading, entries in of_paper.groupby(of_paper["kind"].map(FOLDED).fillna(""), sort=False):
            rows = [_entry(entry, titles, card) for _, entry in entries.iterrows()]
            text = table(
                f"{name}: {heading.lower() or 'tables and figures'}", INDEX_HEAD, rows, 'paper-index"'
            )
            parts.append(folded(heading, text) if heading else text)
    return "\n".join(parts)


def _entry(entry: pd.Series, titles: Mapping[str, str], card: pd.DataFrame) -> str:
    found = card[(card["paper"] == entry["paper"]) & (card["artefact"] == entry["artefact"])]
    if len(found):
        chosen = {"paper": entry["name"], "artefact": entry["artefact"]}
        verdict = rows_link(verdict_in_a_word(found["kind"]), **chosen)
        if (found["with_files"] != "").any():
            again = rows_link(verdict_in_a_word(found["real_kind"]), **chosen)
            verdict += f"; with the authors' files: {again}"
    elif "synthetic" in entry["note"]:
        verdict = entry["status"] + ("" if entry["real"] else " (synthetic)")
    else:
        code = f"<code>{entry['code'].rsplit('.')[-1]}</code>" * (entry["status"] == "implemented")
        said = "; ".join(filter(None, [code, words(entry["note"])]))
        verdict = entry["status"] + f' <span class="setting">({said})</span>' * bool(said)
    page = f'<a href="{entry["page"]}.html">{escape(titles[entry["page"]])}</a>'
    cells = words(entry["shows"]), page, verdict
    return (
        f'<tr><th scope="row"><a href="{entry["place"].rstrip("#")}">{entry["artefact"]}</a></th>'
        f"{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    )


def finder_page(index: pd.DataFrame) -> str:
    """Return a table that leads to the tables and figures of each paper by their numbers."""
    lines = ["| paper | tables | figures |\n|---|---|---|"]
    for name, entries in index.groupby("name", sort=False):
        cells = []
        for kind in ("table", "figure"):
            found = entries[entries["kind"] == kind][["artefact", "place"]].to_numpy()
            links = [
                f'<a href="{to.rstrip("#")}" title="{one}">{one.split()[1].rstrip(",")}</a>'
                for one, to in found
            ]
            cells.append(" · ".join(links) or "–")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def counts_page(card: pd.DataFrame, real: pd.DataFrame) -> str:
    """Return a table of how many numbers of each paper count as what, without the authors' files and with them.

    Each count leads to its rows. Where numbers wait for files that are not here, it says how to get these.
    """
    known, waiting = papers_of_files(beside(card, real))
    without, having = counts(card), counts(real).loc[known]
    shown = [kind for kind in KINDS if without.loc["all", kind] or having[kind].any()]
    lines = ["{.as-cards}", f"| | {' | '.join(shown)} |", "|---|" + "---:|" * len(shown)]
    for paper in card["paper"].unique():
        name = PAPERS.get(paper, paper)
        for key, table_of, state in (
            ("verdict", without, "without their files"),
            ("files", having, "with them"),
        ):
            if paper in table_of.index:
                found = table_of.loc[paper, shown].items()
                cells = [rows_link(n, **{"paper": name, key: kind}) if n else "0" for kind, n in found]
                label = f"{name}, {state}" if paper in known + waiting else name
                lines.append(f"| {label} | {' | '.join(cells)} |")
    if waiting:
        names = " and ".join(PAPERS.get(paper, paper) for paper in waiting)
        commands = "".join(f".venv/bin/repro fetch {paper}\n" for paper in waiting)
        lines.append(
            f"\nThe files of {names} are not here, so we do not know how many numbers agree with them. You can"
            f" compute it:\n\n```bash\n{commands}make book\n```"
        )
    return "\n".join(lines) + "\n"


def rows_page(card: pd.DataFrame, places: Mapping[tuple[str, str], str]) -> str:
    """Return all rows as HTML: a fold for each table, figure or section of a paper, a ``tbody`` for each number."""
    parts = ['<div class="scorecard-filter"></div>\n']
    by_paper = card.sort_values("paper", key=lambda papers: pd.factorize(papers)[0], kind="stable")
    for (name, artefact), rows in by_paper.groupby(["name", "artefact"], sort=False):
        total = rows["kind"].value_counts().reindex(KINDS).dropna()
        said = ", ".join(
            f"{n:.0f} {kind if n == 1 else kind.replace('differs', 'differ')}" for kind, n in total.items()
        )
        caption = f'<a href="{places[name, artefact]}">{name}, {artefact}</a>.'
        for heading, column in CAPTION.items():
            if given := "; ".join(filter(None, rows[column].unique())):
                caption += f' <span class="setting">{heading}: {words(given)}.</span>'
        about = f'cards" data-paper="{name}" data-artefact="{artefact}"'
        real = bool((rows["with_files"] != "").any())
        lines = [_row(row, real) for _, row in rows.iterrows()]
        text = table(caption, [*ROW_HEAD, *[REAL] * real], lines, about)
        parts.append(folded(f"<b>{name}, {artefact}</b>: {said}.", text))
    return "\n".join(parts)


def _row(row: pd.Series, with_real: bool = False) -> str:
    """Return a row of the scorecard: its numbers, and what is known of it in a second line."""
    unit = "\N{NO-BREAK SPACE}" + words(row["unit"])
    printed = [row[name].replace("-", "−") for name in ("published", "published_std") if row[name]]
    ours = [number(float(row[name])) for name in ("regenerated", "regenerated_std") if row[name]]
    width = f"±\N{NO-BREAK SPACE}{number(row['width'], 2)}{unit}" if row["verdict"] in COMPARED else "–"
    verdict, kind = row["verdict"].replace("_", " "), row["kind"]
    apart = ", near the edge" * (row["near_edge"] == "true")
    if kind != verdict:
        verdict, apart = kind, f" ({verdict})" + apart
    said = _sentence(row["note"])
    if row["with_files_note"]:
        said += _sentence(f"{REAL}: {row['with_files_note']}")
    if row["best"]:
        better = is_error(row) and float(row["best"]) < float(row["regenerated"])
        said += f"<b>Our {'best' if better else 'method'}: {number(float(row['best']))}{unit}.</b>"
    key = " ".join(["row", *row[KEY]]).lower().replace("-", " minus ")
    cells = [" ± ".join(printed) + unit, " ± ".join(ours) + unit if ours else "–", width]
    cells += [_verdict(verdict) + apart, *[_real(row, unit)] * with_real]
    return (
        f'<tbody id="{re.sub(r"[^a-z0-9]+", "-", key).strip("-")}" data-verdict="{kind}"'
        f' data-files="{row["real_kind"]}"><tr><th scope="row">'
        f"{words(row['row'])}, {words(row['quantity'])}</th>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        + (f'<tr class="remarks"><td colspan="{len(cells) + 1}">{said}</td></tr>' if said else "")
        + "</tbody>"
    )


def _real(row: pd.Series, unit: str) -> str:
    numbers = [number(float(row[name])) for name in ("with_files", "with_files_std") if row[name]]
    return f"{' ± '.join(numbers)}{unit}, {_verdict(row['real_kind'])}" if numbers else "–"


def _sentence(text: str) -> str:
    return words(f"{text[:1].upper()}{text[1:]}.") + " " if text else ""


def _verdict(kind: str) -> str:
    return f'<span class="verdict verdict-{kind.replace(" ", "-")}">{kind}</span>'


def files_page(sources: Iterable[Source]) -> str:
    """Return a table of the files that can be fetched: how many, and which page reads them for what."""
    lines = ["{.as-cards}", "| paper | page | files | what for |", "|---|---|---|---|"]
    for (paper, page, use), files in groupby(sources, lambda source: (source.paper, source.page, source.use)):
        link = f'<a href="notebooks/{page}.html"><code>{page}</code></a>' if page else "none yet"
        lines.append(f"| `{paper}` | {link} | {amount(files)} | {use} |")
    return "\n".join(lines) + "\n"


def findings(card: pd.DataFrame, noise: pd.DataFrame) -> dict[str, str]:
    """Return what the home page says in numbers, by name; a dash for a paper that the scorecard lacks.

    The study of the noise has the calibrated robots of Table 1 with the noise that the paper prints.
    """
    numbers = card.assign(
        **{name: pd.to_numeric(card[name]) for name in ("published", "regenerated", "best")}
    )
    ring = numbers[
        (numbers["artefact"] == "Table 1") & (numbers["row"] == "n_b=1") & (numbers["unit"] == "%")
    ]
    bend = numbers[numbers["quantity"] == "rmse_position"]
    relative = numbers["quantity"].str.startswith("delta") & (numbers["unit"] == "%")
    rig = numbers[relative & (numbers["artefact"] == "Table 2") & numbers["row"].str.endswith("T5.test")]
    noisy = noise[(noise["row"] == "n_b=1") & (noise["method"] == "calibrated") & (noise["noise_mt"] > 0.01)]
    ours = card[card["paper"] == "baaij2023"]
    tally = kinds(ours).value_counts().reindex(KINDS, fill_value=0 if len(ours) else np.nan)
    return {
        "home.compared": number(tally.drop(["not comparable", "missing"]).sum(skipna=False)),
        "home.outside": number(tally[["better", "differs"]].sum(skipna=False)),
        "home.smaller": number(tally["better"]),
        "home.weak": number(tally["weak"]),
        "home.ring_paper": number(ring["regenerated"].mean(), 1),
        "home.ring_best": number(ring["best"].mean(), 1),
        "home.ring_noisy": number(noisy["error_percent"].mean(), 1),
        "home.rig_own": number(rig["regenerated"].mean(), 2),
        "home.rig_printed": number(rig["published"].mean(), 2),
        "home.bend_paper": number(bend["regenerated"].mean(), 1),
        "home.bend_printed": number(bend["published"].mean(), 2),
    }
