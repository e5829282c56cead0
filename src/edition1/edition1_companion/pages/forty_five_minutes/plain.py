"""The plain fusion that takes the calibration of the start for true: with it the sizes of the drift were set."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from edition1.estimation.base import track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.kernels import compiled
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.seen_directions import SeenDirections
from edition1.sensing.stacked import StackedSensing
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edition1_companion.pages.forty_five_minutes.twin import (
    EARTH,
    FAST_TILT,
    IMUS,
    NOISE_MT,
    RATE_HZ,
    ROBOT,
    Twin,
)
from edition1_companion.twins.calibrated_robots import VELOCITY_SHARE, box, start
from edition1_companion.twins.calibration_session import released_moments

PROCESS_NOISE = 0.3
"""Acceleration in widths of the box per s^1.5."""


def fused_tip_percent(twins: Sequence[Twin], *, last_minutes: float = 15.0) -> Float[np.ndarray, " twins"]:
    """Root mean square error of the tip over the last minutes, in percent of the length.

    Hall sensors count with their white noise, IMUs with that of their vertical in motion.
    """
    axes = SeenDirections(ROBOT, IMUS, (0, 0, 0, 1, 1, 1, 2, 2, 2), torch.eye(3).double().repeat(3, 1))
    magnets = LinearisedSensing(ROBOT, released_moments(), earth_mt=EARTH)
    sensing = StackedSensing((magnets, axes), (NOISE_MT, 2**0.5 * FAST_TILT[0]))
    low, high = box(3)
    moving = (PROCESS_NOISE * (high - low), VELOCITY_SHARE * (high - low))
    method = IteratedKalmanFilter(compiled(sensing), low, high, *moving, iterations=3)
    R = [Rotation.from_rotvec(twin.imus.reshape(-1, 3).numpy()).as_matrix() for twin in twins]
    seen = torch.from_numpy(np.stack([x.reshape(-1, 27) for x in R], axis=1))  # base axes, seen by each IMU
    u = sensing.scaled([torch.stack([twin.hall_mt for twin in twins], dim=1), seen])
    found = track(method, u, start(3).expand(len(twins), -1), rate_hz=RATE_HZ)
    true = ROBOT.tip(torch.stack([twin.q for twin in twins], dim=1))[..., :3, 3]
    off = (found.tip(ROBOT)[..., :3, 3] - true)[-round(60 * last_minutes * RATE_HZ) :]
    return 100 / ROBOT.length * off.square().sum(-1).mean(0).sqrt().numpy()
