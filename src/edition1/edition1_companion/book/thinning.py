"""Large tables of the book keep some of their rows: what is only drawn need not be committed whole."""

from __future__ import annotations

from itertools import compress
from pathlib import Path

import pandas as pd

from edition1.files import write_whole


def thin(tables: Path, listed: Path) -> None:
    """Keep every k-th value of the last key in the tables of a folder that ``data/thinned.csv`` lists.

    Parameters
    ----------
    tables
        The folder.
    listed
        Lines ``table,keys,every``: the columns that tell rows apart, and ``k``. All rows with a value that is kept
        stay as they are.
    """
    for table, keys, every in pd.read_csv(listed).itertuples(index=False):
        path = tables / f"{table}.csv"
        if path.is_file():
            values = pd.read_csv(path)[keys.split()[-1]]
            kept = values.rank(method="dense").sub(1).mod(every) == 0
            header, *lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
            write_whole(path, header + "".join(compress(lines, kept)))
