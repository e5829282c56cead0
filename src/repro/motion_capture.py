r"""Configurations from motion capture: which shape of the robot fits measured bodies or markers best.

A body :math:`i` on the robot has the pose :math:`T_i(q)\,M_i` in the base frame and :math:`B\,T_i(q)\,M_i` in that of
the cameras. We minimise, for every shape by itself,

.. math:: \sum_i \frac{\|p_i - \hat p_i\|^2}{\sigma_p^2} + \frac{\|\log(R_i \hat R_i^T)\|^2}{\sigma_R^2}

over :math:`q` by Levenberg-Marquardt; the slopes of positions and turns are twists of the robot. The rig's constants
:math:`B` and :math:`M_i` are fitted over many shapes at once by Gauss-Newton, with the shapes eliminated: each of
them is at its own optimum, and only its Schur complement counts.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from repro.common import Array, bad_input, is_table, numbers, printable, require
from repro.estimators.base import Trajectory
from repro.estimators.calibration import outside
from repro.estimators.least_squares import CHI2, LevenbergMarquardt
from repro.robot import FreeBody, Place, Robot, place, point_on, rotation_matrix, unit_quaternions
from repro.sensing import _batch_difference
from repro.tables import Table, configurations_of, read_table, text_of

_RIG_POSITION, _RIG_ROTATION = 10e-3, 0.2
"""Priors of a frame's place and rotation [m, rad]; those of an unknown base are a hundred times as wide."""
_RIG_SHAPES, _RIG_ITERATIONS, _TOLERANCE = 400, 60, 1e-6
_LENGTH_UNITS = {"Millimeters": 1e-3, "Centimeters": 1e-2, "Meters": 1.0}
_POSE = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]
_POSITION_FIRST = [4, 5, 6, 0, 1, 2, 3]
_EXPORTS = ("Format Version", "Segments", "Objects", "NO_OF_FRAMES")
"""What files of Motive, Vicon and Qualisys begin with."""
_FROZEN, _JUMP_STEPS, _FRAME_S, _ORIGIN = 20, 5.0, 0.5, 5e-3
"""Frames are frozen if more are equal in a row and the next step is so many usual ones; rows farther apart than this
are no frames [s]; a body that is mostly farther from the origin does not go there [m]."""
_SLACK, _OUTSIDE, _MISFIT = 0.1, 0.05, 0.1
"""Poses may be outside the bounds by this share of their width, this share of the poses farther, and the kinematics
may miss them by this share of the robot's length."""
_EQUAL = 5e-5
"""Two ways of the axes fit alike if their misfits differ by no more than a tenth and this [m]."""


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
    """

    base: Array
    bodies: Array
    deviation: Array


@dataclass(frozen=True, repr=False)
class FittedShapes(Trajectory):
    """Configurations, as over time in a :class:`.Trajectory`, and what they leave of the measured poses.

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
    def residual(self) -> Array:
        """Root mean square distance of measured and fitted positions, of every shape ``[t]`` [m]."""
        return _size(self.residuals[..., :3], -1)

    def to_frame(self) -> Any:
        """Return the data frame of :meth:`.Trajectory.to_frame` with the residual, ``residual_mm``."""
        return super().to_frame().assign(residual_mm=1e3 * self.residual)

    def __repr__(self) -> str:
        """Return the lines of a trajectory, and the residual."""
        distance = 1e3 * _size(self.residuals[..., :3], None)
        return f"{super().__repr__()}\nresidual, root mean square: {distance:.2g} mm"


def _size(vectors: Array, axis: int | None) -> Array:
    """Root mean square length of those that are there; NaN where none is."""
    return np.sqrt(np.ma.filled(np.ma.masked_invalid(np.square(vectors).sum(-1)).mean(axis), np.nan))


class _Bodies:
    """Poses of places as a sensor model: all positions, then all rotation vectors, in the base frame."""

    compiled = False

    def __init__(self, robot: Robot, places: Sequence[Place]) -> None:
        self.robot, self.places = robot, tuple(places)
        self.n_q, self.n_readings, self.rotations = robot.n_q, 6 * len(self.places), robot.rotations

    def __call__(self, q: Array) -> Array:
        return self.linearise(q)[0]

    def linearise(self, q: Array) -> tuple[Array, Array]:
        T, X = self.robot.motion(q, self.places)
        p, turns = T[..., None, :3, 3], X[..., :3]
        moves = X[..., 3:] + np.cross(turns, p)
        J = np.concatenate([moves, turns], axis=1)  # [n, 2 b, n_q, 3]
        u = np.concatenate([T[..., :3, 3], _rotation_vectors(T[..., :3, :3])], axis=1)
        return u.reshape(len(q), -1), np.swapaxes(J, 2, 3).reshape(len(q), -1, self.n_q)

    def difference(self, u: Array, u_hat: Array) -> Array:
        r = np.empty(u_hat.shape)
        _batch_difference(self.n_readings // 2, np.ascontiguousarray(u), np.ascontiguousarray(u_hat), r)
        return r


def _rotation_vectors(R: Array) -> Array:
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])


def fit_shape(
    robot: Robot,
    poses: Any,
    at: Sequence[Any] | None = None,
    *,
    times: Any = None,
    noise: tuple[float, float] = (0.5e-3, 0.01),
    start: Any = None,
    rig: Rig | None = None,
    fit_rig: bool = False,
) -> FittedShapes:
    r"""Fit the shapes of a robot to motion capture.

    Parameters
    ----------
    robot
        What is to be fitted. Coordinates with equal bounds stay there; other bounds do not count.
    poses
        Measured bodies, one row per shape: poses ``[t, n, 4, 4]``, positions and quaternions XYZW ``[t, n, 7]``, or
        markers ``[t, n, 3]`` [m]; NaN for what is missing, a whole body or its rotation alone. Without the dimension
        of time it is one shape. A data frame or the path of a table is read by the names of its columns.
    at
        Where each body is: something that is mounted (it has a ``place``), or ``(segment, at)`` [m], or
        ``(segment, at, position)`` for a marker beside the backbone, with its place in the cross-section [m]. The
        tips of all segments if not given; with one body more, the first is on the base. What is measured on the base
        (segment 0, a whole pose) may move: all other bodies are taken relative to it.
    times
        Time of each row [s].
    noise
        Standard deviations of a measured position along each axis [m] and of a rotation about each axis [rad].
    start
        Configuration from which every shape is searched; that of the robot, else straight, if not given.
    rig
        Frames of base and bodies, such as an earlier fit found; all the identity if not given.
    fit_rig
        Fit them over all shapes, from ``rig`` if given. Priors of 10 mm and 0.2 rad hold what the shapes do not
        determine, and ``rig.deviation`` tells it: beside constant curvature a tilt of base and bodies is a bend.

    Returns
    -------
    FittedShapes
        ``q``, ``covariance``, ``residuals`` and ``rig``. Coordinates beyond the last body that was seen are NaN, with
        an infinite variance. If the residuals are larger than the noise in most shapes, the covariances grow by them.

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
    if is_table(poses):
        table = read_table(poses)
        poses = np.stack(list(bodies_of(table).values()), axis=1)[..., _POSITION_FIRST]
        times = table.times if times is None else times
    T = _measured(poses, owner)
    places = _places(robot, at, T.shape[1], owner)
    require((numbers(noise, "noise", owner, (2,)) > 0).all(), "noise", owner, "positive", noise)
    require(robot.n_q, "robot", owner, "one with a coordinate", "none")
    for k, where in enumerate(places):
        if where.segment == 0 and np.isfinite(T[:, k, 0, 0]).any():  # all others as if this body never moved
            mount = robot.poses(np.zeros(robot.n_q), [places.pop(k)])[0]
            T = mount @ np.linalg.inv(T[:, k, None]) @ np.delete(T, k, axis=1)
            break
    n = T.shape[1]
    require(any(where.segment for where in places), "poses", owner, "of a body beyond the base", "none")
    first = rig is None
    rig = Rig(np.eye(4), np.tile(np.eye(4), (n, 1, 1)), np.zeros((1 + n, 6))) if rig is None else rig
    require(rig.bodies.shape == (n, 4, 4), "rig", owner, f"of {n} bodies", f"{len(rig.bodies)}")
    search = _Search(robot, places, noise, start, owner)
    if fit_rig:
        if first:
            rig = replace(rig, base=_first_base(robot.poses(search.q0, places), T, robot.length / 2))
        shown = np.unique(np.linspace(0, len(T) - 1, min(len(T), _RIG_SHAPES)).astype(int))
        rig = search.rig_of(T[shown], rig, 100.0 if first else 1.0)
    u, places = _readings(T, rig), search.mounted(rig)
    far = float(np.nanmedian(np.linalg.norm(u[:, : 3 * n].reshape(-1, 3), axis=-1)))
    expected = "in metres and in the frame of the base (or fit_rig=True)"
    loose = any(isinstance(segment, FreeBody) for segment in robot.segments)
    require(
        loose or not far > 3 * robot.length, "poses", owner, expected, f"positions {far:.3g} m from the base"
    )
    q, u_hat, C, chi2, used = search.best(u, places)
    # Coordinates of segments that no body was seen on or beyond.
    last = [where.segment - (where.at == 0 < robot.segments[where.segment - 1].length) for where in places]
    unknown = search.segment > np.where(np.isfinite(u[:, : 3 * n : 3]), last, 0).max(1)[:, None]
    dof = np.maximum(used - (search.free & ~unknown).sum(1), 0)
    if (dof > 0).any():
        C *= max(1.0, float(np.median(chi2[dof > 0] / dof[dof > 0])))
    both = unknown[:, :, None] | unknown[:, None, :]
    q, C = np.where(unknown, np.nan, q), np.where(both, np.where(np.eye(robot.n_q) == 1, np.inf, np.nan), C)
    at_times = np.arange(len(T), dtype=float) if times is None else numbers(times, "times", owner, (len(T),))
    r = _Bodies(robot, places).difference(u, u_hat).reshape(len(T), 2, n, 3)
    return FittedShapes(
        at_times, q, C, u_hat, chi2, dof, u.shape[1] - used, {},
        residuals=np.concatenate([r[:, 0], r[:, 1]], axis=-1), rig=rig, robot=robot,
    )  # fmt: skip


def _measured(poses: Any, owner: str) -> Array:
    """Return poses ``[t, n, 4, 4]``, NaN for what is missing: a whole body or its rotation."""
    values = numbers(poses, "poses", owner, finite=False)
    if values.shape[-2:] == (4, 4) and values.ndim in (3, 4):
        T = values.reshape(-1, *values.shape[-3:]).copy()
    elif values.shape[-1:] in ((3,), (7,)) and values.ndim in (2, 3):
        rows = values.reshape(-1, *values.shape[-2:])
        T = np.full((*rows.shape[:2], 4, 4), np.nan)
        T[..., :3, 3] = rows[..., :3]
        there = np.isfinite(rows[..., 3:]).all(-1) & (values.shape[-1] == 7)
        if there.any():
            T[there, :3, :3] = rotation_matrix(unit_quaternions(rows[there, 3:], "poses", owner, (None, 4)))
    else:
        expected = "of shape (t, n, 4, 4), (t, n, 7) or (t, n, 3)"
        raise bad_input("poses", owner, expected, f"shape {values.shape}")
    require(T.size, "poses", owner, "of at least one shape and one body", f"shape {values.shape}")
    T[~np.isfinite(T[..., :3, :3]).all((-2, -1)), :3, :3] = np.nan
    T[~np.isfinite(T[..., :3, 3]).all(-1), :3] = np.nan
    R = np.where(np.isfinite(T[..., :3, :3]), T[..., :3, :3], np.eye(3))
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max((-2, -1))
    for k, body in np.argwhere((off > 1e-2) | (np.linalg.det(R) < 0)):
        words = f"a matrix that is none in row {k + 1}, body {body + 1}"
        raise bad_input("poses", owner, "rotations and positions [m]", words)
    T[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    return T


def _places(robot: Robot, at: Any, n: int, owner: str) -> list[Place]:
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
        own: Any = getattr(item, "place", item)
        if not isinstance(own, Place):
            pair = isinstance(own, Sequence) and len(own) in (2, 3)
            require(pair, "at", owner, "parts, or (segment, at [m]), or (segment, at, position)", item)
            own = place(owner, *list[Any](own))
        robot.check_place(own, "at")
        places.append(own)
    require(len(places) == n, "at", owner, f"one place for each of {n} bodies", f"{len(places)}")
    return places


class _Search:
    """Finds the best configuration of every shape, and the rig that suits all of them."""

    def __init__(
        self, robot: Robot, places: list[Place], noise: tuple[float, float], start: Any, owner: str
    ) -> None:
        self.robot, self.places, self.noise = robot, places, noise
        stated: Any = (robot.lower, robot.upper)
        self.known = np.full(robot.n_q, np.nan)
        if robot.lower is not None:
            self.known = np.where(stated[0] == stated[1], stated[0], np.nan)
        self.free = np.isnan(self.known)
        q0 = robot.start if start is None else robot.check_q(start, owner)
        if q0 is None:  # not quite straight: there the slopes by an azimuth are zero
            q0 = np.where([name.startswith("kappa") for name in robot.coordinates], 0.1, 0.0)
        self.q0 = np.where(self.free, q0, self.known)
        self.segment = np.array(
            [g for g, s in enumerate(robot.segments, 1) for _ in s.coordinates], dtype=int
        )

    def mounted(self, rig: Rig) -> list[Place]:
        """Return the places of the bodies themselves."""
        return [
            where._replace(
                rotation=where.rotation @ body[:3, :3], position=where.position + where.rotation @ body[:3, 3]
            )
            for where, body in zip(self.places, rig.bodies, strict=True)
        ]

    def fit(self, q: Array, u: Array, places: list[Place], tolerance: float) -> tuple[Array, ...]:
        """Return configurations, readings there, covariance, chi-square and number of readings used."""
        last = max(where.segment for where in places)
        robot = Robot(self.robot.segments[:last])
        n, far = robot.n_q, np.full(robot.n_q, 1e6)
        noise = np.repeat(self.noise, 3 * len(places))
        method = LevenbergMarquardt(_Bodies(robot, places), -far, far, noise, tolerance=tolerance)
        known = None if self.free.all() else self.known[:n]
        found, u_hat, C, status, used = method.fit(q[:, :n], u, known)
        found = method.angles.wrapped(found)
        C = np.pad(C, ((0, 0), (0, q.shape[1] - n), (0, q.shape[1] - n)))
        return np.concatenate([found, q[:, n:]], axis=1), u_hat, C, status[:, CHI2], used

    def best(self, u: Array, places: list[Place]) -> tuple[Array, ...]:
        """Return the same, searched: from the base to the tip one segment more at a time, then all together."""
        q, both = np.tile(self.q0, (len(u), 1)), u.reshape(len(u), 2, len(places), 3)
        reached = sorted({where.segment for where in places} - {0})
        for g in reached[:-1]:
            up_to = [k for k, where in enumerate(places) if where.segment <= g]
            q = self.fit(q, both[:, :, up_to].reshape(len(u), -1), [places[k] for k in up_to], 1.0)[0]
        found = self.fit(q, u, places, _TOLERANCE)
        for step in (-1, 1):  # where it fits badly, the shapes before and after are better starts
            bad = np.flatnonzero(found[3] > 10 * np.median(found[3]) + 1e-6)
            if len(bad):
                again = self.fit(found[0][(bad + step) % len(u)], u[bad], places, _TOLERANCE)
                lower = again[3] < found[3][bad]
                for old, new in zip(found, again, strict=True):
                    old[bad[lower]] = new[lower]
        return found

    def rig_of(self, T: Array, rig: Rig, wider: float) -> Rig:
        """Return the rig that suits all shapes: Gauss-Newton with the shapes eliminated."""
        n = len(self.places)
        prior = np.tile(np.repeat([_RIG_POSITION, _RIG_ROTATION], 3), 1 + n)
        prior[:6] *= wider
        weight = np.repeat(1 / np.array(self.noise), 3 * n)
        moved, damping, cost, q = np.zeros(len(prior)), 1e-3, math.inf, None
        trial, delta, H, g, limit, typical = rig, moved, np.eye(len(prior)), moved, np.inf, 1.0
        for _ in range(_RIG_ITERATIONS):
            u, places = _readings(T, trial), self.mounted(trial)
            x, _, _, chi2, used = self.best(u, places) if q is None else self.fit(q, u, places, _TOLERANCE)
            penalty = np.square((moved + delta) / prior).sum()
            if np.minimum(chi2, limit).sum() + penalty < cost:
                rig, q, moved, damping = trial, x, moved + delta, damping / 10
                dof = np.maximum(used - self.free.sum(), 1)
                typical = max(1.0, float(np.median(chi2 / dof)))
                # A shape that fits a hundred times as badly as most counts as one that fits ten times as badly.
                limit = 10 * typical * dof
                cost = np.minimum(chi2, limit).sum() + penalty
                shares = weight * np.sqrt(np.minimum(1.0, limit / np.maximum(chi2, 1e-300)))[:, None]
                H, g = _eliminated(_Bodies(self.robot, places), x, u, shares, self.free)
                H, g = H + np.diag(prior**-2), g - moved / prior**2
            else:
                damping *= 10
            delta = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
            if delta @ H @ delta < 1e-8:
                break
            trial = _moved(rig, delta)
        deviation = np.sqrt(typical * np.diag(np.linalg.inv(H)))
        return replace(rig, deviation=deviation.reshape(1 + n, 6))


def _eliminated(model: _Bodies, q: Array, u: Array, weight: Array, free: Array) -> tuple[Array, Array]:
    """Return information and gradient of the rig, with the shapes at their best for every rig."""
    t, n = len(q), len(model.places)
    R = model.robot.poses(q, model.places)[..., :3, :3]
    u_hat, J = model.linearise(q)
    r = weight * model.difference(u, u_hat)
    there = np.isfinite(r)
    p, K = u_hat[:, : 3 * n].reshape(t, n, 3), np.zeros((t, 2, n, 3, 1 + n, 6))
    K[:, 0, :, :, 0, :3] = K[:, 1, :, :, 0, 3:] = np.eye(3)
    K[:, 0, :, :, 0, 3:] = np.swapaxes(np.cross(np.eye(3), p[:, :, None]), -1, -2)
    for k in range(n):
        K[:, 0, k, :, 1 + k, :3] = K[:, 1, k, :, 1 + k, 3:] = R[:, k]
    K = np.where(there, weight, 0.0)[..., None] * K.reshape(t, 6 * n, -1)
    J = np.where(there, weight, 0.0)[..., None] * J[..., free]
    r = np.where(there, r, 0.0)
    by_shape = np.linalg.pinv(np.swapaxes(J, 1, 2) @ J, hermitian=True)
    seen = J @ (by_shape @ (np.swapaxes(J, 1, 2) @ K))  # the part of K that shapes can take over
    return np.einsum("tsk,tsl->kl", K, K - seen), np.einsum("tsk,ts->k", K - seen, r)


def _moved(rig: Rig, delta: Array) -> Rig:
    """Return a rig whose frames moved along and about their own axes."""
    each = delta.reshape(-1, 6)
    T = np.zeros((len(each), 4, 4))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_rotvec(each[:, 3:]).as_matrix(), each[:, :3]
    T[:, 3, 3] = 1.0
    return Rig(rig.base @ T[0], rig.bodies @ T[1:], rig.deviation)


def _readings(T: Array, rig: Rig) -> Array:
    """Return positions and rotation vectors in the base frame, ``[t, 6 n]``, NaN where nothing was measured."""
    own = np.linalg.inv(rig.base) @ T
    turns = np.full((*own.shape[:2], 3), np.nan)
    there = np.isfinite(own[..., 0, 0])
    turns[there] = _rotation_vectors(own[there][:, :3, :3])
    return np.concatenate([own[..., :3, 3], turns], axis=1).reshape(len(T), -1)


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
    ours, theirs = (reach * np.swapaxes(X[axes][:, :3, :3], 1, 2).reshape(-1, 3) for X in (own, T))
    ours = np.concatenate([model_points - model_points.mean(0), ours])
    theirs = np.concatenate([points - points.mean(0), theirs])
    base = np.eye(4)
    base[:3, :3] = Rotation.align_vectors(theirs, ours)[0].as_matrix()
    base[:3, 3] = points.mean(0) - base[:3, :3] @ model_points.mean(0)
    return base


class Motion(NamedTuple):
    """Poses of rigid bodies over time, in the axes of the motion capture."""

    name: str
    """Of the take."""
    started: datetime | None
    """When it started, by the clock of the computer that recorded; ``None`` if the file does not say."""
    rate_hz: float
    """Frames per second in the file."""
    times: Array
    """Time of each frame after the start ``[t]`` [s]."""
    bodies: dict[str, Array]
    """By name ``[t, 7]``: quaternion X, Y, Z, W, then position X, Y, Z [m]; NaN where the body is lost."""
    lines: Sequence[int] = ()
    """Line of each frame in the file."""
    remarks: tuple[str, ...] = ()
    """What was left out."""
    missing: int = 0
    """Frames that the header announces and the file does not have."""
    up: str = "z"
    """The axis that points up."""


def read_motion(path: Path | str) -> Motion:
    """Read the rigid bodies of a file of motion capture.

    The file is an export of OptiTrack Motive (CSV with quaternions, versions 1.20 to 1.29), Vicon (CSV with
    segments), Qualisys (TSV with bodies, "6D"), or a table with the columns ``time_s, x_1_mm, y_1_mm, z_1_mm, qx_1,
    qy_1, qz_1, qw_1`` for body "1" and so on. Quaternions lead from the body to the axes of the file; in Motive y
    points up. A frame is lost where cells are empty, where a body has no orientation, or lies in the origin without a
    turn; more than 20 frames that are equal bit for bit and
    end in a jump are frozen and lost too.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If it is no such file, has another version, unit or type of rotation, no body, times that do not increase, or
        quaternions that are not unit within 0.01.

    Examples
    --------
    One body, which is lost in the second of three frames:

    >>> import tempfile
    >>> first = "Format Version,1.23,Export Frame Rate,40,Total Exported Frames,3"
    >>> text = f'''{first},Rotation Type,Quaternion,Length Units,Millimeters
    ...
    ... ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
    ... ,Name,Tip,Tip,Tip,Tip,Tip,Tip,Tip
    ... ,ID,1,1,1,1,1,1,1
    ... ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
    ... Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
    ... 0,0.000,0,0,0,1,5,110,-3
    ... 1,0.025,,,,,,,
    ... 2,0.050,0.6,0,0,0.8,5,90,-60
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "tilt.csv")
    ...     _ = file.write_text(text)
    ...     take = read_motion(file)
    >>> take.name, take.rate_hz, list(take.bodies)
    ('tilt', 40.0, ['Tip'])
    >>> take.bodies["Tip"][:, 4:]
    array([[ 0.005,  0.11 , -0.003],
           [   nan,    nan,    nan],
           [ 0.005,  0.09 , -0.06 ]])
    """
    path, remarks = Path(path), list[str]()
    require(path.is_file(), "path", "read_motion", "a file that exists", path)
    text, owner = text_of(path, remarks), path.name
    if not text.startswith(_EXPORTS):
        return _motion_of(read_table(path))
    read = _motive if text.startswith("Format") else _qualisys if text.startswith("NO") else _vicon
    separator = "\t" if read is _qualisys else ","
    motion = read([next(csv.reader([line], delimiter=separator), []) for line in text.splitlines()], path)
    increasing = len(motion.times) and np.all(np.diff(motion.times) > 0)
    require(increasing, "times", owner, "increasing from frame to frame", "others, or no frame")
    if motion.missing:
        remarks.append(
            f"{owner} has {len(motion.times)} frames, {motion.missing} fewer than its header says."
        )
    motion = motion._replace(bodies={printable(name): poses for name, poses in motion.bodies.items()})
    for name, poses in motion.bodies.items():
        _clear_lost(poses, f"{name} in {owner}", motion.lines, remarks)
    return motion._replace(remarks=tuple(remarks))


def _numbers_of(
    rows: Sequence[Sequence[str]], header: int, end: int, wanted: Sequence[int], owner: str
) -> tuple[Array, list[int]]:
    """Return the wanted columns of the rows below a header ``[t, n]``, NaN where a cell is empty, and their lines."""
    lines = [k + 1 for k in range(header, end) if any(rows[k])]
    try:
        values = [[float(rows[k - 1][c] or "nan") for c in wanted] for k in lines]
    except (ValueError, IndexError) as error:
        raise bad_input("frames", owner, "rows of numbers", error) from error
    return np.array(values).reshape(-1, len(wanted)), lines


def _motive(rows: list[list[str]], path: Path) -> Motion:
    owner, header = path.name, dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    version = header.get("Format Version", "nothing")
    require(re.fullmatch(r"1\.2\d", version), "Format Version", owner, "1.20 to 1.29", version)
    for key, known in {"Rotation Type": ("Quaternion",), "Length Units": tuple(_LENGTH_UNITS)}.items():
        require(header.get(key) in known, key, owner, " or ".join(known), header.get(key, "nothing"))
    space = header.get("Coordinate Space", "Global")
    require(space == "Global", "Coordinate Space", owner, "Global", space)
    try:
        rate_hz, announced = float(header["Export Frame Rate"]), int(header["Total Exported Frames"])
        axes = next(k for k, row in enumerate(rows) if row[:1] == ["Frame"])
        began = header.get("Capture Start Time")
        started = None if began is None else datetime.strptime(began, "%Y-%m-%d %I.%M.%S.%f %p")
    except (KeyError, ValueError, StopIteration) as error:
        words = (
            "one with frame rate, number of frames and, if any, start time, and a line that begins with Frame"
        )
        raise bad_input("header", owner, words, error or "another") from error
    # Older versions do not say which line is which: there the names are in the fourth.
    names = next((row for row in rows[:axes] if row[1:2] == ["Name"]), rows[min(3, axes)])
    columns = list(zip(names, rows[axes - 1], rows[axes], strict=False))
    keys = {name: [(name, *key) for key in _POSE] for name, kind, _ in columns if kind == "Rotation"}
    picked = {name: [columns.index(key) for key in own] for name, own in keys.items() if {*own} <= {*columns}}
    require(picked, "rigid bodies", owner, "there with rotation and position", "none")
    wanted = [1, *(k for own in picked.values() for k in own)]
    table, lines = _numbers_of(rows, axes + 1, len(rows), wanted, owner)
    poses = table[:, 1:].reshape(len(table), -1, 7).swapaxes(0, 1).copy()
    poses[..., 4:] *= _LENGTH_UNITS[header["Length Units"]]
    bodies, name = dict(zip(picked, poses, strict=True)), header.get("Take Name", path.stem)
    return Motion(name, started, rate_hz, table[:, 0], bodies, lines, (), max(announced - len(table), 0), "y")


def _vicon(rows: list[list[str]], path: Path) -> Motion:
    owner, end = path.name, next((k for k, row in enumerate(rows) if k > 5 and not any(row)), len(rows))
    header, wanted = [*rows[:5], *5 * [[""]]], ["RX", "RY", "RZ", "TX", "TY", "TZ"]
    starts = [k for k in range(len(header[3])) if header[3][k : k + 6] == wanted]
    units = {"rad": 1.0, "deg": math.pi / 180, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
    known = all(len(own := header[4][k : k + 6]) == 6 and {*own} <= {*units} for k in starts)
    if not (starts and known and re.fullmatch(r"[\d.]+", header[1][0])):
        words = "of Vicon: a rate, names, RX, RY, RZ, TX, TY, TZ of each segment, and their units"
        raise bad_input("header", owner, words, "another")
    table, lines = _numbers_of(rows, 5, end, [0, *(k + c for k in starts for c in range(6))], owner)
    bodies, rate_hz = dict[str, Array](), float(header[1][0])
    for n, k in enumerate(starts):
        own = table[:, 1 + 6 * n : 7 + 6 * n] * [units[unit] for unit in header[4][k : k + 6]]
        q = np.zeros((len(own), 4))
        there = np.isfinite(own).all(1)
        q[there] = Rotation.from_rotvec(own[there, :3]).as_quat()
        bodies[header[2][k]] = np.concatenate([q, own[:, 3:]], axis=1)
    return Motion(path.stem, None, rate_hz, (table[:, 0] - 1) / rate_hz, bodies, lines)


def _qualisys(rows: list[list[str]], path: Path) -> Motion:
    axes = next((k for k, row in enumerate(rows) if row[:2] == ["Frame", "Time"]), 0)
    header = {row[0]: row[1:] for row in rows[:axes] if row}
    names, block = header.get("BODY_NAMES", []), ["X", "Y", "Z"]
    whole = axes and all(rows[axes][2 + 16 * n :][:3] == block for n in range(len(names)))
    if not (names and whole and "Rot[0]" in rows[axes]):
        words = (
            "of Qualisys 6D: BODY_NAMES, then Frame, Time, and X, Y, Z, angles, Residual, Rot[0] to Rot[8]"
        )
        raise bad_input("header", path.name, words, "another")
    wanted = [1, *(2 + 16 * n + c for n in range(len(names)) for c in (0, 1, 2, *range(7, 16)))]
    table, lines = _numbers_of(rows, axes + 1, len(rows), wanted, path.name)
    bodies = dict[str, Array]()
    for n, name in enumerate(names):
        own = table[:, 1 + 12 * n : 13 + 12 * n]
        R, q = own[:, 3:].reshape(-1, 3, 3).swapaxes(1, 2), np.zeros((len(own), 4))  # by columns
        there = np.isfinite(R).all((1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(R)) - 1) < 0.01)
        q[there] = Rotation.from_matrix(R[there]).as_quat()
        bodies[name] = np.concatenate([q, 1e-3 * own[:, :3]], axis=1)
    try:
        started = datetime.strptime(header["TIME_STAMP"][0], "%Y-%m-%d, %H:%M:%S.%f")
    except (KeyError, ValueError, IndexError):
        started = None
    rate_hz = float(header.get("FREQUENCY", ["nan"])[0])
    return Motion(path.stem, started, rate_hz, table[:, 0], bodies, lines)


def bodies_of(table: Table) -> dict[str, Array]:
    """Return the bodies of a table ``[t, 7]``, as in a :class:`Motion`; markers have no quaternion.

    Body k has the columns ``x_k_mm, y_k_mm, z_k_mm`` (or ``_m``, ``_cm``) and the quaternion ``qx_k, qy_k, qz_k,
    qw_k``. Bodies are in the order of their numbers.

    Raises
    ------
    InputError
        If a column is missing.
    """
    found = sorted(
        {int(name.split("_")[1]) for name in table.names if re.fullmatch(r"q?[xyzw]_[0-9]+", name)}
    )
    require(found, "columns", table.owner, "x_1_mm, y_1_mm, z_1_mm and so on", ", ".join(table.columns))
    whole, bodies = any(name.startswith("qx_") for name in table.names), dict[str, Array]()
    for body in found:
        q = [
            table.scaled(f"q{axis}_{body}")[0] if whole else np.full(len(table.values), np.nan)
            for axis in "xyzw"
        ]
        p = [table.scaled(f"{axis}_{body}", ("mm", "cm", "m"))[0] for axis in "xyz"]
        bodies[str(body)] = np.stack([*q, *p], axis=1)
    return bodies


def _motion_of(table: Table) -> Motion:
    bodies, remarks = bodies_of(table), list(table.remarks)
    if table.times is None or len(table.times) < 2:
        expected = "there: a column time_s, or a file of Motive, Vicon or Qualisys"
        raise bad_input("times", table.owner, expected, "none")
    for name, poses in bodies.items():
        _clear_lost(poses, f"body {name} in {table.owner}", table.lines, remarks)
    rate_hz = 1 / float(np.median(np.diff(table.times)))
    return Motion(Path(table.owner).stem, None, rate_hz, table.times, bodies, table.lines, tuple(remarks))


def _clear_lost(poses: Array, owner: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Make frames NaN in which a body was lost or frozen; refuse what is no orientation."""
    q, p = poses[:, :4], poses[:, 4:]
    markers = bool(np.isnan(q).all())
    size = np.ones(len(q)) if markers else np.linalg.norm(q, axis=1)
    lost = ~np.isfinite(p).all(axis=1) | ~np.isfinite(size) | (size == 0)
    off = np.abs(size[~lost] - 1).max(initial=0)
    name, _, file = owner.rpartition(" in ")
    require(off < 0.01, f"quaternions of {name}", file, "unit within 0.01", f"an error of {off:.3g}")
    origin = (p == 0).all(axis=1) & (markers | (np.abs(q[:, 3]) == 1))
    away = np.linalg.norm(p[~origin & ~lost], axis=1)
    if len(away) and np.median(away) > _ORIGIN:  # else the body may be there
        lost |= origin
    poses[lost] = np.nan
    _say(lost, f"Frames of {owner} without a pose", lines, remarks)
    _clear_frozen(poses, p, f"Frames of {owner}", lines, remarks)


def _clear_frozen(values: Array, place: Array, what: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Make rows NaN that only repeat the one before, many times, until they jump: what rests goes on slowly."""
    seen = np.flatnonzero(np.isfinite(place).all(axis=1))
    if len(seen) == 0:
        return
    rows, x = np.nan_to_num(values[seen]), place[seen] / np.maximum(np.nanstd(place, axis=0), 1e-12)
    last = np.flatnonzero(
        (rows[1:] != rows[:-1]).any(axis=1)
    )  # of each run of equal rows, but the one at the end
    step, length = np.linalg.norm(x[last + 1] - x[last], axis=1), np.diff(last, prepend=-1)
    frozen = np.zeros(len(values), dtype=bool)
    for k in np.flatnonzero(length > _FROZEN):
        if step[k] > _JUMP_STEPS * np.median(step):
            frozen[seen[last[k] - length[k] + 2 : last[k] + 1]] = True
    values[frozen] = np.nan
    _say(
        frozen,
        f"{what} left out, which only repeat the one before, more than {_FROZEN} in a row",
        lines,
        remarks,
    )


def _say(rows: Array, what: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Add a remark on some rows: how many they are, and where."""
    at = np.flatnonzero(rows)
    if len(at):
        parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        words = [f"{lines[x[0]]} to {lines[x[-1]]}" if len(x) > 1 else f"{lines[x[0]]}" for x in parts[:4]]
        more = ", and so on" if len(parts) > 4 else ""
        where = f"line{'s' * (len(at) > 1)} {', '.join(words)}{more}"
        remarks.append(f"{what}: {len(at)} of {len(rows)} ({where}).")


class Poses(NamedTuple):
    """Measured configurations."""

    times: Array | None
    """Of the rows [s]; None if they have none."""
    q: Array
    """Configurations ``[t, n_q]`` [m, rad]; NaN where the pose is not known."""
    lines: Sequence[int]
    """Where the rows stand in the file."""
    remarks: tuple[str, ...]
    """What was left out."""
    known: dict[str, Any]
    """``window_s`` ``[t, 2]`` of rows that say when they start and end [s], and by which ``clock``; from bodies the
    measured ``tip`` ``[t, 3]`` [m], ``residual`` ``[t]`` [m], ``covariance``, the :class:`Motion`, and configurations
    ``turned`` ``[t, n_q]`` that fit as well, by the angle of the base about the straight robot [deg]."""


def read_poses(
    robot: Robot, path: Any, *, bodies: Sequence[str] = (), straight_s: float = 0.0, covariance: Any = None
) -> Poses:
    """Read measured poses of a robot: from its coordinates, or from bodies on the ends of its segments.

    Coordinates are columns with a unit (``delta_x_1_mm, delta_y_1_mm``), with ``time_s``, or ``start_s`` and
    ``end_s``, or neither. Held poses may also start and end by other clocks: ``start_board_s`` and ``end_board_s``,
    or ``start_unix_s`` and ``end_unix_s``. Bodies are those of :func:`read_motion`; z points along the straight robot
    to its tip, but for Motive, where y does. Rows that cannot be right are NaN and told.

    Parameters
    ----------
    robot
        The robot.
    path
        The file, or a data frame.
    bodies
        Names of the bodies from base to tip, one on the end of every segment; with one more, the first is on the
        base. All bodies of the file, in their order, if not given.
    straight_s
        The robot is straight and unstretched for the first so many seconds: shifts and turns of bodies against the
        ends of the segments are taken from there [s], and along which axes the robot points. With 0 there are none.
    covariance
        Covariance of a measured configuration ``[n_q, n_q]``, by which it may be outside the bounds; a tenth of their
        width if not given.

    Raises
    ------
    InputError
        If the file has no poses of this robot, or most of them are outside its bounds.
    """
    require(0 <= straight_s < math.inf, "straight_s", "read_poses", "0 or above", straight_s)
    if isinstance(path, str | Path) and Path(path).is_file() and text_of(Path(path), []).startswith(_EXPORTS):
        return _fitted(robot, read_motion(path), Path(path).name, bodies, straight_s, covariance)
    table = read_table(path)
    if not set(robot.coordinates) & set(table.names):
        return _fitted(robot, _motion_of(table), table.owner, bodies, straight_s, covariance)
    given = "coordinates of the robot, and bodies or a straight start beside them"
    require(not (straight_s or bodies), "poses", table.owner, "bodies", given)
    q, times, remarks, known = (
        configurations_of(robot, table),
        table.times,
        list(table.remarks),
        dict[str, Any](),
    )
    pairs = {clock: (f"start_{clock}s", f"end_{clock}s") for clock in ("unix_", "board_", "")}
    if clocks := [clock for clock, pair in pairs.items() if {*pair} <= {*table.names}]:
        window = np.stack([table.scaled(name)[0] for name in pairs[clocks[0]]], axis=1)
        known, times = {"window_s": window, "clock": clocks[0]}, window.mean(axis=1)
    elif times is not None and len(times) > 1 and np.median(np.diff(times)) < _FRAME_S:
        zero = np.asarray((q == 0).all(axis=1))
        if robot.n_q > 1 and zero.mean() < 0.5:
            q[zero] = np.nan
        _clear_frozen(q, q, f"Rows of {table.owner}", table.lines, remarks)
    _say(np.asarray(np.isnan(q).any(axis=1)), f"Rows of {table.owner} without a pose", table.lines, remarks)
    _clear_outside(robot, q, table.owner, table.lines, remarks, covariance)
    return Poses(times, q, table.lines, tuple(remarks), known)


def _clear_outside(
    robot: Robot,
    q: Array,
    owner: str,
    lines: Sequence[int],
    remarks: list[str],
    covariance: Any,
    hint: str = "(units, axes, bounds?)",
) -> None:
    """Make poses NaN that are outside the robot's bounds; refuse some that are far, or most of them."""
    if robot.lower is None or robot.upper is None:
        return
    width = robot.upper - robot.lower
    free = robot.fixed | robot.free_angles.free  # nobody measures a fixed one exactly
    slack = np.where(free, np.inf, _SLACK * width + 1e-9)
    far = (q < robot.lower - slack) | (q > robot.upper + slack)
    out = far if covariance is None else far | outside(robot, q, covariance)
    rows, c = np.asarray(out.any(axis=1)), int(out.sum(axis=0).argmax())
    name, many = robot.coordinates[c], far.any(axis=1).sum() > max(1, _OUTSIDE * len(q))
    bounds = f"{robot.lower[c]:.4g} to {robot.upper[c]:.4g}"
    if many or rows.sum() > max(1, len(q) / 2):
        received = (
            f"{np.nanmin(q[:, c]):.4g} to {np.nanmax(q[:, c]):.4g}, {rows.sum()} of {len(q)} poses outside"
        )
        raise bad_input(name, owner, f"within the robot's bounds, {bounds} {hint}", received)
    q[rows] = np.nan
    _say(rows, f"Poses of {owner} left out, outside the robot's bounds, for {name} {bounds}", lines, remarks)


def _at_rest(T: Array, times: Array, straight_s: float, names: Sequence[str], owner: str) -> Array:
    """Return the mean pose of every body ``[n, 4, 4]`` in the first seconds."""
    rest = np.tile(np.eye(4), (T.shape[1], 1, 1))
    for k, name in enumerate(names):
        own = T[(times < times[0] + straight_s) & np.isfinite(T[:, k, 0]).all(axis=1), k]
        require(len(own), "bodies", owner, f"seen in the first {straight_s:g} s", f"no pose of {name}")
        rest[k, :3, :3] = Rotation.from_matrix(own[:, :3, :3]).mean().as_matrix()
        rest[k, :3, 3] = own[:, :3, 3].mean(axis=0)
    return rest


def _straightened(robot: Robot, T: Array, rest: Array) -> tuple[dict[int, Array], Array]:
    """Return poses of the ends of segments, straight at rest, and the rotation of the base.

    The base has its axes along those of the capture, in whichever of 24 ways fits the robot best, or leans from them
    to the line of the bodies at rest. It is at the origin, or where the last end is at rest by its length away. Ways
    that fit alike are turns about the straight robot [deg]: only readings tell them apart.
    """
    straight = robot.poses(np.zeros(robot.n_q), _places(robot, None, len(rest), "read_poses"))
    tip, moves, seen = rest[-1, :3, 3], T @ np.linalg.inv(rest), np.isfinite(T[:, :, 0, 3]).any(axis=1)
    shown = np.flatnonzero(seen)[np.linspace(0, seen.sum() - 1, _RIG_SHAPES // 2).astype(int)]
    ways = sorted(Rotation.create_group("O").as_matrix(), key=lambda R: (-round(R[0, 0]), -round(R.trace())))
    line = tip - rest[0, :3, 3] * (len(rest) > 1)
    line = line / np.linalg.norm(line).clip(1e-12)
    leaning = [R for R in ways if R[:, 2] @ line > 0.57]
    ways += [
        Rotation.from_quat([*np.cross(R[:, 2], line), 1 + R[:, 2] @ line]).as_matrix() @ R for R in leaning
    ]
    bases = np.tile(np.eye(4), (2, len(ways), 1, 1))
    bases[..., :3, :3] = ways
    bases[1, :, :3, 3] = tip - bases[1, :, :3, :3] @ straight[-1, :3, 3]
    bases = bases[int(np.linalg.norm(tip) > 1.5 * robot.length) :].reshape(-1, 4, 4)
    misfits = []
    for base in bases:
        fit = fit_shape(robot, np.linalg.inv(base) @ moves[shown] @ base @ straight)
        beyond = outside(robot, fit.q).any(axis=1).mean()
        misfits.append(np.sqrt(np.nanmedian(np.square(fit.residual))) + robot.length * beyond)
    good = bases[np.array(misfits) <= 1.1 * min(misfits) + _EQUAL]
    ways = dict[int, Array]()
    for base in good[::-1]:
        R = good[0, :3, :3].T @ base[:3, :3]
        if R[2, 2] > 1 - 1e-9:
            angle = round(math.degrees(math.atan2(R[1, 0], R[0, 0])))
            ways[angle] = np.linalg.inv(base) @ moves @ base @ straight
    return ways, good[0, :3, :3]


def _fitted(
    robot: Robot, motion: Motion, owner: str, bodies: Sequence[str], straight_s: float, covariance: Any
) -> Poses:
    """Return the configurations that fit bodies best."""
    n, there = len(robot.segments), list(motion.bodies)
    short = {name.rpartition(":")[2]: name for name in there}  # Vicon: subject:segment
    names = [short.get(name, name) for name in bodies] or there
    known = len(names) in (n, n + 1) and len({*names}) == len(names) and {*names} <= {*there}
    expected = f"one on the end of each of {n} segments, from base to tip, or {n + 1} with the base first"
    expected += f" (the file has {', '.join(there)})"
    require(known, "bodies", owner, expected, ", ".join(names) or "none")
    poses = np.stack([motion.bodies[name] for name in names], axis=1)[..., _POSITION_FIRST]
    if motion.up == "y":
        poses = poses[..., [0, 2, 1, 3, 5, 4, 6]] * [1, -1, 1, 1, -1, 1, 1]
    T = _measured(poses, owner)
    if len(names) > n:
        T = np.linalg.inv(T[:, :1]) @ T[:, 1:]
    ways, remarks = {0: T}, list(motion.remarks)
    if straight_s > 0:
        ways, R = _straightened(robot, T, _at_rest(T, motion.times, straight_s, names[-n:], owner))
        T = ways[0]
        axes = R[[0, 2, 1]] * [[1], [1], [-1]] if motion.up == "y" else R
        x, _, z = (
            "-+"[int(own[k] > 0)] + "xyz"[k] for own, k in zip(axes.T, np.abs(axes).argmax(0), strict=True)
        )
        remarks.append(
            f"By the axes of {owner}, the straight robot points along {z}, and x of its base along {x}."
        )
    require(np.isfinite(T[:, :, 0, 3]).any(), "poses", owner, "seen in some frame", "none")
    shapes = fit_shape(robot, T, times=motion.times)
    q, miss = shapes.q.copy(), shapes.residual
    typical, most = float(np.sqrt(np.nanmedian(miss**2))), _MISFIT * robot.length
    remarks.append(f"The robot's kinematics miss the poses of {owner} by {1e3 * typical:.2f} mm (median).")
    hint = f"with {motion.up} along the straight robot (units, bounds, order of bodies, axes? "
    hint += "A straight start tells the axes: --straight-s)"
    expected = f"those that the robot can take, {hint}"
    require(typical < most, "poses", owner, expected, f"poses {1e3 * typical:.3g} mm from the nearest shape")
    far = miss > most
    q[far] = np.nan
    _say(far, f"Poses of {owner} left out, which the robot cannot take", motion.lines, remarks)
    _clear_outside(robot, q, owner, motion.lines, remarks, covariance, hint)
    found = {"tip": T[:, -1, :3, 3], "residual": miss, "covariance": shapes.covariance, "motion": motion}
    found["turned"] = {angle: fit_shape(robot, x).q for angle, x in ways.items() if angle}
    return Poses(motion.times, q, motion.lines, tuple(remarks), found)


JUMP, HALF_TURN, ALIKE, REST = np.radians([90.0, 170.0, 15.0, 5.0])
"""Turns [rad]: from frame to frame that no body makes; least turn of exchanged markers; largest one between exchanges
that count as equal, and at the ends of a stretch that was turned back."""


def undo_exchanges(quaternions: Any) -> tuple[Array, Array]:
    """Turn a rigid body back in the frames in which motion capture took its markers for each other.

    Markers that lie nearly symmetrically are now and then exchanged. The body is then seen turned by a half turn in
    its own axes, always the same one, from one frame to the next, and back again later. The jumps themselves tell the
    half turn, if there are two of them or more. A stretch of turned frames is turned back if that joins it to its
    neighbours within 5 degrees. The first frame counts as right.

    Parameters
    ----------
    quaternions
        Orientations X, Y, Z, W of the body ``[t, 4]``, NaN where it is lost.

    Returns
    -------
    tuple
        The orientations, NaN also where the body is turned and cannot be turned back; and which frames were turned
        back.

    Raises
    ------
    InputError
        If there is no orientation.

    Examples
    --------
    A body that stands still, with a half turn about x in three frames:

    >>> seen = np.tile([0.0, 0.0, 0.0, 1.0], (8, 1))
    >>> seen[[2, 5, 6]] = [1.0, 0.0, 0.0, 0.0]
    >>> found, undone = undo_exchanges(seen)
    >>> np.abs(found @ [0.0, 0.0, 0.0, 1.0]), np.flatnonzero(undone)
    (array([1., 1., 1., 1., 1., 1., 1., 1.]), array([2, 5, 6]))
    """
    rows = numbers(quaternions, "quaternions", "undo_exchanges", (None, 4), finite=False)
    there = np.flatnonzero(np.isfinite(rows).all(axis=1))
    require(
        len(there), "quaternions", "undo_exchanges", "there in one frame or more", f"{len(rows)} lost frames"
    )
    q, n = rows[there], len(there)
    seen: Any = Rotation.from_quat(q)
    right, last = np.ones(n, dtype=bool), q[0]
    for k, x in enumerate(q):
        right[k] = abs(x @ last) > np.cos(JUMP / 2)  # q and -q are one rotation
        last = x if right[k] else last
    edge, steps = right[1:] != right[:-1], (seen[:-1].inv() * seen[1:]).magnitude()
    k = np.flatnonzero(edge)
    jumps = seen[np.where(right[k], k, k + 1)].inv() * seen[np.where(right[k], k + 1, k)]
    turns, left = [], jumps[jumps.magnitude() > HALF_TURN]
    while len(left):
        alike = (left[0].inv() * left).magnitude() < ALIKE
        if alike.sum() > 1:  # seen once, nothing says that it is always the same
            turns.append(left[alike].mean())
        left = left[~alike]
    undone = np.zeros(n, dtype=bool)
    for a, b in pairwise([0, *np.flatnonzero(edge | (steps > JUMP)) + 1, n]):
        least = REST
        for turn in () if right[a] else turns:
            back = seen[a:b] * turn.inv()
            for inner, outer in ((0, a - 1), (-1, b)):
                if outer < n and (right | undone)[outer]:
                    rest = (Rotation.from_quat(q[outer]).inv() * back[inner]).magnitude()
                    if rest < least:
                        least, q[a:b], undone[a:b] = rest, back.as_quat(), True
    q[~right & ~undone] = np.nan
    found, which = np.full(rows.shape, np.nan), np.zeros(len(rows), dtype=bool)
    found[there], which[there] = q, undone
    return found, which
