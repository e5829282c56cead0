"""What the errors of the three ways to see one robot say about which one to build (synthetic)."""

from __future__ import annotations

import pandas as pd

from repro.errors import bad_input
from repro.kinematics.paper_robots import LENGTH_M, MAGNET_AXIAL_M
from repro_companion.book.bootstrap import interval, ratio_interval, resampled
from repro_companion.pages.one_robot.errors import CONDITIONS, QUANTITIES
from repro_companion.pages.one_robot.estimates import METHODS, cpu_times
from repro_companion.twins.segment_motion import TRAJECTORIES, motion
from repro_companion.twins.segment_robot import APART_M, draw_parts, simulate

KEYS = ["trajectory", "method", "calibrated", "condition"]
PARTS = {
    METHODS[0]: ("1 ring, 3 sensors of one axis", 4, 3, 100 * (1 - MAGNET_AXIAL_M / LENGTH_M)),
    METHODS[1]: ("1 cube, 1 sensor of three axes", 2, 3, 100 * APART_M / LENGTH_M),
    METHODS[2]: ("1 cube, 1 sensor of three axes", 2, 3, 100 * APART_M / LENGTH_M),
    METHODS[3]: ("2 IMUs", 2, 8, 100.0),
}
"""What is mounted, how many parts that is, numbers that are read at each step, and the share of the segment [%]
between the parts: of the rest nothing is measured."""
BOOTSTRAPS = 2000


def summary(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Means over the draws with their bootstrap 95 % intervals.

    Parameters
    ----------
    table
        From :func:`~repro_companion.pages.one_robot.errors.one_robot_errors`.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method, calibrated, condition``, then each of ``QUANTITIES`` with the ends of its
        interval, ``tip_low_mm`` and ``tip_high_mm`` and so on.
    """
    rows = []
    for key, part in table.groupby(KEYS, sort=False):
        row: dict[str, object] = dict(zip(KEYS, key, strict=True))
        for quantity in QUANTITIES:
            name, unit = quantity.rsplit("_", 1)
            values = part[quantity].to_numpy()
            low, high = interval(values[resampled(len(values), seed, bootstraps=BOOTSTRAPS)].mean(-1))
            row |= {quantity: values.mean(), f"{name}_low_{unit}": low, f"{name}_high_{unit}": high}
        rows.append(row)
    return pd.DataFrame(rows)


def ratios(table: pd.DataFrame, reference: str = METHODS[3], *, seed: int = 0) -> pd.DataFrame:
    """Mean tip error of every calibrated method over that of one of them, with a paired bootstrap 95 % interval.

    Parameters
    ----------
    table
        From :func:`~repro_companion.pages.one_robot.errors.one_robot_errors`.
    reference
        One of the methods.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method, ratio, low, high``.

    Raises
    ------
    InputError
        If there is no such method.
    """
    if reference not in METHODS:
        raise bad_input("reference", "ratios", f"one of {', '.join(map(repr, METHODS))}", repr(reference))
    chosen = table[table["calibrated"] & (table["condition"] == CONDITIONS[0])]
    wide = chosen.pivot(index=["trajectory", "draw"], columns="method", values="tip_mm")
    rows = []
    for name in TRAJECTORIES:
        errors = wide.loc[name]
        again = resampled(len(errors), seed, bootstraps=BOOTSTRAPS)
        below = errors[reference].to_numpy()
        for method in METHODS:
            if method != reference:
                above = errors[method].to_numpy()
                low, high = ratio_interval(above, below, again)
                rows.append((name, method, above.mean() / below.mean(), low, high))
    return pd.DataFrame(rows, columns=["trajectory", "method", "ratio", "low", "high"])


def overview(means: pd.DataFrame) -> pd.DataFrame:
    """One line per method and calibration: parts, errors with intervals as text, and what robustness costs.

    Parameters
    ----------
    means
        From :func:`summary`.

    Returns
    -------
    DataFrame
        ``parts``; the tip error on each trajectory; tip orientation and shape error under load; and tip errors on
        the constant curvature with the worst sensor failed and with the other magnet on board.
    """
    rows = []
    for method in METHODS:
        for known in (False, True):
            here = means[(means["method"] == method) & (means["calibrated"] == known)]
            cells = here.set_index(["trajectory", "condition"])
            steady, load = TRAJECTORIES[0], TRAJECTORIES[2]
            row = {"method": method, "calibrated": "yes" if known else "no", "parts": PARTS[method][1]}
            row |= {f"tip, {x} [mm]": _cell(cells, x, CONDITIONS[0], "tip_mm") for x in TRAJECTORIES}
            row |= {
                "orientation, load [deg]": _cell(cells, load, CONDITIONS[0], "orientation_deg"),
                "shape, load [mm]": _cell(cells, load, CONDITIONS[0], "shape_mm"),
                "tip, failed [mm]": _cell(cells, steady, CONDITIONS[1], "tip_mm"),
                "tip, other magnet [mm]": _cell(cells, steady, CONDITIONS[2], "tip_mm"),
            }
            rows.append(row)
    return pd.DataFrame(rows)


def latency(*, repeats: int = 200) -> pd.DataFrame:
    """Parts, numbers read per step, and the processor time of one estimate, which depends on the machine.

    Parameters
    ----------
    repeats
        Of every timing.

    Returns
    -------
    DataFrame
        Columns ``method, mounted, parts, numbers_per_step, seen_percent, cpu_ms``.
    """
    moved = motion(TRAJECTORIES[0], steps=40)
    times = cpu_times(simulate(moved, draw_parts(1)), moved.arcs_m, repeats=repeats)
    rows = [(method, *PARTS[method], 1e3 * times[method]) for method in METHODS]
    columns = ["method", "mounted", "parts", "numbers_per_step", "seen_percent", "cpu_ms"]
    return pd.DataFrame(rows, columns=columns)


def _cell(cells: pd.DataFrame, trajectory: str, condition: str, quantity: str) -> str:
    if (trajectory, condition) not in cells.index:
        return ""
    name, unit = quantity.rsplit("_", 1)
    row = cells.loc[(trajectory, condition)]
    return " ".join(
        (f"{row[quantity]:.2g}", f"({row[f'{name}_low_{unit}']:.2g}-{row[f'{name}_high_{unit}']:.2g})")
    )
