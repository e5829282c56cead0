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

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from repro.common import Array, InputError, bad_input, numbers, require
from repro.robot import Place, Robot, point_on
from repro.sensing import Sensing

_MOST_CHI2, _FARTHEST = 16.0, 10.0
"""Residuals four times as large as stated: good poses give 0.3 to 1.3, three times worse ones 9 at most; exchanged
axes, another unit, order or sign give 26 and more, or parts that are off by more than ten of their tolerances."""
_CHANCE, _DETERMINED, _OUTLIER = 1.6, 2.0, 6.0
"""By how much more than expected a fit to noise may miss the other poses by chance, where the description is right;
what it is expected to miss them by where they say enough to ask; and what no pose is off by chance."""
_CAUSES = (
    "poses in another unit or order, or with exchanged axes; sensors in another order or of the wrong sign; a magnet "
    "of another size, polarity or place than described (state a tolerance for it); poses or readings noisier than "
    "stated"
)
_DAMPING, _MOST_DAMPING = 1e-3, 1e6
"""Of Levenberg and Marquardt, where a whole step leads to a worse robot, or to none."""
_STEP = 1e-6
"""Of central differences, in every unit."""
_MAGNET = ("x", "y", "z", "tilt about x", "tilt about y")
_SENSOR = ("azimuth", "radius", "tilt")


@dataclass(frozen=True)
class Tolerances:
    """How far a robot may be from its drawing: standard deviations. What a part states of its own comes first.

    Parameters
    ----------
    magnet_position, magnet_tilt
        Centre of a magnet along each axis of its mount [m], and its tilt about each transverse axis [rad].
    sensor_azimuth, sensor_radius, sensor_tilt, sensor_gain
        Azimuth [rad], relative distance from the backbone, tilt about the tangential direction [rad], relative gain
        of every axis.
    moments
        Every multipole moment, relative; magnets of one shape share it.
    magnet_size, magnet_polarisation
        Every dimension of a magnet [m], and its own relative polarisation. Zero: as drawn.
    sensor_turn, sensor_along, sensor_offset
        Tilt of a sensor about the second transverse axis, and of a chip also about the third [rad]; place along the
        backbone [m]; reading without field [mT]. Zero: as drawn.
    earth
        Field of the Earth along each axis of the base [mT]. Zero: as stated.

    Raises
    ------
    InputError
        If one of the first seven is not positive, or another one is negative.

    Examples
    --------
    >>> Tolerances(magnet_position=1e-3).magnet_tilt == math.radians(2.0)
    True
    """

    magnet_position: float = 0.5e-3
    magnet_tilt: float = math.radians(2.0)
    sensor_azimuth: float = 0.01 * 2 * math.pi
    sensor_radius: float = 0.01
    sensor_tilt: float = math.radians(1.0)
    sensor_gain: float = 0.01
    moments: float = 0.02
    magnet_size: float = 0.0
    magnet_polarisation: float = 0.0
    sensor_turn: float = 0.0
    sensor_along: float = 0.0
    sensor_offset: float = 0.0
    earth: float = 0.0

    def __post_init__(self) -> None:
        values = list(asdict(self).values())
        good = all(0 < x < math.inf for x in values[:7]) and all(0 <= x < math.inf for x in values[7:])
        require(good, "tolerances", "Tolerances", "positive, or zero for what is as drawn", self)


@dataclass(frozen=True)
class Calibration:
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
    estimate, deviation
        Parameters [m, rad, mT, relative], and their posterior standard deviations.
    tolerances
        Their standard deviations before the first pose.
    covariance
        Posterior covariance in units of the tolerances: the identity before the first pose.
    chi2
        Squared residual per reading in units of its variance: near one if noise and tolerances are as stated.
    poses
        Number of poses.
    before, after
        Residual of a pose, root mean square of its readings in standard deviations, as the robot is described and as
        a fit to the other poses predicts it; the median of all poses.
    """

    robot: Robot
    described: Robot
    names: tuple[str, ...]
    estimate: Array
    deviation: Array
    tolerances: Array
    covariance: Array
    chi2: float
    poses: int
    before: float
    after: float

    @property
    def moments(self) -> Array:
        """Moments of every magnet ``[m, terms]`` [mT m^(l+2)]."""
        return self.robot.moments

    @property
    def gain(self) -> Array:
        """Gain of every magnetic reading."""
        return self.sensing().tables.gain

    @property
    def earth(self) -> Array:
        """Field of the Earth in the base frame [mT]."""
        return self.sensing().tables.earth

    def sensing(self) -> Sensing:
        """Return the sensor model of the calibrated robot."""
        return self.robot.sensing()

    def reading_covariance(self, q: Any) -> Array:
        """Return the covariance ``[..., s, s]`` [mT^2] of the magnetic readings predicted at ``q``."""
        q = self.robot.check_q(q, "Calibration")
        parameters = dict(zip(self.names, self.estimate.tolist(), strict=True))
        flat = q.reshape(-1, q.shape[-1])
        K = _slopes(self.described, self.sensing(), parameters, flat) * self.tolerances
        return (K @ self.covariance @ np.swapaxes(K, -1, -2)).reshape(*q.shape[:-1], *[K.shape[1]] * 2)

    def q_covariance(self, q: Any, noise: Any = None) -> Array:
        r"""Return the covariance ``[..., n_q, n_q]`` of least squares at ``q``, by noise and by the parameters.

        With the gain :math:`G = (J^T S^{-1} J)^{-1} J^T S^{-1}` and the covariance :math:`E` of the predicted
        readings it is :math:`G (S + E) G^T`. What the calibration left open lasts: it cannot be averaged away.

        Parameters
        ----------
        q
            Estimated configurations.
        noise
            Standard deviation of a reading [mT; rad for IMUs], one number or one for each; the robot's if not given.
        """
        sensing = self.sensing()
        std = _noise_of(self.robot, noise, sensing.n_readings, "Calibration")
        J = sensing.linearise(q)[1]
        E = np.zeros((*J.shape[:-1], J.shape[-2]))
        E[..., : sensing.n_magnetic, : sensing.n_magnetic] = self.reading_covariance(q)
        G = np.linalg.pinv(J / std[:, None]) / std
        return G @ (E + np.diag(std**2)) @ np.swapaxes(G, -1, -2)


def calibrate(
    robot: Robot,
    q: Any,
    u: Any,
    noise: Any = None,
    q_covariance: Any = None,
    *,
    tolerances: Tolerances | None = None,
    moments: Any = None,
    earth: Any = None,
    iterations: int = 8,
) -> Calibration:
    """Find the places of magnets and sensors, gains and moments, by Gauss-Newton with Gaussian priors.

    Parameters
    ----------
    robot
        As described, with magnets and sensors. Parts may state tolerances of their own. A chip with three axes is one
        part, whose axes have gains of their own. Magnets of one shape share what is found of their moments.
    q
        Measured configurations ``[poses, n_q]``, within the robot's bounds if it has any.
    u
        Readings of its magnetic sensors ``[poses, s]`` [mT]. Those of IMUs behind them are not used.
    noise
        Standard deviation of a reading, one number or one for each [mT]; the robot's if not given.
    q_covariance
        Covariance of ``q`` ``[n_q, n_q]`` or ``[poses, n_q, n_q]``; exact poses if not given.
    tolerances
        Standard deviations of the priors, of what the parts do not state themselves.
    moments
        As drawn ``[terms]`` or ``[m, terms]`` [mT m^(l+2)]; those of the robot or of the shapes if not given.
    earth
        Field of the Earth in the base frame [mT]; the robot's if not given.
    iterations
        Largest number of steps; six are enough as a rule.

    Raises
    ------
    InputError
        If readings, poses and robot do not fit or are not finite, if a pose is outside the bounds, or if the result
        is no better than the description: residuals are more than four times as large as stated, a part is off by
        more than ten times its tolerance, most poses are predicted from the others no better than by the robot as
        described, or a single one does not fit the others.

    Examples
    --------
    A magnet that is stronger by 2 % than it was drawn:

    >>> from repro import ConstantCurvature, Magnet, Ring, Robot, Sensor, simulated_readings
    >>> magnets = [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), segment=1, at=0.055)]
    >>> sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 3) for k in range(3)]
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], magnets, sensors)
    >>> q = 0.01 * np.random.default_rng(0).random((20, 3))
    >>> found = calibrate(robot, q, 1.02 * simulated_readings(robot, q), noise=1e-3)
    >>> (found.moments[0, 0] * found.gain / Sensing(robot).moments[0, 0]).round(2)
    array([1.02, 1.02, 1.02])
    """
    owner = "calibrate"
    require(robot.magnets and robot.sensors, "robot", owner, "one with magnets and sensors", "neither")
    require(
        robot.model is None, "robot", owner, "one whose readings are multipoles of its magnets", "networks"
    )
    if earth is not None:
        robot = robot.replaced(earth=earth)
    terms = (robot.sensing() if moments is None else Sensing(robot, moments=moments)).moments
    robot = robot.replaced(moments=terms)
    described = robot.replaced(imus=(), noise=None)
    drawn = described.sensing()
    q = numbers(q, "q", owner, (None, robot.n_q))
    require(len(q), "q", owner, "at least one pose", "none")
    width = drawn.n_readings if np.shape(u)[-1:] != (robot.n_readings,) else robot.n_readings
    u = numbers(u, "u", owner, (len(q), width))[:, : drawn.n_readings]
    std = _noise_of(robot, noise, drawn.n_readings, owner)
    zero = np.zeros((robot.n_q, robot.n_q))
    sigma = zero if q_covariance is None else numbers(q_covariance, "q_covariance", owner, (..., *zero.shape))
    require(iterations >= 1, "iterations", owner, "at least 1", iterations)
    check_poses(robot, q, sigma)
    priors = _priors(described, tolerances or Tolerances(), terms.shape[1])
    names, scale = tuple(priors), np.array(list(priors.values()))
    data = (q, u, std, sigma, scale)
    z = np.zeros(len(scale))
    with np.errstate(all="ignore"):
        wild = np.flatnonzero(~np.isfinite(drawn(q)).all(axis=1))
        for k in wild:
            raise bad_input("q", owner, "a shape that the robot can have", f"{q[k].tolist()} in row {k + 1}")
        try:
            r, J = first, _ = _whitened(described, names, z, *data)
            hessian = J.T @ J + np.eye(len(z))
            damping, taken = 0.0, 0
            while taken < iterations and damping < _MOST_DAMPING:
                stiff = hessian + damping * np.diag(np.diag(hessian))
                step = np.linalg.solve(stiff, J.T @ r - z)
                tried = _tried(described, names, z + step, r @ r + z @ z, data)
                if tried is None:
                    damping = max(10 * damping, _DAMPING)
                    continue
                (r, J), z, taken = tried, z + step, taken + 1
                hessian, damping = J.T @ J + np.eye(len(z)), damping / 10 if damping > _DAMPING else 0.0
                if np.abs(step).max() < 1e-6:
                    break
            covariance = np.linalg.inv(hessian)
            before, after, spread, own = _by_pose(first, r, J, covariance, len(q))
        except (np.linalg.LinAlgError, InputError) as error:
            raise _refused(f"a fit that ends in no robot ({error})") from error
        chi2 = float(np.mean(r**2))
    worst, mostly = int(np.argmax(own)), max(float(np.median(own)), 1.0)
    if not chi2 <= _MOST_CHI2:
        times = f"{math.sqrt(chi2):.3g} times as large as noise and poses allow"
        raise _refused(f"residuals {times}, the largest in row {worst + 1}")
    far = int(np.argmax(np.abs(z)))
    if abs(z[far]) > _FARTHEST:
        raise _refused(f"{names[far]} off by {abs(z[far]):.3g} times its tolerance")
    no_better = after > _CHANCE * spread * before or (after >= before and mostly > 2.0)
    if spread < _DETERMINED and no_better:
        against = f"{after:.3g} standard deviations against {before:.3g} as described"
        raise _refused(f"a fit that predicts a pose from the others to {against}, worst in row {worst + 1}")
    if own[worst] > _OUTLIER * mostly:
        raise _refused(f"row {worst + 1}, {own[worst]:.3g} standard deviations off what the others predict")
    found = placed(robot, dict(zip(names, (z * scale).tolist(), strict=True)))
    deviation = np.sqrt(np.diag(covariance)) * scale
    return Calibration(
        found, robot, names, z * scale, deviation, scale, covariance, chi2, len(q), before, after
    )  # fmt: skip


def check_poses(robot: Robot, q: Array, q_covariance: Any = 0.0) -> None:
    """Refuse measured poses ``[poses, n_q]`` outside the robot's bounds, by row from 1 and coordinate.

    A measured pose may be outside by five of its standard deviations and a hundredth of the range. Angles with bounds
    a whole turn apart have none.

    Raises
    ------
    InputError
        If a pose is farther outside.
    """
    if robot.lower is None or robot.upper is None:
        return
    width = robot.upper - robot.lower
    std = np.sqrt(np.diagonal(np.broadcast_to(q_covariance, (len(q), robot.n_q, robot.n_q)), 0, -2, -1))
    slack = np.where(robot.angles & (width >= 2 * math.pi - 1e-9), np.inf, 5 * std + 0.01 * width + 1e-9)
    for row, c in np.argwhere((q < robot.lower - slack) | (q > robot.upper + slack)):
        name = robot.coordinates[c]
        expected = f"within the robot's bounds, for {name} {robot.lower[c]:g} to {robot.upper[c]:g} (unit?)"
        raise bad_input("q", "calibrate", expected, f"{q[row, c]:g} in row {row + 1}")


def coverage_factor(error: Any, covariance: Any, level: float = 0.95) -> float:
    r"""Return by how much stated covariances must grow to hold the truth as often as they say: split conformal.

    With :math:`e_i` the error of an estimate and :math:`C_i` its stated covariance, the factor is the
    :math:`\lceil (k+1)\,p \rceil`-th smallest of :math:`k` values :math:`e_i^T C_i^{-1} e_i`, over the quantile of
    the chi-square distribution with :math:`n` degrees of freedom. The ellipsoid of the next estimate, its covariance
    times this factor, then holds the truth with a probability of at least :math:`p`, whatever the errors are
    distributed like, if the next one might as well have been one of these (Vovk, Gammerman, Shafer 2005).

    Parameters
    ----------
    error
        Estimates less the truth ``[k, n]``.
    covariance
        Stated covariances ``[n, n]`` or ``[k, n, n]``.
    level
        How often the ellipsoid is to hold, between 0 and 1.

    Returns
    -------
    float
        Infinite where there are too few errors to say: fewer than ``level / (1 - level)``.

    Raises
    ------
    InputError
        If the numbers do not fit, or a covariance is none.

    Examples
    --------
    Nine errors in one coordinate, of which all are twice as large as stated at the edge of the 90 % interval:

    >>> round(coverage_factor(np.full((9, 1), 2 * 1.6449), [[1.0]], 0.9), 3)
    4.0
    """
    from scipy.stats import chi2

    owner = "coverage_factor"
    require(0 < level < 1, "level", owner, "between 0 and 1", level)
    e = numbers(error, "error", owner, (None, None))
    C = numbers(covariance, "covariance", owner, (..., e.shape[1], e.shape[1]))
    require(
        C.ndim == 2 or C.shape[:-2] == (len(e),), "covariance", owner, "one, or one for each error", C.shape
    )
    require((np.linalg.eigvalsh(C) > 0).all(), "covariance", owner, "positive definite", "one that is not")
    scores = np.sort((e * np.linalg.solve(C, e[..., None])[..., 0]).sum(-1))
    rank = math.ceil((len(e) + 1) * level * (1 - 1e-12))
    return float(scores[rank - 1] / chi2(e.shape[1]).ppf(level)) if rank <= len(e) else math.inf


def placed(robot: Robot, parameters: Mapping[str, float]) -> Robot:
    r"""Return the robot whose parts are off their drawing by parameters, as :class:`Calibration` names them.

    Parts move within the cross-section that they are mounted on. Along the backbone a part follows its curve; at the
    end of a segment, and beyond it, it goes straight on. A dimension :math:`d` of a magnet that is off by :math:`x`
    is :math:`d\,e^{x/d}`, and its polarisation is multiplied by :math:`e^x`: neither changes its sign.

    Raises
    ------
    InputError
        If no robot is like that.
    """
    own, magnets, sensors = parameters.get, [], []
    shapes, rows = _strengths(robot, parameters)
    for k, part in enumerate(robot.magnets):
        name = f"magnet {k + 1} "
        p = np.array([own(name + x, 0.0) for x in _MAGNET])
        R = part.place.rotation
        tilted = R @ _about(0, p[3]) @ _about(1, p[4])
        at, beyond = _along(robot, part.place, own(name + "along", 0.0))
        position = part.place.position + R @ p[:3] + [0.0, 0.0, beyond]
        magnets.append(replace(part, shape=shapes[k], at=at, position=position, direction=tilted[:, 2]))
    for j, part in enumerate(robot.sensors):
        name = f"sensor {j + 1} "
        p = [own(name + x, 0.0) for x in _SENSOR]
        shift = [own(name + x, 0.0) for x in "xyz"]
        at, beyond = _along(robot, part.place, own(name + "along", 0.0))
        position = _about(2, p[0]) @ (part.place.position * [1 + p[1], 1 + p[1], 1.0] + shift)
        R = _about(2, p[0]) @ part.place.rotation @ _about(1, -p[2])
        R = R @ _about(0, own(name + "tilt about x", 0.0)) @ _about(2, own(name + "tilt about z", 0.0))
        turned: dict[str, Any] = {"direction": R[:, 2]}
        if part.axes == 3:
            from scipy.spatial.transform import Rotation

            turned = {"orientation": Rotation.from_matrix(R).as_quat()}
        factors = [1 + own(name + x, 0.0) for x in _per_axis("gain", part.axes)]
        offsets = [own(name + x, 0.0) for x in _per_axis("offset", part.axes)]
        gain, offset = np.multiply(part.gain, factors).tolist(), np.add(part.offset, offsets).tolist()
        moved = {"at": at, "position": position + np.array([0.0, 0.0, beyond]), **turned}
        moved |= {"radial": 0.0, "azimuth": 0.0, "tilt": 0.0, "gain": tuple(gain), "offset": tuple(offset)}
        sensors.append(replace(part, **moved))
    relative = np.array([[own(x, 0.0) for x in names] for names in _moment_names(robot, rows.shape[1])])
    earth = np.array([own(f"Earth field along {x}", 0.0) for x in "xyz"])
    earth = None if robot.earth is None and not earth.any() else _earth(robot) + earth
    return robot.replaced(magnets=magnets, sensors=sensors, moments=rows * (1 + relative), earth=earth)


def _refused(received: str) -> InputError:
    expected = f"readings of this robot in these poses (usual causes if not: {_CAUSES})"
    return bad_input("poses and readings", "calibrate", expected, received)


def _noise_of(robot: Robot, noise: Any, n: int, owner: str) -> Array:
    """Standard deviation of every reading ``[n]``, of the robot if not given."""
    expected = "positive, one number or one for each reading"
    require(noise is not None or robot.noise is not None, "noise", owner, expected, "none")
    std = numbers(noise if robot.noise is None or noise is not None else robot.noise[:n], "noise", owner)
    require(std.shape in ((), (n,)) and (std > 0).all(), "noise", owner, expected, noise)
    return np.broadcast_to(std, (n,))


def _earth(robot: Robot) -> Array:
    return np.zeros(3) if robot.earth is None else robot.earth


def _sizes(shape: Any) -> list[str]:
    """Dimensions of a magnet that are there."""
    return [f.name for f in fields(shape) if f.name != "polarisation_mt" and getattr(shape, f.name) > 0]


def _per_axis(name: str, axes: int) -> list[str]:
    return [name] if axes == 1 else [f"{name} {axis}" for axis in "xyz"]


def _moment_names(robot: Robot, terms: int) -> list[list[str]]:
    """Names of the relative moments of every magnet: magnets of one shape share theirs."""
    alike = len({magnet.shape for magnet in robot.magnets}) == 1
    owners = ["" if alike else f"magnet {k + 1} " for k in range(len(robot.magnets))]
    return [[f"{owner}moment A{2 * k + 1}" for k in range(terms)] for owner in owners]


def _strengths(robot: Robot, parameters: Mapping[str, float]) -> tuple[list[Any], Array]:
    """Shapes of the magnets, and their moments without the relative changes of moments."""
    rows = np.array(robot.sensing().moments if robot.moments is None else robot.moments)
    shapes, orders = [], 2 * rows.shape[1] - 1
    for k, magnet in enumerate(robot.magnets):
        name, shape = f"magnet {k + 1} ", magnet.shape
        old = {x: getattr(shape, x) for x in _sizes(shape)}
        sizes = {x: size * math.exp(parameters.get(name + x, 0.0) / size) for x, size in old.items()}
        stronger, resized = math.exp(parameters.get(name + "polarisation", 0.0)), replace(shape, **sizes)
        if resized != shape:
            rows[k] += resized.multipoles(orders) - shape.multipoles(orders)
        rows[k] *= stronger
        shapes.append(replace(resized, polarisation_mt=resized.polarisation_mt * stronger))
    return shapes, rows


def _priors(robot: Robot, t: Tolerances, terms: int) -> dict[str, float]:
    """Standard deviations by name: what every calibration has, in the order of files, then what is stated."""
    always: dict[str, Any] = {}
    stated: dict[str, Any] = {}
    for k, part in enumerate(robot.magnets):
        own, name, R = part.tolerance or {}, f"magnet {k + 1} ", part.place.rotation
        position, tilt = own.get("position", t.magnet_position), own.get("tilt", t.magnet_tilt)
        # A stated place along the backbone takes that of the position along it.
        aside = np.sqrt(1 - R[2] ** 2) if "at" in own and "position" not in own else np.ones(3)
        always |= dict(zip([name + x for x in _MAGNET], [*(position * aside), tilt, tilt], strict=True))
        stated[name + "along"] = own.get("at", 0.0)
        stated |= dict.fromkeys([name + x for x in _sizes(part.shape)], own.get("size", t.magnet_size))
        stated[name + "polarisation"] = own.get("polarisation", t.magnet_polarisation)
    for j, part in enumerate(robot.sensors):
        own, name = part.tolerance or {}, f"sensor {j + 1} "
        position, radial = own.get("position", 0.0), math.hypot(*part.place.position[:2])
        around = 0.0 if position else t.sensor_azimuth
        outwards = 0.0 if position else t.sensor_radius
        if "radius" in own:
            outwards = own["radius"] / radial if radial else 0.0
        tilt, turn = own.get("tilt", t.sensor_tilt), own.get("tilt", t.sensor_turn)
        gains = [name + x for x in _per_axis("gain", part.axes)]
        gain = own.get("gain", t.sensor_gain)
        usual = own.get("azimuth", around), outwards, tilt, gain
        always |= dict(zip([*(name + x for x in _SENSOR), gains[0]], usual, strict=True))
        stated |= dict.fromkeys(gains[1:], gain) | {name + "tilt about x": turn}
        stated[name + "tilt about z"] = turn if part.axes == 3 else 0.0
        stated[name + "along"] = own.get("at", t.sensor_along)
        stated |= dict.fromkeys([name + x for x in "xyz"], position)
        offsets = [name + x for x in _per_axis("offset", part.axes)]
        stated |= dict.fromkeys(offsets, own.get("offset", t.sensor_offset))
    for names in _moment_names(robot, terms):
        always |= dict.fromkeys(names, t.moments)
    stated |= dict.fromkeys([f"Earth field along {x}" for x in "xyz"], t.earth)
    return always | {name: std for name, std in stated.items() if std}


def _about(axis: int, angle: float) -> Array:
    c, s, R = math.cos(angle), math.sin(angle), np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def _along(robot: Robot, where: Place, far: float) -> tuple[float, float]:
    """Place along its segment after a move, and how far beyond the end of the segment that is."""
    reach, at = robot.segments[where.segment - 1].length if where.segment else 0.0, where.at
    if 0 < at < reach:
        at = min(max(at + far, 0.0), reach)
    return at, where.at + far - at


def _by_pose(first: Array, r: Array, J: Array, C: Array, poses: int) -> tuple[float, float, float, Array]:
    """Median residual of a pose as described, predicted from the others, as the fit expects it; and in its unit."""
    r, K = r.reshape(poses, -1), J.reshape(poses, -1, len(C))
    apart = np.eye(r.shape[1]) - K @ C @ np.swapaxes(K, -1, -2)
    predicted = np.linalg.solve(apart, r[..., None])[..., 0]
    expected = np.diagonal(np.linalg.inv(apart), 0, -2, -1)
    squares = first.reshape(r.shape) ** 2, predicted**2, expected, r * predicted
    *rms, own = (np.sqrt(np.abs(x.mean(1))) for x in squares)
    before, after, spread = (float(np.median(x)) for x in rms)
    return before, after, spread, own


def _tried(
    described: Robot, names: Iterable[str], z: Array, cost: Any, data: tuple[Any, ...]
) -> tuple[Array, Array] | None:
    """Residuals and slopes, or nothing where no robot is like that or it fits worse than before."""
    try:
        r, J = _whitened(described, names, z, *data)
    except (np.linalg.LinAlgError, InputError):
        return None
    return (r, J) if r @ r + z @ z <= 1.01 * cost + 1e-6 else None


def _whitened(
    described: Robot,
    names: Iterable[str],
    z: Array,
    q: Array,
    u: Array,
    std: Array,
    q_covariance: Array,
    scale: Array,
) -> tuple[Array, Array]:
    """Residuals ``[poses * s]`` of unit variance, and the slopes of the prediction by ``z``."""
    parameters = dict(zip(names, (z * scale).tolist(), strict=True))
    moved = placed(described, parameters).sensing()
    u_hat, J_q = moved.linearise(q)
    J = _slopes(described, moved, parameters, q) * scale
    noise = np.diag(std**2) + J_q @ q_covariance @ np.swapaxes(J_q, -1, -2)
    rows = np.concatenate([(u - u_hat)[..., None], J], axis=-1)
    rows = np.linalg.solve(np.linalg.cholesky(noise), rows)
    rows = rows.reshape(-1, rows.shape[-1])
    if not np.isfinite(rows).all():
        raise bad_input("numbers", "calibrate", "finite", "infinite ones")
    return rows[:, 0], rows[:, 1:]


def _slopes(described: Robot, moved: Sensing, parameters: Mapping[str, float], q: Array) -> Array:
    """Slopes of readings by the parameters ``[poses, s, k]``.

    The wrench of a pair times how the part moves, for what every calibration has; central differences for the rest.
    """
    robot, gain = moved.robot, moved.tables.gain
    u, wrench = moved.wrenches(q)
    on_backbone = [point_on(part.place.segment, part.place.at) for part in (*robot.magnets, *robot.sensors)]
    frames, n_m, terms = robot.poses(q, on_backbone), len(robot.magnets), moved.moments.shape[1]
    columns: dict[str, Array] = {}
    for k, part in enumerate(described.magnets):
        name, F = f"magnet {k + 1} ", frames[:, k, :3, :3]
        R = F @ part.place.rotation
        centre = frames[:, k, :3, 3] + F @ robot.magnets[k].place.position
        turns = np.stack([np.eye(3)[:, 0], _about(0, parameters[name + "tilt about x"])[:, 1]], axis=1)
        force = wrench[:, :, k, :3]
        torque = wrench[:, :, k, 3:] - np.cross(centre[:, None], force)
        by = np.concatenate([-force @ R, -torque @ (R @ turns)], axis=-1)
        columns |= {name + x: by[..., c] * gain for c, x in enumerate(_MAGNET)}
    row = 0
    for j, part in enumerate(described.sensors):
        name, place, F = f"sensor {j + 1} ", robot.sensors[j].place, frames[:, n_m + j, :3, :3]
        turned = _about(2, parameters[name + "azimuth"])
        at = frames[:, n_m + j, :3, 3] + F @ place.position
        rows = slice(row, row + part.axes)
        total = wrench[:, rows].sum(2)
        force, torque = total[..., :3], total[..., 3:] - np.cross(at[:, None], total[..., :3])
        around = np.cross([0.0, 0.0, 1.0], place.position)
        outwards = turned @ (part.place.position * [1.0, 1.0, 0.0])
        across = -(turned @ part.place.rotation)[:, 1]
        tilted = turned @ part.place.rotation @ _about(1, -parameters[name + "tilt"])
        slopes = {
            "azimuth": _work(force, F @ around) + _work(torque, F[..., 2]),
            "radius": _work(force, F @ outwards),
            "tilt": _work(torque, F @ across),
        }
        slopes |= {x: _work(force, F @ turned[:, c]) for c, x in enumerate("xyz")}
        slopes["tilt about x"] = _work(torque, F @ tilted[:, 0])
        slopes["tilt about z"] = _work(torque, F @ place.rotation[:, 2])
        axes = [_per_axis(x, part.axes) for x in ("gain", "offset")]
        for axis, x, offset in zip(np.eye(part.axes), *axes, strict=True):
            slopes[x] = u[:, rows] * axis / (1 + parameters[name + x])
            slopes[offset] = axis / gain[rows]
        for x in slopes:
            if name + x in parameters:
                columns[name + x] = np.zeros(u.shape)
                columns[name + x][:, rows] = slopes[x] * gain[rows]
        row += part.axes
    before = _strengths(described, parameters)[1]
    names = np.array(_moment_names(described, terms))
    for k in range(terms):
        for name in dict.fromkeys(names[:, k].tolist()):
            one = np.zeros_like(before)
            one[:, k] = np.where(names[:, k] == name, before[:, k], 0.0)
            columns[name] = Sensing(robot, moments=one)(q)[:, : len(gain)] * gain
    for name in parameters.keys() - columns.keys():
        up, down = (
            placed(described, {**parameters, name: parameters[name] + h}).sensing()(q)[:, : len(gain)]
            for h in (_STEP, -_STEP)
        )
        columns[name] = (up - down) / (2 * _STEP)
    return np.stack([columns[name] for name in parameters], axis=-1)


def _work(force: Array, motion: Array) -> Array:
    return np.einsum("psi,pi->ps", force, motion)
