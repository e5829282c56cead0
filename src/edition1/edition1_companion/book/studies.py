"""Studies that take minutes: computed once, committed as tables with the settings that they were made with.

A study is a function and its settings; those of a page are the ``STUDIES`` of its module ``studies``. ``<name>.csv``
holds what the function returns and ``<name>.json`` the settings, so that a page can say what its numbers belong to,
and a change of the settings is noticed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from edition1.errors import bad_input
from edition1.files import write_whole

from edition1_companion.book.project import find_project


@dataclass(frozen=True)
class Study:
    """A table that takes long.

    Parameters
    ----------
    name
        Of the two files, without ending.
    compute
        Function that returns the table.
    settings
        Its keyword arguments, as JSON can hold them.
    needs
        Which of ``data`` (the folder), ``cache`` (of networks that are not kept) and ``progress`` the function takes
        besides.
    digits
        Significant digits of a number in the table.
    """

    name: str
    compute: Callable[..., pd.DataFrame]
    settings: dict[str, Any]
    needs: tuple[str, ...] = ()
    digits: int = 5


def write_studies(studies: Sequence[Study], folder: Path, *, progress: bool) -> list[Path]:
    """Compute the studies whose files are missing or belong to other settings; return the paths of all tables.

    A study is written as a whole when it is done, so that an interrupted call goes on with the next one. A change
    of the code alone is not noticed: remove a table to have it computed anew.

    Parameters
    ----------
    studies
        Those to compute.
    folder
        Where the tables are, ``data/studies``.
    progress
        Name each study on standard error as it starts, with progress bars.
    """
    project = find_project()
    available = {
        "data": project.data,
        "cache": project.cache / "networks",
        "progress": progress,
    }
    paths = []
    for study in studies:
        path = folder / f"{study.name}.csv"
        paths.append(path)
        if path.is_file() and _settings(path) == study.settings:
            continue
        if progress:
            print(study.name, file=sys.stderr, flush=True)
        table = study.compute(**study.settings, **{name: available[name] for name in study.needs})
        path.with_suffix(".json").unlink(missing_ok=True)  # never old settings beside a new table
        write_whole(path, table.to_csv(index=False, float_format=f"%.{study.digits}g", lineterminator="\n"))
        write_whole(path.with_suffix(".json"), json.dumps(study.settings, indent=1) + "\n")
    return paths


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
    settings = _settings(path)
    if settings is None or not path.is_file():
        raise bad_input(
            "name", "read_study", "a study in data/studies with its settings (make studies)", name
        )
    return pd.read_csv(path), settings


def committed(studies: Sequence[Study], folder: Path | None = None) -> pd.DataFrame:
    """Tables of studies, one below the other.

    Raises
    ------
    InputError
        If one of their files is missing.
    """
    return pd.concat([read_study(study.name, folder)[0] for study in studies], ignore_index=True)


def _settings(path: Path) -> dict[str, Any] | None:
    sidecar = path.with_suffix(".json")
    return json.loads(sidecar.read_text(encoding="utf-8")) if sidecar.is_file() else None
