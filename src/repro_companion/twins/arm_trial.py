"""A trial as Martin et al. (2022) evaluate it: orientations and markers on one clock (section III-B3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from repro.estimation.imu_models import pcc_extended
from repro_companion.recordings.alignment import Lag, find_lag
from repro_companion.recordings.martin2022 import one_clock
from repro_companion.recordings.martin2022_models import selection
from repro_companion.twins.arm_recording import MARKER_ARCS_M, ArmRecording
from repro_companion.twins.stick_motion import mode_at

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
        What was found per IMU on the way: see `repro_companion.recordings.imu_clock.ImuStream`.
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
