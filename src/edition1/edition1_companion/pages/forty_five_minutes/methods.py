"""Five estimators of the twin that drifts, and what they err.

All are one filter. *IMU only*, *magnets only* and *fused* take the calibration of the start for true, and the errors
of an IMU for white noise of the size of its tilt in motion; IMUs do not see the elongation, which is then held at its
middle. *Self-calibrating* knows how far its sensors may wander, *oracle* how far they have. The estimators are in the
code of the last commit of the first edition, which computed the study ``forty_five_minutes``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.estimation.base import Trajectory
from edition1.kinematics.motion import tip_motion
from edition1_companion.pages.forty_five_minutes.twin import (
    RATE_HZ,
    ROBOT,
    Twin,
)

METHODS = ("IMU only", "magnets only", "fused", "self-calibrating", "oracle")
LAST_MINUTES = 15


@dataclass(frozen=True)
class Run:
    """Estimates of twins by one method: time, then twins.

    Parameters
    ----------
    tip_error_m
        Distance of the tip from the true one.
    nees
        Normalised squared error of its position, divided by 3.
    flag
        Whether the Hall sensors are left out.
    """

    tip_error_m: Float[Tensor, "t twins"]
    nees: Float[Tensor, "t twins"]
    flag: Bool[Tensor, "t twins"]


def judged(found: Trajectory, twins: Sequence[Twin]) -> Run:
    """Errors of estimates of twins."""
    assert found.covariance is not None
    tip, J = tip_motion(ROBOT, found.q)
    true = ROBOT.tip(torch.stack([twin.q for twin in twins], dim=1))[..., :3, 3]
    off = (tip - true).unsqueeze(-1)
    squared = (off.mT @ torch.linalg.solve(J @ found.covariance @ J.mT, off))[..., 0, 0]
    distance = torch.linalg.vector_norm(off.squeeze(-1), dim=-1)
    return Run(distance, squared / 3, found.diagnostics["flag"])


def by_minute(found: Run, twin: Twin, member: int) -> pd.DataFrame:
    """Error of the tip in percent of the length, normalised error, and flags, minute by minute.

    Columns: ``minute``, ``tip_rmse_percent``, ``nees``, and seconds: ``iron_s`` with iron near, ``flag_iron_s`` with
    a flag then, ``flag_else_s`` with one before the iron comes or more than 15 s after it has gone.
    """
    near = (twin.time_s >= twin.iron_s[0]) & (twin.time_s < twin.iron_s[1])
    after = (twin.time_s >= twin.iron_s[1]) & (twin.time_s < twin.iron_s[1] + 15)
    flag = found.flag[:, member].numpy()
    table = pd.DataFrame(
        {
            "minute": (twin.time_s // 60).astype(int) + 1,
            "square": (100 / ROBOT.length * found.tip_error_m[:, member].numpy()) ** 2,
            "nees": found.nees[:, member].numpy(),
            "iron_s": near / RATE_HZ,
            "flag_iron_s": (flag & near) / RATE_HZ,
            "flag_else_s": (flag & ~near & ~after) / RATE_HZ,
        }
    )
    means = table.groupby("minute").agg(
        {"square": "mean", "nees": "mean", "iron_s": "sum", "flag_iron_s": "sum", "flag_else_s": "sum"}
    )
    means.insert(0, "tip_rmse_percent", np.sqrt(means.pop("square")))
    return means.reset_index()
