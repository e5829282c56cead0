r"""Orientation sensors (IMUs with fusion on board, as the BNO055) and how they err.

A reading of sensor i, taken at time t, is

.. math:: R_i = e^{h_i(t) [e_z]_\times} \, e^{[a_i(t)]_\times} \, R(t - t_\mathrm{latency}) \, M_i,

with the true orientation R (sensor to world), the mounting M, the tilt a (about the horizontal axes of the world: an
error of the measured vertical) and the heading error h (of the measured north). Then it is rounded; some readings
repeat the one before, and the sign of the quaternion, which means nothing, may change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input, require


@dataclass(frozen=True)
class ImuErrors:
    """How a string of IMUs is read and how it errs; angles are standard deviations.

    Every angle is drawn for each IMU by itself. What is marked "assumed" has no source; it is of a plausible order.

    Parameters
    ----------
    rate_hz
        Readings per IMU and second (Martin et al. 2022, section III-A).
    latency_s
        Age of what a reading shows [s]; assumed.
    skew_s
        Time from the reading of one IMU to that of the next [s]: eight of them fill one round; assumed.
    mounting_rad
        Mounting about each axis of the sensor [rad]; assumed.
    heading_offset_rad
        Constant error of the heading [rad]; assumed.
    heading_wander_rad, heading_time_s
        Error of the heading that wanders [rad], and its correlation time [s]; assumed.
    tilt_static_rad
        Constant tilt about each horizontal axis [rad]; assumed.
    tilt_dynamic_rad, tilt_time_s
        Tilt that varies [rad], and its correlation time [s]; assumed.
    quantum
        Resolution of a quaternion's component, 0 for none (datasheet BST-BNO055-DS000: 2^-14).
    repeats
        Share of readings that repeat the one before; assumed (the recorded bags show 0.0001).
    sign_flips
        Share of readings at which the sign of the quaternion changes; assumed (the recorded bags show none).
    """

    rate_hz: float = 31.0
    latency_s: float = 0.010
    skew_s: float = 0.0038
    mounting_rad: float = float(np.radians(3.0))
    heading_offset_rad: float = float(np.radians(6.0))
    heading_wander_rad: float = float(np.radians(2.0))
    heading_time_s: float = 40.0
    tilt_static_rad: float = float(np.radians(1.0))
    tilt_dynamic_rad: float = float(np.radians(1.0))
    tilt_time_s: float = 3.0
    quantum: float = 2.0**-14
    repeats: float = 0.001
    sign_flips: float = 0.001

    def __post_init__(self) -> None:
        for name in ("rate_hz", "heading_time_s", "tilt_time_s"):
            require(0 < getattr(self, name) < np.inf, name, "ImuErrors", "above zero", getattr(self, name))
        for name in vars(self):
            if not 0 <= getattr(self, name) < np.inf:
                raise bad_input(name, "ImuErrors", "finite and not negative", getattr(self, name))
        for name in ("repeats", "sign_flips"):
            if getattr(self, name) > 1:
                raise bad_input(name, "ImuErrors", "a share between 0 and 1", getattr(self, name))

    def scaled(self, factor: float) -> ImuErrors:
        """Return these errors with all angles multiplied by a factor, and the rest as it is.

        Examples
        --------
        >>> round(float(np.degrees(ImuErrors().scaled(0.5).heading_offset_rad)), 9)
        3.0
        """
        angles = [name for name in vars(self) if name.endswith("_rad")]
        return replace(self, **{name: factor * getattr(self, name) for name in angles})


PERFECT = replace(ImuErrors().scaled(0.0), latency_s=0.0, quantum=0.0, repeats=0.0, sign_flips=0.0)
"""Sensors without any error, read in turn at the same rate: every time stamp is when its reading was true."""


@dataclass(frozen=True)
class ImuReadings:
    """Readings of a string of IMUs, round by round.

    Attributes
    ----------
    time_s
        Time stamp of each reading [s]: when it was read, not when it was true.
    orientations
        Quaternions XYZW, sensor to world; unit up to the rounding.
    """

    time_s: Float[np.ndarray, "rounds imus"]
    orientations: Float[np.ndarray, "rounds imus 4"]


def read_imus(
    orientations_at: Callable[[np.ndarray], np.ndarray],
    *,
    start_s: float,
    stop_s: float,
    errors: ImuErrors,
    seed: int,
) -> ImuReadings:
    """Read a string of IMUs in turn, round after round.

    All random numbers are drawn whatever the magnitudes are, so that with the same seed one error can be changed
    and the others stay what they were.

    Parameters
    ----------
    orientations_at
        True orientations of all IMUs, ``[times, imus, 4]`` (unit quaternions XYZW, sensor to world), of times [s].
    start_s, stop_s
        What is read is true between these times [s].
    errors
        Rate and errors.
    seed
        Seed of the random numbers: the same seed gives the same bits.

    Raises
    ------
    InputError
        If there is no time for one round.
    """
    imus = np.shape(orientations_at(np.array([start_s])))[1]
    duration = stop_s - start_s - (imus - 1) * errors.skew_s
    require(duration >= 0, "stop_s", "read_imus", f"at least one round after {start_s:g} s", f"{stop_s:g} s")
    rounds = int(duration * errors.rate_hz * (1 + 1e-12)) + 1
    seen_s = start_s + np.arange(rounds)[:, None] / errors.rate_hz + np.arange(imus) * errors.skew_s
    every = orientations_at(np.minimum(seen_s, stop_s).ravel()).reshape(rounds, imus, imus, 4)
    true = Rotation.from_quat(every[:, range(imus), range(imus)].reshape(-1, 4))

    rng = np.random.default_rng(seed)
    mounting = errors.mounting_rad * rng.standard_normal((imus, 3))
    heading = errors.heading_offset_rad * rng.standard_normal((imus, 1))
    tilt = errors.tilt_static_rad * rng.standard_normal((imus, 2))
    interval = 1 / errors.rate_hz
    wander = ornstein_uhlenbeck(
        (rounds, imus, 1), interval, std=errors.heading_wander_rad, time_s=errors.heading_time_s, rng=rng
    )
    dynamic = ornstein_uhlenbeck(
        (rounds, imus, 2), interval, std=errors.tilt_dynamic_rad, time_s=errors.tilt_time_s, rng=rng
    )
    repeated, flipped = (
        rng.random((2, rounds, imus)) < np.array([errors.repeats, errors.sign_flips])[:, None, None]
    )

    turn = Rotation.from_rotvec(((heading + wander) * [0.0, 0.0, 1.0]).reshape(-1, 3))
    lean = Rotation.from_rotvec(((tilt + dynamic) @ np.eye(2, 3)).reshape(-1, 3))
    mounted = Rotation.from_rotvec(np.tile(mounting, (rounds, 1)))
    quaternions = (turn * lean * true * mounted).as_quat().reshape(rounds, imus, 4)
    quaternions = (
        continuous_signs(quaternions, axis=0) * np.where(np.cumsum(flipped, axis=0) % 2, -1.0, 1.0)[..., None]
    )
    if errors.quantum > 0:
        quaternions = np.round(quaternions / errors.quantum) * errors.quantum
    repeated[0] = False
    latest = np.maximum.accumulate(np.where(repeated, 0, np.arange(rounds)[:, None]), axis=0)
    return ImuReadings(seen_s + errors.latency_s, np.take_along_axis(quaternions, latest[..., None], axis=0))


def ornstein_uhlenbeck(
    shape: tuple[int, ...], interval_s: float, *, std: float, time_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "steps *paths"]:
    r"""Draw stationary Gaussian processes with the correlation :math:`e^{-|\Delta t|/\tau}`, exactly at even steps.

    Parameters
    ----------
    shape
        Number of steps, then of independent paths.
    interval_s
        Time between steps [s].
    std, time_s
        Standard deviation at every step, in the unit of the result, and correlation time [s].
    rng
        Source of the random numbers.
    """
    decay = np.exp(-interval_s / time_s)
    steps = rng.standard_normal(shape)
    steps[1:] *= np.sqrt(1 - decay**2)
    return std * np.asarray(lfilter([1.0], [1.0, -decay], steps, axis=0))


def continuous_signs(quaternions: Float[np.ndarray, "*shape 4"], axis: int) -> Float[np.ndarray, "*shape 4"]:
    """Flip signs so that neighbours along an axis lie on one side (q and -q are one rotation).

    Examples
    --------
    >>> continuous_signs(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -1.0]]), axis=0)[1]
    array([-0., -0., -0.,  1.])
    """
    q = np.moveaxis(quaternions, axis, 0)
    flips = np.where((q[1:] * q[:-1]).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    signs = np.cumprod(np.concatenate([np.ones_like(q[:1, ..., :1]), flips]), axis=0)
    return np.moveaxis(q * signs, 0, axis)
