r"""A slender rod whose strain is a short series along its arc, and a filter that follows it from any sensors.

The curvature about x and y and the twist about z are Legendre series along the arc. Every term of a series is a
Gaussian process in time, a Matern process of smoothness 3/2: a particle that white noise accelerates and that is
drawn back to rest. This is the idea of Teetaert et al. 2025 (arXiv 2510.01381), who hold a Gaussian process in space
and time against a continuum robot. The process has a transition in closed form over any time step (Särkkä and Solin
2019, section 12.3), so sensors may be read at any time, one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.chain import arc_functions
from repro.common import Array, kernel, numbers, require
from repro.estimators.base import Estimate, conditioned, incoming, known_coordinates, start
from repro.estimators.kalman import KalmanState, MotionModel
from repro.sensing import rotation_vector

_KINDS = {"pose": 6, "orientation": 3, "gyroscope": 3}
"""Kinds of sensors, and how many readings they have."""
_GYROSCOPE = 2
"""Its number for the kernels: poses and orientations come before."""
_STILL = 0.01
"""An update ends when no state moves by more than this share of its standard deviation before any reading."""


@dataclass(frozen=True)
class Rod:
    r"""A rod that bends and twists, and neither stretches nor shears.

    With Legendre polynomials :math:`P_k` and the arc length :math:`s`, the strain about the axis :math:`j` of the
    backbone frame is :math:`\kappa_j(s) = \sum_k q_{jk} \sqrt{2k+1}\, P_k(2s/L - 1)` [rad/m], so
    :math:`\sum_k q_{jk}^2` is its mean square along the rod. One term is constant curvature; two are affine curvature
    in a plane that may turn. The strain is taken constant on every piece, with its value in the middle: this is exact
    for one term, and has an error of second order in the length of a piece for more.

    Its configuration holds the terms about x, those about y, then the terms of the twist about z [rad/m].

    Parameters
    ----------
    length
        Length of the backbone [m].
    bending
        Number of terms about each of the two axes across.
    torsion
        Number of terms about the backbone.
    parts
        Number of pieces.

    Raises
    ------
    InputError
        If the length is not positive, there is no term, or there are fewer pieces than terms.

    Examples
    --------
    A quarter circle of 0.2 m towards -y, by its curvature about x:

    >>> rod = Rod(0.2, bending=1, torsion=0)
    >>> T, _ = rod.motion([np.pi / 0.4, 0.0], [0.2])
    >>> T[0, :3, 3].round(4)
    array([ 0.    , -0.1273,  0.1273])
    """

    length: float
    bending: int = 3
    torsion: int = 1
    parts: int = 8

    def __post_init__(self) -> None:
        require(0 < self.length < math.inf, "length", "Rod", "positive [m]", self.length)
        for name, least in (("bending", 0), ("torsion", 0), ("parts", max(self.bending, self.torsion, 1))):
            count = getattr(self, name)
            fits = isinstance(count, int | np.integer) and count >= least
            require(fits, name, "Rod", f"a whole number, at least {least}", count)
        require(self.n_q, "bending, torsion", "Rod", "not both 0", "0 and 0")

    @property
    def n_q(self) -> int:
        """Number of terms."""
        return 2 * self.bending + self.torsion

    @cached_property
    def basis(self) -> Array:
        """Twist per length in the middle of every piece by every term ``[parts, 6, n_q]``; translation is zero."""
        middles = (2 * np.arange(self.parts) + 1) / self.parts - 1
        counts = (self.bending, self.bending, self.torsion)
        columns = [math.sqrt(2 * k + 1) * legval(middles, np.eye(k + 1)[k]) for n in counts for k in range(n)]
        basis = np.zeros((self.parts, 6, self.n_q))
        basis[:, np.repeat([3, 4, 5], counts), np.arange(self.n_q)] = np.stack(columns, axis=1)
        return basis

    def motion(self, q: ArrayLike, arcs_m: ArrayLike) -> tuple[Array, Array]:
        r"""Return poses of places along the rod and their body Jacobians.

        A body Jacobian says by which twist, in its own frame, a pose moves: :math:`T^{-1} dT = (J\, dq)^\wedge`
        (Barfoot, State Estimation for Robotics, 2nd ed., section 8.1).

        Parameters
        ----------
        q
            Terms of the series ``[..., n]`` [rad/m]. The base stays at the origin of the world; if it does not, its
            twist there stands in front of the terms: translation part [m], rotation vector [rad].
        arcs_m
            Distance of every place from the base along the backbone ``[m]`` [m].

        Returns
        -------
        tuple
            Poses ``T_world_place`` ``[..., m, 4, 4]``, positions in m, and Jacobians ``[..., m, 6, n]``: three rows
            of translation, then three of rotation.

        Raises
        ------
        InputError
            If ``q`` has another width, or a place is not on the rod.
        """
        q, n = np.ascontiguousarray(numbers(q, "q", "Rod", (..., None))), self.n_q
        expected = f"of last dimension {n}, or {n + 6} with the twist of the base"
        require(q.shape[-1] in (n, n + 6), "q", "Rod", expected, f"shape {q.shape}")
        arcs = numbers(arcs_m, "arcs_m", "Rod", (None,))
        there = (arcs >= 0) & (arcs <= self.length * (1 + 1e-12))
        require(there.all(), "arcs_m", "Rod", f"between 0 and the length {self.length:g} m", arcs)
        T, J = (np.empty((*q.shape[:-1], len(arcs), *own)) for own in ((4, 4), (6, q.shape[-1])))
        for k in np.ndindex(q.shape[:-1]):
            T[k], J[k] = _along(self.basis, self.length / self.parts, q[k], arcs)
        return T, J


@dataclass(frozen=True)
class RodSensor:
    r"""A sensor on a rod, and the errors of its readings.

    =========== ============================================================ ====================================
    kind        readings                                                     errors
    =========== ============================================================ ====================================
    pose        logarithm of its pose in the world: translation part [m],    a twist in the frame of the sensor
                then rotation vector [rad]
    orientation rotation vector [rad] that turns its frame to the world      a rotation vector in its frame
    gyroscope   angular velocity in its own frame [rad/s]                    added
    =========== ============================================================ ====================================

    The translation part of the logarithm of a pose is not its position: that is the left Jacobian of the rotation
    vector times the translation part.

    Parameters
    ----------
    kind
        One of the table.
    std
        Standard deviation of the white error, new at every reading: one number, or one for each reading.
    arc_m
        Distance of the sensor from the base along the rod [m].
    lasting_std
        Standard deviation of the error that lasts (a mounting or a frame that is off, a bias): one number, or one for
        each reading; empty for none.
    lasting_time_s
        Correlation time of the lasting error [s]; infinite for a constant.

    Raises
    ------
    InputError
        If there is no such kind, or numbers do not fit it or are not positive.

    Examples
    --------
    A gyroscope with a bias that wanders within a minute:

    >>> RodSensor("gyroscope", 0.1, arc_m=0.2, lasting_std=0.01, lasting_time_s=60.0).white
    array([0.1, 0.1, 0.1])
    """

    kind: str
    std: ArrayLike
    arc_m: float = 0.0
    lasting_std: ArrayLike = ()
    lasting_time_s: float = math.inf

    def __post_init__(self) -> None:
        require(self.kind in _KINDS, "kind", "RodSensor", f"one of {', '.join(_KINDS)}", repr(self.kind))
        numbers(self.arc_m, "arc_m", "RodSensor", ())
        require(self.lasting_time_s > 0, "lasting_time_s", "RodSensor", "positive [s]", self.lasting_time_s)
        _ = self.white, self.lasting

    @cached_property
    def white(self) -> Array:
        """Standard deviation of the white error of every reading."""
        return _positive(self.std, "std", "RodSensor", _KINDS[self.kind])

    @cached_property
    def lasting(self) -> Array:
        """Standard deviation of the error that lasts, of every reading; empty for none."""
        count = len(self.white) if np.size(self.lasting_std) else 0
        return _positive(self.lasting_std, "lasting_std", "RodSensor", count)


def _positive(value: ArrayLike, name: str, owner: str, count: int) -> Array:
    """Return so many positive numbers: one is repeated."""
    found = numbers(value, name, owner)
    fits = found.shape in ((), (count,)) and (found > 0).all()
    require(fits, name, owner, f"positive, one number or one for each of {count}", value)
    return np.broadcast_to(found, (count,)).copy()


class RodFilter(MotionModel):
    r"""Iterated extended Kalman filter of a rod, from sensors that are read at any time.

    Every term :math:`q` of the strain, and of the twist of the base if that moves, is a process with
    :math:`E[q(t)\,q(t+\tau)] = \sigma^2 (1 + \lambda\tau)\, e^{-\lambda\tau}`. Over a time :math:`\tau` the state
    :math:`(q, \dot q)` moves by

    .. math::
       F = e^{-\lambda\tau}
       \begin{bmatrix} 1 + \lambda\tau & \tau \\ -\lambda^2\tau & 1 - \lambda\tau \end{bmatrix},
       \qquad Q = \sigma^2 \left(\mathrm{diag}(1, \lambda^2) - F\, \mathrm{diag}(1, \lambda^2)\, F^T\right).

    The configuration is the twist of the base in the world (translation part [m], rotation vector [rad]; only with
    ``base_std``), then the terms of the strain [rad/m]. The readings are those of all sensors, one sensor behind the
    other; NaN is what was not read. A pose or an orientation of which a number is missing is left out whole. Without
    any reading the filter predicts. The estimate's ``chi2`` measures how much the readings surprise the prediction,
    and ``details["lasting"]`` holds the lasting errors.

    Parameters
    ----------
    rod
        The rod.
    sensors
        What is read.
    strain_std
        Standard deviation :math:`\sigma` of every term [rad/m] before any reading; one number or one for each.
    rate
        Rate :math:`\lambda` of the terms [1/s]: how fast the strain changes and is forgotten; one number or one for
        each.
    base_std
        Standard deviations of position [m] and rotation [rad] of the base, about each axis. Without them the base
        stays at the origin of the world.
    base_rate
        Rate of the base [1/s], or of each of its six coordinates.
    iterations
        Largest number of linearisations in an update.

    Raises
    ------
    InputError
        If there is no sensor, one sits beyond the ends of the rod, or numbers do not fit or are not positive.

    Examples
    --------
    The tip of a rod of 1 m is turned by 0.3 rad, so its curvature is 0.3 rad/m:

    >>> tip = RodSensor("orientation", 1e-3, arc_m=1.0)
    >>> method = RodFilter(Rod(1.0, bending=1, torsion=0), [tip], strain_std=10.0, rate=1.0)
    >>> state, estimate = method.step(method.init(), [0.3, 0.0, 0.0])
    >>> estimate.q.round(3), np.sqrt(estimate.covariance.diagonal()).round(3)
    (array([0.3, 0. ]), array([0.001, 0.001]))
    """

    robot, bounds = None, None

    def __init__(
        self,
        rod: Rod,
        sensors: Sequence[RodSensor],
        strain_std: ArrayLike,
        rate: ArrayLike,
        base_std: ArrayLike | None = None,
        base_rate: ArrayLike = 0.1,
        iterations: int = 8,
    ) -> None:
        owner = "RodFilter"
        require(isinstance(rod, Rod), "rod", owner, "a Rod", type(rod).__name__)
        self.rod, self.sensors, self.iterations = rod, tuple(sensors), iterations
        require(self.sensors, "sensors", owner, "at least one", "none")
        for sensor in self.sensors:
            require(isinstance(sensor, RodSensor), "sensors", owner, "RodSensors", type(sensor).__name__)
            there = 0 <= sensor.arc_m <= rod.length * (1 + 1e-12)
            require(there, "arc_m", owner, f"between 0 and the length {rod.length:g} m", sensor.arc_m)
        whole = isinstance(iterations, int) and iterations > 0
        require(whole, "iterations", owner, "a positive whole number", iterations)
        base = np.empty(0) if base_std is None else np.repeat(_positive(base_std, "base_std", owner, 2), 3)
        self._std = np.append(base, _positive(strain_std, "strain_std", owner, rod.n_q))
        rates = _positive(base_rate, "base_rate", owner, len(base)), _positive(rate, "rate", owner, rod.n_q)
        self._rate, self.n_q = np.concatenate(rates), len(self._std)
        self.angles = FreeAngles((), -self._std, self._std)
        lasting = [sensor.lasting for sensor in self.sensors]
        rates = [np.full(len(sensor.lasting), 1 / sensor.lasting_time_s) for sensor in self.sensors]
        self._lasting_std, self._lasting_rate = np.concatenate(lasting), np.concatenate(rates)
        self._scale = np.concatenate([self._std, self._lasting_std, self._std * self._rate])
        self._rows = np.cumsum([0, *(len(sensor.white) for sensor in self.sensors)])
        # For the kernels. The sums say where the readings of a sensor begin, and its errors among the states.
        self._layout = (
            rod.basis,
            rod.length / rod.parts,
            np.array([float(sensor.arc_m) for sensor in self.sensors]),
            np.array([list(_KINDS).index(sensor.kind) for sensor in self.sensors]),
            self._rows,
            self.n_q + np.cumsum([0, *(len(std) for std in lasting)]),
            np.concatenate([sensor.white for sensor in self.sensors]) ** 2,
        )

    def parts_of(self, n_readings: int) -> tuple[Array, Array]:
        """Return which sensor every reading belongs to; no reading stays the same ``[s]``."""
        return np.repeat(np.arange(len(self.sensors)), np.diff(self._rows)), np.ones(n_readings, dtype=bool)

    def widened(self, share: float) -> None:
        """Return nothing: there are no bounds."""

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> KalmanState:
        """Return the state at ``q0``, or at a straight rod: at rest, without errors. Nothing is random."""
        q0 = np.zeros(self.n_q) if q0 is None else start(q0, self.n_q, "RodFilter")
        q = np.concatenate([q0, np.zeros((*q0.shape[:-1], len(self._lasting_std)))], axis=-1)
        P = np.diag(self._scale**2)
        return KalmanState(q, np.zeros(q0.shape), np.broadcast_to(P, (*q0.shape[:-1], *P.shape)).copy())

    def motion(self, tau: float) -> tuple[Array, Array]:
        """Return the transition of ``(q, velocity)`` over a time [s], and the covariance that noise adds.

        Examples
        --------
        >>> sensor = RodSensor("gyroscope", 0.1, arc_m=1.0)
        >>> F, Q = RodFilter(Rod(1.0, 1, 0), [sensor], strain_std=2.0, rate=5.0).motion(0.0)
        >>> F.diagonal(), Q.any()
        (array([1., 1., 1., 1.]), np.False_)
        """
        n, x = self.n_q, self._rate * tau
        faded, stay = np.exp(-x), np.exp(-self._lasting_rate * tau)
        F, rest = np.diag(np.concatenate([faded * (1 + x), stay, faded * (1 - x)])), np.diag(self._scale**2)
        i, k = np.arange(n), np.arange(len(F) - n, len(F))
        F[i, k], F[k, i] = faded * tau, -faded * x * self._rate
        return F, rest - F @ rest @ F.T

    def step(
        self,
        state: KalmanState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[KalmanState, Estimate]:
        """Predict to the time ``t`` and take in ``u``; see :class:`.Estimator`.

        Raises
        ------
        InputError
            If ``t`` is not after the last step, or a shape does not fit.
        """
        n, rows = self.n_q, self._rows
        read = incoming(u, mask, "RodFilter", rows[-1])
        truth = np.asarray(known_coordinates(np.full(n, np.nan) if known is None else known, n, "RodFilter"))
        require(state.t is None or t > state.t, "t", "RodFilter", f"after the last step, {state.t} s", t)
        state = self.predicted(state, t)
        x, m = np.concatenate([state.q, state.velocity], axis=-1), state.q.shape[-1]
        batch = np.broadcast_shapes(x.shape[:-1], read.shape[:-1], truth.shape[:-1])
        x, read, truth = (np.broadcast_to(y, (*batch, y.shape[-1])).copy() for y in (x, read, truth))
        P = np.broadcast_to(state.covariance, (*batch, n + m, n + m)).copy()
        for sensor, first, stop in zip(self.sensors, rows, rows[1:], strict=False):
            if sensor.kind in ("pose", "orientation"):
                read[~np.isfinite(read[..., first:stop]).all(axis=-1), first:stop] = np.nan
        if known is not None:
            unknown = np.full((*batch, m), np.nan)
            x, P = conditioned(x, P, np.concatenate([truth, unknown], axis=-1))
        use, u_hat, chi2 = np.isfinite(read), np.empty(read.shape), np.zeros(batch)
        for k in np.ndindex(batch):
            prior, before = x[k].copy(), P[k].copy()
            for _ in range(self.iterations if use[k].any() else 0):
                last = x[k].copy()
                x[k], P[k], chi2[k] = _improve(self._layout, n, last, prior, before, read[k])
                if (np.abs(x[k] - last) < _STILL * self._scale).all():
                    break
            u_hat[k] = _compare(self._layout, n, x[k], read[k])[0]
        q, C, details = x[..., :n].copy(), P[..., :n, :n].copy(), {"lasting": x[..., n:m].copy()}
        estimate = Estimate(q, C, u_hat, chi2[()], use.sum(axis=-1), (~use).sum(axis=-1), details)
        return KalmanState(x[..., :m], x[..., m:], P, state.t), estimate

    def positions(self, q: ArrayLike, covariance: ArrayLike, arcs_m: ArrayLike) -> tuple[Array, Array]:
        """Return positions in the world of places along the rod, and their covariances, to first order.

        Parameters
        ----------
        q
            Configuration of an estimate ``[..., n_q]``.
        covariance
            Its covariance ``[..., n_q, n_q]``.
        arcs_m
            Distance of every place from the base along the backbone ``[m]`` [m].

        Returns
        -------
        tuple
            Positions ``[..., m, 3]`` [m], and covariances ``[..., m, 3, 3]`` [m^2].

        Raises
        ------
        InputError
            If a shape does not fit, or a place is not on the rod.
        """
        q = numbers(q, "q", "RodFilter", (..., self.n_q))
        P = numbers(covariance, "covariance", "RodFilter", (..., self.n_q, self.n_q))
        T, J = self.rod.motion(q, arcs_m)
        slopes = T[..., :3, :3] @ J[..., :3, :]
        return T[..., :3, 3], slopes @ P[..., None, :, :] @ slopes.mT


@kernel(allocates=True)
def _cross(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


@kernel(entry=True, allocates=True)
def _exponential(x):
    """Return the pose of a twist, its adjoint, and the left Jacobian of SE(3).

    The Jacobian is the power series of the left Jacobian of SO(3), with the bracket of the twist in it.
    """
    r, w = x[:3], x[3:]
    W, V, square, along = _cross(w), _cross(r), w @ w, 2.0 * (w @ r)
    s, f, g, f_z = arc_functions(square)
    g_z = (f - 3.0 * g) / (2.0 * square) if square > 1e-12 else 0.0
    W2 = W @ W
    T, A, J = np.eye(4), np.zeros((6, 6)), np.zeros((6, 6))
    R, left = np.eye(3) + s * W + f * W2, np.eye(3) + f * W + g * W2
    p = left @ r
    T[:3, :3], T[:3, 3] = R, p
    A[:3, :3], A[3:, 3:], A[:3, 3:] = R, R, _cross(p) @ R
    J[:3, :3], J[3:, 3:] = left, left
    J[:3, 3:] = f * V + g * (W @ V + V @ W) + along * (f_z * W + g_z * W2)
    return T, A, J


@kernel(entry=True, allocates=True)
def _logarithm(T):
    """Return the twist of a pose."""
    twist = np.zeros(6)
    rotation_vector(T[:3, :3], twist[3:])
    twist[:3] = np.linalg.solve(_exponential(twist)[2][:3, :3], T[:3, 3].copy())
    return twist


@kernel(entry=True, allocates=True)
def _along(basis, piece, q, arcs):
    """Return poses and body Jacobians of places; the twist of the base stands in front of the terms, or nothing.

    On the way, ``X`` holds the twists in the world: they are the same for all that moves as one body.
    """
    parts, _, terms = basis.shape
    first = len(q) - terms
    poses, jacobians = np.empty((len(arcs), 4, 4)), np.empty((len(arcs), 6, len(q)))
    T, A, X = np.eye(4), np.eye(6), np.zeros((6, len(q)))
    if first:
        T, A, X[:, :6] = _exponential(q[:6])
    for i in range(parts):
        strain = basis[i] @ q[first:]
        strain[2] = 1.0
        for place in range(len(arcs) + 1):  # the places on this piece, then its end
            end = place == len(arcs)
            if not end and min(int(arcs[place] / piece), parts - 1) != i:
                continue
            length = piece if end else arcs[place] - i * piece
            E, onwards, left = _exponential(length * strain)
            here, there, slopes = T @ E, A @ onwards, X.copy()
            slopes[:, first:] += length * (A @ left @ basis[i])
            if end:
                T, A, X = here, there, slopes
            else:
                poses[place], jacobians[place] = here, np.linalg.solve(there, slopes)
    return poses, jacobians


@kernel(entry=True, allocates=True)
def _compare(layout, n, x, u):
    """Return the readings of a state, how ``u`` differs from them, and the slopes of this by the state.

    A pose differs by the twist, in the frame of the sensor, from the predicted pose to the pose that was read.
    """
    basis, piece, arcs, kinds, rows, errors, _ = layout
    u_hat, r, H = np.zeros(len(u)), np.zeros(len(u)), np.zeros((len(u), len(x)))
    poses, jacobians = _along(basis, piece, x[:n], arcs)
    for k in range(len(kinds)):
        first, stop, T, J = rows[k], rows[k + 1], poses[k], jacobians[k]
        error = np.zeros(stop - first)
        for i in range(errors[k], errors[k + 1]):
            error[i - errors[k]] = x[i]
            H[first + i - errors[k], i] = 1.0
        if kinds[k] < _GYROSCOPE:
            twist, low = np.zeros(6), 6 - len(error)
            twist[low:] = error
            u_hat[first:stop] = _logarithm(T @ _exponential(twist)[0])[low:]
            if np.isfinite(u[first:stop]).all():
                twist[low:] = u[first:stop]
                twist = _logarithm(np.linalg.inv(T) @ _exponential(twist)[0])
                r[first:stop] = twist[low:] - error
                H[first:stop, :n] = np.linalg.solve(_exponential(twist)[2], J)[low:]
        else:
            u_hat[first:stop], H[first:stop, len(x) - n :] = J[3:] @ x[len(x) - n :] + error, J[3:]
            r[first:stop] = u[first:stop] - u_hat[first:stop]
    return u_hat, r, H


@kernel(entry=True, allocates=True)
def _improve(layout, n, x, prior, P, u):
    """Return mean and covariance given readings, linearised at ``x``, and the chi-square of their surprise."""
    _, r, H = _compare(layout, n, x, u)
    use = np.flatnonzero(np.isfinite(u))
    r += H @ (x - prior)
    r, H, R = r[use], H[use], np.diag(layout[6][use])
    S = H @ P @ H.T + R
    gain = np.linalg.solve(S, H @ P).T
    # Joseph's form: a covariance stays positive where sensors are far better than the prior.
    rest = np.eye(len(x)) - gain @ H
    C = rest @ P @ rest.T + gain @ R @ gain.T
    return prior + gain @ r, (C + C.T) / 2.0, r @ np.linalg.solve(S, r)
