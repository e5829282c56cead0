"""What a page shows of its alternatives below the form: the command, and a table before and after the change."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from edition1_companion.book.after.alternatives import Alternative, run_folder
from edition1_companion.book.formatted import table_html
from edition1_companion.book.project import Project
from edition1_companion.book.run_form import command_line

if TYPE_CHECKING:
    from pandas import DataFrame

WHOLE = ("this run", "this run first", "this run as well")
"""What the exercise asks for where the alternative is no smaller run."""


def check(one: Alternative) -> str:
    """Return what stands below an exercise that asks for the run of the first alternative, or for a larger one."""
    run = "this run" if one.exercise in WHOLE else "a smaller run"
    return f'\n\n<p><a href="#before-after-0">Check your prediction: {run}, before and after</a></p>'


def compared(one: Alternative, before: DataFrame, after: DataFrame) -> DataFrame:
    """Return the values of two runs beside each other, with words as headings.

    Parameters
    ----------
    one
        What is compared.
    before, after
        Its table in the two runs.
    """
    from pandas import concat

    sides = {"before": _measured(one, before), "after": _measured(one, after)}
    beside = concat(sides, axis=1).swaplevel(axis=1)
    columns = [(value, side) for value in one.values for side in sides]
    table = beside[columns].rename_axis(index=list(one.rows.values()) or None)
    table.columns = [f"{value}, {side}" for value, side in columns]
    return table.reset_index() if one.rows else table.reset_index(drop=True)


def _measured(one: Alternative, table: DataFrame) -> DataFrame:
    chosen = table.query(one.where) if one.where else table
    values = chosen.assign(**{name: chosen.eval(how) for name, how in one.values.items()})
    by = [chosen.eval(row) for row in one.rows] or [0] * len(values)
    return values.groupby(by, sort=False)[list(one.values)].mean()


def section(project: Project, stem: str, name: str, alternatives: list[Alternative]) -> str:
    """Return the comparisons of a page as Markdown with HTML, each folded, empty where it has none.

    Parameters
    ----------
    project
        Where the tables lie.
    stem, name
        Name of the notebook without its ending, and its path as commands have it.
    alternatives
        From its metadata.
    """
    from pandas import read_csv

    blocks = []
    for number, one in enumerate(alternatives):
        places = [run_folder(project, stem, one.table, parameters) for parameters in one.runs().values()]
        tables = [read_csv(place / f"{one.table}.csv") for place in places]
        blocks.append(_block(one, number, name, compared(one, *tables)))
    return "\n".join(["### Before and after", "", *blocks]) if blocks else ""


def _block(one: Alternative, number: int, name: str, table: DataFrame) -> str:
    exact = list(one.rows.values())
    words = {column: column for column in table.columns}
    asked = f'<a href="#exercise">The exercise</a> asks for {escape(one.exercise)}. ' if one.exercise else ""
    before = (
        f"Before: the same with <code>{escape(_named(one.both))}</code>" if one.both else "Before: this page"
    )
    return (
        f'<details class="before-after"><summary>Before and after: {escape(one.title)}</summary>'
        f'<p id="before-after-{number}">{asked}{before}. After:</p>'
        '<div class="highlight-none notranslate"><div class="highlight"><pre tabindex="0">'
        f"{escape(command_line(name, one.both | one.parameters))}</pre></div></div>"
        f"{table_html(table, words, exact=exact).data}</details>\n"
    )


def _named(values: Mapping[str, Any]) -> str:
    return command_line("", values).partition("-p ")[2].replace(" -p ", ", ")
