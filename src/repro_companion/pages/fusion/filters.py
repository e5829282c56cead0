r"""Magnets and IMUs of one robot in one filter, on synthetic readings.

Three estimators with the same constant-curvature model, motion prior and rest pose: the ring's three sensors, the two
IMUs, and both. The slow errors of the IMUs (mounting, heading, tilt) are in the state, and so is a stray field where
there is one. Every run starts with one reading at rest, straight at mid elongation, which is known to all of them.

Information adds: where the model is true, the covariance of both is below that of either. How far below follows from
the filters' own covariances on readings without noise (a posterior Cramer-Rao bound to first order); the errors are
counted on readings with noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.drift_filter import Drift, DriftFilter
from repro.estimation.kalman_filter import IteratedKalmanFilter
from repro.kernels import compiled
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.stacked import StackedSensing
from repro_companion.pages.fusion.models import Imus, Magnets
from repro_companion.pages.fusion.readings import (
    ERRORS,
    IMU_NOISE_RAD,
    RATE_HZ,
    STRAY_TIME_S,
    Record,
    Surroundings,
)
from repro_companion.twins.calibrated_robots import VELOCITY_SHARE, box, start
from repro_companion.twins.calibration_session import released_moments
from repro_companion.twins.segment_motion import ROBOT
from repro_companion.twins.segment_robot import MID_ELONGATION_M

METHODS = ("magnets", "IMUs", "both")
ITERATIONS = 4
SHARE = 0.3
"""Process noise in widths of the box per s^1.5: see :func:`repro_companion.pages.fusion.tables.choices`."""


def imu_drift() -> Drift:
    """Nine slow errors of the relative orientation: constant and wandering on the left, mounting on the right."""
    two, tilt, heading = math.sqrt(2), ERRORS.tilt_static_rad, ERRORS.heading_offset_rad
    mounting = ERRORS.mounting_rad
    constant = [math.hypot(two * tilt, mounting)] * 2 + [math.hypot(two * heading, mounting)]
    wander = [two * ERRORS.tilt_dynamic_rad] * 2 + [two * ERRORS.heading_wander_rad]
    times = [math.inf] * 3 + [ERRORS.tilt_time_s] * 2 + [ERRORS.heading_time_s] + [math.inf] * 3
    std = torch.tensor(constant + wander + [mounting] * 3, dtype=torch.float64)
    return Drift(std, torch.tensor(times, dtype=torch.float64))


@dataclass(frozen=True)
class Tracked:
    """Estimates of one method: time (without the rest), motions, draws.

    The covariance is of all coordinates that the method estimates: the IMUs do not see the elongation, which is
    held in the middle.
    """

    q: Float[Tensor, "t m draws 3"]
    covariance: Float[Tensor, "t m draws n n"]


def estimates(
    method: str, recorded: Record, setting: Surroundings, *, share: float = SHARE, shape_mt: float = 0.0
) -> Tracked:
    """Run one method over a record.

    Parameters
    ----------
    method
        One of ``METHODS``.
    recorded, setting
        Readings and their errors, which the filter knows.
    share
        Process noise, in widths of the box per s^1.5.
    shape_mt
        Noise [mT] that the filter adds to that of the magnetic readings, for a shape that is not the model's.

    Raises
    ------
    InputError
        If the method is unknown.
    """
    if method not in METHODS:
        raise bad_input("method", "estimates", f"one of {', '.join(map(repr, METHODS))}", repr(method))
    low, high = box(1)
    n = 2 if method == "IMUs" else 3
    low, high = low[:n], high[:n]
    moving = (low, high, share * (high - low), VELOCITY_SHARE * (high - low))
    noise_mt = math.hypot(setting.noise_mt, shape_mt)
    if method == "magnets" and setting.stray_mt == 0:
        field = compiled(LinearisedSensing(ROBOT, released_moments()))
        kalman = IteratedKalmanFilter(field, *moving, noise_mt=noise_mt, iterations=ITERATIONS)
        return _tracked(kalman, recorded.magnets)
    parts: list[tuple[Callable[[Tensor], Tensor], float, Tensor]] = []
    drifts: list[Drift] = []
    if method != "IMUs":
        parts.append((Magnets(setting.stray_mt > 0), noise_mt, recorded.magnets))
    if method != "magnets":
        parts.append((Imus(method == "IMUs"), IMU_NOISE_RAD, recorded.turns))
        drifts.append(imu_drift())
    if method != "IMUs" and setting.stray_mt > 0:
        size = torch.full((3,), setting.stray_mt, dtype=torch.float64)
        drifts.append(Drift(size, torch.full_like(size, STRAY_TIME_S)))
    stacked = StackedSensing(tuple(p[0] for p in parts), tuple(p[1] for p in parts))
    drift = Drift(torch.cat([d.std for d in drifts]), torch.cat([d.time_s for d in drifts]))
    kalman = DriftFilter(stacked, *moving, drift, iterations=ITERATIONS)
    return _tracked(kalman, stacked.scaled([p[2] for p in parts]))


def _tracked(method: IteratedKalmanFilter | DriftFilter, u: Tensor) -> Tracked:
    """Calibrate on the reading at rest where there is something to calibrate, then follow."""
    n = len(method.lower)
    q0 = start(1)[:n].expand(*u.shape[1:-1], n)
    state = method.init(q0)
    if isinstance(method, DriftFilter):
        state, _ = method.step(state, u[0], 0.0, known=q0)
        state = method.released(state, q0)
    q, covariance = [], []
    for k in range(1, len(u)):
        state, estimate = method.step(state, u[k], k / RATE_HZ)
        q.append(torch.nn.functional.pad(estimate.q, (0, 3 - n), value=MID_ELONGATION_M))
        covariance.append(estimate.covariance)
    return Tracked(torch.stack(q), torch.stack(covariance))
