r"""Configurations from motion capture: which shape of the robot fits measured bodies or markers best.

A body :math:`i` on the robot has the pose :math:`T_i(q)\,M_i` in the base frame and :math:`B\,T_i(q)\,M_i` in that of
the cameras. We minimise, for every shape by itself,

.. math:: \sum_i \frac{\|p_i - \hat p_i\|^2}{\sigma_p^2} + \frac{\|\log(R_i \hat R_i^T)\|^2}{\sigma_R^2}

over :math:`q` by Levenberg-Marquardt; the slopes of positions and turns are twists of the robot. The rig's constants
:math:`B` and :math:`M_i` are fitted over many shapes at once by Gauss-Newton, with the shapes eliminated: each of
them is at its own optimum, and only its Schur complement counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from repro.chain import Chain, FreeBody, Place, place, point_on, unit_quaternions
from repro.common import Array, bad_input, is_table, numbers, require
from repro.estimators.gauss_newton import Trial, eliminated, gauss_newton
from repro.estimators.least_squares import CHI2, USED, LevenbergMarquardt
from repro.estimators.track import Trajectory
from repro.parts import Assembly, Mounted
from repro.readings import POSITION_FIRST, bodies_of
from repro.sensing import batch_difference
from repro.tables import read_table

_RIG_POSITION, _RIG_ROTATION = 10e-3, 0.2
"""Priors of a frame's place and rotation [m, rad]; those of an unknown base are a hundred times as wide."""
_RIG_SHAPES, _RIG_ITERATIONS, _TOLERANCE = 400, 60, 1e-6
_RARE = 18.4
"""Good shapes fit as badly as one that counts as bad once in 1e8 times: this is the natural logarithm."""
_FAR = 1e6
"""Bounds of coordinates that have none [m, rad]."""


@dataclass(frozen=True)
class Rig:
    """What stays the same over all shapes.

    Parameters
    ----------
    base
        Pose ``T_capture_base`` ``[4, 4]`` of the robot's base in the frame of the measured poses.
    bodies
        Poses ``T_place_body`` ``[n, 4, 4]`` of the bodies where they are mounted.
    deviation
        Standard deviations ``[1 + n, 6]`` of base and bodies: along their own axes [m], then about them [rad]; zero
        where they were not fitted.

    Raises
    ------
    InputError
        If these are no poses.

    Examples
    --------
    A robot that hangs from the ceiling of a room of 2.5 m, and one body without a turn of its own:

    >>> from repro import Rig
    >>> Rig([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2.5], [0, 0, 0, 1]], [np.eye(4)]).deviation.shape
    (2, 6)
    """

    base: Array
    bodies: Array
    deviation: Array = field(default_factory=lambda: np.zeros((0, 6)))

    def __post_init__(self) -> None:
        base, bodies = measured_poses([[self.base]], "Rig")[0], measured_poses([self.bodies], "Rig")
        require(np.isfinite(base).all() and np.isfinite(bodies).all(), "poses", "Rig", "finite", "NaN")
        for name, value in (("base", base[0]), ("bodies", bodies[0])):
            object.__setattr__(self, name, value)
        if len(self.deviation) == 0:
            object.__setattr__(self, "deviation", np.zeros((1 + bodies.shape[1], 6)))


@dataclass(frozen=True, repr=False)
class FittedShapes(Trajectory):
    """Configurations, as over time in a :class:`.Trajectory`, and what they leave of the measured poses.

    ``status`` says of each shape: *consistent*; *left out*: a body does not fit and was left out, the others fit;
    *inconsistent*: the bodies do not fit, and it is not decided which one is wrong; *undetermined*: a coordinate is
    not seen; *unchecked*: the fit uses up all that was measured, so that nothing can contradict.

    Parameters
    ----------
    residuals
        Measured less fitted ``[t, n, 6]`` in the base frame: positions [m], then rotation vectors [rad].
    rig
        The rig that was given or fitted.
    """

    residuals: Array = field(default_factory=lambda: np.zeros((0, 0, 6)))
    rig: Rig | None = None

    @property
    def left_out(self) -> Array:
        """Which bodies were left out because they do not fit ``[t, n]``, as in ``residuals``."""
        t, n = self.residuals.shape[:2]
        return np.asarray(self.details["left_out"].reshape(t, 2, n, 3).any((1, 3)))

    @property
    def residual(self) -> Array:
        """Root mean square distance of measured and fitted positions, of every shape ``[t]`` [m]."""
        return _size(self.residuals[..., :3], -1)

    def to_frame(self) -> Any:
        """Return the data frame of :meth:`.Trajectory.to_frame` with the residual, ``residual_mm``."""
        return super().to_frame().assign(residual_mm=1e3 * self.residual)

    def __repr__(self) -> str:
        """Return the lines of a trajectory, the residual, and how often each body was left out."""
        distance = 1e3 * _size(self.residuals[..., :3], None)
        counts = enumerate(self.left_out.sum(0), 1)
        left = ", ".join(f"body {k} in {n} shapes" for k, n in counts if n)
        said = f"residual, root mean square: {distance:.2g} mm{'; left out: ' * bool(left)}{left}"
        return f"{super().__repr__()}\n{said}"


def _size(vectors: Array, axis: int | None) -> Array:
    """Root mean square length of those that are there; NaN where none is."""
    return np.sqrt(np.ma.filled(np.ma.masked_invalid(np.square(vectors).sum(-1)).mean(axis), np.nan))


class _Fits(NamedTuple):
    """Configurations of shapes at their best, and readings there, with what they leave and use of those measured."""

    q: Array
    u_hat: Array
    covariance: Array
    chi2: Array
    used: Array

    @property
    def variance(self) -> Array:
        """Of every coordinate ``[t, n_q]``."""
        return np.diagonal(self.covariance, axis1=1, axis2=2)


class _Bodies:
    """Poses of places as a sensor model: all positions, then all rotation vectors, in the base frame."""

    compiled = False

    def __init__(self, robot: Chain, places: Sequence[Place]) -> None:
        self.robot, self.places = robot, tuple(places)
        self.n_q, self.n_readings, self.rotations = robot.n_q, 6 * len(self.places), robot.rotations

    def __call__(self, q: Array) -> Array:
        return self.linearise(q)[0]

    def linearise(self, q: Array) -> tuple[Array, Array]:
        T, X = self.robot.motion(q, self.places)
        p, turns = T[..., None, :3, 3], X[..., :3]
        moves = X[..., 3:] + np.cross(turns, p)
        J = np.concatenate([moves, turns], axis=1)  # [n, 2 b, n_q, 3]
        return _readings(T), np.swapaxes(J, 2, 3).reshape(len(q), -1, self.n_q)

    def difference(self, u: Array, u_hat: Array) -> Array:
        r = np.empty(u_hat.shape)
        batch_difference(self.n_readings // 2, np.ascontiguousarray(u), np.ascontiguousarray(u_hat), r)
        return r


def _readings(T: Array) -> Array:
    """Return positions and rotation vectors of poses ``[t, n, 4, 4]`` as readings ``[t, 6 n]``, NaN for NaN."""
    R = np.where(np.isfinite(T[..., :3, :3]), T[..., :3, :3], np.eye(3))
    turns = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*T.shape[:2], 3)
    turns = np.where(np.isfinite(T[..., 0, :1]), turns, np.nan)
    return np.concatenate([T[..., :3, 3], turns], axis=1).reshape(len(T), -1)


def fit_shape(
    robot: Chain,
    poses: object,
    at: Sequence[object] | None = None,
    *,
    times: ArrayLike | None = None,
    noise: tuple[float, float] = (0.5e-3, 0.01),
    rig: Rig | None = None,
    fit_rig: bool = False,
    leave_out: bool = True,
) -> FittedShapes:
    r"""Fit the shapes of a robot to motion capture.

    Parameters
    ----------
    robot
        What is to be fitted. Coordinates with equal bounds stay there; other bounds do not count.
    poses
        Measured bodies, one row per shape: poses ``[t, n, 4, 4]``, positions and quaternions XYZW ``[t, n, 7]``, or
        markers ``[t, n, 3]`` [m]; NaN for what is missing, a whole body, its rotation or its position alone. Without
        the dimension of time it is one shape. A data frame or the path of a table is read by the names of its
        columns. Every shape is searched from the start of the robot, else from the straight one. What rotations do
        not tell, such as an elongation, stays there with an infinite variance.
    at
        Where each body is: something that is mounted (it has a ``place``), or ``(segment, at)`` [m], or
        ``(segment, at, position)`` for a marker beside the backbone, with its place in the cross-section [m]. The
        tips of all segments if not given; with one body more, the first is on the base. What is measured on the base
        (segment 0, a whole pose) may move: all other bodies are taken relative to it.
    times
        Time of each row [s].
    noise
        Standard deviations of a measured position along each axis [m] and of a rotation about each axis [rad].
    rig
        Frames of base and bodies, such as an earlier fit found; all the identity if not given.
    fit_rig
        Fit them over all shapes, from ``rig`` if given. Priors of 10 mm and 0.2 rad hold what the shapes do not
        determine, and ``rig.deviation`` tells it: beside constant curvature a tilt of base and bodies is a bend.
    leave_out
        Fit a shape again without each body in turn if it fits as badly as chance allows once in 1e8 times, in units
        of what is typical. A body that exchanged markers turn over takes its whole shape along. It is left out if
        the others fit without it, and do not fit without any other one.

    Returns
    -------
    FittedShapes
        ``q``, ``covariance``, ``residuals``, ``rig``, and ``status`` and ``left_out`` of every shape. Coordinates
        beyond the last body that was seen are NaN, with an infinite variance. If the residuals are larger than the
        noise in most shapes, the covariances grow by them.

    Raises
    ------
    InputError
        If the bodies do not fit ``at``, or are no rigid poses.

    Examples
    --------
    One segment that ends at the tip of a quarter circle, known by a marker on its tip:

    >>> from repro import ConstantCurvature, Robot, fit_shape
    >>> robot = Robot([ConstantCurvature(length=0.110, radius=0.022)])
    >>> found = fit_shape(robot, [[0.0700282, 0.0, 0.0700282]])
    >>> found.q.round(6) + 0.0
    array([[0.034558, 0.      , 0.      ]])
    """
    owner = "fit_shape"
    T, places, times = _measured(robot, poses, at, times, owner)
    require((numbers(noise, "noise", owner, (2,)) > 0).all(), "noise", owner, "positive", noise)
    search = _Search(robot, places, noise)
    rig = _rig_of(search, T, rig, fit_rig, owner)
    u, places = search.mounted(T, rig)
    _check_near(robot, u[:, : 3 * len(places)], owner)

    found = search.best(u, places)
    left_out, status = search.judged(found, u, places, leave_out)
    unknown, dof = search.unseen(u), search.freedom(found, u)
    C = _open(found.covariance * _typical(found.chi2, dof), unknown | (found.variance > _FAR))
    r = _Bodies(robot, places).difference(u, found.u_hat).reshape(len(T), 2, len(places), 3)
    return FittedShapes(
        times, np.where(unknown, np.nan, found.q), C, found.u_hat, found.chi2, dof, u.shape[1] - found.used,
        {"left_out": left_out}, status,
        residuals=np.concatenate([r[:, 0], r[:, 1]], axis=-1), rig=rig,
        robot=robot if isinstance(robot, Assembly) else None,
    )  # fmt: skip


def _measured(
    robot: Chain, poses: object, at: Sequence[object] | None, times: ArrayLike | None, owner: str
) -> tuple[Array, list[Place], Array]:
    """Return poses ``[t, n, 4, 4]`` of bodies beyond the base, where each is, and the times of the rows."""
    if is_table(poses):
        table = read_table(poses)
        poses = np.stack(list(bodies_of(table).values()), axis=1)[..., POSITION_FIRST]
        times = table.times if times is None else times
    T = measured_poses(poses, owner)
    places = places_of(robot, at, T.shape[1], owner)
    require(robot.n_q, "robot", owner, "one with a coordinate", "none")
    T, places = _on_the_base(robot, T, places)
    require(any(where.segment for where in places), "poses", owner, "of a body beyond the base", "none")
    t = np.arange(len(T), dtype=float) if times is None else numbers(times, "times", owner, (len(T),))
    return T, places, t


def _rig_of(search: _Search, T: Array, given: Rig | None, fit: bool, owner: str) -> Rig:
    """Return the rig that was given, else the identity; or, fitted from there, the one that suits all shapes."""
    n = T.shape[1]
    rig = Rig(np.eye(4), np.tile(np.eye(4), (n, 1, 1))) if given is None else given
    require(rig.bodies.shape == (n, 4, 4), "rig", owner, f"of {n} bodies", f"{len(rig.bodies)}")
    if not fit:
        return rig
    if given is None:
        seen = np.isfinite(T[..., 0, 3]).any()
        require(seen, "rig", owner, "given to fit a rig to rotations alone", "none")
        drawn = search.robot.poses(search.q0, search.places)
        rig = replace(rig, base=_first_base(drawn, T, search.robot.length / 2))
    shown = np.unique(np.linspace(0, len(T) - 1, min(len(T), _RIG_SHAPES)).astype(int))
    return search.fitted_rig(T[shown], rig, 100.0 if given is None else 1.0)


def _open(C: Array, unsure: Array) -> Array:
    """Return covariances in which coordinates that nobody sees have an infinite variance, and no correlation."""
    infinite = np.where(np.eye(C.shape[-1]) == 1, np.inf, np.nan)
    return np.where(unsure[:, :, None] | unsure[:, None, :], infinite, C)


def _typical(chi2: Array, dof: Array) -> float:
    """Return the typical chi-square per degree of freedom, at least 1."""
    free = dof > 0
    return max(1.0, float(np.median(chi2[free] / dof[free]))) if free.any() else 1.0


def _misfit(chi2: Array, dof: Array) -> Array:
    """Return chi-squares in units of the largest one of good shapes: above 1 a shape does not fit."""
    return chi2 / (dof + 2 * _RARE + 2 * np.sqrt(dof * _RARE))


def _check_near(robot: Chain, positions: Array, owner: str) -> None:
    """Refuse positions that are in another unit or frame, by their typical distance from the base."""
    away = np.linalg.norm(positions.reshape(-1, 3), axis=-1)
    far = float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else 0.0
    loose = any(isinstance(segment, FreeBody) for segment in robot.segments)
    expected = "in metres and in the frame of the base (or fit_rig=True)"
    near = loose or not far > 3 * robot.length
    require(near, "poses", owner, expected, f"positions {far:.3g} m from the base")


def _on_the_base(robot: Chain, T: Array, places: list[Place]) -> tuple[Array, list[Place]]:
    """Return all other bodies as if one on the base never moved, if there is one whose whole pose was measured."""
    still = [
        k for k, where in enumerate(places) if where.segment == 0 and np.isfinite(T[:, k, 0]).all(-1).any()
    ]
    if not still:
        return T, places
    k = still[0]
    mount = robot.poses(np.zeros(robot.n_q), [places[k]])[0]
    others = mount @ np.linalg.inv(T[:, k, None]) @ np.delete(T, k, axis=1)
    return others, places[:k] + places[k + 1 :]


def measured_poses(poses: object, owner: str) -> Array:
    """Return poses ``[t, n, 4, 4]``, NaN for what is missing: a whole body or its rotation."""
    values = numbers(poses, "poses", owner, finite=False)
    if values.shape[-2:] == (4, 4) and values.ndim in (3, 4):
        T = values.reshape(-1, *values.shape[-3:]).copy()
    else:
        rigid = values.shape[-1:] in ((3,), (7,)) and values.ndim in (2, 3)
        require(
            rigid, "poses", owner, "of shape (t, n, 4, 4), (t, n, 7) or (t, n, 3)", f"shape {values.shape}"
        )
        rows = values.reshape(-1, *values.shape[-2:])
        T = np.full((*rows.shape[:2], 4, 4), np.nan)
        T[..., :3, 3] = rows[..., :3]
        there = np.isfinite(rows[..., 3:]).all(-1) & (values.shape[-1] == 7)
        if there.any():
            q = unit_quaternions(rows[there, 3:], "poses", owner, (None, 4))
            T[there, :3, :3] = Rotation.from_quat(q).as_matrix()
    require(T.size, "poses", owner, "of at least one shape and one body", f"shape {values.shape}")
    T[~np.isfinite(T[..., :3, :3]).all((-2, -1)), :3, :3] = np.nan
    T[~np.isfinite(T[..., :3, 3]).all(-1), :3, 3] = np.nan
    R = np.where(np.isfinite(T[..., :3, :3]), T[..., :3, :3], np.eye(3))
    off = np.abs(R @ R.mT - np.eye(3)).max((-2, -1))
    for k, body in np.argwhere((off > 1e-2) | (np.linalg.det(R) < 0)):
        words = f"a matrix that is none in row {k + 1}, body {body + 1}"
        raise bad_input("poses", owner, "rotations and positions [m]", words)
    T[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    return T


def places_of(robot: Chain, at: Sequence[object] | None, n: int, owner: str) -> list[Place]:
    """Return where each of ``n`` bodies is: as given, or on the tips of all segments, one more on the base."""
    g = len(robot.segments)
    if at is None:
        expected = (
            f"given unless there are {g} bodies, one on the tip of each segment, or one more on the base"
        )
        require(n in (g, g + 1), "at", owner, expected, f"{n} bodies without it")
        tips = [point_on(i, segment.length) for i, segment in enumerate(robot.segments, 1)]
        return tips if n == g else [point_on(0, 0.0), *tips]
    require(isinstance(at, Sequence), "at", owner, "a list, with a place for each body", at)
    places = []
    for item in at:
        own: Any = item.place if isinstance(item, Mounted) else item
        if not isinstance(own, Place):
            pair = isinstance(own, Sequence) and len(own) in (2, 3)
            require(pair, "at", owner, "parts, or (segment, at [m]), or (segment, at, position)", item)
            own = place(owner, *own)
        robot.check_place(own, "at")
        places.append(own)
    require(len(places) == n, "at", owner, f"one place for each of {n} bodies", f"{len(places)}")
    return places


class _Search:
    """Finds the best configuration of every shape, and the rig that suits all of them."""

    def __init__(self, robot: Chain, places: list[Place], noise: tuple[float, float]) -> None:
        self.robot, self.places, self.noise = robot, places, noise
        self.known = np.where(robot.fixed, np.nan if robot.lower is None else robot.lower, np.nan)
        self.free = np.isnan(self.known)
        q0 = robot.start
        if q0 is None:  # not quite straight: there the slopes by an azimuth are zero
            q0 = np.where([name.startswith("kappa") for name in robot.coordinates], 0.1, 0.0)
        self.q0 = np.where(self.free, q0, self.known)
        self.segment = np.array(
            [g for g, s in enumerate(robot.segments, 1) for _ in s.coordinates], dtype=int
        )

    def mounted(self, T: Array, rig: Rig) -> tuple[Array, list[Place]]:
        """Return measured poses as readings in the base frame, and the places of the bodies themselves."""
        places = [
            where._replace(
                rotation=where.rotation @ body[:3, :3], position=where.position + where.rotation @ body[:3, 3]
            )
            for where, body in zip(self.places, rig.bodies, strict=True)
        ]
        return _readings(np.linalg.inv(rig.base) @ T), places

    def unseen(self, u: Array) -> Array:
        """Return the coordinates ``[t, n_q]`` of segments that no body was seen on or beyond."""
        lengths = [0.0, *(segment.length for segment in self.robot.segments)]
        last = [where.segment - (where.at == 0 < lengths[where.segment]) for where in self.places]
        n = 3 * len(self.places)
        seen = np.isfinite(u[:, :n:3]) | np.isfinite(u[:, n::3])
        return self.segment > np.where(seen, last, 0).max(1)[:, None]

    def fit(self, q: Array, u: Array, places: list[Place], tolerance: float) -> _Fits:
        """Return the fits next to configurations ``[t, n_q]``."""
        last = max(where.segment for where in places)
        robot = Chain(self.robot.segments[:last])
        n, far = robot.n_q, np.full(robot.n_q, _FAR)
        noise = np.repeat(self.noise, 3 * len(places))
        method = LevenbergMarquardt(_Bodies(robot, places), -far, far, noise, tolerance=tolerance)
        known = None if self.free.all() else self.known[:n]
        found, u_hat, C, _, status, counts = method.fit(q[:, :n], u, known)
        found = method.angles.wrapped(found)
        C = np.pad(C, ((0, 0), (0, q.shape[1] - n), (0, q.shape[1] - n)))
        found = np.concatenate([found, q[:, n:]], axis=1)
        return _Fits(found, u_hat, C, status[:, CHI2], counts[:, USED])

    def best(self, u: Array, places: list[Place]) -> _Fits:
        """Return the fits that are found from the base to the tip one segment more at a time, then all together."""
        q, both = np.tile(self.q0, (len(u), 1)), u.reshape(len(u), 2, len(places), 3)
        reached = sorted({where.segment for where in places if (self.segment <= where.segment).any()})
        for g in reached[:-1]:
            up_to = [k for k, where in enumerate(places) if where.segment <= g]
            q = self.fit(q, both[:, :, up_to].reshape(len(u), -1), [places[k] for k in up_to], 1.0).q
        found = self.fit(q, u, places, _TOLERANCE)
        for step in (-1, 1):  # where it fits badly, the shapes before and after are better starts
            bad = np.flatnonzero(found.chi2 > 10 * np.median(found.chi2) + 1e-6)
            if len(bad):
                again = self.fit(found.q[(bad + step) % len(u)], u[bad], places, _TOLERANCE)
                lower = again.chi2 < found.chi2[bad]
                for old, new in zip(found, again, strict=True):
                    old[bad[lower]] = new[lower]
        return found

    def freedom(self, found: _Fits, u: Array) -> Array:
        """Return degrees of freedom of every shape: readings less the directions that they determine."""
        wide = _FAR**2 / 3  # the variance of what nothing shows
        known = 1 - np.minimum(found.variance / wide, 1.0)
        return np.maximum(found.used - (known * (self.free & ~self.unseen(u))).sum(1).round().astype(int), 0)

    def judged(self, found: _Fits, u: Array, places: list[Place], leave_out: bool) -> tuple[Array, Array]:
        """Return which readings were left out, and the status of every shape.

        What is left out becomes NaN in ``u``, and a shape that fits without it takes the place of the one in
        ``found``.
        """
        before, dof = np.isfinite(u), self.freedom(found, u)
        typical = _typical(found.chi2, dof)
        bad = np.flatnonzero(_misfit(found.chi2 / typical, dof) > 1)
        status = np.where(dof > 0, "consistent", "unchecked").astype(object)
        status[(self.unseen(u) | (found.variance > _FAR)).any(1)] = "undetermined"
        status[bad] = "inconsistent"
        if not leave_out or not len(bad):
            return before & ~np.isfinite(u), status

        tried, fits = [], []
        for k in range(len(places)):
            others = u[bad].reshape(len(bad), 2, -1, 3)
            others[:, :, k] = np.nan
            others = others.reshape(len(bad), -1)
            again = self.best(others, places)
            dof = self.freedom(again, others)
            tried.append((*again, others))
            fits.append((dof > 0) & (_misfit(again.chi2 / typical, dof) < 1))
        alone = np.sum(fits, axis=0) == 1  # else another body explains the misfit as well
        for fit, now in zip(tried, fits, strict=True):
            for old, new in zip((*found, u), fit, strict=True):
                old[bad[now & alone]] = new[now & alone]
        status[bad[alone]] = "left out"
        return before & ~np.isfinite(u), status

    def fitted_rig(self, T: Array, rig: Rig, wider: float) -> Rig:
        """Return the rig that suits all shapes: Gauss-Newton with the shapes eliminated."""
        n = len(self.places)
        std = np.tile(np.repeat([_RIG_POSITION, _RIG_ROTATION], 3), 1 + n)
        std[:6] *= wider
        trials = _RigTrials(self, T, rig)
        prior = std**-2
        fit = gauss_newton(trials.trial, prior, iterations=_RIG_ITERATIONS, tolerance=_TOLERANCE)
        of_shapes = (fit.information - np.diag(prior)) / trials.typical
        deviation = np.sqrt(np.diag(np.linalg.inv(of_shapes + np.diag(prior))))
        return replace(trials.rig, deviation=deviation.reshape(1 + n, 6))


class _RigTrials:
    """Rigs that are tried: by how much each moves the frames of the last one that was better.

    A shape that fits a hundred times as badly as most counts as one that fits ten times as badly.
    """

    def __init__(self, search: _Search, T: Array, rig: Rig) -> None:
        self.search, self.T, self.rig = search, T, rig
        self.z, self.q, self.limit, self.typical = np.zeros(6 * (1 + len(search.places))), None, np.inf, 1.0

    def trial(self, z: Array) -> Trial:
        """Return what the shapes leave of the poses, each at its best for this rig."""
        rig = _moved(self.rig, z - self.z)
        u, places = self.search.mounted(self.T, rig)
        search, start = self.search, self.q
        found = search.best(u, places) if start is None else search.fit(start, u, places, _TOLERANCE)
        cost = float(np.minimum(found.chi2, self.limit).sum())
        return Trial(cost, lambda: self._taken(z, rig, u, places, found))

    def _taken(
        self, z: Array, rig: Rig, u: Array, places: list[Place], found: _Fits
    ) -> tuple[float, Array, Array]:
        """Go on from a better rig, with new weights of the shapes."""
        search, chi2 = self.search, found.chi2
        self.z, self.rig, self.q = z, rig, found.q
        dof = np.maximum(found.used - search.free.sum(), 1)
        self.typical = max(1.0, float(np.median(chi2 / dof)))
        self.limit = 10 * self.typical * dof
        shares = np.sqrt(np.minimum(1.0, self.limit / np.maximum(chi2, 1e-300)))[:, None]
        weight = np.repeat(1 / np.array(search.noise), 3 * len(search.places)) * shares
        cost = float(np.minimum(chi2, self.limit).sum())
        return cost, *_equations(_Bodies(search.robot, places), found.q, u, weight, search.free)


def _equations(model: _Bodies, q: Array, u: Array, weight: Array, free: Array) -> tuple[Array, Array]:
    """Return information and gradient of the rig, with the shapes at their best for every rig."""
    t, n = len(q), len(model.places)
    R = model.robot.poses(q, model.places)[..., :3, :3]
    u_hat, J = model.linearise(q)
    r = weight * model.difference(u, u_hat)
    weight = np.where(np.isfinite(r), weight, 0.0)[..., None]
    p, K = u_hat[:, : 3 * n].reshape(t, n, 3), np.zeros((t, 2, n, 3, 1 + n, 6))
    K[:, 0, :, :, 0, :3] = K[:, 1, :, :, 0, 3:] = np.eye(3)
    K[:, 0, :, :, 0, 3:] = np.cross(np.eye(3), p[:, :, None]).mT
    for k in range(n):
        K[:, 0, k, :, 1 + k, :3] = K[:, 1, k, :, 1 + k, 3:] = R[:, k]
    return eliminated(weight * K.reshape(t, 6 * n, -1), weight * J[..., free], np.nan_to_num(r))


def _moved(rig: Rig, delta: Array) -> Rig:
    """Return a rig whose frames moved along and about their own axes."""
    each = delta.reshape(-1, 6)
    T = np.zeros((len(each), 4, 4))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_rotvec(each[:, 3:]).as_matrix(), each[:, :3]
    T[:, 3, 3] = 1.0
    return Rig(rig.base @ T[0], rig.bodies @ T[1:], rig.deviation)


def _first_base(model_T: Array, T: Array, reach: float) -> Array:
    """Return the base frame that brings the robot at its start closest to all measured bodies (Kabsch).

    What is ten times as far from the middle as most does not count.
    """
    p = T[..., :3, 3]
    away = np.linalg.norm(p - np.nanmedian(p, axis=(0, 1)), axis=-1)
    T = np.where((away <= 10 * np.nanmedian(away) + 1e-9)[..., None, None], T, np.nan)
    seen = np.isfinite(T[..., 0, 3])
    own = np.broadcast_to(model_T, T.shape)
    points, model_points = T[seen][:, :3, 3], own[seen][:, :3, 3]
    axes = np.isfinite(T[..., 0, 0])
    ours, theirs = (reach * X[axes][:, :3, :3].mT.reshape(-1, 3) for X in (own, T))
    ours = np.concatenate([model_points - model_points.mean(0), ours])
    theirs = np.concatenate([points - points.mean(0), theirs])
    base = np.eye(4)
    base[:3, :3] = Rotation.align_vectors(theirs, ours)[0].as_matrix()
    base[:3, 3] = points.mean(0) - base[:3, :3] @ model_points.mean(0)
    return base
