"""Orientations of several sensors on one clock, and what was found on the way there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from edition1.errors import require

GAP_FACTOR = 2.0


@dataclass(frozen=True)
class ImuStream:
    """Orientations of all IMUs on one clock, and what was found on the way there.

    Attributes
    ----------
    time_s
        Times of the samples [s]: those of the readings of the last IMU of a round.
    orientations
        Unit quaternions XYZW, sensor frame to world, of continuous sign.
    facts
        One row per IMU: ``readings``, ``rate_hz`` (mean), ``median_interval_ms``, ``longest_interval_ms``,
        ``gaps`` (intervals above twice the median), ``samples_in_gaps``, ``repeats`` (readings equal to the
        one before to the last bit), ``jumps`` and ``largest_step_deg`` (angle between consecutive readings),
        ``sign_flips``, ``rescaled`` (norm off 1 by more than 1e-6) and ``largest_norm_error``.
    jumps
        One row per jump: ``time_s``, ``imu``, ``step_deg``, and ``axis_z``, the vertical part of the step's
        unit axis in the world frame (1 or -1: a change of heading alone). Jumps stay in the data.
    lost
        Messages whose sequence numbers are missing.
    """

    time_s: Float[np.ndarray, " samples"]
    orientations: Float[np.ndarray, "samples imus 4"]
    facts: pd.DataFrame
    jumps: pd.DataFrame
    lost: int


def on_clock_of_last(
    times: Sequence[Float[np.ndarray, " _"]],
    quaternions: Sequence[Float[np.ndarray, "_ 4"]],
    *,
    between: str = "interpolate",
    jump_deg: float = 20.0,
) -> ImuStream:
    """Bring sensors with time stamps of their own onto the clock of the last one.

    From the first moment at which every sensor has been read to the last. At these times the others take either the
    spherical linear interpolation between their readings before and after, or the latest reading. Gaps and jumps are
    bridged in the same way, and counted.

    Parameters
    ----------
    times, quaternions
        Of each sensor: increasing times [s], and XYZW, sensor frame to world.
    between
        "interpolate" or "hold".
    jump_deg
        Angle between consecutive readings of a sensor above which they count as a jump [deg].

    Raises
    ------
    InputError
        If there is no common time, a sensor has less than two readings, or an option cannot be used.
    """
    require(between in ("interpolate", "hold"), "between", "one_clock", '"interpolate" or "hold"', between)
    require(jump_deg > 0, "jump_deg", "one_clock", "an angle above zero [deg]", jump_deg)
    last = times[-1]
    ticks = last[(last >= max(t[0] for t in times)) & (last <= min(t[-1] for t in times))]
    require(ticks.size != 0, "readings", "one_clock", "of all IMUs over some common time", "none")
    parts = [
        _track(imu, time_s, raw, ticks, between, jump_deg)
        for imu, (time_s, raw) in enumerate(zip(times, quaternions, strict=True))
    ]
    orientations, facts, jumps = zip(*parts, strict=True)
    return ImuStream(
        time_s=ticks,
        orientations=np.stack(orientations, axis=1),
        facts=pd.DataFrame(facts),
        jumps=pd.concat(jumps).sort_values("time_s", ignore_index=True),
        lost=0,
    )


def _track(
    imu: int, time_s: np.ndarray, raw: np.ndarray, ticks: np.ndarray, between: str, jump_deg: float
) -> tuple[np.ndarray, dict[str, Any], pd.DataFrame]:
    """Return one IMU's orientations at the ticks, its facts, and its jumps."""
    require(len(time_s) >= 2, "readings", "one_clock", "at least two per IMU", f"{len(time_s)} of IMU {imu}")
    norms = np.linalg.norm(raw, axis=1, keepdims=True)
    unit, norm_error = raw / norms, np.abs(norms - 1.0)
    rotations = Rotation.from_quat(unit)
    turns = np.degrees((rotations[1:] * rotations[:-1].inv()).as_rotvec())  # in the world frame
    steps_deg = np.linalg.norm(turns, axis=1)
    jumped = steps_deg > jump_deg
    intervals = np.diff(time_s)
    gap = intervals > GAP_FACTOR * np.median(intervals)
    latest = np.searchsorted(time_s, ticks, side="right") - 1
    at_ticks = unit[latest] if between == "hold" else Slerp(time_s, rotations)(ticks).as_quat()
    facts = {
        "imu": imu,
        "readings": len(time_s),
        "rate_hz": len(intervals) / (time_s[-1] - time_s[0]),
        "median_interval_ms": 1e3 * np.median(intervals),
        "longest_interval_ms": 1e3 * intervals.max(),
        "gaps": int(gap.sum()),
        "samples_in_gaps": int((np.append(gap, False)[latest] & (ticks > time_s[latest])).sum()),
        "repeats": int((raw[1:] == raw[:-1]).all(axis=1).sum()),
        "jumps": int(jumped.sum()),
        "largest_step_deg": steps_deg.max(),
        "sign_flips": int(((raw[1:] * raw[:-1]).sum(axis=1) < 0).sum()),
        "rescaled": int((norm_error > 1e-6).sum()),
        "largest_norm_error": norm_error.max(),
    }
    jumps = pd.DataFrame({"time_s": time_s[1:][jumped], "imu": imu, "step_deg": steps_deg[jumped]})
    jumps["axis_z"] = turns[jumped, 2] / steps_deg[jumped]
    return _continuous(at_ticks), facts, jumps


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """Flip signs so that consecutive quaternions lie on one side (q and -q are one rotation)."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod(np.append(1.0, flips))[:, None]
