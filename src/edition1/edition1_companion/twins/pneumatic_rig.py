"""Digital twin of the rig of Baaij et al. 2023, section 5: SYNTHETIC recordings T0 to T5, none of them measured.

Torques become pressures, pressures a motion with lag and hysteresis, the motion the field of a ring at three sensors
that are not as drawn, and the field readings. The parameters stand in `edition1_companion.twins.rig_twins`.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from edition1_companion.recordings.baaij2023 import Recording, process
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.pneumatic_actuation import DURATION_S, TRAJECTORIES, Chambers, torque_sequence
from edition1_companion.twins.rig_files import (
    SYNTHETIC,
    MarkerCapture,
    RingTrack,
    capture_ring,
    write_recording,
)
from edition1_companion.twins.rig_motion import Bending, InnerShape, RigMotion, rig_motion
from edition1_companion.twins.sensor_board import Board, analogue_readings, converted, disturbance

REGULATOR_HZ = 100.0
"""Rate of the pressure regulator (section 5.2)."""
FILL_S, FILLED_S, SEQUENCE_S, TAIL_S = 2.5, 2.6, 8.0, 4.0
"""Times [s]: the chambers begin to fill, are at the offset pressure, the sequence begins; after it they are empty for
the time of the last. Assumed; the authors' pipeline cuts 8 s at the start and 5 s at the end."""


@dataclass(frozen=True)
class Differences:
    """How the motion differs between recordings; one entry for each of T0 to T5, in this order.

    Parameters
    ----------
    shift_mm
        Bend along x that is added to the neutral one.
    elongation_mm, elongation_per_mm2
        What motion capture calls elongation: that of the inflated, straight segment, and what is added for each mm²
        of the square of the bend. What the sensors feel is that of the bending, in all recordings.
    """

    shift_mm: tuple[float, ...]
    elongation_mm: tuple[float, ...]
    elongation_per_mm2: tuple[float, ...]

    def bending(self, bending: Bending, number: int) -> Bending:
        """Bending of a recording, by its number."""
        x, y = bending.neutral_mm
        return replace(bending, neutral_mm=(x + self.shift_mm[number], y))

    def seen(self, q: Float[np.ndarray, "n 3"], bending: Bending, number: int) -> Float[np.ndarray, "n 3"]:
        """Configuration [m] that motion capture sees in a recording, by its number."""
        bend, straight = q[:, :2], q[:, 2] / bending.elongation_mm * self.elongation_mm[number]
        more = 1e3 * self.elongation_per_mm2[number] * (bend * bend).sum(axis=1)
        return np.column_stack([bend, straight + more])


@dataclass(frozen=True)
class TwinConfig:
    """All parameters of the twin.

    Parameters
    ----------
    chambers, bending, inner, board, capture
        Actuation, tip, magnet, sensors and motion capture.
    hysteresis
        One of :data:`edition1_companion.twins.rig_motion.MODELS`.
    bias_mv
        Common bias of the readings in T0 to T5, in this order.
    bias_scatter_mv
        Standard deviation of a bias of each sensor in each recording but T5.
    gain_scatter
        Standard deviation of the relative gain, about its mean reading, of each sensor in each recording but T5.
    differences
        How the motion differs between recordings; None: it does not.
    """

    chambers: Chambers
    bending: Bending
    inner: InnerShape
    board: Board
    capture: MarkerCapture
    hysteresis: str
    bias_mv: tuple[float, ...]
    bias_scatter_mv: float
    gain_scatter: float
    differences: Differences | None = None

    @property
    def sha256(self) -> str:
        """SHA-256 of all values, as JSON with sorted names; differences that are None are left out."""
        values = asdict(self)
        if self.differences is None:
            del values["differences"]
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class RigRecording:
    """One synthetic recording, with the truth that files do not tell.

    Attributes
    ----------
    name
        Name of the files.
    motion
        Pressures and configurations, at 100 Hz.
    readings_mv
        What the board sent, 40 Hz.
    track
        What motion capture saw.
    sensors_start_s, capture_start_s
        Times of `motion` at which the two began.
    """

    name: str
    motion: RigMotion
    readings_mv: Float[np.ndarray, "readings 3"]
    track: RingTrack
    sensors_start_s: float
    capture_start_s: float

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write the raw files below ``folder``, see :func:`edition1_companion.twins.rig_files.write_recording`."""
        return write_recording(folder, self.name, self.track, self.readings_mv)

    def read(self, *, skip: int = 1) -> Recording:
        """Write the raw files to a temporary folder, and read them by the pipeline."""
        with tempfile.TemporaryDirectory() as folder:
            self.write(Path(folder))
            return process(self.name, Path(folder), skip=skip)


def record_rig(
    config: TwinConfig, trajectory: str, *, seed: int, duration_s: float | None = None
) -> RigRecording:
    """Record one of the six actuation sequences; synthetic.

    Parameters
    ----------
    config
        The twin.
    trajectory
        One of T0 to T5.
    seed
        Seed of all random numbers; each sequence draws its own. The same seed gives the same bits.
    duration_s
        Length of the sequence [s], when shorter than in section 5.3.
    """
    number = TRAJECTORIES.index(trajectory)

    def torque(time_s: np.ndarray) -> np.ndarray:
        return torque_sequence(trajectory, time_s, config.chambers, seed=seed)

    length_s = min(duration_s or np.inf, DURATION_S[trajectory])
    return record_torque(config, trajectory, torque, length_s, np.random.default_rng([seed, number]), number)


def record_torque(
    config: TwinConfig,
    name: str,
    torque: Callable[[np.ndarray], np.ndarray],
    length_s: float,
    rng: np.random.Generator,
    number: int,
) -> RigRecording:
    """Record any sequence of torques; synthetic.

    Parameters
    ----------
    config
        The twin.
    name
        Last part of the name of the recording.
    torque
        Torques ``[samples, 2]`` [N m] at times after the start [s]; none after the end.
    length_s
        Time of the end [s].
    rng
        Of all random numbers.
    number
        The session is that of this one of T0 to T5.
    """
    end = SEQUENCE_S + length_s
    time_s = np.arange(round((end + TAIL_S) * REGULATOR_HZ) + 1) / REGULATOR_HZ
    chambers, bending, differences = config.chambers, config.bending, config.differences
    torque_nm = np.where((time_s < end)[:, None], torque(time_s - SEQUENCE_S), 0.0)
    fill = np.interp(time_s, [FILL_S, FILLED_S, end, end + 1.0], [0.0, 1.0, 1.0, 0.0])
    pressures = chambers.pressures(torque_nm) - chambers.offset_mbar * (1.0 - fill[:, None])
    if differences is not None:
        bending = differences.bending(bending, number)
    motion = rig_motion(time_s, pressures, chambers, bending, config.inner, model=config.hysteresis)

    starts = rng.uniform(0.0, config.capture.latest_start_s, 2)
    clock = np.arange(int((time_s[-1] - starts.max()) * RIG_RATE_HZ)) / RIG_RATE_HZ
    pressures_read, q, q_magnet = motion.at(starts[0] + clock)
    u = analogue_readings(config.board, q, q_magnet)
    if TRAJECTORIES[number] != "T5":
        u = u + (u - u.mean(axis=0)) * config.gain_scatter * rng.standard_normal(RIG_SENSORS)
        u = u + config.bias_scatter_mv * rng.standard_normal(RIG_SENSORS)
    u = u + config.bias_mv[number]
    u = u + disturbance(config.board, clock, pressures_read.mean(axis=1) / chambers.offset_mbar, rng)

    _, q_seen, _ = motion.at(starts[1] + clock / (1.0 + 1e-6 * config.capture.clock_ppm))
    if differences is not None:
        q_seen = differences.seen(q_seen, bending, number)
    track = capture_ring(config.capture, clock, q_seen, rng)
    whole = f"{SYNTHETIC}_{name}"
    return RigRecording(whole, motion, converted(u), track, float(starts[0]), float(starts[1]))


@dataclass(frozen=True)
class TwinRecordings:
    """Recordings of one twin: as simulated, and as the pipeline has read them from files."""

    config: TwinConfig
    raw: dict[str, RigRecording]
    read: dict[str, Recording]


def record_twin(
    config: TwinConfig,
    *,
    seed: int = 0,
    trajectories: Sequence[str] = TRAJECTORIES,
    longest_s: float | None = None,
    skip: int = 1,
) -> TwinRecordings:
    """Record sequences with a twin, write them as raw files to a temporary folder, and read them by the pipeline.

    Parameters
    ----------
    config
        The twin.
    seed
        Seed of the recordings.
    trajectories
        Which ones.
    longest_s
        Cut sequences to this length [s].
    skip
        See :func:`edition1_companion.recordings.baaij2023.merge`.
    """
    raw = {name: record_rig(config, name, seed=seed, duration_s=longest_s) for name in trajectories}
    return TwinRecordings(config, raw, {name: raw[name].read(skip=skip) for name in trajectories})
