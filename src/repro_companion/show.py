"""What a page writes and shows: tables, sentences, values in its text."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd


def project_folder() -> Path:
    """Return the checkout that the working directory is in."""
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "data" / "published").is_dir():
            return folder
    raise FileNotFoundError("Go to a checkout of the project: its data/ is needed.")


def results_folder() -> Path:
    """Return where tables are written: REPRO_RESULTS, else runs/tables of the project."""
    return Path(os.environ.get("REPRO_RESULTS") or project_folder() / "runs" / "tables")


def save(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Write a table to the results and return what was written."""
    path = results_folder() / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    frame.to_csv(path, index=False, float_format="%.10g", lineterminator="\n")
    return pd.read_csv(path, keep_default_na=False, na_values=[""])
