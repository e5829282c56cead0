r"""Calibration: a robot that is not as drawn, from readings in measured poses, with the tolerances as priors.

Parameters :math:`z` in units of their tolerances minimise

.. math:: \|z\|^2 + \sum_i r_i^T S_i^{-1} r_i, \qquad r_i = u_i - h(q_i, z), \qquad
          S_i = \sigma_u^2 I + J_i \Sigma_{q,i} J_i^T .

A pose is known only up to its measurement, so a residual is uncertain by the noise of the sensors and by the noise
of the pose, seen through :math:`J_i = \partial u/\partial q`. The posterior covariance of :math:`z` is the inverse of
the Hessian; directions in which it stays near one are what the poses do not determine.

Whether the fit is any good is asked of every pose in turn: with slopes :math:`K_i` in units of :math:`S_i` and the
posterior covariance :math:`C`, a fit without the pose misses its readings by :math:`(I - K_i C K_i^T)^{-1} r_i`,
with the covariance :math:`(I - K_i C K_i^T)^{-1}`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Generic, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from repro.common import Array, InputError, bad_input, is_table, numbers, require, whole
from repro.estimators.base import evenly, information_of_bounds
from repro.estimators.gauss_newton import Fit, Trial, gauss_newton
from repro.estimators.track import with_bar
from repro.parts import Assembly, Source
from repro.readings import Readings, configurations_of, read_readings
from repro.sensing import Sensing, sensing_of
from repro.tables import read_table
from repro.tolerances import Described, Tolerances, in_words, placed, priors_of, slopes_of

_MOST, _OUTLIER, _FARTHEST = 4.0, 5.0, 10.0
"""By how many of its standard deviations a pose may be off what the others predict, most of them, and any of them in
units of most. Good poses give 0.5 to 1.2, three times worse ones 3; exchanged axes, another unit, order or sign give
5 and more, or parts that are off by more than ten of their tolerances."""
_CAUSES = (
    "poses in another unit or order, at other times than the readings, or with exchanged axes; sensors in another "
    "order or of the wrong sign; a magnet of another size, polarity or place than described (state a tolerance for "
    "it); poses or readings noisier than stated"
)
_CHANCE = 3.0
"""By how many of its standard deviations the mean square of left-out poses may exceed what is expected, by chance."""
_ITERATIONS, _SLACK = 50, 1.01
"""Number of steps, of which six are enough as a rule; by what factor a step may raise the squared residuals, whose
variances change with the slopes."""
_WIDE, _FEW, _GRADE, _STEPS, _QUICK = 1.7, 20, 3.0, 10, 4
"""Of a rough drawing: within how many tolerances starts are tried, with how many poses; by what factor the
noise falls from one grade to the next, and how many steps each grade takes, in the end and in a trial."""
_LEAST_FIELD = 0.02
"""A smaller constant field is no cause [mT]: that of the Earth is 0.05."""


@dataclass(frozen=True, repr=False)
class Calibration(Generic[Described]):
    """A calibrated robot, and how well it is known.

    The robot as described and the plain numbers of ``names``, ``estimate``, ``tolerances``, ``covariance``, ``chi2``,
    ``poses``, ``before`` and ``after`` are all of it: ``robot`` is ``placed(described, dict(zip(names, estimate)))``.

    Parameters
    ----------
    robot
        With its parts where they were found, their gains, offsets and moments, and the field of the Earth.
    described
        The robot that was calibrated.
    names
        Names of the parameters.
    estimate
        Parameters [m, rad, mT, relative].
    deviation
        Their posterior standard deviations.
    tolerances
        Their standard deviations before the first pose.
    covariance
        Posterior covariance in units of the tolerances: the identity before the first pose.
    chi2
        Squared residual per reading in units of its variance: near one if noise and tolerances are as stated.
    poses
        Number of poses.
    before
        Residual of a pose as the robot is described: root mean square of its readings in standard deviations, the
        median of all poses.
    after
        The same as a fit to the other poses predicts it.
    model_error
        Covariance of what the readings of a pose are off the prediction by the other poses, beyond what noise and
        parameters explain ``[s, s]`` [mT²]: no parameter describes it. Zero if it is within chance.
    """

    robot: Described
    described: Described
    names: tuple[str, ...]
    estimate: Array
    deviation: Array
    tolerances: Array
    covariance: Array
    chi2: float
    poses: int
    before: float
    after: float
    model_error: Array

    def __repr__(self) -> str:
        """Return two lines."""
        larger = " (state tolerances or noise that are larger)" if self.chi2 > 1.5 else ""
        inexact = float(np.sqrt(np.diag(self.model_error).max(initial=0.0)))
        more = (
            f"\nthe model is inexact, by up to {inexact:.3g} mT a reading: the ± hold it" if inexact else ""
        )
        return (
            f"Calibration by {self.poses} poses: {len(self.names)} parameters; "
            f"chi-square per reading: {self.chi2:.3g}{larger}\n"
            f"a pose is predicted from the others to {self.after:.3g} standard deviations, "
            f"against {self.before:.3g} as described{more}"
        )

    def sensing(self) -> Sensing:
        """Return the sensor model of the calibrated robot."""
        return sensing_of(self.robot)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a calibration of a robot from a file, for ``repro.load_robot(robot_file, path)``.

        Raises
        ------
        InputError
            If the robot does not come from a file.
        """
        with whole(path, "save", new=False) as part:
            part.write_text(calibration_text(self), encoding="utf-8")

    def q_covariance(self, q: ArrayLike, noise: ArrayLike | None = None) -> Array:
        r"""Return the covariance ``[k, n_q, n_q]`` of least squares at ``q``, by noise, parameters and model error.

        With the slopes :math:`J` of the readings, their noise :math:`S` and the deviations :math:`D` that the bounds
        leave, an estimate has the covariance :math:`C = (J^T S^{-1} J + D^{-2})^{-1}` and follows errors of the
        readings by the gain :math:`G = C J^T S^{-1}`. If the predicted readings have the covariance :math:`E`, it is
        :math:`C + G E G^T`.

        Parameters
        ----------
        q
            Estimated configurations ``[k, n_q]``.
        noise
            Standard deviation of a reading [mT; rad for IMUs], one number or one for each; the robot's if not given.
        """
        of_noise, lasting = self._covariances(q, noise)
        return of_noise + lasting

    def lasting_covariance(self, q: ArrayLike) -> Array:
        """Return the part of :meth:`q_covariance` that no average over time removes: all but the noise."""
        return self._covariances(q, None)[1]

    def _covariances(self, q: ArrayLike, noise: ArrayLike | None) -> tuple[Array, Array]:
        """Return the covariance of an estimate by noise and bounds, and by parameters and errors of the model."""
        robot, sensing, fixed = self.robot, self.sensing(), self.robot.fixed
        q = robot.check_q(q, "Calibration")
        std = _noise_of(robot, noise, sensing.n_readings, "Calibration")
        H = np.where(fixed, 0.0, sensing.linearise(q)[1]) / std[:, None]
        A = H.mT @ H
        if robot.lower is None or robot.upper is None:
            C = np.linalg.pinv(A, hermitian=True)
        else:
            known = information_of_bounds(robot.lower, robot.upper, robot.free_angles.free)
            C = np.linalg.inv(A + np.diag(np.where(fixed, 1.0, known)))
            C = np.where(fixed | fixed[:, None], 0.0, C)
        parameters, n = dict(zip(self.names, self.estimate.tolist(), strict=True)), sensing.n_magnetic
        K = np.zeros((*H.shape[:-1], len(self.names)))
        K[..., :n, :] = slopes_of(self.described, sensing, parameters, q) * self.tolerances
        E = K @ self.covariance @ K.mT
        E[..., :n, :n] += self.model_error
        G = C @ H.mT / std
        return C, G @ E @ G.mT


def calibrate(
    robot: Described,
    q: object,
    u: object,
    noise: ArrayLike | None = None,
    q_covariance: ArrayLike | None = None,
    *,
    tolerances: Tolerances | None = None,
    earth: ArrayLike | None = None,
    rows: Sequence[str] | None = None,
    starts: int = 0,
    progress: str | None = None,
) -> Calibration[Described]:
    """Find the places of magnets and sensors, gains and moments, by Gauss-Newton with Gaussian priors.

    Parameters
    ----------
    robot
        As described, with magnets and sensors. Parts may state tolerances of their own. A chip with three axes is one
        part, whose axes have gains of their own. Magnets of one shape share what is found of their moments.
    q
        Measured configurations ``[poses, n_q]``, within the robot's bounds if it has any; or a table of them, with
        columns such as ``delta_x_1_mm``.
    u
        Readings ``[poses, s]`` [mT], or a table of them. Those of IMUs behind those of the sensors are not used.
    noise
        Standard deviation of a reading, one number or one for each [mT]; the robot's if not given.
    q_covariance
        Covariance of ``q`` ``[n_q, n_q]`` or ``[poses, n_q, n_q]``; exact poses if not given.
    tolerances
        Standard deviations of the priors, of what the parts do not state themselves. ``Tolerances(earth=5.0)`` finds
        a constant field of some mT, such as that of a motor nearby, too.
    earth
        Field of the Earth in the base frame [mT]; the robot's if not given.
    rows
        What messages call each pose, such as its file and line; those of a table if not given.
    starts
        For a rough drawing, whose tolerances are stated as large: if the fit next to the drawing cannot be, start
        there again with noise that falls in grades, then at the best of so many places spread over the tolerances.
    progress
        Label of a progress bar over the starts; none if not given.

    Raises
    ------
    InputError
        If readings, poses and robot do not fit or are not finite, if a pose is outside the bounds or there is only
        one, so that nothing could check the result, or if this is no better than the description: poses are predicted
        from the others no better than by the robot as described, or too badly, or a part is off by more than ten
        times its tolerance.

    Examples
    --------
    A magnet that is stronger by 2 % than it was drawn:

    >>> from repro import ConstantCurvature, Magnet, Ring, Robot, Sensor, simulated_readings
    >>> magnets = [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), segment=1, at=0.055)]
    >>> sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 3) for k in range(3)]
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], magnets, sensors)
    >>> q = 0.01 * np.random.default_rng(0).random((20, 3))
    >>> found = calibrate(robot, q, 1.02 * simulated_readings(robot, q), noise=1e-3)
    >>> (found.robot.moments[0, 0] * found.sensing().tables.gain / Sensing(robot).moments[0, 0]).round(2)
    array([1.02, 1.02, 1.02])
    """
    owner = "calibrate"
    require(robot.magnets and robot.sensors, "robot", owner, "one with magnets and sensors", "neither")
    expected = "one whose readings are multipoles of its magnets"
    require(robot.model is None, "robot", owner, expected, "networks")
    robot = robot if earth is None else robot.replaced(earth=earth)
    robot = robot.replaced(moments=sensing_of(robot).moments, source=robot.source)
    described = robot.replaced(imus=(), noise=None)
    q, u, rows = _measured(robot, described, q, u, rows, owner)
    std = _noise_of(robot, noise, described.n_readings, owner)
    require(
        isinstance(starts, int) and 0 <= starts <= 1000, "starts", owner, "a number from 0 to 1000", starts
    )
    given = np.zeros((robot.n_q, robot.n_q)) if q_covariance is None else q_covariance
    sigma = numbers(given, "q_covariance", owner, (..., robot.n_q, robot.n_q))
    fits = sigma.shape[:-2] in ((), (len(q),))
    require(fits, "q_covariance", owner, f"one, or one for each of {len(q)} poses", sigma.shape)
    _check_within(robot, outside(robot, q, sigma), q, rows)
    priors = priors_of(described, tolerances or Tolerances())
    names, scale = tuple(priors), np.array(list(priors.values()))

    poses = _Poses(described, names, scale, q, u, std, sigma)
    with np.errstate(all="ignore"):
        fit, covariance, (before, after, _, inexact) = poses.fitted(rows, starts, progress)
    found = placed(robot, poses.parameters(fit.z))
    deviation, chi2 = np.sqrt(np.diag(covariance)) * scale, float(np.mean(fit.last.details[0] ** 2))
    return Calibration(
        found, robot, names, fit.z * scale, deviation, scale, covariance, chi2, len(q), before, after, inexact
    )


def _measured(
    robot: Assembly, described: Assembly, q: object, u: object, rows: Sequence[str] | None, owner: str
) -> tuple[Array, Array, Sequence[str] | None]:
    """Return poses, magnetic readings and what messages call each pose; refuse what does not fit together."""
    at = None
    if is_table(q):
        table = read_table(q)
        q, at = configurations_of(robot, table), table.times
        rows = rows or [f"{table.owner}, line {line}" for line in table.lines]
        for row, c in np.argwhere(np.isnan(q)):
            raise bad_input("pose", f"{rows[row]},", f"a number for {robot.coordinates[c]}", "none")
    q = numbers(q, "q", owner, (None, robot.n_q))
    require(len(q) > 1, "q", owner, "two poses or more, each of which the others predict", len(q))
    u = read_readings(robot, u) if is_table(u) else u
    since = u.times if isinstance(u, Readings) else None
    if at is not None and since is not None and len(at) == len(since):
        apart = float(np.abs(at - since).max())
        received = f"times up to {apart:.3g} s off"
        require(apart < 0.05, "times", owner, "those of the poses, within 0.05 s", received)
    u = numbers(u, "u", owner, (len(q), robot.n_readings))[:, : described.n_readings]
    for row, k in np.argwhere(sensing_of(described).too_near(q))[:1]:
        name = robot.part_names[robot.parts[k]]
        expected = f"farther from every magnet, where its field is known (row {row + 1} of the poses)"
        raise bad_input(name, "the robot", expected, "within the sphere around a magnet")
    return q, u, rows


_Quality = tuple[float, float, Array, Array]
"""What poses are off as described, as the others predict them, each of them, and the error of the model."""
_Fitted = tuple[Fit, Array, _Quality]
"""A fit, its covariance, and what it is worth."""


class _Poses(NamedTuple):
    """Readings in measured poses, and how uncertain both are."""

    described: Assembly
    names: tuple[str, ...]
    scale: Array
    q: Array
    u: Array
    std: Array
    sigma: Array

    def parameters(self, z: Array) -> dict[str, float]:
        """Return parameters by name, of ``z`` in units of their tolerances."""
        return dict(zip(self.names, (z * self.scale).tolist(), strict=True))

    def fitted(self, rows: Sequence[str] | None, starts: int, progress: str | None) -> _Fitted:
        """Return the first fit that can be, or refuse the last one with the cause that is known."""
        last = _refused("none")
        for k, start in enumerate(self.starts(starts, progress)):
            try:
                return self.judged(start, rows, rough=k > 0)
            except _Refused as error:
                last = error
        raise _Refused(f"{str(last).removesuffix('.')}{self.missing_field(rough=starts > 0)}.") from last

    def judged(self, start: Array, rows: Sequence[str] | None, *, rough: bool) -> _Fitted:
        """Return the fit from a start, or refuse it."""
        try:
            fit = self.graded(start, _STEPS, 2 * _ITERATIONS) if rough else self.descended(start, _ITERATIONS)
            covariance = np.linalg.inv(fit.information)
            quality = _by_pose(self.trial(0 * start), fit.last, covariance, len(self.q))
        except _NO_FIT as error:
            raise _refused(f"a fit that ends in no robot ({error})") from error
        _judge(fit.z, [in_words(self.described, name) for name in self.names], quality, rows)
        return fit, covariance, quality

    def missing_field(self, *, rough: bool) -> str:
        """Return words about a constant field with which everything fits, if there is one."""
        names = tuple(f"Earth field along {x}" for x in "xyz")
        if names[0] in self.names:
            return ""
        size = float(np.abs((self.u - sensing_of(self.described)(self.q)).mean(0)).max())
        other = self._replace(names=(*self.names, *names), scale=np.append(self.scale, [size] * 3))
        try:
            fit = other.judged(np.zeros(len(other.scale)), None, rough=rough)[0]
        except _Refused:
            return ""
        found = size * float(np.linalg.norm(fit.z[-3:]))
        if found < _LEAST_FIELD:
            return ""
        return f"; with a constant field of {found:.2g} mT they fit: state Tolerances(earth={found:.2g})"

    def starts(self, n: int, progress: str | None) -> Iterator[Array]:
        """Yield the drawing, once more for the rough fit, then the best of starts spread over the tolerances."""
        drawn = np.zeros(len(self.scale))
        yield drawn
        if n == 0:
            return
        yield drawn
        few = slice(None, None, 1 + len(self.q) // _FEW)
        sigma = np.broadcast_to(self.sigma, (len(self.q), *self.sigma.shape[-2:]))
        some = self._replace(q=self.q[few], u=self.u[few], sigma=sigma[few])
        spread, tried = evenly(drawn - _WIDE, drawn + _WIDE, 1 + n), []
        for k in with_bar(n, progress):
            try:
                fit = some.graded(spread[1 + k], _QUICK, _STEPS)
            except _NO_FIT:
                continue
            tried.append((fit.last.cost + fit.z @ fit.z, fit.z))
        yield from (z for _, z in sorted(tried, key=lambda one: one[0])[:1])

    def descended(self, start: Array, steps: int) -> Fit:
        """Return the fit next to a start."""
        return gauss_newton(self.trial, np.ones(len(start)), iterations=steps, slack=_SLACK, start=start)

    def graded(self, start: Array, steps: int, last: int) -> Fit:
        """Return the fit from a start that is far off.

        At first the noise is as large as what the start leaves, then it falls in grades to what is stated: small
        noise makes a narrow valley that bends, in which every step is short.
        """
        left = max(1.0, math.sqrt(self.trial(start).cost / self.u.size))
        for grade in range(math.ceil(math.log(left, _GRADE)), 0, -1):
            start = self._replace(std=self.std * _GRADE**grade).descended(start, steps).z
        return self.descended(start, last)

    def trial(self, z: Array) -> Trial:
        """Return what a robot with these parameters leaves of the readings.

        The details are residuals ``[poses * s]`` of unit variance, slopes of the prediction by ``z``, and a root of
        the noise of every pose.
        """
        parameters = self.parameters(z)
        moved = sensing_of(placed(self.described, parameters))
        u_hat, J_q = moved.linearise(self.q)
        J = slopes_of(self.described, moved, parameters, self.q) * self.scale
        root = np.linalg.cholesky(np.diag(self.std**2) + J_q @ self.sigma @ J_q.mT)
        rows = np.concatenate([(self.u - u_hat)[..., None], J], axis=-1)
        rows = np.linalg.solve(root, rows).reshape(-1, 1 + len(z))
        require(np.isfinite(rows).all(), "numbers", "calibrate", "finite", "infinite ones")
        r, J = rows[:, 0], rows[:, 1:]
        cost = float(r @ r)
        return Trial(cost, lambda: (cost, J.T @ J, J.T @ r), (r, J, root))


def _judge(z: Array, names: Sequence[str], quality: _Quality, rows: Sequence[str] | None) -> None:
    """Refuse a fit that predicts poses no better than the drawing, or too badly, or from parts that are far off."""
    before, after, own, _ = quality
    worst, far, mostly = int(np.argmax(own)), int(np.argmax(np.abs(z))), float(np.median(own))
    # Fewer than ten poses hardly predict another one.
    no_better = after >= before and (mostly > 2.0 or (len(own) >= 10 and after > 1.5))
    if no_better or not mostly <= _MOST or own[worst] > _OUTLIER * max(mostly, 0.8):
        against = f"{after:.3g} standard deviations against {before:.3g} as described"
        where = f"worst in {rows[worst] if rows else f'row {worst + 1}'}, by {own[worst]:.3g}"
        raise _refused(f"a fit that predicts a pose from the others to {against}, {where}")
    if abs(z[far]) > _FARTHEST:
        raise _refused(f"{names[far]} off by {abs(z[far]):.3g} times its tolerance")


def outside(robot: Assembly, q: Array, q_covariance: ArrayLike = 0.0) -> Array:
    """Return which coordinates of measured poses ``[poses, n_q]`` are outside the robot's bounds.

    A measured pose may be outside by five of its standard deviations and a hundredth of the range. Angles with bounds
    a whole turn apart have none.
    """
    if robot.lower is None or robot.upper is None:
        return np.zeros(q.shape, dtype=bool)
    std = np.sqrt(np.diagonal(np.broadcast_to(q_covariance, (len(q), robot.n_q, robot.n_q)), 0, -2, -1))
    slack = 5 * std + 0.01 * (robot.upper - robot.lower) + 1e-9
    slack = np.where(robot.free_angles.free, np.inf, slack)
    return (q < robot.lower - slack) | (q > robot.upper + slack)


def _check_within(robot: Assembly, out: Array, q: Array, rows: Sequence[str] | None) -> None:
    """Refuse measured poses ``[poses, n_q]`` that are outside the bounds, by the name of the row and coordinate."""
    for row, c in np.argwhere(out):
        lower, upper = np.array([robot.lower, robot.upper])[:, c]
        expected = f"within the robot's bounds, for {robot.coordinates[c]} {lower:g} to {upper:g} (unit?)"
        where = rows[row] if rows else f"row {row + 1}"
        raise bad_input("q", "calibrate", expected, f"{q[row, c]:g} in {where}")


class _Refused(InputError):
    """A fit that cannot be."""


_NO_FIT = (np.linalg.LinAlgError, OverflowError, InputError)


def _refused(received: str) -> _Refused:
    expected = f"readings of this robot in these poses (usual causes if not: {_CAUSES})"
    return _Refused(str(bad_input("poses and readings", "calibrate", expected, received)))


def _noise_of(robot: Assembly, noise: ArrayLike | None, n: int, owner: str) -> Array:
    """Standard deviation of every reading ``[n]``, of the robot if not given."""
    expected = "positive, one number or one for each reading"
    if noise is None:
        require(robot.total_noise is not None, "noise", owner, expected, "none")
        noise = np.asarray(robot.total_noise)[:n]
    std = numbers(noise, "noise", owner)
    require(std.shape in ((), (n,)) and (std > 0).all(), "noise", owner, expected, noise)
    return np.broadcast_to(std, (n,))


def _by_pose(drawn: Trial, last: Trial, C: Array, poses: int) -> _Quality:
    """Return what poses are off: as described, as the others predict them, and each in the unit of this prediction.

    The first two are medians. Last comes the covariance of what the model cannot describe.
    """
    first, (r, J, root) = drawn.details[0], last.details
    r, K = r.reshape(poses, -1), J.reshape(poses, -1, len(C))
    apart = np.eye(r.shape[1]) - K @ C @ K.mT
    predicted = np.linalg.solve(apart, r[..., None])[..., 0]
    squares = first.reshape(r.shape) ** 2, predicted**2, r * predicted
    before, after, own = (np.sqrt(np.abs(x.mean(1))) for x in squares)
    expected = root @ np.linalg.inv(apart) @ root.mT
    inexact = _model_error((root @ predicted[..., None])[..., 0], expected, own)
    return float(np.median(before)), float(np.median(after)), own, inexact


def _model_error(off: Array, expected: Array, own: Array) -> Array:
    """Return the covariance of errors ``[poses, s]`` beyond that expected ``[poses, s, s]``, zero if within chance.

    The mean square of every pose in units of its expected covariance, ``own``, scatters by the root of two over
    the number of readings.
    """
    scatter = math.sqrt(2 / off.size)
    if np.square(own).mean() <= 1 + _CHANCE * scatter:
        return np.zeros(expected.shape[1:])
    values, vectors = np.linalg.eigh((off[:, :, None] * off[:, None, :] - expected).mean(0))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


_SCHEMA = 3
_KEPT = ("names", "estimate", "tolerances", "covariance", "chi2", "poses", "before", "after", "model_error")
"""What a calibration consists of beside the robot as described."""


def calibration_text(found: Calibration) -> str:
    """Return a calibration as the JSON that :func:`load_calibration` reads for the same robot file."""
    source = found.described.source
    expected = "of a robot that load_robot has read"
    require(isinstance(source, Source), "calibration", "save", expected, "one of another robot")
    content = {"schema": _SCHEMA, "robot": source.name, "robot_sha256": source.sha256}
    content |= {name: np.asarray(vars(found)[name]).tolist() for name in _KEPT}
    content["sha256"] = _own_hash(content)
    return json.dumps(content, indent=1) + "\n"


def _own_hash(content: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps({**content, "sha256": ""}, sort_keys=True).encode()).hexdigest()


def load_calibration(path: str | Path, robot: Described) -> Calibration[Described]:
    """Read what a calibration found for a robot file.

    Parameters
    ----------
    path
        What :meth:`Calibration.save` wrote.
    robot
        From the robot file that was calibrated.

    Raises
    ------
    InputError
        If the file is no calibration, was changed, belongs to another robot, or holds values that cannot be.
    """
    given = isinstance(path, str | PathLike)
    require(given, "calibration", "load_calibration", "a path", type(path).__name__)
    path, source = Path(path), robot.source
    owner = path.name
    require(path.is_file(), "calibration", "load_calibration", "a file that exists", path)
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        same = content["schema"] == _SCHEMA and content["sha256"] == _own_hash(content)
    except KeyError as error:
        raise bad_input("file", owner, "JSON that Calibration.save wrote", f"one without {error}") from error
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise bad_input("file", owner, "JSON that Calibration.save wrote", error) from error
    require(same, "sha256", owner, "the hash of a file as it was written, of schema 3", "another")
    same = source is not None and content["robot_sha256"] == source.sha256
    expected = f"made with {source.name if source else 'a robot file'} as it is now"
    require(same, "robot_sha256", owner, expected, f"one made with {content['robot']!r}")
    names, n = content["names"], len(content["names"])
    estimate, tolerances = (numbers(content[name], name, owner, (n,)) for name in ("estimate", "tolerances"))
    C = numbers(content["covariance"], "covariance", owner, (n, n))
    known = (np.abs(estimate) <= _FARTHEST * tolerances).all()
    require(known, "estimate", owner, f"within {_FARTHEST:g} of its tolerances", "more")
    good = (np.abs(C) <= 1.0 + 1e-6).all() and np.allclose(C, C.T) and np.linalg.eigvalsh(C).min() > -1e-9 * n
    require(good, "covariance", owner, "that of random numbers, in units of the tolerances", "another matrix")
    s = robot.n_magnetic
    M = numbers(content.get("model_error", np.zeros((s, s))), "model_error", owner, (s, s))  # new in 1.1
    least = -1e-9 * np.abs(M).max(initial=0.0)
    good = np.allclose(M, M.T) and np.linalg.eigvalsh(M).min(initial=0.0) >= least
    require(good, "model_error", owner, "a covariance of readings", "another matrix")
    rest = {name: content[name] for name in ("chi2", "poses", "before", "after")}
    moved = placed(robot, dict(zip(names, estimate.tolist(), strict=True)))
    deviation = np.sqrt(np.diag(C)) * tolerances
    return Calibration(moved, robot, tuple(names), estimate, deviation, tolerances, C, **rest, model_error=M)
