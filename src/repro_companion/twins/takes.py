"""What an emulated board can play: a recording, or SYNTHETIC readings of the robots of the three papers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from torch import Tensor

from repro.errors import bad_input, require
from repro.kinematics.paper_robots import pcc_robot
from repro.robot_file.columns import FORMATS
from repro.robot_file.robot_file import RobotFile
from repro.sensing.magnetic import readings as field_readings
from repro.sensing.magnets import ring
from repro_companion.recordings.mitchell2021_conventions import file_axes
from repro_companion.recordings.rig_robot import RIG_RATE_HZ
from repro_companion.twins.bend_curves import CURVES, TIME_STEP, bend_curve, bend_readings
from repro_companion.twins.imu_stream import synthetic_stream
from repro_companion.twins.pneumatic_actuation import TRAJECTORIES
from repro_companion.twins.pneumatic_rig import record_rig
from repro_companion.twins.rig_twins import nominal_twin
from repro_companion.twins.trajectories import RATE_HZ, STEPS, lemniscate
from repro_live.emulate.board import Reading
from repro_live.record.recording import read_recording

SOURCES = ("lemniscate", *CURVES, *(f"twin:{name}" for name in TRAJECTORIES), "arm")
"""Synthetic takes: T3 of Baaij et al. [mT]; the curves of Mitchell et al. [mT]; the twin of the rig [mV]; the IMUs of
Martin et al."""
COUNT_MT = 0.01
"""One count of the Hall sensor of Mitchell et al. [mT]."""
ARM_S, ARM_HZ = 20.0, 35.0


@dataclass(frozen=True)
class Take:
    """Readings that a board can send.

    Attributes
    ----------
    label
        What they are; says so if they are synthetic.
    format
        Wire format that their unit is meant for.
    time_s
        Time of each since the board was switched on [s].
    stream
        Stream of each.
    values
        Readings in the unit of the format, rounded to what it can carry; NaN where one has fewer.
    period_s
        After this time the take can begin again [s].
    """

    label: str
    format: str
    time_s: Float[np.ndarray, " readings"]
    stream: Int[np.ndarray, " readings"]
    values: Float[np.ndarray, "readings channels"]
    period_s: float

    def readings(self, *, loop: bool = False) -> Iterator[Reading]:
        """Yield the readings one by one; over and over if ``loop``."""
        heads = list(zip(self.time_s.tolist(), self.stream.tolist(), strict=True))
        rows = [tuple(row) for row in self.values.tolist()]
        for turn in count() if loop else range(1):
            for (time_s, stream), row in zip(heads, rows, strict=True):
                yield Reading(turn * self.period_s + time_s, stream, row)


def open_take(source: str, format: str = "", *, rate_hz: float | None = None, seed: int = 0) -> Take:
    """Return the readings of a source in the unit of a wire format.

    Parameters
    ----------
    source
        One of :data:`SOURCES`, or the path of a recording.
    format
        One of :data:`repro_live.wire.formats.FORMATS`; by default that of the source. Our own frames
        take any source, ``csv`` any of one stream, the other text formats only what they were made for.
    rate_hz
        Readings per second of each stream; by default 40 Hz for Baaij et al., 100 for Mitchell et al., 35 for Martin
        et al., and as recorded. Readings in between are interpolated, but those of a recording only move in time.
    seed
        Of the synthetic readings.

    Raises
    ------
    InputError
        If there is no such source or format, they do not fit, or the rate is not positive.
    """
    if format and format not in FORMATS:
        raise bad_input("format", "open_take", f"one of {', '.join(FORMATS)}", format)
    if rate_hz is not None and not 0 < rate_hz < math.inf:
        raise bad_input("rate_hz", "open_take", "above zero [Hz]", rate_hz)
    if source == "lemniscate":
        take = _lemniscate(rate_hz or RATE_HZ)
    elif source in CURVES:
        take = _curve(source, rate_hz or 1 / TIME_STEP, format)
    elif source.removeprefix("twin:") in TRAJECTORIES and source.startswith("twin:"):
        take = _twin(source.removeprefix("twin:"), rate_hz or RIG_RATE_HZ, seed)
    elif source == "arm":
        take = _arm(rate_hz or ARM_HZ, seed)
    elif Path(source).is_file():
        take = _recorded(Path(source), rate_hz)
    else:
        expected = f"one of {', '.join(SOURCES)}, or the path of a recording"
        raise bad_input("source", "open_take", expected, repr(source))
    chosen = format or take.format
    one_stream = ["csv"] if (take.stream == 0).all() else []
    fitting = dict.fromkeys((take.format, "frames", *one_stream))
    if chosen not in fitting:
        fitting = " or ".join(fitting)
        raise bad_input("format", f"the take {source}", fitting, chosen)
    values = _carried(chosen, take.values)
    return Take(take.label, chosen, take.time_s, take.stream, values, take.period_s)


def _carried(format: str, values: np.ndarray) -> np.ndarray:
    """Round to what the format carries, so that what is sent can be compared with what arrives."""
    if format == "frames":
        return values.astype(np.float32).astype(float)
    if format == "csv":
        return values
    return np.round(values, {"hall": 0, "millivolts": 4, "quaternions": 6}[format]) + 0.0


def _even(label: str, format: str, values: np.ndarray, rate_hz: float) -> Take:
    n = len(values)
    return Take(label, format, np.arange(n) / rate_hz, np.zeros(n, np.int64), values, n / rate_hz)


def _resampled(values: np.ndarray, rate_hz: float, wanted_hz: float) -> np.ndarray:
    if wanted_hz == rate_hz:
        return values
    at = np.arange(0, len(values) - 1, rate_hz / wanted_hz)
    return np.column_stack([np.interp(at, np.arange(len(values)), column) for column in values.T])


def _lemniscate(rate_hz: float) -> Take:
    q = lemniscate(1, steps=max(2, round(STEPS * rate_hz / RATE_HZ)))
    u = field_readings(pcc_robot(), q, ring("released")).numpy()
    return _even("lemniscate T3 of one segment [mT], SYNTHETIC", "frames", u, rate_hz)


def _curve(name: str, rate_hz: float, format: str) -> Take:
    """Field of the cube; counts in the order of the board for its lines, else mT in the axes of the model."""
    u = bend_readings(bend_curve(name))
    if format == "frames":
        return _even(
            f"{name} [mT], SYNTHETIC", "frames", _resampled(u.numpy(), 1 / TIME_STEP, rate_hz), rate_hz
        )
    counts = file_axes(u).numpy()[:, ::-1] / COUNT_MT  # the board sends the component along the body last
    return _even(
        f"{name} [counts], SYNTHETIC", "hall", _resampled(counts, 1 / TIME_STEP, rate_hz).round(), rate_hz
    )


def _twin(name: str, rate_hz: float, seed: int) -> Take:
    u = record_rig(nominal_twin(), name, seed=seed).readings_mv
    label = f"{name} of the digital twin [mV], SYNTHETIC"
    return _even(label, "millivolts", _resampled(u, RIG_RATE_HZ, rate_hz), rate_hz)


def _arm(rate_hz: float, seed: int) -> Take:
    table = synthetic_stream(seed=seed, duration_s=max(ARM_S, 2 / rate_hz), rate_hz=rate_hz)
    time_s = table["time_s"].to_numpy()
    values, stream = table[["x", "y", "z", "w"]].to_numpy(), table["imu"].to_numpy(np.int64)
    return Take(
        "eight IMUs on an arm, SYNTHETIC", "quaternions", time_s, stream, values, time_s[-1] + time_s[1]
    )


def _recorded(path: Path, rate_hz: float | None) -> Take:
    recording = read_recording(path)
    table = recording.frames
    require(len(table) >= 2, "source", "open_take", "a recording of at least two frames", len(table))
    stream = table["stream"].to_numpy(np.int64)
    if rate_hz is None:
        time_s = table["time_s"].to_numpy(float)
        time_s = np.maximum.accumulate(time_s - time_s[0])
    else:
        time_s = np.arange(len(table)) / (rate_hz * len(np.unique(stream)))
    values = table[recording.channels].to_numpy(float)
    period_s = time_s[-1] * len(table) / (len(table) - 1)
    label = "; ".join([path.name, *recording.remarks])
    return Take(label, recording.format, time_s, stream, values, period_s)


PERIOD_S = 10.0
"""Duration of the lemniscate T3 [s]."""


@dataclass(frozen=True)
class Played:
    """What a board sends, and the truth.

    Attributes
    ----------
    robot
        Whose readings.
    take
        What is sent; its sequence numbers count the rows.
    q
        Configurations, one for each row.
    """

    robot: RobotFile
    take: Take
    q: Float[Tensor, "readings n_q"]


def played(robot: RobotFile, *, rate_hz: float, seconds: float, seed: int) -> Played:
    """Return noisy readings on the lemniscate T3 of a robot of Baaij et al., as its board sends them.

    Parameters
    ----------
    robot
        Segments of constant curvature with ring magnets.
    rate_hz
        Readings per second.
    seconds
        How long, at most 10 s.
    seed
        Of the noise.

    Raises
    ------
    InputError
        If the robot is another one, or there is less than one reading.
    """
    n = len(robot.robot.segments)
    if robot.magnet is None or robot.robot.n_q != 3 * n or robot.format != "frames":
        raise bad_input("robot", "played", "one of Baaij et al. that sends frames", robot.name)
    count = round(rate_hz * seconds)
    if not 1 <= count <= rate_hz * PERIOD_S:
        raise bad_input("seconds", "played", f"of one reading at least, {PERIOD_S:g} at most", seconds)
    q = lemniscate(n, steps=round(rate_hz * PERIOD_S))[:count]
    u = field_readings(robot.robot, q, robot.magnet, earth_mt=robot.earth_mt).numpy() * robot.gain.numpy()
    u += robot.offset.numpy() + robot.noise * np.random.default_rng(seed).standard_normal(u.shape)
    values = np.zeros((count, robot.channels))
    values[:, list(robot.channel)] = u
    label = f"lemniscate T3 of {robot.name} [{robot.unit}], SYNTHETIC"
    take = _even(label, "frames", _carried("frames", values), rate_hz)
    return Played(replace(robot, rate_hz=rate_hz), take, q)


def with_sensors(robot: RobotFile, sensors: int) -> RobotFile:
    """Return a robot with another number of sensors in the tip plane of its only segment."""
    require(len(robot.robot.segments) == 1, "robot", "with_sensors", "one of one segment", robot.name)
    return replace(
        robot,
        robot=replace(robot.robot, sensors=pcc_robot(1, sensors).sensors),
        channels=sensors,
        channel=tuple(range(sensors)),
        gain=robot.gain[:1].expand(sensors).clone(),
        offset=robot.offset[:1].expand(sensors).clone(),
    )
