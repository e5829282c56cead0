r"""Errors of sensors that wander: further coordinates behind the configuration of any sensor model.

Every error :math:`b` wanders from zero,

.. math:: \dot b = -b/T + w, \qquad E[w(t)\,w(t')] = s^2\,\delta(t - t'),

a random walk for :math:`T = \infty`. A Kalman filter estimates it with the configuration, as far as the readings tell
the two apart; what they do not tell apart stays as uncertain as its prior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from repro.chain import turn
from repro.common import Array, require
from repro.estimators.base import model_of
from repro.sensing import Sensing, rotation_vector

_KINDS = ("offset", "gain", "moment", "stray", "heading", "tilt")


@dataclass(frozen=True)
class Drift:
    """Errors of one kind that wander.

    ========== ======================================= ============================ ==========================
    kind       one error for each                      unit                         sensor model
    ========== ======================================= ============================ ==========================
    offset     reading that is no IMU                  that of the readings         any
    gain       reading that is no IMU                  relative                     any
    moment     magnet                                  relative                     :class:`repro.Sensing`
    stray      axis of the base, of a uniform field    mT                           :class:`repro.Sensing`
    heading    IMU, about the z axis of the base       rad                          :class:`repro.Sensing`
    tilt       IMU, about the x and y axes of the base rad                          :class:`repro.Sensing`
    ========== ======================================= ============================ ==========================

    Parameters
    ----------
    kind
        One of the table.
    start
        Standard deviation before the first reading.
    walk
        Standard deviation that a second adds [unit/s^0.5].
    time_s
        Time :math:`T` within which the error fades [s]; infinite for a random walk.
    shared
        Whether all of them have one error, as magnets do that warm up together.

    Raises
    ------
    InputError
        If the kind is another one, or a number is negative.

    Examples
    --------
    >>> Drift("offset", start=0.02, walk=0.001)
    Drift(kind='offset', start=0.02, walk=0.001, time_s=inf, shared=False)
    """

    kind: str
    start: float
    walk: float = 0.0
    time_s: float = math.inf
    shared: bool = False

    def __post_init__(self) -> None:
        require(self.kind in _KINDS, "kind", "Drift", f"one of {', '.join(_KINDS)}", repr(self.kind))
        for name in ("start", "walk"):
            value = getattr(self, name)
            require(0 <= value < math.inf, name, "Drift", "finite and not negative", value)
        require(self.time_s > 0, "time_s", "Drift", "positive [s]", self.time_s)
        expected = "of each, for fields and IMUs"
        require(not self.shared or self.kind in _KINDS[:3], "shared", "Drift", expected, True)


class Drifting:
    """A sensor model with errors that wander: a sensor model of (configuration, errors).

    Give it to a :class:`repro.KalmanFilter`, whose bounds and process noise are those of the configuration alone.

    Parameters
    ----------
    sensing
        A sensor model.
    drifts
        What wanders.

    Raises
    ------
    InputError
        If a kind does not fit the sensor model.

    Examples
    --------
    A reading of the sum of a coordinate and an equally uncertain offset: each takes half of it.

    >>> from repro import Drift, Drifting, KalmanFilter
    >>> root = 3**0.5
    >>> sensing = Drifting(lambda q: q, [Drift("offset", start=1.0)])
    >>> method = KalmanFilter(sensing, [-root], [root], noise=1e-6, acceleration=[1.0], velocity=[1.0])
    >>> estimate = method.step(method.init([0.0]), [1.0], t=0.0)[1]
    >>> estimate.q.round(6), estimate.details["drift"].round(6)
    (array([0.5]), array([0.5]))
    """

    def __init__(self, sensing: Callable[[Array], ArrayLike], drifts: Sequence[Drift]) -> None:
        require(drifts, "drifts", "Drifting", "at least one", "none")
        robot = sensing.robot if isinstance(sensing, Sensing) else None
        for drift in drifts:
            name, received = f"drifts, kind {drift.kind},", type(sensing).__name__
            if drift.kind in ("heading", "tilt"):
                require(robot and robot.imus, name, "Drifting", "of a robot with IMUs", received)
            elif drift.kind in ("moment", "stray"):
                multipoles = isinstance(sensing, Sensing) and sensing.model is None
                require(multipoles, name, "Drifting", "of a robot whose model are multipoles", received)
        self.sensing, self.drifts, self.robot = sensing, tuple(drifts), robot


class DriftModel:
    """The sensor model of (configuration, errors) for a :class:`Drifting`, once the bounds are known."""

    compiled = False

    def __init__(self, drifting: Drifting, lower: Array, upper: Array, owner: str) -> None:
        self.base = base = model_of(drifting.sensing, lower, upper, owner)
        robot = base.robot if isinstance(base, Sensing) else None
        n_imus = len(robot.imus) if robot else 0
        self.n_hall, self.n_readings = base.n_readings - 3 * n_imus, base.n_readings
        n_magnets = len(robot.magnets) if robot else 0
        counts = {"moment": n_magnets, "stray": 3, "heading": n_imus, "tilt": 2 * n_imus}
        rows = [
            (drift, -1 if drift.shared else k)
            for drift in drifting.drifts
            for k in range(1 if drift.shared else counts.get(drift.kind, self.n_hall))
        ]
        self.names = tuple(f"{drift.kind} {'of all' if k < 0 else k + 1}" for drift, k in rows)
        self.states = np.array([(drift.start, drift.walk, 1 / drift.time_s) for drift, _ in rows]).T
        self._offset, self._gain = (self._share(rows, kind) for kind in ("offset", "gain"))
        # A reading is linear in moments and in a uniform field: one model for each of these errors.
        self._linear = [
            (c, self._part(base, drift.kind, k))
            for c, (drift, k) in enumerate(rows)
            if drift.kind in ("moment", "stray") and isinstance(base, Sensing)
        ]
        self._turns = [
            (c, drift.kind, k) for c, (drift, k) in enumerate(rows) if drift.kind in ("heading", "tilt")
        ]
        self.n_base = len(lower)
        self.n_q = len(lower) + len(rows)
        self.rotations = base.rotations

    def _share(self, rows: list[tuple[Drift, int]], kind: str) -> Array:
        """Which readings have which error of a kind ``[s, errors]``."""
        share = np.zeros((self.n_hall, len(rows)))
        for c, (drift, k) in enumerate(rows):
            if drift.kind == kind:
                share[slice(None) if k < 0 else k, c] = 1.0
        return share

    @staticmethod
    def _part(base: Sensing, kind: str, k: int) -> Sensing:
        moments, field = np.zeros_like(base.moments), np.zeros(3)
        if kind == "stray":
            field[k] = 1.0
        else:
            moments[slice(None) if k < 0 else k] = base.moments[slice(None) if k < 0 else k]
        return Sensing(base.robot, moments=moments, earth=field, gain=base.tables.gain)

    def __call__(self, x: Array) -> Array:
        """Return readings ``[n, s]`` at (configuration, errors) ``[n, n_q]``."""
        return self.linearise(x)[0]

    def linearise(self, x: Array) -> tuple[Array, Array]:
        """Return readings ``[n, s]`` and their slopes ``[n, s, n_q]``."""
        q, b, n, h = np.ascontiguousarray(x[:, : self.n_base]), x[:, self.n_base :], self.n_base, self.n_hall
        u, J_q = self.base.linearise(q)
        J = np.zeros((*u.shape, self.n_q))
        J[..., :n] = J_q
        for c, part in self._linear:
            v, slope = part.linearise(q)
            u[:, :h] += b[:, c, None] * v[:, :h]
            J[:, :h, :n] += b[:, c, None, None] * slope[:, :h]
            J[:, :h, n + c] = v[:, :h]
        gain = 1.0 + b @ self._gain.T
        J[:, :h] *= gain[..., None]
        J[:, :h, n:] += u[:, :h, None] * self._gain + self._offset
        u[:, :h] = gain * u[:, :h] + b @ self._offset.T
        if self._turns:
            for k in range(len(x)):
                self._turned(b[k], u[k], J[k])
        return u, J

    def _turned(self, b: Array, u: Array, J: Array) -> None:
        """Turn what the IMUs read by their tilts, then by their headings about the vertical."""
        R, E, yaw, by_tilt, room = np.zeros((5, 3, 3))
        for imu in range((len(u) - self.n_hall) // 3):
            rows = slice(self.n_hall + 3 * imu, self.n_hall + 3 * imu + 3)
            tilt, heading, columns = np.zeros(3), 0.0, []
            for c, kind, k in self._turns:
                if kind == "heading" and k == imu:
                    heading += b[c]
                    columns.append((c, 2))
                elif kind == "tilt" and k // 2 == imu:
                    tilt[k % 2] += b[c]
                    columns.append((c, k % 2))
            turn(*u[rows], R, room)
            turn(*tilt, E, by_tilt)
            turn(0.0, 0.0, heading, yaw, room)
            rotation_vector(yaw @ E @ R, u[rows])
            J[rows] = yaw @ E @ J[rows]
            for c, axis in columns:
                J[rows, self.n_base + c] = yaw[:, 2] if axis == 2 else (yaw @ by_tilt)[:, axis]

    def difference(self, u: Array, u_hat: Array) -> Array:
        """Return what was read beyond what was predicted, as the sensor model has it."""
        return self.base.difference(u, u_hat)
