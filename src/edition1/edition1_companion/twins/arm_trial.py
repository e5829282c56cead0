"""A trial as Martin et al. (2022) evaluate it: orientations and markers on one clock (section III-B3).

Draws of the synthetic trial are the same motion, with other sensors and another frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import require
from edition1.estimation.imu_models import pcc_extended
from edition1_companion.recordings.alignment import Lag, find_lag
from edition1_companion.recordings.martin2022 import one_clock
from edition1_companion.recordings.martin2022_models import selection
from edition1_companion.twins.arm_recording import MARKER_ARCS_M, ArmRecording, MotionCapture, record_soft_arm
from edition1_companion.twins.imu_errors import ImuErrors
from edition1_companion.twins.soft_arm import SoftArm
from edition1_companion.twins.stick_motion import mode_at

M2_ARC_M = MARKER_ARCS_M[1]


@dataclass(frozen=True)
class ArmTrial:
    """A trial on the IMUs' clock.

    Attributes
    ----------
    time_s
        Times of the samples [s].
    orientations
        Unit quaternions XYZW, arm to world: the base, which is upright and not measured, then the eight IMUs.
    points
        Positions [m] from motion capture, interpolated linearly.
    point_arcs_m
        Their distances from the base [m]: the markers at 360 and 600 mm, then points that no fit may use.
    mode
        Name of the mode of motion at each sample.
    facts
        What was found per IMU on the way: see `edition1_companion.recordings.imu_clock.ImuStream`.
    lag
        By how much the IMUs' clock is ahead of that of motion capture, their latency included.
    """

    time_s: Float[np.ndarray, " samples"]
    orientations: Float[np.ndarray, "samples 9 4"]
    points: Float[np.ndarray, "samples points 3"]
    point_arcs_m: tuple[float, ...]
    mode: np.ndarray
    facts: pd.DataFrame
    lag: Lag


def synchronised(recording: ArmRecording) -> ArmTrial:
    """Bring a synthetic recording onto one clock, by what was recorded alone.

    The delay is where the height of the marker M2 according to the PCC-extended model (eight IMUs, 16 segments)
    correlates best with the height that motion capture saw: heights do not depend on how the frames are turned about
    the vertical. One delay serves all models. The paper interpolates the model's output at the times of motion
    capture; here motion capture is interpolated at the times of the IMUs, so that all models have the same samples.

    Raises
    ------
    InputError
        If the readings are not whole, or the correlation has no clear peak.

    References
    ----------
    Martin, Bruder and Wood (2022), section III-B3: linear interpolation in time, delay by cross-correlation.
    """
    stream = one_clock(recording.readings)
    upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], stream.orientations[:, :1].shape)
    orientations = np.concatenate([upright, stream.orientations], axis=1)
    height = pcc_extended(orientations, selection("pcc", 8), [M2_ARC_M])[:, 0, 2]
    seen = recording.points[:, recording.point_arcs_m.index(M2_ARC_M), 2]
    lag = find_lag(stream.time_s, height, recording.capture_time_s, seen)
    capture_s = recording.capture_time_s + lag.lag_s
    known = (stream.time_s >= capture_s[0]) & (stream.time_s <= capture_s[-1])
    time_s = stream.time_s[known]
    flat = recording.points.reshape(len(capture_s), -1)
    points = np.stack([np.interp(time_s, capture_s, column) for column in flat.T], axis=-1)
    return ArmTrial(
        time_s=time_s,
        orientations=orientations[known],
        points=points.reshape(len(time_s), -1, 3),
        point_arcs_m=recording.point_arcs_m,
        mode=mode_at(time_s),
        facts=stream.facts,
        lag=lag,
    )


ORIGIN_M = 0.005
"""How well the position of the arm's base is known in the frame of the motion capture, per axis [m]; assumed."""
HEADING_RAD = float(np.radians(2.0))
"""How well the two frames are aligned about the vertical [rad]; assumed."""
CHOSEN_ORIGIN_M = (0.006, -0.014, -0.034)
"""An offset of the origin that was CHOSEN so that medians come near the published figures; never in the scorecard."""


@dataclass(frozen=True)
class Draw:
    """A trial, and the truth behind it that a recording does not tell.

    Attributes
    ----------
    seed
        Of sensors and frame.
    trial
        What an evaluation sees.
    capture
        How the frame of the motion capture was off.
    latency_s
        Age of what the sensors' readings show [s].
    """

    seed: int
    trial: ArmTrial
    capture: MotionCapture
    latency_s: float

    def truth(
        self, arm: SoftArm, arcs_m: Sequence[float] | Float[np.ndarray, " points"], every: int = 1
    ) -> Float[np.ndarray, "samples points 3"]:
        """Where points of the arm were at every n-th sample [m], in the frame of the motion capture; no noise."""
        time_s = self.trial.time_s[::every] - self.latency_s
        c, s = np.cos(self.capture.heading_rad), np.sin(self.capture.heading_rad)
        turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return arm.positions_at(time_s, np.array(arcs_m)) @ turned.T + self.capture.origin_m


def errors_with(angles_deg: Mapping[str, float]) -> ImuErrors:
    """Default errors of the IMUs but for some angles, given in degrees by their names without ``_rad``.

    Raises
    ------
    InputError
        If there is no such angle, or it is negative.

    Examples
    --------
    >>> round(errors_with({"mounting": 180.0}).mounting_rad, 4)
    3.1416
    """
    known = [name.removesuffix("_rad") for name in vars(ImuErrors()) if name.endswith("_rad")]
    for name in angles_deg:
        require(name in known, "angles_deg", "errors_with", f"among {', '.join(known)}", name)
    return replace(
        ImuErrors(), **{f"{name}_rad": float(np.radians(value)) for name, value in angles_deg.items()}
    )


def frame_with(origin_mm: float, heading_deg: float) -> dict[str, float]:
    """Arguments ``origin_m`` and ``heading_rad`` of :func:`draw` from millimetres and degrees."""
    return {"origin_m": origin_mm / 1e3, "heading_rad": float(np.radians(heading_deg))}


def draw(
    arm: SoftArm,
    seed: int,
    *,
    errors: ImuErrors | None = None,
    origin_m: float = ORIGIN_M,
    heading_rad: float = HEADING_RAD,
) -> Draw:
    """Record the motion with sensors and a frame of their own, and bring the recording onto one clock.

    Parameters
    ----------
    arm
        How the arm moved.
    seed
        The same seed gives the same bits.
    errors
        Errors of the IMUs; the defaults when not given.
    origin_m, heading_rad
        Standard deviations of the frame of the motion capture: of its origin along each axis [m] and of its turn
        about the vertical [rad].

    Raises
    ------
    InputError
        If the motion is too short, or the two clocks cannot be aligned.
    """
    rng = np.random.default_rng([seed, 2])  # apart from the numbers of IMUs and markers
    x, y, z = origin_m * rng.standard_normal(3)
    capture = MotionCapture(
        origin_m=(float(x), float(y), float(z)), heading_rad=float(heading_rad * rng.standard_normal())
    )
    return drawn(arm, seed, errors or ImuErrors(), capture)


def drawn(arm: SoftArm, seed: int, errors: ImuErrors, capture: MotionCapture) -> Draw:
    """Record the motion as :func:`draw` does, with a given frame."""
    trial = synchronised(record_soft_arm(arm, seed=seed, errors=errors, capture=capture))
    return Draw(seed, trial, capture, errors.latency_s)
