"""What a page writes and shows: tables, intervals, and sentences."""

from __future__ import annotations

import os
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from pandas.io.formats.style import Styler

from repro_companion.run import check_value, declared, project_folder

KEY = ["paper", "artefact", "row", "quantity", "unit"]
"""What tells a printed number from all others."""
ROW_COLUMNS = [
    *KEY, "regenerated", "regenerated_std", "n_seeds", "setting", "best", "best_method", "note", "comparable"
]  # fmt: skip
"""Columns of what a page regenerates, ``<name>.rows.csv``."""


_TEMPLATES = Environment(
    loader=PackageLoader("repro_companion"),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    autoescape=False,
)


def rendered(template: str, **values: object) -> str:
    """Return a template of this package, ``templates/<template>``, filled with values, which are HTML already."""
    return _TEMPLATES.get_template(template).render(values)


_TEMPLATES.filters["fixed"] = lambda value, digits: f"{value:.{digits}f}"
_TEMPLATES.filters["percent_less"] = lambda value: f"{abs(value):.0f} % {'less' if value > 0 else 'more'}"


def sentences(template: str, **values: object) -> str:
    """Return a paragraph of words: a template filled with values, its lines joined by blanks."""
    lines = _TEMPLATES.from_string(template).render(values).splitlines()
    return " ".join(line.strip() for line in lines if line.strip())


def fold(title: str, text: str) -> str:
    """Return a text that a reader unfolds by its title."""
    return f"`````{{dropdown}} {title}\n{text}\n`````"


def checked(page: str, values: Mapping[str, object]) -> Path:
    """Return the checkout; refuse another folder, and values that the parameters of a page cannot have.

    ``repro run`` has looked at them before, but papermill and Jupyter have not.
    """
    root = project_folder()
    for one in declared(root / "notebooks" / f"{page}.ipynb").values():
        check_value(one, values.get(one.name), f"{page}.ipynb", repr(values.get(one.name)))
    return root


def results_folder() -> Path:
    """Return where tables are written: REPRO_RESULTS, else runs/tables of the project."""
    return Path(os.environ.get("REPRO_RESULTS") or project_folder() / "runs" / "tables")


def save(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Write a table to the results and return what was written."""
    path = results_folder() / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    frame.to_csv(path, index=False, float_format="%.10g", lineterminator="\n")
    return pd.read_csv(path, keep_default_na=False, na_values=[""])


def study(name: str) -> pd.DataFrame:
    """Return a committed study, a table of ``data/studies``."""
    return pd.read_csv(project_folder() / "data" / "studies" / f"{name}.csv")


def rows(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Write numbers that a page regenerates for the scorecard, as ``<name>.rows.csv``; return what was written."""
    unknown = ", ".join(column for column in frame if column not in ROW_COLUMNS)
    if unknown:
        raise ValueError(f"Rows of {name} have columns that the scorecard does not know: {unknown}.")
    full = frame.reindex(columns=ROW_COLUMNS)
    for column in (*KEY, "regenerated", "setting"):
        if full[column].isna().to_numpy().any():
            raise ValueError(f"A row of {name} has no {column}.")
    if full.duplicated(KEY).any():
        raise ValueError(
            f"{name} regenerates a number twice: {full.loc[full.duplicated(KEY), KEY].to_csv(index=False)}"
        )
    full["n_seeds"] = full["n_seeds"].astype("Int64")
    full["comparable"] = ["false" if value is False else "true" for value in full["comparable"]]
    return save(full, f"{name}.rows")


def mean_ratio(values: np.ndarray, reference: np.ndarray | float, resamples: int = 10_000) -> np.ndarray:
    """Return a ratio of means over draws ``[draw, ...]`` and the ends of its interval (95 %) ``[3, ...]``.

    The interval is a bootstrap, paired over the draws.
    """
    values, reference = np.broadcast_arrays(values, reference)
    again = np.random.default_rng(0).integers(len(values), size=(resamples, len(values)))
    ends = np.quantile(values[again].mean(1) / reference[again].mean(1), [0.025, 0.975], axis=0)
    return np.stack([values.mean(0) / reference.mean(0), *ends])


def number(value: object, digits: int = 3) -> str:
    """Return a number with so many significant digits, a whole number exactly, a dash for nothing."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if pd.isna(value):
        return "–"
    if isinstance(value, int | np.integer):
        text = f"{value:,}" if abs(value) >= 10_000 else str(value)
    elif np.isinf(value):
        text = "∞" if value > 0 else "-∞"
    elif value and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa} × 10{str(int(exponent)).translate(_RAISED)}"
    else:
        text = f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")
    return text.replace("-", "−")


_TEMPLATES.filters["two"] = lambda value: number(value, 2)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def show(frame: pd.DataFrame, names: Mapping[str, str] | None = None, digits: int = 3) -> Styler:
    """Return a table as it is read: headings in words, so many significant digits."""
    table = frame.rename(columns=dict(names or {})).reset_index(drop=True)
    numeric = [pd.api.types.is_numeric_dtype(table[column]) for column in table]
    sides = {True: "text-align: right", False: "text-align: left"}
    aligned = {
        column: [{"selector": "", "props": sides[is_number]}]
        for column, is_number in zip(table, numeric, strict=True)
    }
    content = sha256(table.to_csv().encode()).hexdigest()
    styler = Styler(table, uuid=content[:8]).hide(axis="index").set_table_styles(aligned)
    styler.set_table_attributes('class="dataframe shown"')
    return styler.format(lambda value: number(value, digits), escape="html")


def say(*parts: object) -> None:
    """Show sentences, as Markdown, tables and figures, one below the other; an empty sentence is nothing."""
    from IPython.display import Markdown, display

    for part in parts:
        if not isinstance(part, str):
            display(part)
        elif part:
            display(Markdown(part))
