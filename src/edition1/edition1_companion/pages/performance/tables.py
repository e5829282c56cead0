"""The benchmark's table, arranged for the page "Performance"; nothing is timed here."""

from __future__ import annotations

import numpy as np
import pandas as pd

from edition1_companion.pages.performance.rows import ARITHMETIC, KINDS

LIVE = ", live"
"""Ends the names of lines with one robot at a time."""
BOUND_BY = {
    "time step, 3 LM iterations": "a chain of dependent operations for each sensor and magnet, one number at a time: "
    "see the share of the arithmetic limit",
    "time step, 20 gradient": "products with the layers of the network, which vector instructions already share",
    "training set": "the multipole series of every sensor and magnet, and the random numbers of the draws",
    "particle filter": "random numbers, a quarter of a step, and what a step costs in Python around its kernels; "
    "the reference is the field alone",
    "PCC-extended": "the reference is vectorised, too: both pay for the square roots and divisions of every link",
}
"""What a rate is bound by where it misses a target, by the start of the capability."""


def with_targets(table: pd.DataFrame) -> pd.DataFrame:
    """Lines of capabilities that have targets: those of ``results/bench.csv``.

    Parameters
    ----------
    table
        From :func:`bench.capabilities.benchmark`, or read from ``data/benchmark.csv``.
    """
    return table.loc[table["met"].notna() & table["kind"].isin(KINDS)]


def target_table(table: pd.DataFrame) -> pd.DataFrame:
    """Targets beside what was measured; exponents, of which less is better, come last."""
    columns = ["capability", "met", "ours", "target", "ratio", "target_ratio", "unit", "kind"]
    shown = table.loc[table["met"].notna(), columns]
    return shown.assign(met=shown["met"].astype(bool)).reset_index(drop=True)


def missed(table: pd.DataFrame) -> pd.DataFrame:
    """Lines whose targets are not met, with what bounds them: ``bound_by`` in place of ``met``."""
    found = target_table(table).loc[lambda lines: ~lines["met"]]
    reasons = [
        next(
            (why for start, why in BOUND_BY.items() if name.startswith(start)),
            "the growth of the work itself",
        )
        for name in found["capability"]
    ]
    found["met"] = reasons
    return found.rename(columns={"met": "bound_by"}).reset_index(drop=True)


def ratios_of_kind(table: pd.DataFrame, kind: str) -> pd.DataFrame:
    """Lines of one kind of ratio.

    Parameters
    ----------
    table
        As for :func:`with_targets`.
    kind
        One of :data:`~edition1_companion.pages.performance.rows.KINDS`.
    """
    columns = ["capability", "ours", "reference", "unit", "ratio", "error", "note"]
    return table.loc[table["kind"] == kind, columns].reset_index(drop=True)


def arithmetic(table: pd.DataFrame) -> pd.DataFrame:
    """Kernels, their rates, the limits and the shares of them that are reached."""
    found = table.loc[table["kind"] == ARITHMETIC]
    names = found["capability"].str.removeprefix(f"{ARITHMETIC}: ")
    columns = {"ours": "rate", "reference": "limit", "ratio": "share of the limit"}
    return (
        found.assign(kernel=names)
        .rename(columns=columns)[["kernel", "rate", "unit", "limit", "share of the limit", "note"]]
        .reset_index(drop=True)
    )


def exponent(size: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """Exponent of the power law through the largest decade of the sizes, and the largest relative deviation from it.

    Examples
    --------
    >>> size = np.array([1.0, 10.0, 100.0])
    >>> print("%.2f, %.2f" % exponent(size, 3 * size**1.5))
    1.50, 0.00
    """
    last = size >= size.max() / 10 * (1 - 1e-9)
    x, y = np.log(size[last]), np.log(cost[last])
    slope, offset = np.polyfit(x, y, 1)
    return float(slope), float(np.abs(np.expm1(y - slope * x - offset)).max())


def exponents(points: pd.DataFrame) -> pd.DataFrame:
    """Exponent of every scaling curve: columns ``capability, against, exponent, deviation``.

    Parameters
    ----------
    points
        From :func:`bench.scaling.scaling`, or read from ``data/benchmark_scaling.csv``.
    """
    rows = []
    for key, part in points.groupby(["capability", "against"], sort=False):
        found = exponent(part["size"].to_numpy(float), part["seconds"].to_numpy(float))
        rows.append((*key, *found))
    return pd.DataFrame(rows, columns=["capability", "against", "exponent", "deviation"])
