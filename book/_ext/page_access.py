"""Corrections to the theme's pages for readers who use a keyboard or a screen reader."""

from __future__ import annotations

import re


def accessible(text: str) -> str:
    """Return the HTML of a page with the names and tab stops that theme and extensions leave out."""
    return named_by_their_text(named_summaries(one_name_for_search(text)))


def one_name_for_search(text: str) -> str:
    """Let the search button be named by what is written on it: a label that says less hides the keys."""
    return re.sub(r'(<button class="btn search-button-field[^>]*?) aria-label="[^"]*"', r"\1", text)


def named_summaries(text: str) -> str:
    """Name the arrows that unfold the table of contents: they hold a picture only."""
    return text.replace(
        '<summary><span class="toctree-toggle"',
        '<summary aria-label="Pages below"><span class="toctree-toggle"',
    )


def named_by_their_text(text: str) -> str:
    """Let what unfolds a cell be named by what is written on it: Show code cell source."""
    return text.replace('<summary aria-label="Toggle hidden content">', "<summary>")
