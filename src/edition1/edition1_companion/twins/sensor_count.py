"""How many sensors a robot needs: errors on T3 by sensors per segment, noise and segments (synthetic)."""

from __future__ import annotations

import pandas as pd
import torch

from edition1.errors import bad_input
from edition1.estimation.information import cramer_rao, fisher_information
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.book.pose_errors import pose_errors
from edition1_companion.twins.calibrated_robots import least_squares, relative_error
from edition1_companion.twins.calibration_session import released_moments
from edition1_companion.twins.trajectories import lemniscate

ITERATIONS = 12
"""Of Levenberg-Marquardt at every time step, each from the straight pose."""


def sensor_count_errors(
    n_segments: int, n_sensors: int, noise_mt: float, *, seed: int = 0, draws: int = 10, steps: int = 100
) -> pd.DataFrame:
    """Errors on T3 of Levenberg-Marquardt with the multipole model, one line per draw of the noise.

    Readings come from magpylib, on the robot as drawn with the ring ``"released"``; noise is white and normal. Every
    time step starts straight at mid elongation, within the training box.

    Parameters
    ----------
    n_segments
        Segments of the robot.
    n_sensors
        Sensors in the tip plane of each segment, spaced evenly.
    noise_mt
        Standard deviation of a reading [mT].
    seed
        Of the noise.
    draws
        Of the noise.
    steps
        Time steps on T3.

    Returns
    -------
    DataFrame
        Columns ``draw``; ``mean_percent``, the relative error of eq. (13), mean over the coordinates; ``tip_mm`` and
        ``shape_mm``; ``at_bound_percent``, the share of time steps at which the box holds the estimate; and
        ``bound_percent``, the Cramér-Rao bound of ``mean_percent`` (infinite where the readings leave a coordinate
        open).

    Raises
    ------
    InputError
        If the noise is not positive, or there is no draw, segment, sensor or step.
    """
    if not noise_mt > 0 or draws < 1:
        received = (noise_mt, draws)
        raise bad_input("noise_mt, draws", "sensor_count_errors", "positive and at least 1", received)
    robot, q = pcc_robot(n_segments, n_sensors), lemniscate(n_segments, steps=steps)
    clean = readings(robot, q, ring("released")).unsqueeze(1)
    generator = torch.Generator().manual_seed(seed)
    normal = torch.randn(steps, draws, clean.shape[-1], generator=generator, dtype=clean.dtype)
    sensing = LinearisedSensing(robot, released_moments())
    u, options = clean + noise_mt * normal, {"noise_mt": noise_mt, "iterations": ITERATIONS}
    estimate = least_squares(compiled(sensing), u, n_segments, **options)
    variance = cramer_rao(fisher_information(sensing.linearise(q)[1], noise_mt)).diagonal(dim1=-2, dim2=-1)
    bound = 100 * (variance.mean(0).sqrt() / (q.amax(0) - q.amin(0))).mean()
    poses = pose_errors(robot, estimate.q, q.unsqueeze(1))
    columns = {
        "draw": torch.arange(draws),
        "mean_percent": relative_error(estimate.q, q).mean(-1),
        "tip_mm": poses["tip_mm"],
        "shape_mm": poses["shape_mm"],
        "at_bound_percent": 100 * estimate.diagnostics["at_bound"].double().mean(0),
        "bound_percent": bound.expand(draws),
    }
    return pd.DataFrame({name: values.numpy() for name, values in columns.items()})


def against_three(table: pd.DataFrame) -> pd.DataFrame:
    """Means over the draws, beside what three sensors on each segment achieve.

    Parameters
    ----------
    table
        Those of :func:`sensor_count_errors` below each other, with columns ``n_segments, n_sensors, noise_mt``.

    Returns
    -------
    DataFrame
        Columns ``n_segments, noise_mt, n_sensors, mean_percent, bound_percent, tip_mm, at_bound_percent``; ``ratio``,
        the error by that of three sensors; ``averaging``, the root of 3/n, by which a mean of n readings has less
        noise, empty below three.
    """
    keys, values = ["n_segments", "noise_mt"], ["mean_percent", "bound_percent", "tip_mm", "at_bound_percent"]
    means = pd.DataFrame(table.groupby([*keys, "n_sensors"], as_index=False)[values].mean())
    three = means.loc[means["n_sensors"] == 3, [*keys, "mean_percent"]]
    joined = means.merge(
        three.rename(columns={"mean_percent": "three"}), on=keys, validate="many_to_one", how="left"
    )
    averaging = (3 / joined["n_sensors"]).where(joined["n_sensors"] >= 3) ** 0.5
    return joined.assign(ratio=joined["mean_percent"] / joined["three"], averaging=averaging).drop(
        columns="three"
    )
