"""The appendix for those who judge the project: for each claim a command, what it costs, and what comes out of it."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from repro_companion.claims import CLAIMS, NUMBER
from repro_companion.compare import allowed, read_tolerances, row_texts
from repro_companion.scorecard import TIMING
from repro_companion.show import KEY, number, rendered

MEASURED = Path("book/measured.csv")
"""What each page takes on the computer that it names: ``scripts/artifact.py --measure`` writes it."""
LAST_DIGITS = 1e-4
"""A tolerance up to which only digits move that no page shows."""
DURATION = re.compile(r": ([\w ]+ (?:minutes?|hours?|hour))\.$")
"""How the first line of a study's docstring ends."""


def appendix(
    root: Path, claims: pd.DataFrame, titles: Mapping[str, str], papers: Mapping[str, str]
) -> dict[str, str]:
    """Return what the page *For evaluators* includes, by the names of its files; claims have their numbers."""
    measured = pd.read_csv(root / MEASURED).set_index("what")
    # A page that is new has a line, too; a test asks for its times.
    measured = measured.reindex(measured.index.union(claims["page"].unique())).fillna({"tables": ""})
    named = pd.read_csv(root / CLAIMS, dtype=str, keep_default_na=False)["found"].map(NUMBER.findall)
    pages = measured.loc[[what for what in measured.index if what.startswith("notebooks/")]]
    lines = [
        {
            **claim,
            **measured.loc[claim["page"], ["minutes", "megabytes"]],
            "name": claim["page"].rpartition("/")[2],
            "title": titles[claim["page"]],
            "paper": papers[claim["paper"]],
            "moves": ", ".join(dict.fromkeys(may_move(root, pages.loc[claim["page"], "tables"], names))),
        }
        for claim, names in zip(claims.to_dict("records"), named, strict=True)
    ]
    speed = pd.read_csv(root / "data/benchmark.csv")
    return {
        "artifact_claims.md": rendered(
            "artifact_claims.md", claims=lines, site=measured.loc["site"], pages=pages
        ),
        "artifact_studies.md": rendered("artifact_studies.md", studies=studies(root)),
        "artifact_speed.md": rendered(
            "artifact_speed.md", rows=speed[speed["target"].notna()].to_dict("records"), shown=in_code
        ),
    }


def may_move(root: Path, tables: str, names: list[str]) -> list[str]:
    """Return how far the numbers that a claim names may move on another processor, as words."""
    keys = [name.split("|") for name in names if "|" in name]
    lines, said = read_tolerances(root), []
    for table in tables.split():
        if not table.endswith(".rows.csv"):
            continue
        rows = pd.read_csv(root / "results" / table, keep_default_na=False, na_values=[""])
        # A rate is a copy from data/benchmark.csv: the page does not measure it.
        here = rows["setting"] != TIMING
        chosen = [list(key) in keys for key in rows[KEY[1:]].to_numpy()] & here.to_numpy()
        moved = allowed(row_texts(rows), table.removesuffix(".csv"), "regenerated", lines)
        said += [in_words(tolerance) for tolerance in moved[chosen]]
    return said


def in_words(tolerance: float) -> str:
    """Return a tolerance, in parts of the largest number of its column, as words."""
    if tolerance <= LAST_DIGITS:
        return "last digits"
    return f"{number(100 * tolerance, 1)} %" if tolerance < 1 else "any: the step is chaotic"


def studies(root: Path) -> list[dict[str, str]]:
    """Return every committed study with its command, what it holds, and how long it takes."""
    tree = ast.parse((root / "scripts/studies.py").read_text(encoding="utf-8"))
    texts = {
        node.name: ast.get_docstring(node) or "" for node in tree.body if isinstance(node, ast.FunctionDef)
    }
    found = []
    for path in sorted((root / "data/studies").glob("*.csv")):
        first = texts.get(path.stem, "Return figures of a robot whose files have no licence.").partition(
            "\n"
        )[0]
        takes = DURATION.search(first)
        script = (
            "studies.py " + path.stem if path.stem in texts else path.stem.replace("others_", "others.py ", 1)
        )
        found.append(
            {
                "command": f".venv/bin/python scripts/{script}",
                "holds": in_code(DURATION.sub("", first).removeprefix("Return ").rstrip(".")),
                "takes": takes[1] if takes else "–",
            }
        )
    return found


def in_code(text: str) -> str:
    """Return a text whose names of functions and pages are code."""
    return re.sub(r"\b[A-Za-z]\w+_\w+\b", r"`\g<0>`", text)
