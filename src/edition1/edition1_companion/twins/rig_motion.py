r"""From chamber pressures to the shape of the rig's segment: lag, asymmetry and hysteresis.

The bend of the tip is not quite that of the middle, where the magnet is: two configurations describe the segment, the
tip's, which motion capture sees, and the magnet's. Between them there is a hysteresis that depends on the path, and a
lag across the direction of bending that depends on the rate. So readings are no function of what motion capture sees.
Both are assumed; their size follows from how much the maps from configuration to readings differ between the authors'
recordings.

There are two standard models of the memory of a hysteresis, both normalised to [-1, 1] and independent of the rate:

* ``"bouc-wen"``: Bouc-Wen with exponent 1 and without its second shape term, which is Dahl's model of friction,
  :math:`\dot z = (\dot x - |\dot x| z)/r`, solved exactly between samples (Wen, 1976; Dahl, 1968);
* ``"prandtl-ishlinskii"``: the mean of stop operators of evenly spaced thresholds up to ``r``, each divided by
  its threshold (Brokate and Sprekels, *Hysteresis and Phase Transitions*, 1996, chapter 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from edition1_companion.twins.pneumatic_actuation import Chambers

MODELS = ("bouc-wen", "prandtl-ishlinskii")
"""Names of the models."""
STOPS = 6
"""Number of stop operators."""


@dataclass(frozen=True)
class Bending:
    r"""How the tip follows the pressures; millimetres at the reference torque of the chambers.

    With the torque in units of its reference, turned so that it points where it bends and delayed, each axis bends by
    :math:`a s + b s^2 + c s^3`, less a hysteresis.

    Parameters
    ----------
    neutral_mm
        Bend of the inflated segment without torque (an asymmetry), along x and y.
    linear_mm, quadratic_mm, cubic_mm
        ``a, b, c`` along x and y.
    elongation_mm
        Elongation at the offset pressure.
    lag_s
        Time constant of the first-order lag between pressure and bend.
    hysteresis_mm, stroke_mm
        Amplitude of the hysteresis along both axes, and how far the bend has to travel to turn it over.
    """

    neutral_mm: tuple[float, float]
    linear_mm: tuple[float, float]
    quadratic_mm: tuple[float, float]
    cubic_mm: tuple[float, float]
    elongation_mm: float
    lag_s: float
    hysteresis_mm: float
    stroke_mm: float


@dataclass(frozen=True)
class InnerShape:
    """How the bend at the magnet differs from that of the tip.

    Parameters
    ----------
    hysteresis_mm, stroke_mm
        Amplitude of the part that depends on the path along both axes, and the way that turns it over.
    across_s
        Time [s] by which the magnet lags where the direction of bending turns; the lag along the direction of bending
        is taken to be zero.
    centre
        Torque over the reference below which the direction of bending, and that lag, fade out.
    """

    hysteresis_mm: float
    stroke_mm: float
    across_s: float
    centre: float = 0.1


@dataclass(frozen=True)
class RigMotion:
    """The segment over time.

    Attributes
    ----------
    time_s
        Even times [s].
    pressures_mbar
        Chamber pressures.
    q, q_magnet
        Configuration of the tip, and the one that gives the pose of the magnet [m].
    """

    time_s: Float[np.ndarray, " samples"]
    pressures_mbar: Float[np.ndarray, "samples 3"]
    q: Float[np.ndarray, "samples 3"]
    q_magnet: Float[np.ndarray, "samples 3"]

    def at(self, time_s: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pressures [mbar] and both configurations [m] at other times [s], linearly between the samples."""

        def between(values: np.ndarray) -> np.ndarray:
            return np.column_stack([np.interp(time_s, self.time_s, column) for column in values.T])

        return between(self.pressures_mbar), between(self.q), between(self.q_magnet)


def rig_motion(
    time_s: Float[np.ndarray, " samples"],
    pressures_mbar: Float[np.ndarray, "samples 3"],
    chambers: Chambers,
    bending: Bending,
    inner: InnerShape,
    *,
    model: str = "bouc-wen",
) -> RigMotion:
    """Motion of the segment, from rest, under chamber pressures.

    Parameters
    ----------
    time_s
        Even times [s].
    pressures_mbar
        Pressures at these times.
    chambers, bending, inner
        The segment.
    model
        Model of both hystereses, one of :data:`MODELS`.
    """
    dt = float(time_s[1] - time_s[0])
    inflated = pressures_mbar.mean(axis=1) / chambers.offset_mbar
    driven = np.column_stack([chambers.bending_torque(pressures_mbar), inflated])
    share = -np.expm1(-dt / bending.lag_s)
    delayed = np.asarray(lfilter([share], [1.0, share - 1.0], driven, axis=0))
    s, inflation = delayed[:, :2], delayed[:, 2:]
    neutral = inflation * np.array(bending.neutral_mm)
    bent = sum(
        s**power * np.array(factor)
        for power, factor in enumerate((bending.linear_mm, bending.quadratic_mm, bending.cubic_mm), start=1)
    )
    free = neutral + bent
    tip = free - bending.hysteresis_mm * _memories(free, bending.stroke_mm, model)
    across = turned_bend(s, np.gradient(s, dt, axis=0), tip - neutral, inner.centre)
    magnet = tip - inner.across_s * across
    magnet = magnet - inner.hysteresis_mm * _memories(tip, inner.stroke_mm, model)
    elongation = bending.elongation_mm * inflation
    q, q_magnet = (1e-3 * np.column_stack([xy, elongation]) for xy in (tip, magnet))
    return RigMotion(time_s, pressures_mbar, q, q_magnet)


def _memories(xy: np.ndarray, stroke: float, model: str) -> np.ndarray:
    return np.column_stack([memory(column, stroke, model) for column in xy.T])


def turned_bend(
    torque: Float[np.ndarray, "n 2"],
    rate: Float[np.ndarray, "n 2"],
    bent_mm: Float[np.ndarray, "n 2"],
    centre: float,
) -> Float[np.ndarray, "n 2"]:
    """Rate at which the direction of a torque turns, times the bend turned by a right angle [mm/s]."""
    turning = torque[:, 0] * rate[:, 1] - torque[:, 1] * rate[:, 0]
    turning = turning / ((torque * torque).sum(axis=1) + centre**2)
    return turning[:, None] * np.column_stack([-bent_mm[:, 1], bent_mm[:, 0]])


def memory(
    x: Float[np.ndarray, " samples"], stroke: float, model: str = "bouc-wen"
) -> Float[np.ndarray, " samples"]:
    """Memory of a path, in [-1, 1]: it tends to 1 while ``x`` rises and to -1 while it falls.

    Parameters
    ----------
    x
        Samples of the path. The memory is zero at the first one.
    stroke
        How far ``x`` has to travel for the memory to turn over, in the unit of ``x``: after a long rise the
        Bouc-Wen memory is within ``1/e`` of 1 one stroke after the turn; all stops have turned after two.
    model
        One of :data:`MODELS`.

    Examples
    --------
    >>> memory(np.array([0.0, 1.0, 2.0, 1.0]), stroke=1.0).round(3)
    array([ 0.   ,  0.632,  0.865, -0.314])
    """
    return _bouc_wen(x, stroke) if model == "bouc-wen" else _prandtl_ishlinskii(x, stroke)


def _bouc_wen(x: np.ndarray, stroke: float) -> np.ndarray:
    z, found = 0.0, [0.0] * len(x)
    for k, step in enumerate(np.diff(x).tolist(), start=1):
        end = math.copysign(1.0, step)
        z = end + (z - end) * math.exp(-abs(step) / stroke)
        found[k] = z
    return np.array(found)


def _prandtl_ishlinskii(x: np.ndarray, stroke: float) -> np.ndarray:
    found = np.zeros(len(x))
    steps = np.diff(x).tolist()
    for threshold in stroke * np.arange(1, STOPS + 1) / STOPS:
        z, limit, stop = 0.0, float(threshold), [0.0] * len(x)
        for k, step in enumerate(steps, start=1):
            z = min(max(z + step, -limit), limit)
            stop[k] = z
        found += np.array(stop) / (limit * STOPS)
    return found
