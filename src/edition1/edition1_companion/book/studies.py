"""Studies that took minutes to hours: committed as tables with the settings that they were made with.

``<name>.csv`` holds the table and ``<name>.json`` the settings. The code that computed them is that of the last commit
of the first edition, which CHANGELOG.md names; the page of the second edition that shows a study computes it again.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from edition1.errors import bad_input
from edition1_companion.book.project import find_project


def read_study(name: str, folder: Path | None = None) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Table of a study and the settings that it was made with.

    Parameters
    ----------
    name
        Of the study.
    folder
        ``data/studies`` of the project when not given.

    Raises
    ------
    InputError
        If one of its two files is missing.
    """
    path = (folder or find_project().data / "studies") / f"{name}.csv"
    settings = path.with_suffix(".json")
    if not settings.is_file() or not path.is_file():
        raise bad_input("name", "read_study", "a study in data/studies with its settings", name)
    return pd.read_csv(path), json.loads(settings.read_text(encoding="utf-8"))


def joined(names: Sequence[str], folder: Path | None = None) -> pd.DataFrame:
    """Tables of studies, one below the other.

    Raises
    ------
    InputError
        If one of their files is missing.
    """
    return pd.concat([read_study(name, folder)[0] for name in names], ignore_index=True)
