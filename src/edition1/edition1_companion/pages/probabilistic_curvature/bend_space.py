"""The bend space of Mitchell et al. 2021: its curves (Fig. 4), a cloud in it (Fig. 3), and the field over it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import torch

from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.bend import MAX_BEND, bend_angle_and_direction, bend_vector
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.pages.probabilistic_curvature.simulation import Setting
from edition1_companion.twins.bend_curves import CURVES, LENGTH_M, bend_curve, bend_readings, curve_times


def curves_table(every: int = 4) -> pd.DataFrame:
    """Curves of Fig. 4: columns ``curve, t, direction_rad, angle_rad``, every so many steps."""
    tables = []
    for name in CURVES:
        angle, direction = bend_angle_and_direction(bend_curve(name)[::every])
        polar = {"t": curve_times()[::every], "direction_rad": direction, "angle_rad": angle}
        tables.append(pd.DataFrame({"curve": name} | {column: x.numpy() for column, x in polar.items()}))
    return pd.concat(tables, ignore_index=True)


def cloud(setting: Setting, *, step: int = 240) -> pd.DataFrame:
    """Particles before a step along Flower of a filter that started straight, Fig. 3.

    Parameters
    ----------
    setting
        What to run.
    step
        Number of steps that the filter has taken.

    Returns
    -------
    DataFrame
        Columns ``bend_x_rad, bend_y_rad, is_truth``; the true state comes last.
    """
    q = bend_curve("flower")
    u = bend_readings(q, setting.length_m, noise_mt=setting.sensor_noise_mt)
    filter_ = setting.filter()
    state = filter_.init(torch.zeros(1, 1, 2, dtype=torch.float64))
    for reading in u[:step]:
        state, _ = filter_.step(state, reading[None, None], 0.0)
    points = np.vstack([state.q[0, 0].numpy(), q[step].numpy()])
    table = pd.DataFrame(points, columns=["bend_x_rad", "bend_y_rad"])
    return table.assign(is_truth=table.index == len(table) - 1)


def field_map(length_m: float = LENGTH_M, rings: int = 19, spokes: int = 48) -> pd.DataFrame:
    """Field over the bend space, and how well it determines the bend.

    Parameters
    ----------
    length_m
        Distance of sensor and magnet along the arc [m].
    rings, spokes
        Bend angles from 0 to 90 degrees, and bend directions.

    Returns
    -------
    DataFrame
        Columns ``angle_deg, bend_x_deg, bend_y_deg``; ``axial_mt, lateral_mt, abs_mt``, the field by magpylib; the
        singular values ``weakest_mt_per_rad, strongest_mt_per_rad`` of its derivative and their ratio
        ``condition``; and ``gain_mm_per_mt``, the largest error of the position for an error of the reading.
    """
    angle = torch.linspace(0, MAX_BEND, rings, dtype=torch.float64)
    direction = torch.linspace(0, 2 * torch.pi, spokes + 1, dtype=torch.float64)[:-1]
    around = torch.cartesian_prod(angle[1:], direction)
    q = torch.cat([angle.new_zeros(1, 2), bend_vector(around[:, 0], around[:, 1])])
    u = bend_readings(q, length_m)
    sensor = BendSensor(length_m)
    J = jacobian(sensor, q)[1]
    strongest, weakest = torch.linalg.svdvals(J).unbind(-1)
    gain = torch.linalg.matrix_norm(jacobian(sensor.position, q)[1] @ torch.linalg.pinv(J), ord=2)
    columns = {
        "angle_deg": torch.linalg.vector_norm(q, dim=-1).rad2deg(),
        "bend_x_deg": q[:, 0].rad2deg(),
        "bend_y_deg": q[:, 1].rad2deg(),
        "axial_mt": u[:, 2],
        "lateral_mt": torch.linalg.vector_norm(u[:, :2], dim=-1),
        "abs_mt": torch.linalg.vector_norm(u, dim=-1),
        "weakest_mt_per_rad": weakest,
        "strongest_mt_per_rad": strongest,
        "condition": strongest / weakest,
        "gain_mm_per_mt": 1e3 * gain,
    }
    return pd.DataFrame({name: x.numpy() for name, x in columns.items()})
