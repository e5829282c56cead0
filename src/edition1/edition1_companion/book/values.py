"""Results in words: a page gives values, and the build puts them where its text or another page names them.

A cell of a notebook calls ``give(ratio=f"{x:.2f}")``. ``{{ratio}}`` then stands for the value in the notebook's own
Markdown cells, captions and alternative texts, and ``{{table_1.ratio}}`` on every other page of the book. No result
is typed. Sentences that belong to one place need none of this: a cell displays them with ``say``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from edition1.errors import bad_input, require
from edition1_companion.book.formatted import as_read

if TYPE_CHECKING:
    from nbformat import NotebookNode

KIND = "application/vnd.repro.values+json"
VOUCHED = re.compile(r"\{(?:paper|setting)\}`([^`]*)`")
"""Roles that say where a number comes from; captions and alternative texts keep the number alone."""
PLACE = re.compile(r"\{\{\s*([a-z_][\w.]*)\s*\}\}")


def give(**values: str) -> None:
    """Make results known to the text, as they are to be read: with their digits and, where the text varies, words."""
    from IPython.display import display

    for name, value in values.items():
        require(isinstance(value, str), name, "give", "a text, with the digits that are to be read", value)
    display({KIND: {name: as_read(value) for name, value in values.items()}, "text/plain": ""}, raw=True)


def say(*sentences: str) -> None:
    """Show sentences in place, each an f-string of results, as a paragraph of Markdown."""
    from IPython.display import Markdown, display

    display(Markdown(as_read(" ".join(sentences))))


def filled(text: str, values: Mapping[str, str], place: str) -> str:
    """Return a text with values in place of their names.

    Parameters
    ----------
    text
        With ``{{name}}``.
    values
        By name.
    place
        Where the text stands, for the message.

    Raises
    ------
    InputError
        If a name has no value.
    """

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise bad_input(match[0], place, f"one of {', '.join(sorted(values)) or 'none'}", match[1])
        return values[match[1]]

    return PLACE.sub(value, text)


def fill(notebook: NotebookNode, name: str) -> None:
    """Put the values that the cells of an executed notebook gave into its text, and keep them in its metadata.

    Raises
    ------
    InputError
        If the text names a value that no cell gave.
    """
    values: dict[str, str] = {}
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            values |= output.get("data", {}).get(KIND, {})
        if "outputs" in cell:
            cell.outputs = [output for output in cell.outputs if KIND not in output.get("data", {})]
    for number, cell in enumerate(notebook.cells):
        place = f"cell {number} of {name}"
        if cell.cell_type == "markdown":
            cell.source = filled(cell.source, values, place)
        about = cell.metadata.get("mystnb", {})
        for part, key in (("figure", "caption"), ("image", "alt")):
            if key in about.get(part, {}):
                text = filled(about[part][key], values, f"{key} in {place}")
                about[part][key] = VOUCHED.sub(r"\1", text)
    notebook.metadata.setdefault("repro", {})["values"] = values
