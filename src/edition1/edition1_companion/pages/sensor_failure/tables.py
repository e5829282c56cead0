"""Sensor failure (Baaij et al. 2023, Figs 4b and 5) as tidy tables: errors, ratios, courses over time, stills."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from torch import Tensor

from edition1_companion.book.bootstrap import ratio_interval, resampled
from edition1_companion.pages.sensor_failure.failure import ROW, RUNS, Estimates, Failure, times
from edition1_companion.twins.robot_tables import backbones, mounted_parts

TARGET = 1.2
"""Largest error after the failure that counts as compensated, relative to the error before."""
AUTHORS_PERCENT = {
    "before": (3.5, 3.8, 3.5, 2.8, 3.1, 3.6, 1.5, 1.3, 2.4),
    "after": (3.7, 5.8, 5.8, 2.2, 3.0, 5.1, 1.6, 2.2, 3.5),
}
"""Errors of the authors' released networks on regenerated data, in the order of the coordinates; not in print."""
PRIOR_PERCENT = 100 / math.sqrt(12)
"""Standard deviation of a uniform distribution over the range of a coordinate: what is known without readings."""


def errors_by_run(estimates: Estimates, failure: Failure) -> pd.DataFrame:
    """Errors of eq. (13) before and after the failure, one row per member, run, part and coordinate.

    Columns: ``member``, ``run``, ``part`` (before, after), ``quantity``, ``error_percent`` (relative RMSE over the
    steps of the part, in per cent of the range over the whole trajectory) and, where the estimator reports one,
    ``deviation_percent`` (root mean square of the reported standard deviation, likewise).
    """
    span = estimates.q.amax(0) - estimates.q.amin(0)
    relative = {"error_percent": (estimates.q_hat - estimates.q[:, None, None]) / span}
    if estimates.deviation is not None:
        relative["deviation_percent"] = estimates.deviation / span
    after = failure.after(len(estimates.q))
    members, coordinates = range(estimates.q_hat.shape[1]), ROW.robot().coordinates
    tables = []
    for part, steps in (("before", ~after), ("after", after)):
        index = pd.MultiIndex.from_product([members, RUNS, coordinates], names=["member", "run", "quantity"])
        table = pd.DataFrame(
            {name: 100 * x[steps].square().mean(0).sqrt().flatten().numpy() for name, x in relative.items()},
            index=index,
        )
        tables.append(table.reset_index().assign(part=part))
    return pd.concat(tables, ignore_index=True).reindex(
        columns=["member", "run", "part", "quantity", *relative]
    )


def errors_with_authors(table: pd.DataFrame) -> pd.DataFrame:
    """Errors of the paper's method with our networks, beside those of the authors' released networks.

    Columns: ``quantity``; mean and sample standard deviation over seeds of the error before and after the failure
    and of the run with all sensors over the same steps as after (``before_percent``, ``before_percent_std`` and so
    on: ``after``, ``all_sensors``); ``authors_before_percent``, ``authors_after_percent``.

    Parameters
    ----------
    table
        From :func:`errors_by_run`.
    """
    parts = {
        "before": table.query("run == 'failure' and part == 'before'"),
        "after": table.query("run == 'failure' and part == 'after'"),
        "all_sensors": table.query("run == 'all sensors' and part == 'after'"),
    }
    columns = {}
    for name, part in parts.items():
        by_quantity = part.groupby("quantity", sort=False)["error_percent"]
        columns |= {f"{name}_percent": by_quantity.mean(), f"{name}_percent_std": by_quantity.std()}
    authors = {f"authors_{part}_percent": values for part, values in AUTHORS_PERCENT.items()}
    return pd.DataFrame(columns).rename_axis("quantity").reset_index().assign(**authors)


def compensation(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """How far the loss of sensors is compensated: two ratios of errors, with paired bootstrap intervals over draws.

    Columns: ``quantity`` (a coordinate, or ``mean`` over them); ``before_percent``, ``after_percent`` and
    ``all_sensors_percent`` (the run with all sensors, over the same steps as after); ``after_to_before`` and
    ``failure_to_all_sensors``, the ratios of the means, with ``_low`` and ``_high`` (95 %) and ``_holds`` (at most
    :data:`TARGET`); ``deviation_ratio``, reported standard deviation with the failure relative to all sensors over
    the same steps; ``determined``, whether the one with the failure is below :data:`PRIOR_PERCENT` (for the mean:
    that of every coordinate).

    Parameters
    ----------
    table
        From :func:`errors_by_run` of :func:`~edition1_companion.pages.sensor_failure.failure.calibrated_method`.
    seed
        Of the bootstrap.
    """
    lines = []
    for quantity in [*dict.fromkeys(table["quantity"]), "mean"]:
        here = table if quantity == "mean" else table.query("quantity == @quantity")
        cells = here.pivot_table(
            index="member", columns=["run", "part"], values="error_percent", aggfunc="mean"
        )
        before, after = (cells["failure", part].to_numpy() for part in ("before", "after"))
        alike = cells["all sensors", "after"].to_numpy()
        late = here.query("part == 'after'")
        deviation = late.pivot_table(
            index="quantity", columns="run", values="deviation_percent", aggfunc="mean"
        )
        line = {"quantity": quantity, "before_percent": before.mean(), "after_percent": after.mean()}
        line["all_sensors_percent"] = alike.mean()
        line |= _ratio("after_to_before", after, before, seed)
        line |= _ratio("failure_to_all_sensors", after, alike, seed)
        line["deviation_ratio"] = deviation["failure"].mean() / deviation["all sensors"].mean()
        line["determined"] = bool((deviation["failure"] < PRIOR_PERCENT).all())
        lines.append(line)
    return pd.DataFrame(lines)


def _ratio(name: str, upper: np.ndarray, lower: np.ndarray, seed: int) -> dict[str, float | bool]:
    low, high = ratio_interval(upper, lower, resampled(len(upper), seed))
    ratio = upper.mean() / lower.mean()
    return {name: ratio, f"{name}_low": low, f"{name}_high": high, f"{name}_holds": bool(ratio <= TARGET)}


def over_time(estimates: Estimates, failure: Failure) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Readings and configurations along the run with the failure: truth, and mean and spread over the members.

    Returns
    -------
    DataFrame, DataFrame
        ``time_s, segment, sensor, working, true_mT, mean_mT, std_mT`` and
        ``time_s, segment, quantity, true_mm, mean_mm, std_mm``, segments and sensors from 1.
    """
    steps, robot = len(estimates.q), ROW.robot()
    time_s = times(steps).numpy()
    sensors = pd.MultiIndex.from_product(
        [time_s, range(1, len(robot.sensors) + 1)], names=["time_s", "sensor"]
    )
    u = _spread(estimates.u[:, 0], estimates.u_hat[:, :, 1], "mT", sensors)
    u.insert(1, "segment", np.tile([i + 1 for i in robot.sensors.segment], steps))
    u.insert(3, "working", failure.working(steps)[:, 1].flatten().numpy())
    coordinates = pd.MultiIndex.from_product([time_s, robot.coordinates], names=["time_s", "quantity"])
    q = _spread(1e3 * estimates.q, 1e3 * estimates.q_hat[:, :, 1], "mm", coordinates)
    q.insert(1, "segment", q["quantity"].str.rpartition("_")[2].astype(int))
    return u, q


def _spread(truth: Tensor, members: Tensor, unit: str, index: pd.MultiIndex) -> pd.DataFrame:
    x = members.numpy()
    std = x.std(1, ddof=1) if x.shape[1] > 1 else np.full_like(x[:, 0], math.nan)
    columns = {f"true_{unit}": truth.numpy(), f"mean_{unit}": x.mean(1), f"std_{unit}": std}
    return pd.DataFrame({name: y.ravel() for name, y in columns.items()}, index=index).reset_index()


def uncertainty(estimates: Estimates) -> pd.DataFrame:
    """Errors over time beside the reported standard deviations, as root mean squares over draws and segments.

    Columns: ``time_s``, ``run``, ``quantity`` (without the number of the segment), ``error_mm``, ``deviation_mm``.
    """
    names = list(dict.fromkeys(name.rpartition("_")[0] for name in ROW.robot().coordinates))
    index = pd.MultiIndex.from_product(
        [times(len(estimates.q)).numpy(), RUNS, names], names=["time_s", "run", "quantity"]
    )
    assert estimates.deviation is not None
    columns = {"error_mm": estimates.q_hat - estimates.q[:, None, None], "deviation_mm": estimates.deviation}
    squares = {
        name: (1e3 * x).square().unflatten(-1, (-1, len(names))).mean((1, 3)) for name, x in columns.items()
    }
    return pd.DataFrame(
        {k: x.sqrt().flatten().numpy() for k, x in squares.items()}, index=index
    ).reset_index()


def stills(estimates: Estimates, failure: Failure, n: int = 6) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Shapes at ``n`` times along the run with the failure: the truth, and the mean estimate of the members.

    Returns
    -------
    DataFrame, DataFrame
        Points of the backbones (``time_s, estimated, segment, x_mm, y_mm, z_mm``), and the magnets and sensors
        (``time_s, estimated, part, segment, working, x_mm, y_mm, z_mm``, without the axes).
    """
    steps, robot = len(estimates.q), ROW.robot()
    chosen = np.linspace(0, steps - 1, n).round().astype(int)
    working = failure.working(steps)[:, 1]
    shapes, parts = [], []
    for k in chosen:
        for estimated, q in ((False, estimates.q[k]), (True, estimates.q_hat[k, :, 1].mean(0))):
            key = {"time_s": float(times(steps)[k]), "estimated": estimated}
            shapes.append(backbones(robot, q[None]).drop(columns="shape").assign(**key))
            part = mounted_parts(robot, q, "released")[["part", "segment", "x_mm", "y_mm", "z_mm"]]
            state = np.ones(len(part), dtype=bool)
            state[part["part"] == "sensor"] = working[k].numpy()
            parts.append(part.assign(**key, working=state))
    return pd.concat(shapes, ignore_index=True), pd.concat(parts, ignore_index=True)
