"""The printed cells of Table 2 of Baaij et al. 2023 as a table, to stand beside regenerated ones."""

from __future__ import annotations

import pandas as pd

from repro_companion.book.project import find_project
from repro_companion.book.published import read_published


def published_table_2() -> pd.DataFrame:
    """Columns ``row, quantity, unit, published, published_std``, in the order of the paper."""
    rows = [
        (key.row, key.quantity, key.unit, float(cell.value), float(cell.std))
        for key, cell in read_published(find_project().published).items()
        if (key.paper, key.artefact) == ("baaij2023", "Table 2")
    ]
    return pd.DataFrame(rows, columns=["row", "quantity", "unit", "published", "published_std"])
