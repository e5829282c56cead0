"""What the papers claim, what we find, and why: a table on each page, and the headlines on the home page."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from repro_companion.show import number, rendered

CLAIMS = Path("data/published/claims.csv")
"""Claims with the section that makes them; {...} in what we find names a number."""
CLAIM = ["paper", "section", "page", "headline", "claim", "found", "why"]
NUMBER = re.compile(r"\{([^}]*)\}")


def claims_of(root: Path, card: pd.DataFrame, home: Mapping[str, str]) -> pd.DataFrame:
    """Return all claims, with our numbers in place: of the scorecard, or of those that the home page says."""
    claims = pd.read_csv(root / CLAIMS, dtype=str, keep_default_na=False)
    return claims.assign(found=claims["found"].map(lambda text: filled(text, card, home)))


def filled(text: str, card: pd.DataFrame, home: Mapping[str, str]) -> str:
    """Return a text with its numbers: {name} of the home page, {artefact|row|quantity|unit} of the scorecard.

    These have two digits; from ten on at most three, with the decimals of print, as in the tables below.
    """

    def value(match: re.Match[str]) -> str:
        name, *rest = match[1].split("|")
        if not rest:
            return home[name]
        artefact, row, quantity, unit = name, *rest
        chosen = card[
            (card["artefact"] == artefact)
            & (card["row"] == row)
            & (card["quantity"] == quantity)
            & (card["unit"] == unit)
        ]
        if len(chosen) != 1:
            raise ValueError(f"{CLAIMS} names {match[0]}, which is {len(chosen)} rows of the scorecard.")
        found = float(chosen["regenerated"].iloc[0])
        decimals = len(chosen["published"].iloc[0].partition(".")[2])
        return number(found, 2) if abs(found) < 10 else f"{float(f'{found:.3g}'):.{decimals}f}"

    return NUMBER.sub(value, text)


def claims_table(claims: pd.DataFrame, page: str) -> str:
    """Return the table of one page, empty where a page has no claim to judge."""
    return rendered("claims.md", claims=claims[claims["page"] == page].to_dict("records"))


def headlines(claims: pd.DataFrame, titles: Mapping[str, str], papers: Mapping[str, str]) -> str:
    """Return the headline claims of all papers, each with its page."""
    rows = claims[claims["headline"] == "yes"].assign(
        title=claims["page"].map(dict(titles)), paper=claims["paper"].map(dict(papers))
    )
    return rendered("headlines.md", claims=rows.to_dict("records"))
