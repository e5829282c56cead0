"""An experiment that a user can make, to learn how the rig follows its commands; the twin's is SYNTHETIC.

Two minutes: sines of many rates along both axes, so that the bend turns both ways and at all rates, and jumps between
random points. Recorded as T0 to T5, and read from the same files by the same pipeline; the pressures are beside them.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from repro.errors import bad_input
from repro.sensing.rig import RIG_RATE_HZ
from repro_companion.recordings.baaij2023 import INFLATION_S, Recording, process
from repro_companion.twins.marker_capture import capture_ring
from repro_companion.twins.pneumatic_actuation import TRAJECTORIES, Chambers
from repro_companion.twins.pneumatic_rig import (
    FILL_S,
    FILLED_S,
    REGULATOR_HZ,
    SEQUENCE_S,
    TAIL_S,
    RigRecording,
    TwinConfig,
)
from repro_companion.twins.rig_files import SYNTHETIC
from repro_companion.twins.rig_motion import rig_motion
from repro_companion.twins.sensor_board import analogue_readings, converted, disturbance

SWEEP_S, JUMPS_S = 60.0, 60.0
"""Length of the two parts of the experiment [s]: sines of many rates along both axes, then jumps."""
RATES_HZ = (0.05, 0.11, 0.17, 0.26, 0.37, 0.53, 0.71, 1.0)
"""Rates of the sines; amplitudes fall with the root of the rate."""
HELD_S = (0.5, 2.5)
"""Shortest and longest time between two jumps [s]."""
REACH = 0.85
"""Largest torque over the reference."""


@dataclass(frozen=True)
class Commanded:
    """A recording and the commands that it was made with.

    Attributes
    ----------
    recording
        Bends by motion capture, and readings.
    start_s
        Time of its first frame by the clock of the commands [s].
    time_s, torque
        Even times [s], and torque over the reference, turned to where it bends; each holds up to its time.
    """

    recording: Recording
    start_s: float
    time_s: Float[np.ndarray, " n"]
    torque: Float[np.ndarray, "n 2"]

    @property
    def bend_mm(self) -> Float[np.ndarray, "frames 2"]:
        """Bend by motion capture [mm]."""
        return 1e3 * self.recording.q[:, :2]

    def lagged(self, lag_s: float) -> tuple[Float[np.ndarray, "frames 2"], Float[np.ndarray, "frames 2"]]:
        """Torque after a first-order lag, and its rate [1/s], at the frames."""
        share = -np.expm1(-(self.time_s[1] - self.time_s[0]) / lag_s)
        s = np.asarray(lfilter([share], [1.0, share - 1.0], self.torque, axis=0))
        rate, at = (self.torque - s) / lag_s, self.start_s + self.recording.time_s
        found = (np.column_stack([np.interp(at, self.time_s, c) for c in z.T]) for z in (s, rate))
        return next(found), next(found)


def experiment_torque(
    time_s: Float[np.ndarray, " n"], chambers: Chambers, *, seed: int
) -> Float[np.ndarray, "n 2"]:
    """Torques ``(tau_x, tau_y)`` [N m] of the experiment, zero outside it: sines, then jumps in a disc.

    Parameters
    ----------
    time_s
        Times after its start [s].
    chambers
        For the reference torque.
    seed
        Of phases, points and times.
    """
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(RATES_HZ)))
    rates = np.array(RATES_HZ)
    inside = (time_s >= 0) & (time_s < SWEEP_S + JUMPS_S)
    t = np.where(inside, time_s, 0.0)[:, None, None]
    sines = (np.sin(2.0 * np.pi * rates * t + phase) / np.sqrt(rates)).sum(axis=-1)
    sines = sines / np.linalg.norm(sines, axis=1).max()
    jumps = round(JUMPS_S / HELD_S[0]) + 1
    ends = SWEEP_S + rng.uniform(*HELD_S, jumps).cumsum()
    radius, azimuth = np.sqrt(rng.random(jumps)), 2.0 * np.pi * rng.random(jumps)
    points = radius[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    held = points[np.minimum(np.searchsorted(ends, time_s), jumps - 1)]
    shape = np.where((time_s < SWEEP_S)[:, None], sines, held)
    torque = REACH * chambers.reference_nm * np.column_stack([-shape[:, 1], shape[:, 0]])
    return np.where(inside[:, None], torque, 0.0)


def record_experiment(config: TwinConfig, *, seed: int) -> Commanded:
    """Make the experiment with a twin, in the session of its T5, and read its files by the pipeline; synthetic.

    Parameters
    ----------
    config
        The twin.
    seed
        Of the experiment and of its noise.
    """
    rng = np.random.default_rng(
        [seed, len(TRAJECTORIES) + 1]
    )  # T0 to T5 and the loops have the numbers below
    end = SEQUENCE_S + SWEEP_S + JUMPS_S
    time_s = np.arange(round((end + TAIL_S) * REGULATOR_HZ) + 1) / REGULATOR_HZ
    chambers = config.chambers
    torque = experiment_torque(time_s - SEQUENCE_S, chambers, seed=seed)
    fill = np.interp(time_s, [FILL_S, FILLED_S, end, end + 1.0], [0.0, 1.0, 1.0, 0.0])
    pressures = chambers.pressures(torque) - chambers.offset_mbar * (1.0 - fill[:, None])
    motion = rig_motion(time_s, pressures, chambers, config.bending, config.inner, model=config.hysteresis)
    starts = rng.uniform(0.0, config.capture.latest_start_s, 2)
    clock = np.arange(int((time_s[-1] - starts.max()) * RIG_RATE_HZ)) / RIG_RATE_HZ
    pressures_read, q, q_magnet = motion.at(starts[0] + clock)
    u = analogue_readings(config.board, q, q_magnet) + config.bias_mv[-1]
    u = u + disturbance(config.board, clock, pressures_read.mean(axis=1) / chambers.offset_mbar, rng)
    _, q_seen, _ = motion.at(starts[1] + clock / (1.0 + 1e-6 * config.capture.clock_ppm))
    track = capture_ring(config.capture, clock, q_seen, rng)
    name = f"{SYNTHETIC}_experiment"
    raw = RigRecording(name, motion, converted(u), track, float(starts[0]), float(starts[1]))
    with tempfile.TemporaryDirectory() as folder:
        raw.write(Path(folder))
        read = process(name, Path(folder))
    return commanded(config.chambers, raw, read)


def commanded(
    chambers: Chambers, raw: RigRecording, read: Recording, *, frames: int | None = None
) -> Commanded:
    """Commands beside a recording, its first frames only if so wished; the clock of the commands is the sensors'.

    Raises
    ------
    InputError
        If the recording does not tell how many readings were cut to align it.
    """
    if "readings cut to align" not in read.repairs:
        raise bad_input("read", "commanded", "a recording by the pipeline", read.name)
    cut = read.repairs["readings cut to align"] / RIG_RATE_HZ + INFLATION_S
    kept = slice(0, frames)
    part = Recording(read.name, read.frame[kept], read.q[kept], read.u[kept], read.repairs)
    torque = turned_torque(chambers, raw.motion.pressures_mbar)
    return Commanded(part, raw.sensors_start_s + cut, raw.motion.time_s, torque)


def turned_torque(chambers: Chambers, pressures_mbar: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Torque of pressures [mbar] over the reference, turned to where it bends."""
    torque = chambers.torque(pressures_mbar) / chambers.reference_nm
    return np.column_stack([torque[:, 1], -torque[:, 0]])
