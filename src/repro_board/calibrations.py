"""Calibrations at the board: from measured poses in motion, and from motion alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from repro.common import Array, bad_input, require
from repro.estimators.calibration import Calibration, calibrate
from repro.estimators.drift import Drift, Drifting, DriftModel
from repro.estimators.least_squares import LevenbergMarquardt
from repro.estimators.track import track
from repro.parts import Imu
from repro.robot import Robot
from repro.tolerances import Tolerances, placed
from repro_board.cleaning import SPIKE, alike, orientations, unwrapped

TOLERANCES = Tolerances(sensor_gain=0.05, sensor_offset=0.5, earth=0.05)
"""How far a robot may be from its file, where the file states nothing."""
_MOST_POSES = 150
_MODEL_ERROR, _MOST_ROWS, _ROUNDS = 0.003, 4000, 40
"""Without poses: share of a reading that its model is off; rows that are used, and most rounds."""
_CAUSES = (
    "parts that are not where the file says, which poses would tell; axes exchanged or of the wrong sign; another "
    "unit or robot; iron or magnets nearby"
)


def with_poses(
    robot: Robot, q: Array, u: Array, covariance: Array, where: Sequence[str]
) -> tuple[Robot, Calibration | None, Array, list[str]]:
    """Calibrate magnets, sensors and IMUs with the rows whose pose ``q`` ``[t, n_q]`` is not NaN.

    Returns the robot, what was found of its magnets and sensors, all readings with the frames of the IMUs undone, and
    the words for it.
    """
    found, words, n = None, [], sum(sensor.axes for sensor in robot.sensors)
    known = np.flatnonzero(np.isfinite(q).all(1))
    known = known[alike(q[known], unwrapped(robot, u[known]))]
    for _ in range(2 if robot.sensors else 0):
        rows = known[np.isfinite(u[known, :n]).all(1)]
        rows = rows[:: 1 + len(rows) // _MOST_POSES]
        lines = [where[int(k)] for k in rows]
        found = calibrate(
            robot, q[rows], np.nan_to_num(u[rows]), None, covariance[rows], tolerances=TOLERANCES, rows=lines
        )
        size = np.linalg.norm((u[known] - found.sensing()(q[known]))[:, :n], axis=1)
        known = known[~(size > SPIKE * np.nanmedian(size))]
    imus, u = [], u.copy()
    for k in range(len(robot.imus)):
        imu, said = _mounted(robot, k, q, u, known)
        imus.append(imu)
        words.append(said)
    moved = robot if found is None else found.robot
    words += [] if found is None else [repr(found)]
    if left := int(np.isfinite(q).all(1).sum()) - len(known):
        words.append(f"{left} rows of the first part do not go with their poses and are not fitted.")
    return moved.replaced(imus=imus, source=moved.source), found, u, words


def _mounted(robot: Robot, k: int, q: Array, u: Array, known: Array) -> tuple[Imu, str]:
    """Return an IMU as it is mounted, and the words for it; its frame in the readings ``u`` is undone."""
    imu, name = robot.imus[k], robot.part_names[len(robot.sensors) + k]
    rows, columns = orientations(robot, u, k)
    own = np.intersect1d(rows, known)
    require(len(own), name, "repro evaluate", "there in the first part", "nothing")
    measured = Rotation.from_rotvec(u[own, columns])
    expected = Rotation.from_matrix(robot.poses(q[own], [imu.place])[:, 0, :3, :3])
    mounting, frame = Rotation.identity(), Rotation.identity()
    for _ in range(100):  # each is the mean of what the other leaves
        mounting = (expected.inv() * frame.inv() * measured).mean()
        frame = (measured * mounting.inv() * expected.inv()).mean()
    u[rows, columns] = (frame.inv() * Rotation.from_rotvec(u[rows, columns])).as_rotvec()
    mounted = (Rotation.from_matrix(imu.place.rotation) * mounting).as_quat()
    angles = " and ".join(f"{math.degrees(x.magnitude()):.2g}" for x in (mounting, frame))
    said = f"{name}: mounting and frame off by {angles} deg; mounted = {mounted.round(4).tolist()}"
    return replace(imu, orientation=mounted), said


class _Motion(NamedTuple):
    """Readings ``[t, s]`` of a robot in motion, and a model with its errors behind its coordinates."""

    robot: Robot
    model: DriftModel
    method: LevenbergMarquardt
    u: Array
    noise: Array
    start: Array
    """Standard deviations of the errors before."""


class _Rows(NamedTuple):
    """The shapes ``[t, n_q]`` that fit best at some errors, and what they leave."""

    q: Array
    residuals: Array
    slopes: Array
    held: Array
    """Which coordinates are at a bound."""
    fit: Array
    weight: Array
    """Chi-square per degree of freedom of each row, and how many of these it has."""

    def cost(self, gate: float) -> float:
        return float((self.weight * np.minimum(self.fit, gate)).sum())


class _Fitted(NamedTuple):
    errors: Array
    information: Array
    fit: Array
    gate: float
    """Rows that fit worse are spikes or failures."""
    before: float


def by_motion(robot: Robot, u: Array) -> tuple[Calibration, str]:
    r"""Find moments, gains and offsets while the robot moves: least squares over all rows, the shapes eliminated.

    Every row has a shape of its own, so only what no shape explains tells anything of the errors. A Kalman filter
    with the same errors in its state takes the smoothness of the motion for knowledge and states far too little.
    """
    motion, one_moment = _in_motion(robot, u), len({magnet.shape for magnet in robot.magnets}) == 1
    fitted, start = _fitted(motion), motion.start
    spread, changes = (
        max(1.0, float(np.median(fitted.fit))),
        _parameters(robot, motion.model.names, one_moment),
    )
    rows, prior = np.array(list(changes.values())), np.diag(start**-2)
    estimate, tolerance = rows @ fitted.errors, np.sqrt(np.square(rows) @ start**2)
    C = rows @ np.linalg.inv((fitted.information - prior) / spread + prior) @ rows.T
    C = C / np.outer(tolerance, tolerance)
    _judge(list(changes), np.abs(estimate) / tolerance, spread)
    moved = placed(robot, dict(zip(changes, estimate.tolist(), strict=True)))
    quality = (spread, len(motion.u), math.sqrt(fitted.before), math.sqrt(spread))
    exact = np.zeros([sum(sensor.axes for sensor in robot.sensors)] * 2)
    deviation = np.sqrt(np.diag(C)) * tolerance
    found = Calibration(moved, robot, tuple(changes), estimate, deviation, tolerance, C, *quality, exact)
    return found, _told(found, len(motion.u), int((fitted.fit > fitted.gate).sum()))


def _in_motion(robot: Robot, u: Array) -> _Motion:
    owner = "repro calibrate --self"
    fits = robot.magnets and robot.sensors and robot.model is None
    require(fits, "robot", owner, "one with magnets and sensors, and without networks", "another")
    shared = len({magnet.shape for magnet in robot.magnets}) == 1
    drifts = [Drift("moment", 0.05, shared=shared), Drift("gain", 0.05), Drift("offset", 0.5)]
    drifts += [Drift("heading", 0.2), Drift("tilt", 0.1)] if robot.imus else []  # found, and forgotten
    stated: Any = (robot.total_noise, robot.lower, robot.upper)
    model = DriftModel(Drifting(robot.sensing(), drifts), stated[1], stated[2], owner)
    u, start = u[:: 1 + len(u) // _MOST_ROWS], model.states[0]
    # The model and the places of parts are no better than a share of the reading.
    size = np.sqrt(np.nanmean(np.square(u), axis=0)) * (np.arange(u.shape[1]) < model.n_hall)
    noise = np.hypot(stated[0], _MODEL_ERROR * size)
    lower, upper = (np.concatenate([x, c * start]) for x, c in zip(stated[1:], (-1e3, 1e3), strict=True))
    return _Motion(robot, model, LevenbergMarquardt(model, lower, upper, noise), u, noise, start)


def _fitted(motion: _Motion) -> _Fitted:
    robot, start = motion.robot, motion.start
    q = track(LevenbergMarquardt(robot, noise=motion.noise), motion.u, rate_hz=1.0, monitor=None).q
    theta, step, damping, best, before = 0 * start, 0 * start, 1e-3, math.inf, math.nan
    prior, gate, fit = np.diag(start**-2), math.inf, np.ones(len(q))
    H, g = prior, step
    for _ in range(_ROUNDS):
        rows = _at(motion, q, theta + step)
        fit, penalty = rows.fit, float(np.square((theta + step) / start).sum())
        typical = float(np.median(fit))
        before = typical if math.isnan(before) else before
        cost = rows.cost(gate) + penalty
        if cost < best:
            settled, theta, q, damping = best - cost < 1e-3, theta + step, rows.q, damping / 10
            gate = SPIKE**2 * max(1.0, typical)
            best = rows.cost(gate) + penalty
            H, g = _equations(rows, gate)
            H = H + prior
            if settled:
                break
        else:
            damping *= 10
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g - theta / start**2)
    return _Fitted(theta, H, fit, gate, before)


def _at(motion: _Motion, q: Array, errors: Array) -> _Rows:
    """Return the shapes at some errors, found from those before."""
    robot, errors = motion.robot, np.tile(errors, (len(q), 1))
    known = np.concatenate([np.full(q.shape, np.nan), errors], axis=1)
    state = motion.method.init(np.concatenate([q, errors], axis=1))
    found = motion.method.step(state, motion.u, known=known)[1]
    u_hat, J = motion.model.linearise(found.q)
    r = motion.model.difference(motion.u, u_hat) / motion.noise
    q = found.q[:, : robot.n_q]
    held = (q <= robot.lower) | (q >= robot.upper)
    fit = found.chi2 / np.maximum(np.isfinite(r).sum(1) - (~held).sum(1), 1)
    return _Rows(q, r, J / motion.noise[:, None], held, fit, found.chi2 / np.maximum(fit, 1e-300))


def _equations(rows: _Rows, gate: float) -> tuple[Array, Array]:
    """Return the normal equations of the errors, the shape of each row eliminated; rows beyond the gate are none."""
    n, r = rows.q.shape[1], np.nan_to_num(rows.residuals)
    J = np.where(np.isfinite(rows.residuals)[..., None], rows.slopes, 0.0)
    A, B = np.where(rows.held[:, None], 0.0, J[..., :n]), J[..., n:]
    by_shape = np.linalg.pinv(np.swapaxes(A, 1, 2) @ A, rcond=1e-9, hermitian=True)
    across = B - A @ (by_shape @ (np.swapaxes(A, 1, 2) @ B))
    across = across * (rows.fit <= gate)[:, None, None]
    return np.einsum("tsk,tsl->kl", across, across), np.einsum("tsk,ts->k", across, r)


def _judge(names: Sequence[str], far: Array, spread: float) -> None:
    """Refuse a robot that is farther off than five times what was assumed, or does not fit its readings."""
    if far.max() > 5.0 or spread > 16.0:
        expected = f"those of this robot in motion (usual causes if not: {_CAUSES})"
        worst = f"{names[int(far.argmax())]} {far.max():.3g} times as far off as assumed"
        seen = f"{worst}, and a chi-square per reading of {spread:.3g}"
        raise bad_input("readings", "repro calibrate --self", expected, seen)


def _told(found: Calibration, n: int, left_out: int) -> str:
    lines = [f"{n} rows of readings in motion; {left_out} do not fit (spikes, failures) and are left out."]
    parameters = zip(found.names, found.estimate, found.deviation, found.tolerances, strict=True)
    for name, value, now, before in parameters:
        scale, unit = (1.0, "mT") if "offset" in name else (100.0, "%")
        words = ", not determined" if now > 0.9 * before else ""
        words += "; DOUBT: beyond twice what was assumed" if abs(value) > 2 * before else ""
        change = f"{scale * value:+.2g} ± {scale * now:.2g} {unit}"
        lines.append(f"  {name}: {change} (before ± {scale * before:.2g}){words}")
    lines.append("The places of magnets and sensors are taken as described: only measured poses tell these.")
    return "\n".join(lines)


def _parameters(robot: Robot, errors: Sequence[str], alike: bool) -> dict[str, Array]:
    """Return by how much every parameter of a calibration changes with the errors that a drift model has."""
    rows, one = {}, dict(zip(errors, np.eye(len(errors)), strict=True))
    for m in ["of all"] if alike else range(1, 1 + len(robot.magnets)):
        names = [f"moment A{2 * k + 1}" for k in range(robot.sensing().moments.shape[1])]
        rows |= {name if alike else f"magnet {m} {name}": one[f"moment {m}"] for name in names}
    reading, offsets = 0, robot.per_reading("offset", 0.0, 0.0)
    for j, sensor in enumerate(robot.sensors, 1):
        for axis in [""] if sensor.axes == 1 else [" x", " y", " z"]:
            reading += 1
            gain = rows[f"sensor {j} gain{axis}"] = one[f"gain {reading}"]
            # The drifting gain is that of the whole reading, the calibrated one that of the field alone.
            rows[f"sensor {j} offset{axis}"] = one[f"offset {reading}"] + offsets[reading - 1] * gain
    return rows
