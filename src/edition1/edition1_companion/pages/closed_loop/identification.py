r"""How the rig follows its commands, from a short experiment that a user can make; the twin's is SYNTHETIC.

The experiment takes two minutes: sines of many rates along both axes, so that the bend turns both ways and at all
rates, and jumps between random points. It is recorded as T0 to T5, and read from the same files by the same pipeline;
the pressures are beside them.

With the commanded torque :math:`p` and its first-order lag :math:`\dot s = (p - s)/T`, the bend is

.. math:: x = f(s) + \delta ,

with a static map :math:`f` and a rest :math:`\delta` (hysteresis, and all that the command does not know), taken for
an Ornstein-Uhlenbeck process. Where the direction of :math:`s` turns, at the rate
:math:`\omega = (s_x \dot s_y - s_y \dot s_x)/(|s|^2 + c^2)`, the magnet is not yet where the tip is, and the readings
differ from the map of the bend by

.. math:: \ell = \omega\, A\, (-(x - x_0)_y,\; (x - x_0)_x)^T ,

with three rows of :math:`A` for three sensors. The form is that of the twin: of those that were tried on the second
half of an experiment (bends that turn, rates of the bend with factors polynomial in it), it left the least. Numbers
are fitted. **T5.train alone does not tell** :math:`A`: there the direction turns slowly and always the same way, so
that :math:`\ell` is a function of the bend, which the map takes up (:func:`turning`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from edition1_companion.recordings.baaij2023 import INFLATION_S, Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES, Chambers
from edition1_companion.twins.pneumatic_rig import RigRecording, TwinConfig, record_torque
from edition1_companion.twins.rig_map import SCALE_MM, BendMap, correlation_s, monomials
from edition1_companion.twins.rig_motion import turned_bend

SWEEP_S, JUMPS_S = 60.0, 60.0
"""Length of the two parts of the experiment [s]: sines of many rates along both axes, then jumps."""
RATES_HZ = (0.05, 0.11, 0.17, 0.26, 0.37, 0.53, 0.71, 1.0)
"""Rates of the sines; amplitudes fall with the root of the rate."""
HELD_S = (0.5, 2.5)
"""Shortest and longest time between two jumps [s]."""
REACH = 0.85
"""Largest torque over the reference."""
STATIC_DEGREE = 3
"""Degree of the static map from torque to bend, as that of its inverse."""
LAGS_S = tuple(k / 100 for k in range(5, 61))
CENTRES = (0.02, 0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4)
"""Candidates for :math:`T` [s] and :math:`c`; the best fit is taken."""
SMALL_MV, LARGE_MV = 1.0, 2.0
"""Readings with a lag below the first tell the error without it, those above the second how it grows with the lag."""


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
        s, rate = (np.column_stack([np.interp(at, self.time_s, c) for c in z.T]) for z in (s, rate))
        return s, rate


def experiment_torque(
    time_s: Float[np.ndarray, " n"], chambers: Chambers, *, seed: int
) -> Float[np.ndarray, "n 2"]:
    """Torques [N m] at times after the start of the experiment [s]: sines, then jumps in a disc; else zero."""
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
    """Make the experiment with a twin, in the session of its T5, and read its files by the pipeline; synthetic."""

    def torque(time_s: np.ndarray) -> np.ndarray:
        return experiment_torque(time_s, config.chambers, seed=seed)

    # T0 to T5 and the loops have the numbers below.
    rng = np.random.default_rng([seed, len(TRAJECTORIES) + 1])
    raw = record_torque(config, "experiment", torque, SWEEP_S + JUMPS_S, rng, TRAJECTORIES.index("T5"))
    return commanded(config.chambers, raw, raw.read())


def commanded(
    chambers: Chambers, raw: RigRecording, read: Recording, *, frames: int | None = None
) -> Commanded:
    """Commands beside a recording, its first frames only if so wished; the clock of the commands is the sensors'."""
    cut = read.repairs["readings cut to align"] / RIG_RATE_HZ + INFLATION_S
    kept = slice(0, frames)
    part = Recording(read.name, read.frame[kept], read.q[kept], read.u[kept], read.repairs)
    torque = chambers.bending_torque(raw.motion.pressures_mbar)
    return Commanded(part, raw.sensors_start_s + cut, raw.motion.time_s, torque)


@dataclass(frozen=True)
class Segment:
    r"""How the segment follows its commands, and the readings its bend.

    Attributes
    ----------
    lag_s
        Time constant :math:`T` from command to bend [s].
    static
        Factors of the monomials of :math:`f` [mm].
    rest_mm
        Bend without torque :math:`x_0`.
    apart_mm, apart_s
        Root mean square of :math:`\delta` over both axes, and its correlation time [s].
    centre, across
        :math:`c`, and :math:`A` transposed [mV s/mm].
    error_mv
        Standard deviation, for each sensor, of what map and lag leave beside the white noise.
    share
        Error of :math:`\ell`, as a share of it.
    """

    lag_s: float
    static: Float[np.ndarray, "terms 2"]
    rest_mm: Float[np.ndarray, " 2"]
    apart_mm: float
    apart_s: float
    centre: float
    across: Float[np.ndarray, "2 3"]
    error_mv: Float[np.ndarray, " 3"]
    share: float

    @property
    def fading(self) -> float:
        """Share of a change of the torque that its lag leaves out still, one reading after it."""
        return float(np.exp(-1.0 / RIG_RATE_HZ / self.lag_s))

    def bend_mm(self, torque: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Bend :math:`f(s)` [mm]."""
        return _powers(torque) @ self.static

    def lag_mv(
        self,
        torque: Float[np.ndarray, "n 2"],
        rate: Float[np.ndarray, "n 2"],
        bend_mm: Float[np.ndarray, "n 2"],
    ) -> Float[np.ndarray, "n 3"]:
        r"""How far the readings are from the map of the bend, :math:`\ell` [mV]; the rate of the torque in 1/s."""
        return turned_bend(torque, rate, bend_mm - self.rest_mm, self.centre) @ self.across


def identify(
    bend_map: BendMap,
    excited: Commanded,
    training: Commanded | None,
    rest_mm: Float[np.ndarray, " 2"],
) -> Segment:
    """Fit a segment by least squares: lag and static map to both recordings, all else to the excited one.

    Parameters
    ----------
    bend_map
        Readings by bend, from T5.train.
    excited
        The experiment of :func:`record_experiment`.
    training
        T5.train; it counts as much as the other, whatever its length.
    rest_mm
        Bend without torque.
    """
    parts = [excited] if training is None else [excited, training]

    def fit(lag_s: float) -> tuple[float, np.ndarray]:
        kept = [max(len(part.recording) // 5000, 1) for part in parts]
        weights = [(every / len(part.recording)) ** 0.5 for every, part in zip(kept, parts, strict=True)]
        rows = [w * _powers(p.lagged(lag_s)[0][::k]) for p, w, k in zip(parts, weights, kept, strict=True)]
        bends = [w * p.bend_mm[::k] for p, w, k in zip(parts, weights, kept, strict=True)]
        columns, wanted = np.vstack(rows), np.vstack(bends)
        factors = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return float(((wanted - columns @ factors) ** 2).sum()), factors

    lag_s = min(LAGS_S, key=lambda x: fit(x)[0])
    static = fit(lag_s)[1]
    s, rate = excited.lagged(lag_s)
    apart = excited.bend_mm - _powers(s) @ static
    left = excited.recording.u - bend_map(excited.bend_mm)

    def across(centre: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turned = turned_bend(s, rate, excited.bend_mm - rest_mm, centre)
        columns = np.column_stack([turned, np.ones(len(turned))])
        factors = np.linalg.lstsq(columns, left, rcond=None)[0]
        return factors[:2], np.abs(turned @ factors[:2]), left - columns @ factors

    centre = min(CENTRES, key=lambda x: float((across(x)[2] ** 2).sum()))
    factors, lag, after = across(centre)
    small = lag.max(axis=1) < SMALL_MV
    calm = (after[small] ** 2).mean(axis=0)
    large = lag > LARGE_MV
    beyond = (after**2 - calm)[large].sum() / max(float((lag[large] ** 2).sum()), 1e-12)
    return Segment(
        lag_s=lag_s,
        static=static,
        rest_mm=rest_mm,
        apart_mm=float(np.sqrt((apart**2).mean())),
        apart_s=correlation_s(apart),
        centre=centre,
        across=factors,
        error_mv=np.sqrt(np.maximum(calm - bend_map.noise_mv**2, bend_map.error_mv**2)),
        share=float(np.sqrt(max(beyond, 0.0))),
    )


def turning(bend_map: BendMap, part: Commanded, segment: Segment) -> tuple[float, float]:
    """How much a recording tells about the lag in its readings.

    Returns
    -------
    tuple
        Root mean square of the regressors of the lag [mm/s], over frames and both axes; and the share of it (root
        mean square) that no polynomial of the bend, of the degree of the map, takes up.
    """
    turned = turned_bend(*part.lagged(segment.lag_s), part.bend_mm - segment.rest_mm, segment.centre)
    columns = monomials(part.bend_mm, bend_map.degree)
    own = turned - columns @ np.linalg.lstsq(columns, turned, rcond=None)[0]
    size = float(np.sqrt((turned**2).mean()))
    return size, float(np.sqrt((own**2).mean())) / size


def _powers(torque: np.ndarray) -> np.ndarray:
    """Monomials of torques over the reference: their unit is one, not that of a bend."""
    return monomials(SCALE_MM * torque, STATIC_DEGREE)
