"""The arms of the page: the released bag, the continuum robot that is part of the project, or a synthetic stream."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input
from edition1.estimation.imu_chain import point_at, rigid_body
from edition1_companion.recordings.continuum_robot import (
    LENGTH_M,
    STATIONS_M,
    TRUTH,
    find_trials,
    poses,
    read_readings,
)
from edition1_companion.recordings.imu_clock import ImuStream, on_clock_of_last
from edition1_companion.recordings.martin2022 import BAGS, find_bag, one_clock
from edition1_companion.recordings.martin2022 import read_readings as read_bag
from edition1_companion.twins.captured_rod import captured
from edition1_companion.twins.imu_stream import synthetic_stream

BAG, ROBOT, SYNTHETIC = "released bag", "continuum robot", "synthetic stream"
SOURCES = {BAG: "recorded bag", ROBOT: "recorded robot", SYNTHETIC: "synthetic stream"}
"""What titles and tables call each of them."""
TRIAL = "slow_free_space"
SHORT_S = 20.0
"""What is used of a recording in a fast run: its beginning, of the robot from where it moves."""


@dataclass(frozen=True)
class Arm:
    """Orientations along an arm on one clock."""

    recording: str
    """One of :data:`SOURCES`."""
    stream: ImuStream
    along: str
    """Axis of the sensors that points along the arm."""
    links_m: Float[np.ndarray, " imus"]
    """A straight link for each sensor."""
    sensors_m: Float[np.ndarray, " imus"]
    """Where the sensors sit along these links."""
    origin: str
    """File or seed."""

    @property
    def source(self) -> str:
        """Words for titles and tables."""
        return SOURCES[self.recording]


def load_arm(
    recording: str, robot: Path, *, bag: str, along: str, between: str, jump_deg: float, seed: int, fast: bool
) -> Arm:
    """Return an arm by its name, or the first that is found: the bag, else the robot, which is part of the project.

    Parameters
    ----------
    recording
        "first found", or one of :data:`SOURCES`.
    robot
        ``data/recordings/continuum_robot``.
    bag
        Name of the released bag.
    along
        Axis of the sensors along the arm, or "of the recording".
    between, jump_deg
        As for :func:`edition1_companion.recordings.martin2022.one_clock`.
    seed
        Of the synthetic stream.
    fast
        Use :data:`SHORT_S` only.
    """
    path = None if recording in (ROBOT, SYNTHETIC) else find_bag(bag)
    if recording == BAG and path is None:
        raise bad_input("recording", "load_arm", "one that is found (see repro fetch)", bag)
    options = {"between": between, "jump_deg": jump_deg}
    eight, ends = np.full(8, 0.08), 0.08 * np.arange(1, 9)
    if path is not None:
        readings, axis = read_bag(path), "y" if along == "of the recording" else along
        stream = one_clock(readings[readings["time_s"] < SHORT_S] if fast else readings, **options)
        return Arm(BAG, stream, axis, eight, ends, f"{bag}, sha256 {BAGS[bag][:12]}…")
    if recording == SYNTHETIC:
        axis = "y" if along == "of the recording" else along
        stream = one_clock(synthetic_stream(seed=seed, along_arm=axis), **options)
        return Arm(SYNTHETIC, stream, axis, eight, ends, f"seed {seed}")
    (trial,) = (trial for trial in find_trials(robot) if trial.name == TRIAL)
    bodies = [read_readings(trial.folder / f"{name}.csv") for name in TRUTH]
    start = trial.window_s[0] if fast and trial.window_s else max(body.time_s[0] for body in bodies)
    times = [body.time_s - start for body in bodies]
    kept = [(time_s >= 0) & (time_s < (SHORT_S if fast else np.inf)) for time_s in times]
    turns = [Rotation.from_matrix(poses(body)[:, :3, :3]).as_quat() for body in bodies]
    stream = on_clock_of_last(
        [time_s[k] for time_s, k in zip(times, kept, strict=True)],
        [turn[k] for turn, k in zip(turns, kept, strict=True)],
        **options,
    )
    axis = "z" if along == "of the recording" else along
    places = np.array([0.0, *STATIONS_M])
    return Arm(ROBOT, stream, axis, links_about(LENGTH_M, len(places)), places, f"{TRIAL}, all of it")


def links_about(length_m: float, sensors: int) -> Float[np.ndarray, " sensors"]:
    """Straight links with evenly spread sensors in their middle; the first and the last at an end: half a link."""
    links = np.full(sensors, length_m / (sensors - 1))
    links[[0, -1]] /= 2
    return links


def off_capture(robot: Path, links_m: Float[np.ndarray, " 5"]) -> pd.DataFrame:
    """Distance of the robot's chain to the motion capture: columns ``station_mm, rmse_mm``.

    In the frames that show all bodies, without interpolation; the chain begins where body 0 is.
    """
    (trial,) = (trial for trial in find_trials(robot) if trial.name == TRIAL)
    T = captured(trial, whole=True)[1]
    q = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(*T.shape[:2], 4)
    chain = point_at(rigid_body(q, links_m), links_m, np.minimum(STATIONS_M, links_m.sum()))
    off = np.linalg.norm(chain - (T[:, 1:, :3, 3] - T[:, :1, :3, 3]), axis=-1)
    return pd.DataFrame(
        {"station_mm": 1e3 * np.array(STATIONS_M), "rmse_mm": 1e3 * np.sqrt((off**2).mean(axis=0))}
    )
