"""Five estimators of the twin that drifts, and what they err.

All are one filter. *IMU only*, *magnets only* and *fused* take the calibration of the start for true, and the errors
of an IMU for white noise of the size of its tilt in motion; IMUs do not see the elongation, which is then held at its
middle. *Self-calibrating* knows how far its sensors may wander, *oracle* how far they have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from edition1.estimation.base import Trajectory, stacked
from edition1.estimation.self_calibration import SelfCalibratingFilter
from edition1.estimation.wander import Wander
from edition1.kinematics.motion import tip_motion
from jaxtyping import Bool, Float
from torch import Tensor

from edition1_companion.pages.forty_five_minutes.plain import PROCESS_NOISE
from edition1_companion.pages.forty_five_minutes.twin import (
    EARTH,
    ELONGATION_M,
    FAST_TILT,
    IMU_NOISE_RAD,
    IMUS,
    MINUTES,
    NOISE_MT,
    RATE_HZ,
    ROBOT,
    Sizes,
    Twin,
    draw_twin,
)
from edition1_companion.twins.calibrated_robots import VELOCITY_SHARE, box, start
from edition1_companion.twins.calibration_session import released_moments

METHODS = ("IMU only", "magnets only", "fused", "self-calibrating", "oracle")
GATE = 1e-8
"""Chance of a false flag at a reading. With 1e-6 two of five runs of ``SETTING`` had false flags, with this none."""
STEADY = 3.0
"""Walk of the moments, in that of a random walk of the size of the warming. Magnets warm up evenly, and the filter of
a walk lags behind what drifts one way. Of 1, 2 and 3, that whose normalised error was nearest to one on the seeds
100 to 109; the error of the tip hardly changed."""
LAST_MINUTES = 15
IN_MOTION = Wander.fading("tilt", *FAST_TILT)
"""Error of an IMU's vertical in motion, which nobody knows."""


def wanders(believed: float = 1.0) -> tuple[Wander, ...]:
    """What may wander, and how far: the sizes of the twin, or so many times them.

    Parameters
    ----------
    believed
        Size of the drift that the filter believes, in that of the twin; of all but the tilt in motion.
    """
    sizes, grown = Sizes(), math.sqrt(60 * MINUTES)  # a random walk ends with its size
    warming = STEADY * abs(sizes.remanence_per_k * sizes.warming_k)
    return (
        Wander("moment", 0.0, believed * warming / grown, shared=True),
        Wander("gain", 0.0, believed * sizes.gain / grown),
        Wander("offset", 0.0, believed * sizes.offset_mt / grown),
        Wander("heading", 0.0, believed * sizes.heading_rad / grown),
        # A tilt that fades in T, less what it was at the start: its variance is that of one that fades in 2 T.
        Wander(
            "tilt", 0.0, believed * sizes.tilt_rad * math.sqrt(2 / sizes.tilt_time_s), 2 * sizes.tilt_time_s
        ),
        IN_MOTION,
    )


def estimator(method: str, believed: float = 1.0) -> SelfCalibratingFilter:
    """Return the filter of a method."""
    low, high = box(3)
    base = SelfCalibratingFilter(
        ROBOT,
        low,
        high,
        PROCESS_NOISE * (high - low),
        VELOCITY_SHARE * (high - low),
        wanders(believed),
        released_moments(),
        IMUS,
        EARTH,
        NOISE_MT,
        IMU_NOISE_RAD,
        gate=GATE,
    )
    if method == "self-calibrating":
        return base
    if method == "oracle":
        known = (w if w == IN_MOTION else Wander(w.kind, 0.0, shared=w.shared) for w in base.wanders)
        return replace(base, wanders=tuple(known))
    return replace(base, wanders=(), imu_noise_rad=FAST_TILT[0], gate=None)


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


def readings(twin: Twin) -> Float[Tensor, "t s"]:
    """All readings of a twin, as the filters take them."""
    return torch.cat([twin.hall_mt, twin.imus.flatten(1)], dim=1)


def followed(method: str, twins: Sequence[Twin], believed: float = 1.0) -> Run:
    """Follow twins by a method."""
    follower, n = estimator(method, believed), ROBOT.n_q
    u = torch.stack([readings(twin) for twin in twins], dim=1)
    hall = torch.arange(u.shape[-1]) < follower.n_hall
    mask = {"IMU only": ~hall, "magnets only": hall}.get(method)
    known = torch.tensor([math.nan, math.nan, ELONGATION_M] * 3).double() if method == "IMU only" else None
    truth = torch.stack([lasting_errors(twin) for twin in twins], dim=1)
    state, estimates = follower.init(start(3).expand(len(twins), -1)), []
    for k, t in enumerate(twins[0].time_s.tolist()):
        if method == "oracle":
            q = torch.cat([state.q[:, :n], truth[k], state.q[:, n + truth.shape[-1] :]], dim=-1)
            state = replace(state, q=q)
        state, estimate = follower.step(state, u[k], t, mask=mask, known=known)
        estimates.append(estimate)
    return judged(stacked(estimates), twins)


def lasting_errors(twin: Twin) -> Float[Tensor, "t n"]:
    """True errors of the sensors, in the order of :func:`wanders`, without the tilt in motion."""
    lasting = [w for w in wanders() if w != IN_MOTION]
    columns = [
        twin.errors[w.kind].reshape(len(twin.time_s), -1)[:, : 1 if w.shared else None] for w in lasting
    ]
    return torch.from_numpy(np.hstack(columns))


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


def errors_by_minute(
    twins: Sequence[int], minutes: float = MINUTES, methods: Sequence[str] = METHODS
) -> pd.DataFrame:
    """Table of :func:`by_minute` for twins and methods, in columns ``twin`` and ``method``."""
    drawn = [draw_twin(seed, minutes=minutes) for seed in twins]
    parts = []
    for method in methods:
        found = followed(method, drawn)
        for member, seed in enumerate(twins):
            parts.append(by_minute(found, drawn[member], member).assign(twin=seed, method=method))
    table = pd.concat(parts, ignore_index=True).sort_values(["twin"], kind="stable", ignore_index=True)
    return table[["twin", "method", *[c for c in table.columns if c not in ("twin", "method")]]]
