r"""Can a design work? What the readings of a robot can tell about its shape, before any reading is taken.

At random shapes within the bounds the information matrix is :math:`J^T S^{-1} J`, with the slopes :math:`J` of the
readings and the variances :math:`S` of their noise; a reading beyond its range counts nothing. With the slopes
:math:`G` of the tip, :math:`G (J^T S^{-1} J)^{-1} G^T` is the Cramér-Rao bound of its position: no unbiased estimate
from one set of readings has a smaller covariance. Least squares reach it where it is small against the bends. What
the parts are off their drawing by, and the steps of the readings, go through the same gain of least squares.

If only its range :math:`w` is known, a coordinate has the standard deviation :math:`w/\sqrt{12}`. In these units the
information is :math:`A`, and readings leave the share :math:`(A + I)^{-1}` of the variance. Directions of which they
leave most are hardly determined. A sensor adds :math:`\log\det(A + I)/2` with it less the same without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from repro.common import Array, require
from repro.robot import Robot

_HOPELESS, _ROUGH = 0.3, 0.1
"""Standard deviations of the tip, as shares of what the bounds alone leave, from which nothing or little is known."""
_OPEN = "not determined"
_UNDETERMINED, _IDLE = 0.5, 0.01
"""Share of a deviation that readings leave; information that a sensor adds [nat]."""


@dataclass(frozen=True, repr=False)
class DesignCheck:
    """What :meth:`repro.Robot.check` finds; ``print`` shows it.

    Parameters
    ----------
    q
        Random shapes within the bounds ``[n, n_q]``.
    tip, tip_within_bounds, tip_as_built
        Standard deviation of the tip, the root of its three variances' sum, in each of them ``[n]`` [m]. By noise
        alone, the Cramér-Rao bound, infinite where readings do not determine it; the same with what the bounds say;
        and with the sensors' steps and the tolerances of all parts too, before a calibration.
    coordinates
        Standard deviation of each coordinate by noise alone ``[n, n_q]`` [m, rad].
    spread
        Standard deviation of the tip over these shapes [m]: how well it is known without a reading.
    added
        Mean information that each sensor or IMU adds to the others [nat], by name.
    saturated
        Share of shapes where a sensor goes beyond its range, and its largest reading [mT], by name.
    undetermined
        Combinations of coordinates that readings hardly determine, in words.
    notes
        What else deserves a look.
    can_work, verdict
        The answer, also as a sentence.
    """

    q: Array
    tip: Array
    tip_within_bounds: Array
    tip_as_built: Array
    coordinates: Array
    spread: float
    added: dict[str, float]
    saturated: dict[str, tuple[float, float]]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    can_work: bool
    verdict: str

    @property
    def idle(self) -> tuple[str, ...]:
        """Sensors and IMUs that contribute nothing."""
        return tuple(name for name, nats in self.added.items() if nats < _IDLE)

    def __repr__(self) -> str:
        """Return a few lines, the verdict last."""
        (tip, worst), (built, worst_built) = _half_and_worst(self.tip), _half_and_worst(self.tip_as_built)
        if np.median(self.tip_as_built) > self.spread:
            built, worst_built = f"more than the bounds allow, {_length(self.spread)}", ""
        lines = [
            f"Design in {len(self.q)} random shapes: the median, and what the worst twentieth exceeds",
            f"tip by noise alone: {tip}, {worst}",
            f"tip with steps and tolerances, before a calibration: {', '.join(filter(None, (built, worst_built)))}",
        ]
        if self.undetermined:
            lines.append(f"hardly determined: {'; '.join(self.undetermined)}")
        if self.idle:
            which = "every sensor" if len(self.idle) == len(self.added) else ", ".join(self.idle)
            lines.append(f"contributes nothing: {which}")
        lines += [
            f"{name} saturates in {100 * share:.2g} % of the workspace (up to {most:.3g} mT)"
            for name, (share, most) in self.saturated.items()
        ]
        return "\n".join([*lines, *self.notes, self.verdict])


def _length(std: float) -> str:
    return _OPEN if std >= 1.0 else f"±{1e3 * std:.2g} mm" if std < 0.0995 else f"±{1e3 * std:.0f} mm"


def _half_and_worst(std: Array) -> tuple[str, str]:
    """Return the median, and what a twentieth of the workspace exceeds, in words."""
    middle, worst = np.quantile(std, [0.5, 0.95], method="nearest")
    return _length(middle), _length(worst)


def check_design(robot: Robot, *, samples: int = 400, seed: int = 0) -> DesignCheck:
    """Ask whether a robot can work: see :meth:`repro.Robot.check`.

    Parameters
    ----------
    robot
        With bounds, noise, and sensors or IMUs. Parts without tolerances have those of :class:`.Tolerances`.
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
    owner = "check"
    lower, upper, noise = robot.lower, robot.upper, robot.noise
    for name, value in (("bounds", lower), ("noise", noise)):
        require(value is not None, name, owner, "stated by the robot", "none")
    assert lower is not None
    assert upper is not None
    assert noise is not None
    require(samples > 1, "samples", owner, "at least 2", samples)
    sensing, free = robot.sensing(), ~robot.fixed
    require(free.any(), "bounds", owner, "such that a coordinate is free", "none that is")
    q = np.random.default_rng(seed).uniform(lower, upper, (samples, robot.n_q))
    u, J = sensing.linearise(q)
    good = np.isfinite(u).all(-1) & np.isfinite(J).all((-2, -1))
    require(good.sum() > 1, "robot", owner, "one with finite readings", "none in most shapes")
    q, u, J = q[good], u[good], J[good]
    beyond = np.abs(u) > robot.range
    p, G = robot.tip_slopes(q)
    scale = (upper - lower)[free] / math.sqrt(12)
    H = np.where(beyond[..., None], 0.0, J[..., free] * scale / noise[:, None])
    A, tips = np.swapaxes(H, 1, 2) @ H, G[..., free] * scale
    values, vectors = np.linalg.eigh(A)
    empty = values <= 1e-12 * np.maximum(values[:, -1:], 1.0)
    inverse = np.where(empty, 0.0, 1 / np.where(empty, 1.0, values))
    along, shares = np.square(tips @ vectors).sum(1), np.square(vectors)
    # A direction without information counts where the tip, or a coordinate, moves along it.
    lost = (empty & (along > 1e-18 * along.sum(1, keepdims=True))).any(1)
    tip = np.where(lost, np.inf, np.sqrt((along * inverse).sum(1)))
    open_, own = (shares * empty[:, None] > 1e-18).any(-1), (shares * inverse[:, None]).sum(-1)
    coordinates = np.zeros(q.shape)
    coordinates[:, free] = np.where(open_, np.inf, np.sqrt(own)) * scale
    left = 1 / (1 + np.maximum(values, 0.0))
    within = (along * left).sum(1)
    gain = tips @ (vectors * left[:, None]) @ np.swapaxes(H @ vectors, 1, 2) / noise
    built = within + np.square(gain * robot.resolution).sum((1, 2)) / 12
    built = np.sqrt(built + np.square(gain @ _off_drawing(robot, sensing, q)).sum((1, 2)))
    within, spread = np.sqrt(within), float(np.sqrt(np.square(p - p.mean(0)).sum(-1).mean()))
    names = [name for name, is_free in zip(robot.coordinates, free, strict=True) if is_free]
    hardly = (vectors * (left > _UNDETERMINED**2)[:, None]) @ np.swapaxes(vectors, 1, 2)
    can_work, verdict = _verdict(tip, within, built, spread)
    return DesignCheck(
        q, tip, within, built, coordinates, spread, _added(robot, H, A), _saturated(robot, u, beyond),
        _combinations(names, hardly.mean(0)), _notes(robot, sensing, q, len(names)), can_work, verdict,
    )  # fmt: skip


def _off_drawing(robot: Robot, sensing: Any, q: Array) -> Array:
    """Slopes of the readings by what parts may be off their drawing, times its deviations ``[n, s, k]``."""
    from repro.estimators.calibration import Tolerances, _priors, _slopes

    off = np.zeros((len(q), sensing.n_readings, 3 * len(robot.imus)))
    for k, imu in enumerate(robot.imus):
        own, row = imu.tolerance or {}, sensing.n_magnetic + 3 * k
        off[:, row : row + 3, 3 * k : 3 * k + 3] = np.eye(3) * max(
            own.get("tilt", 0.0), own.get("heading", 0.0)
        )
    if robot.model is not None or not robot.magnets or not robot.sensors:
        return off
    drawn = robot.replaced(imus=(), noise=None, moments=sensing.moments)
    priors = _priors(drawn, Tolerances(), sensing.moments.shape[1])
    K = _slopes(drawn, drawn.sensing(), dict.fromkeys(priors, 0.0), q) * list(priors.values())
    rows = np.zeros((len(q), sensing.n_readings, K.shape[-1]))
    rows[:, : sensing.n_magnetic] = K
    return np.concatenate([rows, off], axis=-1)


def _added(robot: Robot, H: Array, A: Array) -> dict[str, float]:
    eye, added = np.eye(A.shape[-1]), {}
    whole = np.linalg.slogdet(A + eye)[1]
    for k, name in enumerate(robot.part_names):
        others = H[:, robot.parts != k]
        without = np.linalg.slogdet(np.swapaxes(others, 1, 2) @ others + eye)[1]
        added[name] = float((whole - without).mean()) / 2
    return added


def _saturated(robot: Robot, u: Array, beyond: Array) -> dict[str, tuple[float, float]]:
    found = {}
    for k, name in enumerate(robot.part_names):
        rows = robot.parts == k
        if beyond[:, rows].any():
            found[name] = float(beyond[:, rows].any(1).mean()), float(np.abs(u[:, rows]).max())
    return found


def _combinations(names: list[str], projector: Array) -> tuple[str, ...]:
    """Say which combinations are hardly determined: those in most shapes, then what changes with the shape."""
    values, vectors = np.linalg.eigh(projector)
    always = values > 0.5
    if always.all():
        return ("every coordinate",)
    rest = projector - (vectors * np.where(always, values, 0.0)) @ vectors.T
    common, texts = vectors[:, always] @ vectors[:, always].T, []
    for _ in range(int(always.sum())):  # Cholesky with pivots: the coordinate least determined comes next
        pivot = int(np.argmax(np.diag(common).round(9)))
        direction = common[:, pivot] / math.sqrt(common[pivot, pivot])
        common = common - np.outer(direction, direction)
        here = [int(k) for k in np.argsort(-np.abs(direction).round(9), kind="stable")]
        here = [k for k in here if abs(direction[k]) > abs(direction[here[0]]) / 2]
        named = [names[k] for k in here]
        if len(here) == 1:
            texts.append(named[0])
        elif len(here) == 2:
            word = "sum" if direction[here[0]] * direction[here[1]] > 0 else "difference"
            texts.append(f"the {word} of {named[0]} and {named[1]}, in units of their ranges")
        else:
            texts.append(f"a combination of {_listed([names[k] for k in sorted(here)])}")
    share = np.diag(rest)
    if share.sum() > 0.5:
        named = [names[k] for k in np.flatnonzero(share > share.max() / 2)]
        texts.append(f"{_listed(named)} in combinations that change with the shape")
    return tuple(texts)


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _notes(robot: Robot, sensing: Any, q: Array, unknowns: int) -> tuple[str, ...]:
    notes, s = [], sensing.n_readings
    if s <= unknowns:
        notes.append(
            f"{s} readings for {unknowns} unknowns, none to spare: a sensor that fails is never noticed"
        )
    distances = sensing.relations(q)[..., 1::4].min(0) if robot.sensors else np.zeros((0, 0))
    for k, magnet in enumerate(robot.magnets if len(distances) else ()):
        j, shape = int(distances[:, k].argmin()), magnet.shape
        size = vars(shape)
        reach = (
            math.sqrt(3) * size["edge"] / 2
            if "edge" in size
            else 0.5 * math.hypot(size.get("diameter", size.get("outer_diameter")), size["height"])
        )
        if distances[j, k] < reach:
            where = f"{robot.names[j]} comes within {1e3 * distances[j, k]:.2g} mm of the centre of magnet {k + 1}"
            notes.append(f"{where}, which reaches {1e3 * reach:.2g} mm: its field is not known there")
    return tuple(notes)


def _verdict(tip: Array, within: Array, built: Array, spread: float) -> tuple[bool, str]:
    middle, worst = np.quantile(within, [0.5, 0.95]) / spread
    own = np.median(tip) < 1.5 * np.median(within)
    typical, largest = _half_and_worst(tip if own else within)
    if not middle < _HOPELESS:
        allow = _half_and_worst(tip)[0]
        allow = "leave the tip open" if allow == _OPEN else f"allow {allow}"
        return (
            False,
            f"This robot cannot work: the readings {allow}, and the bounds alone allow {_length(spread)}.",
        )
    known = f"the tip is known to {typical} from one set of readings" + ("" if own else " and the bounds")
    if not worst < _HOPELESS:
        return (
            True,
            f"This robot works in part of its workspace: {known} in half of it, to {largest} in a twentieth.",
        )
    word = "can work" if middle < _ROUGH else "gives a rough shape"
    word += " once it is calibrated" if not np.median(built) < _HOPELESS * spread else ""
    return True, f"This robot {word}: {known}, to {largest} in all but a twentieth of its workspace."
