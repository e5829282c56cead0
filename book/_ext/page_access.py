"""Corrections to the theme's pages for readers who use a keyboard or a screen reader."""

from __future__ import annotations

import re

CELL = re.compile(r"<(t[hd])\b([^>]*)>(.*?)</t[hd]>", re.S)
"""A cell of a table: its tag, its attributes, and what stands in it."""


def accessible(text: str) -> str:
    """Return the HTML of a page with the names and tab stops that theme and extensions leave out."""
    named = named_by_their_text(named_summaries(one_name_for_search(text)))
    return formulas_with_their_stops(whole_options(with_headings(figures_in_full(named))))


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


def formulas_with_their_stops(text: str) -> str:
    """Keep a formula and the comma or stop after it on one line: browsers may break between them."""
    return re.sub(
        r'(?<!<span class="together">)(<span class="math[^>]*>[^<]*</span>[,.;:?!)]+)',
        r'<span class="together">\1</span>',
        text,
    )


def figures_in_full(text: str) -> str:
    """Let a figure that leads nowhere lead to its file: there it is as large as it is drawn, or as a reader likes."""
    return re.sub(
        r'(<a\b[^>]*>\s*)?(<img\b[^>]*\bsrc="((?:\.\./)*_images/[^"]+)"[^>]*>)',
        lambda found: (
            found[0] if found[1] else f'<a class="in-full" href="{found[3]}" title="In full">{found[2]}</a>'
        ),
        text,
    )


def with_headings(text: str) -> str:
    """Give each cell of a table ``as-cards`` its heading and mark dashes: narrow screens show neither."""
    return re.sub(
        r'<table class="[^"]*\bas-cards\b.*?</table>', lambda found: _headed(found[0]), text, flags=re.S
    )


def _headed(table: str) -> str:
    head, body, rest = re.split(r"(<tbody>.*</tbody>)", table, flags=re.S)
    above, names = re.findall(r"<tr\b.*?</tr>", head, re.S), {}
    for row, places in zip(above, _columns(above), strict=True):
        for (_, _, content), place in zip(CELL.findall(row), places, strict=True):
            text = re.sub(r"<[^>]*>", "", content).strip().replace('"', "&quot;")
            names |= dict.fromkeys(place, text)
    rows = re.split(r"(?=<tr\b)", body)
    first = (place[0] for places in _columns(rows) for place in places)

    def named(cell: re.Match[str]) -> str:
        column = next(first)
        if cell[1] == "th" or "data-heading=" in cell[2]:
            return cell[0]
        missing = " data-missing" if cell[3] == "<p>—</p>" and "data-missing" not in cell[2] else ""
        return f'<td data-heading="{names.get(column, "")}"{cell[2]}{missing}>{cell[3]}</td>'

    return head + CELL.sub(named, "".join(rows)) + rest


def _columns(rows: list[str]) -> list[list[range]]:
    """Return the columns of each row's cells, where a cell may take several, and those of rows below."""
    left: dict[int, int] = {}  # how many rows a cell above still takes, by column
    found = []
    for row in rows:
        places, column = [], 0
        for _, attributes, _ in CELL.findall(row):
            while left.get(column):
                column += 1
            spans = dict(re.findall(r'\b(colspan|rowspan)="(\d+)"', attributes))
            places.append(range(column, column + int(spans.get("colspan", 1))))
            column = places[-1].stop
            left |= dict.fromkeys(places[-1], int(spans.get("rowspan", 1)))
        left = {column: rows_left - 1 for column, rows_left in left.items()}
        found.append(places)
    return found


def whole_options(text: str) -> str:
    """Keep the hyphens of options beside their names, where a browser would break the line between them."""
    text = re.sub(r'<span class="pre">(?=--?[a-z])', '<span class="pre whole">', text)
    return re.sub(
        r'<div class="highlight-(?:ba)?sh\b.*?</pre>',
        lambda block: re.sub(r"(?<=[\s>])--?[A-Za-z][\w-]*", r'<span class="whole">\g<0></span>', block[0]),
        text,
        flags=re.S,
    )


def schematics_in_full(text: str, name: str, images: str) -> tuple[str, dict[str, str]]:
    """Let each schematic, which is drawn within its page, lead to a file of its own, as other figures do.

    Parameters
    ----------
    text
        The page.
    name
        What the names of the files begin with.
    images
        Address of their folder, seen from the page.

    Returns
    -------
    str
        The page with links.
    dict
        The text of each file by its name.
    """
    files: dict[str, str] = {}

    def linked(found: re.Match[str]) -> str:
        file = f"{name}-{len(files) + 1}.svg"
        head = '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"'
        files[file] = re.sub(r' style="[^"]*"', "", found[2], count=1).replace("<svg", head, 1)
        return f'{found[1]}<a class="in-full" href="{images}{file}" title="In full">{found[2]}</a>'

    pattern = r'(<figure class="schematic">\s*)(<svg\b.*?</svg>)'
    return re.sub(pattern, linked, text, flags=re.S), files
