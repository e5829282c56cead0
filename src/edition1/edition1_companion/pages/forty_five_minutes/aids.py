r"""What readings of a straight robot say of its magnets and sensors if parts are moved meanwhile, by information.

The pose is known as well as one of a calibration, and stays. Sensor :math:`k`, of gain :math:`1 + g_k` and offset
:math:`o_k`, stands in place :math:`s`, where the field is :math:`\pm F_s(q)` times :math:`1 + m`:

.. math:: u = \pm F_s\,(1 + m + g_k) \pm J_s\,\delta q + o_k + \varepsilon .

Sensors are exchanged by moving each to the next place; the sign changes when every magnet is turned round, or
replaced by the one of a pair that has the other pole.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.levenberg_marquardt import jacobian
from edition1.robot_file.robot_file import RobotFile
from edition1_companion.pages.forty_five_minutes.poses import (
    POSE_M,
    POSE_RAD,
    RATE_HZ,
    TEST_S,
    described,
    stated_percent,
)
from edition1_live.emulate.robot_readings import course
from edition1_live.own.self_calibration import PRIORS
from edition1_live.robot.calibrate import pose_covariance

AIDS = {
    "straight": ((0, 1),),
    "sensors exchanged": ((0, 1), (1, 1)),
    "magnets turned round": ((0, 1), (0, -1)),
    "both": ((0, 1), (1, 1), (0, -1), (1, -1)),
}
"""Readings of each: by how many places the sensors are moved on, and the sign of the magnets."""


def aids(robots: Sequence[str]) -> pd.DataFrame:
    """Uncertainty that readings of the straight robot leave, over that before, and the error of the tip by it.

    Columns ``robot, aid, moment, gain, offset, stated_percent``: means over the parts, and what
    :func:`edition1_companion.pages.forty_five_minutes.poses.stated_percent` says along a motion.
    """
    rows = []
    for name in robots:
        robot = described(name)
        q = torch.from_numpy(course(robot, np.arange(round(TEST_S * RATE_HZ)) / RATE_HZ, seed=10_000))
        u_hat = robot.sensing()(q) / robot.gain
        each = torch.eye(len(robot.gain)).double().expand(len(q), -1, -1)
        by_error = torch.cat([u_hat.unsqueeze(-1), torch.diag_embed(u_hat), each], dim=-1)
        for aid, readings in AIDS.items():
            C = left(robot, readings)
            share = (C.diagonal() / prior(robot)).sqrt()
            moment, gain, offset = (float(part.mean()) for part in share.split([1, *2 * [len(robot.gain)]]))
            error = by_error @ C @ by_error.mT * robot.gain.outer(robot.gain)
            rows.append((name, aid, moment, gain, offset, stated_percent(robot, q, error)))
    return pd.DataFrame(rows, columns=["robot", "aid", "moment", "gain", "offset", "stated_percent"])


def prior(robot: RobotFile) -> Float[Tensor, " errors"]:
    """Variances of the moment of all magnets, the gains, and the offsets [mT^2], before any reading."""
    n, size = len(robot.gain), PRIORS.placement
    return torch.tensor([size.moments] + [size.sensor_gain] * n + [PRIORS.offset_mt] * n).double().square()


def left(robot: RobotFile, readings: Sequence[tuple[int, int]]) -> Float[Tensor, "errors errors"]:
    """Covariance of moment, gains and offsets after readings of the straight robot."""
    n, model, gain = len(robot.gain), robot.sensing(), robot.gain
    F, J = model(robot.start) / gain, jacobian(model, robot.start)[1] / gain.unsqueeze(-1)
    rows = []
    for moved, sign in readings:
        sensor = torch.eye(n).double().roll(moved, dims=1)  # which stands in a place
        rows.append(
            torch.cat([sign * F.unsqueeze(-1), sign * F.unsqueeze(-1) * sensor, sensor, sign * J], dim=1)
        )
    H = torch.cat(rows)
    noise = (robot.noise / gain).square().repeat(len(readings))
    D = torch.cat([prior(robot), pose_covariance(robot, POSE_M, POSE_RAD).diagonal()])
    S = H * D @ H.mT + torch.diag(noise)
    C = torch.diag(D) - (H * D).mT @ torch.linalg.solve(S, H * D)
    return C[: 1 + 2 * n, : 1 + 2 * n]
