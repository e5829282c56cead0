"""Our best figures for Table 1 of Baaij et al. 2023: a robot that is not as drawn, calibrated in 100 poses.

Frozen before any figure on the lemniscate T3 was taken; what could be chosen was chosen on the half lemniscate T2.
Readings come from magpylib and the true robot; the estimator knows the drawing, its tolerances and, if calibrated,
readings in measured poses. Nothing starts at, or holds, a true coordinate of the trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from repro.estimation.calibration import Calibration, calibrate
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.estimation.poses import configurations
from repro.kernels import compiled
from repro.kinematics.trajectories import lemniscate
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.training_set import BENDING_M, ELONGATION_M
from repro_companion.book.bootstrap import ratio_interval, resampled
from repro_companion.twins.calibration_session import (
    SENSOR_NOISE_MT,
    Config,
    Session,
    draw_session,
    released_moments,
)
from repro_companion.twins.table_1_rows import ROWS, Row

VELOCITY_SHARE = 0.5
"""Standard deviation of a velocity before the first reading, in widths of the box per second."""


def box(n_segments: int) -> tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]]:
    """Bounds of the training box [m]: bending of 20.73 mm either way, elongation from 0 to 6.6 mm."""
    high = torch.tensor([BENDING_M, BENDING_M, ELONGATION_M["released"]] * n_segments, dtype=torch.float64)
    low = torch.tensor([-BENDING_M, -BENDING_M, 0.0] * n_segments, dtype=torch.float64)
    return low, high


def start(n_segments: int) -> Float[Tensor, " n_q"]:
    """Return the straight pose at mid elongation, (0, 0, 2.75 mm) for every segment."""
    return torch.tensor([0.0, 0.0, 2.75e-3] * n_segments, dtype=torch.float64)


def estimator(n_segments: int, sensing: LinearisedSensing, iterations: int) -> LevenbergMarquardt:
    """Levenberg-Marquardt within the training box."""
    return LevenbergMarquardt(
        compiled(sensing), *box(n_segments), noise_mt=SENSOR_NOISE_MT, iterations=iterations
    )


def session(row: Row, config: Config) -> Session:
    """Draws of a row of Table 1: see :func:`draw_session`."""
    q = lemniscate(row.n_segments, half=config.half)
    return draw_session(row.robot(), q, box(row.n_segments), config, earth_mt=row.earth_mt())


def calibration(row: Row, measured: Session, config: Config) -> Calibration:
    """Calibrate all draws of a row from their measured poses and readings."""
    robot = row.robot()
    q, covariance = configurations(
        robot, measured.poses, position_m=config.position_m, rotation_rad=config.rotation_rad
    )
    return calibrate(
        robot,
        q,
        covariance,
        measured.pose_readings,
        released_moments(),
        noise_mt=SENSOR_NOISE_MT,
        earth_mt=row.earth_mt(),
    )


def best(rows: Sequence[Row] = ROWS, config: Config | None = None) -> pd.DataFrame:
    """Errors of the calibrated and of the uncalibrated multipole model, one line per row, draw and coordinate.

    Columns: ``row``, ``quantity`` (``delta_x_1`` and so on), ``draw``, ``calibrated``, ``error_percent`` (relative
    RMSE of eq. (13), in per cent of the range on the trajectory).
    """
    config = config or Config()
    tables = []
    for row in rows:
        measured = session(row, config)
        models = {
            True: calibration(row, measured, config).sensing(row.earth_mt()),
            False: LinearisedSensing(row.robot(), released_moments(), earth_mt=row.earth_mt()),
        }
        for calibrated, sensing in models.items():
            method = estimator(row.n_segments, sensing, config.iterations)
            q0 = start(row.n_segments).expand(len(measured.q), config.draws, -1)
            found = method.step(method.init(q0), measured.readings, 0.0)[1].q
            error = relative_error(found, measured.q)
            table = pd.DataFrame(error.numpy(), columns=list(row.robot().coordinates))
            table = (
                table.rename_axis("draw")
                .reset_index()
                .melt("draw", var_name="quantity", value_name="error_percent")
            )
            tables.append(table.assign(row=row.name, calibrated=calibrated))
    columns = ["row", "quantity", "draw", "calibrated", "error_percent"]
    return pd.concat(tables, ignore_index=True).reindex(columns=columns)


def summary(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Means over draws and the gain by calibration, with a paired bootstrap interval over the draws.

    Columns: ``row``, ``quantity`` (a coordinate, or ``mean`` over the coordinates of a row), ``calibrated_percent``
    and ``uncalibrated_percent`` with ``_std`` (sample standard deviation over draws), ``ratio`` of the two means,
    ``ratio_low`` and ``ratio_high`` (95 %).
    """
    lines = []
    for row, quantity in _pairs(table):
        here = table.query("row == @row" if quantity == "mean" else "row == @row and quantity == @quantity")
        pairs = here.pivot_table(index="draw", columns="calibrated", values="error_percent", aggfunc="mean")
        yes, no = pairs[True].to_numpy(), pairs[False].to_numpy()
        low, high = ratio_interval(yes, no, resampled(len(yes), seed))
        spread = [x.std(ddof=1) if len(x) > 1 else math.nan for x in (yes, no)]
        lines.append(
            {
                "row": row,
                "quantity": quantity,
                "calibrated_percent": yes.mean(),
                "calibrated_percent_std": spread[0],
                "uncalibrated_percent": no.mean(),
                "uncalibrated_percent_std": spread[1],
                "ratio": yes.mean() / no.mean(),
                "ratio_low": low,
                "ratio_high": high,
            }
        )
    return pd.DataFrame(lines)


def against_published(table: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Mean over the per-cent columns of each row of best/published.

    Parameters
    ----------
    table
        From :func:`best`.
    published
        Published values in long form: ``paper``, ``artefact``, ``row``, ``quantity``, ``unit``, ``value``.

    Returns
    -------
    DataFrame
        ``row``, ``calibrated`` and ``uncalibrated``: the mean ratio of each.
    """
    here = published.query("paper == 'baaij2023' and artefact == 'Table 1' and unit == '%'")
    means = table.pivot_table(
        index=["row", "quantity"], columns="calibrated", values="error_percent", sort=False
    )
    joined = means.reset_index().merge(here[["row", "quantity", "value"]], validate="one_to_one")
    joined = joined.assign(
        calibrated=joined[True] / joined["value"], uncalibrated=joined[False] / joined["value"]
    )
    return joined.pivot_table(index="row", values=["calibrated", "uncalibrated"], sort=False).reset_index()


def relative_error(
    found: Float[Tensor, "t *batch n_q"], truth: Float[Tensor, "t n_q"]
) -> Float[Tensor, "*batch n_q"]:
    """Relative RMSE over time, eq. (13): in per cent of the range of the truth."""
    width = truth.amax(0) - truth.amin(0)
    truth = truth.reshape(len(truth), *(1,) * (found.ndim - 2), -1)
    return 100 * (found - truth).square().mean(0).sqrt() / width


def _pairs(table: pd.DataFrame) -> list[tuple[str, str]]:
    """Rows and quantities in their order, ``mean`` last in each row."""
    keys: dict[str, list[str]] = {}
    for row, quantity in zip(table["row"], table["quantity"], strict=True):
        names = keys.setdefault(row, [])
        if quantity not in names:
            names.append(quantity)
    return [(row, quantity) for row, names in keys.items() for quantity in [*names, "mean"]]
