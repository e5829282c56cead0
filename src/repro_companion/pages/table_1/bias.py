"""Whether the regenerated errors of Table 1 lie above or below the printed ones as a whole, and by how much."""

from __future__ import annotations

import numpy as np
import pandas as pd

from repro_companion.twins.table_1_rows import ROWS

NOT_OBSERVABLE = "n_s=6"
"""Row whose errors are those of an estimate that drifts."""


def bias_table(errors: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Geometric mean of regenerated over printed errors [%], by number of segments and over all.

    Each simulation counts once, whatever rows of Table 1 it is printed in; the row that does not determine its
    variables is left out.

    Parameters
    ----------
    errors
        Columns ``row, seed, quantity, unit, error``: of the networks of each seed.
    published
        Columns ``row, quantity, unit, published, published_std``.

    Returns
    -------
    pandas.DataFrame
        ``n_b`` (a number of segments, or all, as text), ``cells``, ``below`` (cells whose mean over the seeds is
        below print), ``ratio`` (of these means), ``lowest_seed`` and ``highest_seed`` (of a single seed's errors),
        ``std_ratio`` (of the standard deviations over the seeds; NaN for one seed).
    """
    segments, keys = {row.name: row.n_segments for row in ROWS}, ["row", "quantity", "unit"]
    kept = errors[(errors["unit"] == "%") & (errors["row"] != NOT_OBSERVABLE)]
    cells = kept.merge(published[[*keys, "published", "published_std"]], on=keys)
    n_b = cells["row"].map(segments)
    lines = []
    for label, group in [*cells.groupby(n_b), ("all", cells)]:
        by_cell = group.groupby(keys)
        mean, std = by_cell["error"].mean(), by_cell["error"].std()
        printed, printed_std = by_cell["published"].first(), by_cell["published_std"].first()
        by_seed = np.log(group["error"] / group["published"]).groupby(group["seed"]).mean()
        lines.append(
            {
                "n_b": str(label),
                "cells": len(mean),
                "below": int((mean < printed).sum()),
                "ratio": np.exp(np.log(mean / printed).mean()),
                "lowest_seed": np.exp(by_seed.min()),
                "highest_seed": np.exp(by_seed.max()),
                "std_ratio": np.exp(np.log(std / printed_std).mean()),
            }
        )
    return pd.DataFrame(lines)


def bias_by_factor(errors: pd.DataFrame, changed: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """What changing one factor of the training does to the ratio to print, without an Earth field.

    Parameters
    ----------
    errors, published
        As in :func:`bias_table`, of the recipe as released.
    changed
        As ``errors``, with a column ``factor``
        (:func:`repro_companion.pages.table_1.factors.factor_errors`).

    Returns
    -------
    pandas.DataFrame
        ``changed`` (``nothing``, or a factor), then the columns of :func:`bias_table` by number of segments.
    """
    still = {row.name for row in ROWS if row.earth_axis is None}
    tables = {"nothing": errors[errors["row"].isin(still)]} | dict(
        list(changed.groupby("factor", sort=False))
    )
    parts = [bias_table(table, published).assign(changed=name) for name, table in tables.items()]
    whole = pd.concat(parts, ignore_index=True).query("n_b != 'all'")
    return whole[["changed", *whole.columns.drop("changed")]].sort_values(
        "n_b", kind="stable", ignore_index=True
    )
