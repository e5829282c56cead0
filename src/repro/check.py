r"""Can a design work? What the readings of a robot can tell about its shape, before any reading is taken.

At random shapes within the bounds the information matrix is :math:`J^T S^{-1} J`, with the slopes :math:`J` of the
readings and the variances :math:`S` of their noise; a reading beyond its range, or so close to a magnet that its
field is not known, counts nothing. With the slopes
:math:`G` of the tip, :math:`G (J^T S^{-1} J)^{-1} G^T` is the Cramér-Rao bound of its position: no unbiased estimate
from one set of readings has a smaller covariance. Least squares reach it where it is small against the bends. The
steps of the readings count as noise. What the parts are off their drawing by goes through the gain of least squares.

If only its range :math:`w` is known, a coordinate has the standard deviation :math:`w/\sqrt{12}`. In these units the
information is :math:`A`, and readings leave the share :math:`(A + I)^{-1}` of the variance. Directions of which they
leave most are hardly determined. A sensor adds :math:`\log\det(A + I)/2` with it less the same without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from repro.chain import ConstantCurvature
from repro.common import Array, require
from repro.parts import Assembly
from repro.sensing import Sensing, sensing_of
from repro.tolerances import Tolerances, priors_of, slopes_of

_HOPELESS = 0.3
"""Standard deviation of the tip, as a share of what the bounds alone leave, from which little is known."""
_OPEN = "not determined"
_MOST_SAMPLES = 1_000_000
_UNDETERMINED, _IDLE, _ALONE = 0.5, 0.01, 0.9
"""Share of a deviation that readings leave; information that a sensor adds [nat]; share of a coordinate in directions
that are hardly determined, from which it is so by itself and not in combination with others."""


@dataclass(frozen=True, repr=False)
class DesignCheck:
    """What :meth:`repro.Robot.check` finds; ``print`` shows it.

    Parameters
    ----------
    q
        Random shapes within the bounds ``[n, n_q]``.
    tip
        Standard deviation of the tip, the root of its three variances' sum, in each of them ``[n]`` [m]: the
        Cramér-Rao bound by noise and steps of the readings alone, infinite where these do not determine the tip.
    tip_within_bounds
        The same with what the bounds say.
    tip_as_built
        The same with the bounds and the tolerances of all parts, before a calibration.
    spread
        Standard deviation of the tip over these shapes [m]: how well it is known without a reading.
    added
        Mean information that each sensor or IMU adds to the others [nat], by name.
    saturated
        Share of shapes where a reading goes beyond its range, and its largest value [mT], by name.
    undetermined
        Coordinates, or combinations of them, that readings hardly determine, in words.
    notes
        What else deserves a look.
    can_work
        Whether the readings leave less than 30 % of what is open about the tip within the bounds, in most shapes.
    verdict
        The answer as a sentence.
    """

    q: Array
    tip: Array
    tip_within_bounds: Array
    tip_as_built: Array
    spread: float
    added: dict[str, float]
    saturated: dict[str, tuple[float, float]]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    can_work: bool
    verdict: str

    @property
    def grades(self) -> tuple[bool, bool, bool]:
        """Whether it can work: in most shapes, in all but a twentieth of them, and before a calibration."""
        return _grades(self.tip_within_bounds, self.tip_as_built, self.spread)

    @property
    def idle(self) -> tuple[str, ...]:
        """Sensors and IMUs that contribute nothing."""
        return tuple(name for name, nats in self.added.items() if nats < _IDLE)

    def __repr__(self) -> str:
        """Return a few lines, the verdict last."""
        built = _in_words(self.tip_as_built)
        if np.median(self.tip_as_built) > self.spread:
            built = f"no better than without readings, {length_in_words(self.spread)}"
        lines = [
            f"Tip in {len(self.q)} random shapes, ± one standard deviation: the median, and the worst twentieth",
            f"tip by the readings alone: {_in_words(self.tip)}",
            f"tip by readings and bounds, before a calibration: {built}",
        ]
        if self.undetermined:
            lines.append(f"hardly determined: {'; '.join(self.undetermined)}")
        if self.idle:
            lines.append(f"contributes nothing: {', '.join(self.idle)}")
        lines += [
            f"{name} saturates in {100 * share:.3g} % of the workspace (up to {most:.3g} mT)"
            for name, (share, most) in self.saturated.items()
        ]
        return "\n".join([*lines, *self.notes, self.verdict])


def length_in_words(std: float) -> str:
    """Return a deviation [m] as ± mm."""
    return _OPEN if std >= 1.0 else f"±{1e3 * std:.2g} mm" if std < 0.0995 else f"±{1e3 * std:.0f} mm"


def _middle_and_worst(std: Array) -> tuple[float, float]:
    """Return the median, and what a twentieth of the workspace exceeds."""
    middle, worst = np.quantile(std, [0.5, 0.95], method="nearest")
    return float(middle), float(worst)


def _in_words(std: Array) -> str:
    middle, worst = _middle_and_worst(std)
    return f"{length_in_words(middle)}, {length_in_words(worst)}"


def check_design(robot: Assembly, *, samples: int = 400, seed: int = 0) -> DesignCheck:
    """Ask whether a robot can work: see :meth:`repro.Robot.check`.

    Parameters
    ----------
    robot
        With bounds, noise, and sensors or IMUs. Magnets and sensors without tolerances have those of
        :class:`.Tolerances`; IMUs without are as drawn.
    samples
        Number of random shapes.
    seed
        Of their generator.

    Raises
    ------
    InputError
        If the robot states no bounds or no noise, or has no sensors.

    Examples
    --------
    A magnet that is far from its sensors:

    >>> from repro import ConstantCurvature, Disc, Magnet, Robot, Sensor
    >>> magnet = Magnet(Disc(2e-3, 1e-3, 1300.0), segment=1, at=0.11)
    >>> robot = Robot(
    ...     [ConstantCurvature(0.11, 0.022)], [magnet], [Sensor(0, 0.0, axes=3)],
    ...     lower=[-0.02, -0.02, 0.0], upper=[0.02, 0.02, 0.006], noise=0.02,
    ... )
    >>> check_design(robot).can_work
    False
    """
    seen = _seen(robot, samples, seed)
    tip, within, built, hardly = _deviations(seen, _off_drawing(robot, seen.sensing, seen.q))
    spread = float(np.sqrt(np.square(seen.p - seen.p.mean(0)).sum(-1).mean()))
    expected = "one whose tip moves (add a link beyond a joint)"
    require(spread > 1e-9, "robot", "check", expected, "one whose tip stays")

    names = np.array(robot.coordinates)[seen.free].tolist()
    can_work, verdict = _verdict(tip, within, built, spread)
    return DesignCheck(
        seen.q, tip, within, built, spread, _added(robot, seen.H), _saturated(robot, seen.u, seen.beyond),
        _combinations(names, hardly), _notes(robot, seen.inside, names), can_work, verdict,
    )  # fmt: skip


def median_tip(robot: Assembly, *, as_built: bool = False, samples: int = 100, seed: int = 0) -> float:
    """Return the median deviation of the tip by readings and bounds [m]: this part of a check alone.

    Parameters
    ----------
    robot
        As :func:`check_design` takes it.
    as_built
        With the tolerances of all parts, before a calibration; else after one.
    samples, seed
        As for a check.

    Raises
    ------
    InputError
        As :func:`check_design`.

    Examples
    --------
    >>> import numpy as np, repro
    >>> robot = repro.load_robot(repro.example() / "robot.toml")
    >>> bool(median_tip(robot, samples=50) == np.median(robot.check(samples=50).tip_within_bounds))
    True
    """
    seen = _seen(robot, samples, seed)
    nothing = np.zeros((len(seen.q), robot.n_readings, 0))
    off = _off_drawing(robot, seen.sensing, seen.q) if as_built else nothing
    _, within, built, _ = _deviations(seen, off)
    return float(np.median(built if as_built else within))


class _Seen(NamedTuple):
    """Random shapes, and what readings tell in them."""

    sensing: Sensing
    free: Array
    """Which coordinates are free ``[n_q]``; all slopes are by these, in units of what the bounds leave of them."""
    q: Array
    u: Array
    p: Array
    tips: Array
    """Slopes of the tip ``[n, 3, free]`` [m]."""
    H: Array
    """Slopes of the readings in units of their noise ``[n, s, free]``, zero for a reading that counts nothing."""
    noise: Array
    inside: Array
    """Which readings are too near a magnet, and which ones are beyond their range ``[n, s]``."""
    beyond: Array


def _seen(robot: Assembly, samples: int, seed: int) -> _Seen:
    """Return random shapes within the bounds, and what readings tell in them; refuse a robot that has none."""
    owner = "check"
    whole = isinstance(samples, int | np.integer) and 1 < samples <= _MOST_SAMPLES
    require(whole, "samples", owner, f"a whole number, at least 2 and at most {_MOST_SAMPLES}", samples)
    lower, upper, noise = _stated(robot, owner)
    sensing, free = sensing_of(robot), upper > lower
    require(free.any(), "bounds", owner, "such that a coordinate is free", "none that is")
    q = np.random.default_rng(seed).uniform(lower, upper, (samples, robot.n_q))
    u, J = sensing.linearise(q)
    good = np.isfinite(u).all(-1) & np.isfinite(J).all((-2, -1))
    require(good.sum() > 1, "robot", owner, "one with finite readings", "none in most shapes")
    q, u, J = q[good], u[good], J[good]
    inside, beyond = sensing.too_near(q), robot.missing(u) == 2
    p, G = robot.tip_slopes(q)
    scale = (upper - lower)[free] / math.sqrt(12)
    H = np.where((beyond | inside)[..., None], 0.0, J[..., free] * scale / noise[:, None])
    return _Seen(sensing, free, q, u, p, G[..., free] * scale, H, noise, inside, beyond)


def _stated(robot: Assembly, owner: str) -> tuple[Array, Array, Array]:
    """Return bounds and noise, or refuse a robot without."""
    stated: Any = (robot.lower, robot.upper, robot.total_noise)
    for name, value in (("bounds", stated[0]), ("noise", stated[2])):
        require(value is not None, name, owner, "stated by the robot", "none")
    return stated


def _deviations(seen: _Seen, off: Array) -> tuple[Array, Array, Array, Array]:
    """Return deviations of the tip: by readings, with bounds, as built; and shares of coordinates hardly determined.

    ``off`` is by how much parts may move the readings.
    """
    H, tips = seen.H, seen.tips
    values, vectors = np.linalg.eigh(H.mT @ H)
    empty = values <= 1e-12 * np.maximum(values[:, -1:], 1.0)
    inverse = np.where(empty, 0.0, 1 / np.where(empty, 1.0, values))
    along = np.square(tips @ vectors).sum(1)
    # A direction without information counts where the tip moves along it.
    lost = (empty & (along > 1e-18 * along.sum(1, keepdims=True))).any(1)
    tip = np.where(lost, np.inf, np.sqrt((along * inverse).sum(1)))
    left = 1 / (1 + np.maximum(values, 0.0))
    within = (along * left).sum(1)
    gain = tips @ (vectors * left[:, None]) @ (H @ vectors).mT / seen.noise
    built = np.sqrt(within + np.square(gain @ off).sum((1, 2)))
    hardly = np.square(vectors) * (left > _UNDETERMINED**2)[:, None]
    return tip, np.sqrt(within), built, hardly.sum(-1).mean(0)


def _notes(robot: Assembly, inside: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Return what else deserves a look, by which readings are too near a magnet, and names of free coordinates."""
    notes = tuple(
        f"{name} comes so close to a magnet that its field is not known there; its readings count nothing then"
        for k, name in enumerate(robot.part_names)
        if inside[:, robot.parts == k].any()
    )
    if robot.n_readings <= len(names):
        few = f"{robot.n_readings} readings for {len(names)} unknowns, none to spare"
        notes += (f"{few}: a sensor that fails is never noticed",)
    notes += mirrors_in_words(robot)
    if robot.start is not None:
        at_end = (robot.start <= robot.lower) | (robot.start >= robot.upper)
        at_end &= ~robot.fixed & ~robot.free_angles.free
        notes += tuple(f"{robot.coordinates[c]} starts at a bound" for c in np.flatnonzero(at_end))
    return notes


_MIRRORS = (((1.0, 1.0), (1, 0)), ((-1.0, 1.0), (0, 1)), ((1.0, -1.0), (0, 1)))
"""What planes through the backbone do to x and y: signs, and which comes first."""


def mirrors_in_words(robot: Assembly) -> tuple[str, ...]:
    """Return a sentence for each chip whose wiring no reading can check."""
    return tuple(
        f"readings alone cannot tell whether axes of {name} are exchanged or inverted: hold the north pole of a "
        "magnet on the side to which each axis points, and look whether that axis reads negative"
        for name in mirrored_chips(robot)
    )


def mirrored_chips(robot: Assembly) -> tuple[str, ...]:
    """Return the chips with three axes whose wrong wiring reads like a mirrored shape of the robot.

    We mirror the shape at three planes through the backbone, and the axes of one chip with it. If all readings agree,
    nobody can tell the two from each other.
    """
    bends = [g for g, segment in enumerate(robot.segments) if isinstance(segment, ConstantCurvature)]
    x = np.array([robot.coordinates.index(f"delta_x_{g + 1}") for g in bends], dtype=int)
    if not len(x) or robot.total_noise is None or robot.lower is None:
        return ()
    bounds: Any = (robot.lower, robot.upper)
    q = np.random.default_rng(0).uniform(bounds[0], bounds[1], (20, robot.n_q))
    sensing, found = sensing_of(robot), []
    u = sensing(q)
    for k, name in enumerate(robot.part_names[: len(robot.sensors)]):
        rows = np.flatnonzero(robot.parts == k)
        for signs, order in _MIRRORS if len(rows) == 3 else ():
            shape, wired = q.copy(), u.copy()
            for c in range(2):
                shape[:, x + c] = signs[c] * q[:, x + order[c]]
                wired[:, rows[c]] = signs[c] * u[:, rows[order[c]]]
            if np.abs((sensing(shape) - wired) / robot.total_noise).max() < 1.0:
                found.append(name)
                break
    return tuple(found)


def _off_drawing(robot: Assembly, sensing: Sensing, q: Array) -> Array:
    """Slopes of the readings by what parts may be off their drawing, times its deviations ``[n, s, k]``."""
    off = np.zeros((len(q), sensing.n_readings, 3 * len(robot.imus)))
    for k, imu in enumerate(robot.imus):
        own, row = imu.tolerance or {}, sensing.n_magnetic + 3 * k
        turned = max(own.get("tilt", 0.0), own.get("heading", 0.0))
        off[:, row : row + 3, 3 * k : 3 * k + 3] = turned * np.eye(3)
    if robot.model is not None or not robot.magnets or not robot.sensors:
        return off
    drawn = robot.replaced(imus=(), noise=None, moments=sensing.moments)
    priors = priors_of(drawn, Tolerances())
    of_parts = slopes_of(drawn, sensing_of(drawn), dict.fromkeys(priors, 0.0), q) * list(priors.values())
    of_parts = np.pad(of_parts, ((0, 0), (0, 3 * len(robot.imus)), (0, 0)))
    return np.concatenate([of_parts, off], axis=-1)


def _added(robot: Assembly, H: Array) -> dict[str, float]:
    def information(rows: Array) -> Array:
        return np.linalg.slogdet(rows.mT @ rows + np.eye(H.shape[-1]))[1]

    whole = information(H)
    return {
        name: float((whole - information(H[:, robot.parts != k])).mean()) / 2
        for k, name in enumerate(robot.part_names)
    }


def _saturated(robot: Assembly, u: Array, beyond: Array) -> dict[str, tuple[float, float]]:
    return {
        robot.names[k]: (float(beyond[:, k].mean()), float(np.abs(u[:, k]).max()))
        for k in np.flatnonzero(beyond.any(0))
    }


def _combinations(names: list[str], shares: Array) -> tuple[str, ...]:
    """Say what is hardly determined, by the shares of coordinates in such directions."""
    texts = [name for name, share in zip(names, shares, strict=True) if share > _ALONE]
    mixed = [name for name, share in zip(names, shares, strict=True) if _ALONE >= share > (1 - _ALONE)]
    if len(texts) == len(names):
        texts = ["every coordinate"]
    if len(mixed) > 1:
        texts.append(f"combinations of {', '.join(mixed[:-1])} and {mixed[-1]}")
    return tuple(texts)


def _grades(within: Array, built: Array, spread: float) -> tuple[bool, bool, bool]:
    """Whether readings tell much: in most shapes, in all but a twentieth of them, and before a calibration."""
    middle, worst = _middle_and_worst(within)
    limit = _HOPELESS * spread
    return middle < limit, worst < limit, bool(np.median(built) < limit)


def _verdict(tip: Array, within: Array, built: Array, spread: float) -> tuple[bool, str]:
    middle, worst = _middle_and_worst(within)
    mostly, throughout, as_built = _grades(within, built, spread)
    if not mostly:
        allow = length_in_words(np.quantile(tip, 0.5, method="nearest"))
        allow = "leave the tip open" if allow == _OPEN else f"allow {allow}"
        bounds = f"the bounds alone allow {length_in_words(spread)}"
        return False, f"This robot cannot work: the readings {allow}, and {bounds}."
    word = "can work" if throughout else "works in part of its workspace"
    if not as_built:
        word += " once it is calibrated"
    known = f"{length_in_words(middle)}, to {length_in_words(worst)} in all but a twentieth of its shapes"
    return (
        True,
        f"This robot {word}: the tip is known to {known} (without readings {length_in_words(spread)}).",
    )
