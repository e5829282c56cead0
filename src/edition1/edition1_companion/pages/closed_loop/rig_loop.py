r"""The digital twin of the rig, step by step: pressures in, bend and readings out; all of it SYNTHETIC.

`edition1_companion.twins.rig_motion` moves the segment through a whole sequence of pressures. A controller knows the
next pressures only when it has seen the readings before them: here is the same motion, from the same equations,
sample by sample at 100 Hz, with readings at 40 Hz. The motion of the magnet needs the rate of the torque, a central
difference: a sample is complete once the pressures of the next are known, which is before the next reading.

Runs are a leading dimension: all of them step at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from edition1.errors import require
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import REGULATOR_HZ, TwinConfig
from edition1_companion.twins.rig_motion import turned_bend
from edition1_companion.twins.sensor_board import converted, disturbance


@dataclass(frozen=True)
class MotionState:
    """The segment at the newest sample of the regulator; no array is ever changed.

    Attributes
    ----------
    delayed, before
        Torque over the reference, turned to where it bends, and inflation, after the lag: at the newest sample, and
        at the one before it (None at the first).
    free_mm, tip_mm
        Bend without and with its hysteresis.
    memory, inner_memory
        Of the hystereses of the tip and of the magnet, in [-1, 1].
    """

    delayed: Float[np.ndarray, "runs 3"]
    before: Float[np.ndarray, "runs 3"] | None
    free_mm: Float[np.ndarray, "runs 2"]
    tip_mm: Float[np.ndarray, "runs 2"]
    memory: Float[np.ndarray, "runs 2"]
    inner_memory: Float[np.ndarray, "runs 2"]


@dataclass(frozen=True)
class RigState:
    """The rig at a reading: its number, and the segment at the newest sample that is complete."""

    tick: int
    motion: MotionState


@dataclass(frozen=True)
class SteppedRig:
    """The segment of a twin, from reading to reading.

    Parameters
    ----------
    config
        The twin; its hysteresis is ``"bouc-wen"``, the other model is not stepped.
    """

    config: TwinConfig

    def init(self, runs: int) -> RigState:
        """Segments at rest, with empty chambers, at the first reading."""
        zero = np.zeros((runs, 2))
        return RigState(0, MotionState(np.zeros((runs, 3)), None, zero, zero, zero, zero))

    def step(
        self, state: RigState, pressures_mbar: Float[np.ndarray, "runs 3"]
    ) -> tuple[RigState, Float[np.ndarray, "runs 3"], Float[np.ndarray, "runs 3"]]:
        """Hold pressures [mbar] from this reading to the next.

        Returns
        -------
        RigState, array, array
            State at the next reading; configuration of the tip, and the one of the magnet, at this one [m].
        """
        # 2.5 samples of the regulator for each reading: two and three in turn.
        per_reading = REGULATOR_HZ / RIG_RATE_HZ
        first, last = int(per_reading * state.tick), int(per_reading * (state.tick + 1))
        motion, shapes = state.motion, []
        for _ in range(last - first):
            motion, *shape = self.move(motion, pressures_mbar)
            shapes.append(shape)
        share = per_reading * state.tick - first  # the reading is between two samples, or at one
        q, q_magnet = ((1 - share) * here + share * later for here, later in zip(*shapes[:2], strict=True))
        return RigState(state.tick + 1, motion), q, q_magnet

    def move(
        self, motion: MotionState, pressures_mbar: Float[np.ndarray, "runs 3"]
    ) -> tuple[MotionState, Float[np.ndarray, "runs 3"], Float[np.ndarray, "runs 3"]]:
        """One sample of the regulator on; both configurations [m] are those of the sample before."""
        config, dt = self.config, 1.0 / REGULATOR_HZ
        chambers, bending, inner = config.chambers, config.bending, config.inner
        inflation = pressures_mbar.mean(axis=1) / chambers.offset_mbar
        driven = np.column_stack([chambers.bending_torque(pressures_mbar), inflation])
        delayed = motion.delayed - np.expm1(-dt / bending.lag_s) * (driven - motion.delayed)

        s, old = motion.delayed[:, :2], motion.before
        rate = (delayed[:, :2] - s) / dt if old is None else (delayed[:, :2] - old[:, :2]) / (2 * dt)
        bent = motion.tip_mm - motion.delayed[:, 2:] * bending.neutral_mm
        across = turned_bend(s, rate, bent, inner.centre)
        magnet = motion.tip_mm - inner.across_s * across - inner.hysteresis_mm * motion.inner_memory
        elongation = bending.elongation_mm * motion.delayed[:, 2]
        q, q_magnet = (1e-3 * np.column_stack([xy, elongation]) for xy in (motion.tip_mm, magnet))

        s = delayed[:, :2]
        free = delayed[:, 2:] * bending.neutral_mm + s * bending.linear_mm
        free = free + s**2 * bending.quadratic_mm + s**3 * bending.cubic_mm
        memory = _remember(motion.memory, free - motion.free_mm, bending.stroke_mm)
        tip = free - bending.hysteresis_mm * memory
        inner_memory = _remember(motion.inner_memory, tip - motion.tip_mm, inner.stroke_mm)
        return MotionState(delayed, motion.delayed, free, tip, memory, inner_memory), q, q_magnet


def _remember(z: np.ndarray, step: np.ndarray, stroke: float) -> np.ndarray:
    """Bouc-Wen memory after a step of the path, as in `edition1_companion.twins.rig_motion`."""
    end = np.copysign(1.0, step)
    return end + (z - end) * np.exp(-np.abs(step) / stroke)


@dataclass(frozen=True)
class Sessions:
    """What the board does to the readings in each run, drawn before it starts.

    Parameters
    ----------
    bias_mv
        Constant part of each sensor.
    gain
        Relative gain of each sensor, about its reading when the segment is inflated and no torque acts.
    disturbance_mv
        Noise and drift.
    """

    bias_mv: Float[np.ndarray, "runs 3"]
    gain: Float[np.ndarray, "runs 3"]
    disturbance_mv: Float[np.ndarray, "ticks runs 3"]

    def readings_mv(
        self, tick: int, clean_mv: Float[np.ndarray, "runs 3"], rest_mv: Float[np.ndarray, "runs 3"]
    ) -> Float[np.ndarray, "runs 3"]:
        """What the board sends, from readings [mV] without disturbance, and those at rest."""
        changed = clean_mv + (clean_mv - rest_mv) * self.gain + self.bias_mv
        return converted(changed + self.disturbance_mv[tick])


SESSIONS = ("as trained", "another")
"""A session has the noise, drift and converter of the twin; another one also a bias and gains of its own."""


def sessions(config: TwinConfig, kinds: Sequence[str], seeds: Sequence[int], ticks: int) -> Sessions:
    """Draw the sessions of some runs.

    The common bias of another session is that of one of the twin's recordings T0 to T4, the scatter of bias and gain
    of each sensor that of these recordings. Noise and drift of a seed are the same in both kinds.

    Parameters
    ----------
    config
        The twin.
    kinds
        For each run one of :data:`SESSIONS`.
    seeds
        For each run its seed.
    ticks
        Number of readings.

    Raises
    ------
    InputError
        If there is no such kind.
    """
    require(set(kinds) <= set(SESSIONS), "kinds", "sessions", f"among {', '.join(SESSIONS)}", kinds)
    clock, inflated = np.arange(ticks) / RIG_RATE_HZ, np.ones(ticks)
    runs = len(kinds)
    bias, gain, noise = (np.zeros((*shape, RIG_SENSORS)) for shape in ((runs,), (runs,), (ticks, runs)))
    for k, (kind, seed) in enumerate(zip(kinds, seeds, strict=True)):
        rng = np.random.default_rng([seed, len(TRAJECTORIES)])  # T0 to T5 have the numbers below
        noise[:, k] = disturbance(config.board, clock, inflated, rng)
        if kind == "another":
            common = rng.choice(config.bias_mv[:-1])
            bias[k] = common + config.bias_scatter_mv * rng.standard_normal(RIG_SENSORS)
            gain[k] = config.gain_scatter * rng.standard_normal(RIG_SENSORS)
    return Sessions(bias, gain, noise)
