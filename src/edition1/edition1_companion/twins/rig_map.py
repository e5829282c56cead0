"""Readings of the rig by its bend, as a polynomial, and the sizes of what it leaves; all from one training part.

Physics brings nothing here: with the field of the ring at the three sensors as drawn as further columns, the error of
the readings at the true bend changes by less than 2 % on every trajectory of the development twins. What limits the
map is that the readings of other recordings are another function of the bend.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from scipy.signal import savgol_filter

from edition1.sensing.magnetic import field_at_sensors
from edition1.sensing.magnets import ring
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS, rig_robot

DEGREE = 6
"""Degree of the map, chosen on T5.train of the nominal twin, as a test repeats: the smallest whose error on held-out
blocks is within 3 % of the best."""
MARGIN = 0.1
"""Bounds of the bend beyond the box of the training part, as a share of its width."""
SCALE_MM = 8.0
"""Unit of the bend in the polynomials [mm]: a size, chosen so that the columns of the fit are of order one."""
SENSITIVITY = 5000.0
"""Sensitivity of a sensor along its axis [mV/mT], inferred from section 5.1: 50 mV/mT, amplified by 100."""
STARTS = 400
"""Bends of the training part about which a first estimate may be linearised."""


@dataclass(frozen=True)
class BendMap:
    """What T5.train tells: readings by bend, what they leave, and how the segment moves.

    Attributes
    ----------
    degree, factors
        Of the monomials [mV].
    noise_mv, error_mv
        White noise of each sensor, and the standard deviation of the rest that the map leaves.
    error_s
        Time after which that rest has lost all but 1/e of its autocovariance.
    acceleration
        Density of the white acceleration [mm/s^1.5].
    rate
        Root mean square of the rate of an axis [mm/s].
    mean_mm, spread_mm
        Mean and standard deviation of the bend.
    elongation_mm, elongation_spread_mm
        Elongation [mm], and its change with the square of the bend [1/mm]; the standard deviation of what they leave.
    lower, upper
        Box of the bend [mm].
    starts
        Bends [mm], evenly chosen in time.
    elongation_slope
        Change of a reading with the elongation, mean over sensors and bends of the robot as drawn [mV/mm].
    """

    degree: int
    factors: Float[np.ndarray, "terms 3"]
    noise_mv: Float[np.ndarray, " 3"]
    error_mv: Float[np.ndarray, " 3"]
    error_s: float
    acceleration: float
    rate: float
    mean_mm: Float[np.ndarray, " 2"]
    spread_mm: Float[np.ndarray, " 2"]
    elongation_mm: Float[np.ndarray, " 2"]
    elongation_spread_mm: float
    lower: Float[np.ndarray, " 2"]
    upper: Float[np.ndarray, " 2"]
    starts: Float[np.ndarray, "starts 2"]
    elongation_slope: float

    def __call__(self, bend_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Readings [mV] at bends [mm], without bias."""
        return monomials(bend_mm, self.degree) @ self.factors

    def slopes(self, bend_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3 2"]:
        """Derivatives of the readings [mV/mm], by central differences."""
        apart = 1e-4 * np.eye(2)
        readings = self(np.concatenate([bend_mm + side * d for d in apart for side in (1, -1)]))
        left, right, down, up = readings.reshape(4, -1, RIG_SENSORS)
        return np.stack([left - right, down - up], axis=-1) / 2e-4

    def elongation(self, bend_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Elongation [mm] that goes with bends [mm]."""
        straight, per_mm2 = self.elongation_mm
        return straight + per_mm2 * (bend_mm * bend_mm).sum(axis=1)

    def readings_mv(self, q: Float[np.ndarray, "t q"]) -> Float[np.ndarray, "t 3"]:
        """Readings [mV] at configurations [m]."""
        return self(1e3 * q[:, :2])


def monomials(bend_mm: Float[np.ndarray, "n 2"], degree: int) -> Float[np.ndarray, "n terms"]:
    """All products of powers of the bend up to a degree.

    Examples
    --------
    >>> monomials(np.array([[2.0 * SCALE_MM, 3.0 * SCALE_MM]]), 2).tolist()
    [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]]
    """
    powers = np.stack([(bend_mm / SCALE_MM) ** k for k in range(degree + 1)], axis=-1)
    of_x, of_y = _exponents(degree)
    return powers[:, 0].take(of_x, axis=1) * powers[:, 1].take(of_y, axis=1)


@cache
def _exponents(degree: int) -> tuple[np.ndarray, np.ndarray]:
    total, of_y = np.tril_indices(degree + 1)
    return total - of_y, of_y


def fit_map(train: Recording, *, degree: int = DEGREE) -> BendMap:
    """Fit the map to a training part by linear least squares, and size what it leaves, and the motion."""
    q_mm = 1e3 * train.q
    bend = q_mm[:, :2]
    columns = monomials(bend, degree)
    factors = np.linalg.lstsq(columns, train.u, rcond=None)[0]
    left = train.u - columns @ factors
    noise = np.diff(left, axis=0).std(axis=0) / np.sqrt(2.0)
    slow = np.sqrt(np.maximum(left.var(axis=0) - noise**2, 0.0))
    rate = np.asarray(savgol_filter(bend, 21, 2, deriv=1, delta=1.0 / RIG_RATE_HZ, axis=0))
    half = round(0.5 * RIG_RATE_HZ)
    change = rate[half:] - rate[:-half]
    low, high = bend.min(axis=0), bend.max(axis=0)
    bent = np.column_stack([np.ones(len(bend)), (bend * bend).sum(axis=1)])
    elongation = np.linalg.lstsq(bent, q_mm[:, 2], rcond=None)[0]
    least = 1e-3  # [mV], for a recording without noise: a sixtieth of a step of the converter
    return BendMap(
        degree=degree,
        factors=factors,
        noise_mv=np.maximum(noise, least),
        error_mv=np.maximum(slow, least),
        error_s=correlation_s(left),
        acceleration=float(np.sqrt((change**2).mean() / 0.5)),
        rate=float(np.sqrt((rate**2).mean())),
        mean_mm=bend.mean(axis=0),
        spread_mm=bend.std(axis=0),
        elongation_mm=elongation,
        elongation_spread_mm=float((q_mm[:, 2] - bent @ elongation).std()),
        lower=low - MARGIN * (high - low),
        upper=high + MARGIN * (high - low),
        starts=bend[:: max(len(bend) // STARTS, 1)],
        elongation_slope=_elongation_slope(train.q[:: max(len(bend) // 50, 1)]),
    )


def correlation_s(left: Float[np.ndarray, "t sensors"]) -> float:
    """Time after which the autocovariance of some errors has fallen to 1/e of that between two frames [s]."""
    left = left - left.mean(axis=0)
    n = 2 ** int(np.ceil(np.log2(2 * len(left))))
    power = np.abs(np.fft.rfft(left / np.maximum(left.std(axis=0), 1e-9), n, axis=0)) ** 2
    r = np.fft.irfft(power.sum(axis=1), n)[: len(left)]
    below = r[1:] < r[1] / np.e
    frames = int(np.argmax(below)) + 1 if r[1] > 0 and below.any() else 1
    return frames / RIG_RATE_HZ


def _elongation_slope(q: np.ndarray) -> float:
    """Mean change of the readings with the elongation, for the robot as drawn [mV/mm]."""
    robot, h = rig_robot(), 1e-4
    fields = [
        field_at_sensors(robot, torch.from_numpy(q + np.array([0.0, 0.0, d])), ring("published"))[..., 2]
        for d in (h, -h)
    ]
    return float((fields[0] - fields[1]).mean()) * SENSITIVITY / (2e3 * h)
