"""Calibrations at the board: from measured poses in motion, and from motion alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from repro.common import Array, bad_input, require
from repro.estimators.calibration import Calibration, calibrate
from repro.estimators.drift import Drift, Drifting, DriftModel
from repro.estimators.gauss_newton import Trial, eliminated, gauss_newton
from repro.estimators.least_squares import LevenbergMarquardt
from repro.estimators.track import track
from repro.parts import Imu
from repro.robot import Robot
from repro.tolerances import Tolerances, in_words, placed
from repro_board.cleaning import SPIKE, alike, orientations, unwrapped

TOLERANCES = Tolerances(sensor_gain=0.05, sensor_offset=0.5, earth=0.05)
"""How far a robot may be from its file, where the file states nothing."""
_MOST_POSES = 150
_MODEL_ERROR, _MOST_ROWS, _ROUNDS, _SETTLED, _DAMPING = 0.003, 4000, 40, 1e-3, 1e-5
"""Without poses: share of a reading that its model is off; rows that are used, most rounds, the share of what was
assumed below which a step is the last, and the least damping."""
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
    found, words, n = None, [], robot.n_magnetic
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


def by_motion(robot: Robot, u: Array) -> tuple[Calibration, str]:
    r"""Find moments, gains and offsets while the robot moves: least squares over all rows, the shapes eliminated.

    Every row has a shape of its own, so only what no shape explains tells anything of the errors. A Kalman filter
    with the same errors in its state takes the smoothness of the motion for knowledge and states far too little.
    """
    motion = _Motion(robot, u)
    start = motion.start
    fitted = gauss_newton(motion.trial, start**-2, iterations=_ROUNDS, tolerance=_SETTLED, damping=_DAMPING)
    spread, before = max(1.0, _typical(fitted.last)), _typical(fitted.first)
    changes, prior = _parameters(robot, motion.model.names), np.diag(start**-2)
    rows = np.array(list(changes.values()))
    estimate, tolerance = rows @ fitted.z, np.sqrt(np.square(rows) @ start**2)
    C = rows @ np.linalg.inv((fitted.information - prior) / spread + prior) @ rows.T
    C = C / np.outer(tolerance, tolerance)
    _judge([in_words(robot, name) for name in changes], np.abs(estimate) / tolerance, spread)
    moved = placed(robot, dict(zip(changes, estimate.tolist(), strict=True)))
    quality = (spread, len(motion.u), math.sqrt(before), math.sqrt(spread))
    exact = np.zeros([robot.n_magnetic] * 2)
    deviation = np.sqrt(np.diag(C)) * tolerance
    found = Calibration(moved, robot, tuple(changes), estimate, deviation, tolerance, C, *quality, exact)
    return found, _told(found, len(motion.u), int((fitted.last.details > motion.gate).sum()))


class _Motion:
    """Readings ``[t, s]`` of a robot in motion, and a model with its errors behind its coordinates."""

    def __init__(self, robot: Robot, u: Array) -> None:
        owner = "repro calibrate --self"
        fits = robot.magnets and robot.sensors and robot.model is None
        require(fits, "robot", owner, "one with magnets and sensors, and without networks", "another")
        drifts = [Drift("moment", 0.05, shared=_alike(robot)), Drift("gain", 0.05), Drift("offset", 0.5)]
        drifts += [Drift("heading", 0.2), Drift("tilt", 0.1)] if robot.imus else []  # found, and forgotten
        self.lower, self.upper, stated = (
            np.asarray(x) for x in (robot.lower, robot.upper, robot.total_noise)
        )
        self.model = DriftModel(Drifting(robot.sensing(), drifts), self.lower, self.upper, owner)
        self.u, self.start = u[:: 1 + len(u) // _MOST_ROWS], self.model.states[0]
        # The model and the places of parts are no better than a share of the reading.
        size = np.sqrt(np.nanmean(np.square(self.u), axis=0)) * (np.arange(u.shape[1]) < self.model.n_hall)
        self.noise = np.hypot(stated, _MODEL_ERROR * size)
        far = 1e3 * self.start
        low, high = np.concatenate([self.lower, -far]), np.concatenate([self.upper, far])
        self.method = LevenbergMarquardt(self.model, low, high, self.noise)
        self.q = track(LevenbergMarquardt(robot, noise=self.noise), self.u, rate_hz=1.0, monitor=None).q
        self.gate = math.inf
        """The shapes of the errors that were taken last; rows that fit worse than the gate are spikes or failures."""

    def trial(self, errors: Array) -> Trial:
        """Try errors, with the shapes that fit best then; the details are chi-square per degree of freedom by row."""
        n, all_errors = self.q.shape[1], np.tile(errors, (len(self.q), 1))
        known = np.concatenate([np.full(self.q.shape, np.nan), all_errors], axis=1)
        state = self.method.init(np.concatenate([self.q, all_errors], axis=1))
        found = self.method.step(state, self.u, known=known)[1]
        u_hat, J = self.model.linearise(found.q)
        r = self.model.difference(self.u, u_hat) / self.noise
        q = found.q[:, :n]
        held = (q <= self.lower) | (q >= self.upper)
        dof = np.maximum(np.isfinite(r).sum(1) - (~held).sum(1), 1)
        fit = found.chi2 / dof

        def cost() -> float:
            return float((dof * np.minimum(fit, self.gate)).sum())

        def equations() -> tuple[float, Array, Array]:
            self.q, self.gate = q, SPIKE**2 * max(1.0, float(np.median(fit)))
            use = np.isfinite(r) & (fit <= self.gate)[:, None]
            K = np.where(use[..., None], J / self.noise[:, None], 0.0)
            by_shape = np.where(held[:, None], 0.0, K[..., :n])
            return cost(), *eliminated(K[..., n:], by_shape, np.where(use, r, 0.0), 1e-9)

        return Trial(cost(), equations, fit)


def _typical(trial: Trial) -> float:
    return float(np.median(trial.details))


def _alike(robot: Robot) -> bool:
    """Return whether all magnets are of one shape: then they have one error of their moments."""
    return len({magnet.shape for magnet in robot.magnets}) == 1


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
        lines.append(f"  {in_words(found.robot, name)}: {change} (before ± {scale * before:.2g}){words}")
    lines.append("The places of magnets and sensors are taken as described: only measured poses tell these.")
    return "\n".join(lines)


def _parameters(robot: Robot, errors: Sequence[str]) -> dict[str, Array]:
    """Return by how much every parameter of a calibration changes with the errors that a drift model has."""
    rows, one, alike = {}, dict(zip(errors, np.eye(len(errors)), strict=True)), _alike(robot)
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
