"""One contract for all estimators, and the one loop that drives them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from repro.angles import FreeAngles
from repro.common import Array, array, bad_input, is_table, numbers, require, say_that_kernels_compile
from repro.robot import Robot


class Estimate(NamedTuple):
    """What an estimator says after a time step. Leading dimensions are a batch of independent robots.

    Parameters
    ----------
    q
        Configuration ``[..., n_q]``: m and rad.
    covariance
        Covariance of ``q`` ``[..., n_q, n_q]``, or ``None`` for estimators without one.
    u_hat
        Readings predicted at ``q`` ``[..., s]``, in the unit of the readings.
    chi2
        Squared residuals in units of the variances of the noise; NaN if no noise is stated.
    dof
        How many of these residuals the estimate could not adapt itself to. If model and noise are right, ``chi2`` has
        a chi-square distribution with so many degrees of freedom.
    missing
        Number of readings that were left out: masked, NaN or infinite.
    details
        More about the estimate, by name; arrays with the batch of ``q``.

    Examples
    --------
    >>> Estimate(np.zeros(3), None, np.zeros(8), np.nan, 5, 0, {}).q
    array([0., 0., 0.])
    """

    q: Array
    covariance: Array | None
    u_hat: Array
    chi2: Any
    dof: Any
    missing: Any
    details: dict[str, Array]


@runtime_checkable
class Estimator(Protocol):
    """What every estimator offers: an explicit state, from ``init`` through every ``step``, that nobody changes.

    ``init(q0, seed)`` returns the state before the first readings, at the configuration ``q0`` ``[..., n_q]``.
    ``step(state, u, t, mask, known)`` takes in readings ``u`` ``[..., s]`` at the time ``t`` [s] and returns the next
    state and an :class:`Estimate`. Readings that are NaN or infinite, or whose ``mask`` is false, are missing.
    ``known`` ``[..., n_q]`` holds coordinates that an experiment measures, and NaN for those to be estimated: truth
    never enters otherwise.
    """

    def init(self, q0: Any = None, seed: int = 0) -> Any:
        """Return the state before the first readings."""
        ...

    def step(
        self, state: Any, u: Any, t: float = 0.0, mask: Any = None, known: Any = None
    ) -> tuple[Any, Estimate]:
        """Take in readings."""
        ...


@runtime_checkable
class Watched(Estimator, Protocol):
    """What an estimator offers beside ``init`` and ``step`` for a :class:`.Monitor` to watch it.

    Its estimates report ``chi2`` and ``dof``, and it takes batches and readings that are NaN.
    """

    robot: Any
    """Whose shape it estimates, if known."""
    n_q: int
    """Number of coordinates."""
    angles: FreeAngles
    """Which coordinates come round again."""
    needs_time: bool
    """Whether it predicts by the time since the last row."""

    @property
    def bounds(self) -> tuple[Array, Array] | None:
        """Bounds of the coordinates, if there are any."""
        ...

    def parts_of(self, n_readings: int) -> tuple[Array, Array]:
        """Return which part every reading belongs to, and which readings never stay the same ``[s]``."""
        ...

    def widened(self, share: float) -> Any:
        """Return the estimator with bounds a share of their width farther out, or nothing without bounds."""
        ...


@dataclass(frozen=True)
class Trajectory:
    """Estimates over time: the fields of :class:`Estimate` with a leading dimension of time.

    Parameters
    ----------
    times
        Time of each row [s].
    q, covariance, u_hat, chi2, dof
        As in :class:`Estimate`.
    missing
        Number of readings that are missing. With a monitor it also counts those that were left out.
    details
        More about the estimates, by name. With a monitor, ``left_out`` ``[t, ..., s]`` marks the readings that were
        left out, and ``growth`` is the factor by which the covariance grew.
    status
        What the monitor says of each row: *consistent*; *left out*: the readings of a part do not fit and were left
        out, the rest fits; *inconsistent*: they do not fit, and it is not decided why; *frozen*: the board repeats
        itself; *undetermined*: fewer readings than unknowns; *unchecked*: the fit uses up all readings, so that none
        can contradict; *beyond bounds*: they fit outside the robot's bounds only. ``None`` without a monitor.
    suspects
        Parts that the monitor names ``[t, ..., parts]``, as ``robot.part_names``; without a robot every reading is a
        part of its own.
    readings
        What was read ``[t, ..., s]``, if known.
    robot
        Whose shape it is, if known: it names coordinates and readings.

    Examples
    --------
    >>> Trajectory(np.arange(7.0), np.zeros((7, 3)), None, np.zeros((7, 8)), np.zeros(7), np.zeros(7), np.zeros(7))
    Trajectory of 7 time steps over 6 s, 3 coordinates, 8 readings
    chi-square per degree of freedom: not stated
    0 of 56 readings missing
    """

    times: Array
    q: Array
    covariance: Array | None
    u_hat: Array
    chi2: Array
    dof: Array
    missing: Array
    details: dict[str, Array] = field(default_factory=dict)
    status: Array | None = None
    suspects: Array | None = None
    readings: Array | None = None
    robot: Any = None

    def __repr__(self) -> str:
        """Return three lines."""
        n, s = self.q.shape[-1], self.u_hat.shape[-1]
        span = f"{self.times[-1] - self.times[0]:g} s"
        fits = True if self.status is None else np.isin(self.status, _FITTING)  # one bad row spoils any mean
        free, chi2 = np.sum(self.dof, where=fits), np.sum(self.chi2, where=fits)
        fit = f"{chi2 / free:.3g}" if free and np.isfinite(chi2) else "not stated"
        counts = {} if self.status is None else Counter(self.status.ravel().tolist())
        rows = "".join(f"; {n} rows {name}" for name, n in counts.items())
        if self.suspects is not None and self.suspects.any():
            n_suspect = self.suspects.reshape(-1, self.suspects.shape[-1]).sum(0)
            rows += f"; suspects: {_counted(self._parts(), n_suspect)}"
        near = self.details.get("too_near")
        if near is not None and near.any() and self.robot is not None:
            by_reading = near.reshape(-1, near.shape[-1]).sum(0)
            first = np.unique(self.robot.parts, return_index=True)[1]
            rows += f"; left out, too close to a magnet: {_counted(self.robot.part_names, by_reading[first])}"
        touched = self.at_bounds()
        rows += f"; at a bound: {_counted(touched, touched.values())}" if touched else ""
        left = int(np.sum(self.details.get("left_out", 0)))
        lost = f"{int(np.sum(self.missing)) - left} of {self.u_hat.size} readings missing"
        return (
            f"Trajectory of {len(self.times)} time steps over {span}, {n} coordinates, {s} readings\n"
            f"chi-square per degree of freedom: {fit}\n"
            f"{lost}{f', {left} left out' * (left > 0)}{rows}"
        )

    def at_bounds(self) -> dict[str, int]:
        """Return the coordinates that touch a bound of the robot, and in how many rows."""
        touched = self._at_bound()
        if touched is None:
            return {}
        counts = touched.reshape(-1, touched.shape[-1]).sum(0).tolist()
        return {name: n for (name, _, _), n in zip(self.units(), counts, strict=True) if n}

    def _at_bound(self) -> Array | None:
        """Which coordinates touch a bound ``[t, ..., n_q]``, if the estimator says so."""
        touched = self.details.get("at_bound")
        return touched if touched is not None and touched.shape == self.q.shape else None

    def _parts(self) -> Sequence[str]:
        """Return names of what the monitor may suspect."""
        suspects: Any = self.suspects
        if self.robot is not None and len(self.robot.part_names) == suspects.shape[-1]:
            return self.robot.part_names
        return [f"u{k}" for k in range(1, suspects.shape[-1] + 1)]

    def units(self) -> list[tuple[str, str, float]]:
        """Return name, unit in tables and pictures, and factor to it of every coordinate."""
        if self.robot is None or self.robot.n_q != self.q.shape[-1]:
            return [(f"q_{k}", "", 1.0) for k in range(1, self.q.shape[-1] + 1)]
        units = {"kappa": ("rad", 1.0), "phi": ("deg", np.degrees(1.0)), "rotation": ("deg", np.degrees(1.0))}
        return [(name, *units.get(name.split("_")[0], ("mm", 1e3))) for name in self.robot.coordinates]

    def to_frame(self) -> Any:
        """Return a data frame with names and units: ``time_s``, coordinates, tip, deviations, fit, status, suspects.

        The last column names the coordinates that touch a bound of the robot.

        A coordinate such as ``delta_x_1_mm`` has the standard deviation ``delta_x_1_sd_mm``. The tip is in the base
        frame: ``tip_x_mm`` and so on.

        Raises
        ------
        InputError
            If these are several robots at a time.
        """
        import pandas as pd

        require(self.q.ndim == 2, "shape", "to_frame", "of one robot", f"estimates of shape {self.q.shape}")
        columns: dict[str, Array] = {"time_s": self.times}

        def add(units: list[tuple[str, str, float]], values: Array, C: Array | None) -> None:
            names = [(name, f"_{unit}" if unit else "") for name, unit, _ in units]
            factor = np.array([factor for _, _, factor in units])
            columns.update(zip([name + unit for name, unit in names], (values * factor).T, strict=True))
            if C is not None:
                std = np.sqrt(np.maximum(np.diagonal(C, axis1=1, axis2=2), 0.0)) * factor
                columns.update(zip([f"{name}_sd{unit}" for name, unit in names], std.T, strict=True))

        add(self.units(), self.q, self.covariance)
        if self.robot is not None and self.robot.n_q == self.q.shape[-1]:
            known: Any = np.isfinite(self.q).all(-1)
            p, G = self.robot.tip_slopes(np.where(known[:, None], self.q, 0.0))
            p[~known], C = np.nan, None
            if self.covariance is not None:
                C = G @ np.where(known[:, None, None], self.covariance, 0.0) @ np.swapaxes(G, 1, 2)
                C[~known] = np.nan
            add([(f"tip_{axis}", "mm", 1e3) for axis in "xyz"], p, C)
        columns |= {"chi2": self.chi2, "dof": self.dof, "missing": self.missing}
        if self.status is not None:
            columns["status"] = self.status
        if self.suspects is not None:
            columns["suspects"] = _listed(self._parts(), self.suspects)
        touched = self._at_bound()
        if touched is not None:
            columns["at_bound"] = _listed([name for name, _, _ in self.units()], touched)
        return pd.DataFrame(columns)

    def plot(self, axes: Any = None) -> Any:
        """Draw coordinates with their 95 % band, readings and residuals over time, and what is suspected.

        Parameters
        ----------
        axes
            As many matplotlib axes as there are panels, one for each unit of coordinates and two for readings; new
            ones if not given.

        Returns
        -------
        numpy.ndarray
            The axes.
        """
        from repro.plots import plot_shape

        return plot_shape(self, axes)


_FITTING = ("consistent", "left out", "unchecked")
"""What the monitor says of rows whose readings fit, by name."""
_SHAPES = 256
"""Shapes within the bounds at which we look whether a reading comes too close to a magnet."""


def _counted(names: Iterable[str], counts: Iterable[int]) -> str:
    return ", ".join(f"{name} in {k} rows" for name, k in zip(names, counts, strict=True) if k)


def _listed(names: Sequence[str], marks: Array) -> Array:
    """Return the names that are marked ``[t, n]`` in every row, as a text."""
    return np.array([", ".join(n for n, mark in zip(names, row, strict=True) if mark) for row in marks])


def track(
    estimator: Estimator,
    readings: Any,
    q0: Any = None,
    *,
    times: Any = None,
    rate_hz: float | None = None,
    seed: int = 0,
    mask: Any = None,
    known: Any = None,
    progress: str | None = None,
    monitor: str | None = "auto",
) -> Trajectory:
    """Run an estimator over recorded readings.

    Parameters
    ----------
    estimator
        Any estimator.
    readings
        One row per time step ``[t, ..., s]``; NaN for a missing reading. If the estimator knows its robot, also a
        data frame with names or the path of a table, as :meth:`repro.Robot.readings` takes them, and what
        :meth:`repro.Robot.missing` names is missing, too.
    q0
        Where the estimator starts ``[..., n_q]``; its own choice if not given.
    times
        Time of each row [s], increasing; that of the table if not given.
    rate_hz
        Rows per second, where there are no times; that of the robot if not given. Filters need one of the two.
    seed
        For estimators that draw random numbers.
    mask, known
        As in :class:`Estimator`, with a leading dimension of time.
    progress
        Label of a progress bar; none if not given.
    monitor
        ``"auto"``: with least squares, Kalman and rod filters a monitor watches for sensors that fail; see ``status``
        of a :class:`Trajectory`. ``None``: nobody does.

    Raises
    ------
    InputError
        If there are no readings, or times, masks or known coordinates do not fit them.

    Examples
    --------
    >>> from repro import LevenbergMarquardt, track
    >>> root = LevenbergMarquardt(lambda q: q**2, lower=[0.0], upper=[2.0], noise=0.01)
    >>> track(root, [[0.25], [1.0], [2.25]]).q.ravel().round(6)
    array([0.5, 1. , 1.5])
    """
    return run(
        estimator, readings, q0, times=times, rate_hz=rate_hz, seed=seed, mask=mask, known=known,
        progress=progress, monitor=monitor,
    )[0]  # fmt: skip


def run(
    estimator: Estimator,
    readings: Any,
    q0: Any,
    *,
    times: Any,
    rate_hz: float | None,
    seed: int,
    mask: Any,
    known: Any,
    progress: str | None,
    monitor: str | None,
    owner: str = "track",
) -> tuple[Trajectory, list[Any]]:
    """Return the estimates and the states: the loop of ``track`` and of ``smooth``."""
    require(isinstance(estimator, Estimator), "estimator", owner, "an estimator", type(estimator).__name__)
    require(monitor in ("auto", None), "monitor", owner, '"auto" or None', repr(monitor))
    robot = getattr(estimator, "robot", None) or getattr(getattr(estimator, "model", None), "robot", None)
    if robot is not None and is_table(readings):
        readings = robot.readings(readings)
    if times is None and rate_hz is None:
        times, rate_hz = getattr(readings, "times", None), getattr(robot, "rate_hz", None)
        index = getattr(
            getattr(readings, "index", None), "dtype", np.dtype(int)
        )  # of a data frame without names
        lost = times is None and (index.kind in "fmM" or getattr(readings, "without_times", False))
        words = "given, one of the two: after what was done to the readings their own times are not known"
        require(not lost, "times, rate_hz", owner, words, "neither")
    rows = numbers(readings, "readings", owner, finite=False)
    if robot is not None and rows.shape[-1:] == (robot.n_readings,):
        rows = np.where(robot.missing(rows) > 0, np.nan, rows)
    else:
        rows = np.where(np.abs(rows) < 1e100, rows, np.nan)  # no sensor can tell more
    require(rows.ndim >= 2 and len(rows), "readings", owner, "of shape (t, ..., s)", f"shape {rows.shape}")
    at = _times(len(rows), times, rate_hz, owner, needed=getattr(estimator, "needs_time", False))
    per_row: dict[str, Any] = {"mask": mask, "known": known}
    for name, values in per_row.items():
        if values is not None:
            per_row[name] = values = array(values, name, owner)
            words = f"one row for each of {len(rows)} time steps"
            require(values.ndim and len(values) == len(rows), name, owner, words, f"shape {values.shape}")
    from repro.estimators.monitor import Monitor

    method: Any = estimator
    if monitor is not None and isinstance(estimator, Watched):  # not the estimators of papers
        method = Monitor(estimator)
    state, near = method.init(q0, seed=seed), NearMagnets.of(robot, rows.shape[-1], q0)
    states, estimates, hidden = [], [], []
    for k in _with_bar(len(rows), progress):
        given = {name: values[k] for name, values in per_row.items() if values is not None}
        row = rows[k]
        if near is not None:
            hidden.append(near.readings())
            row = np.where(hidden[-1], np.nan, row)
        state, estimate = method.step(state, row, float(at[k]), **given)
        if near is not None:
            near.q = estimate.q
        states.append(state.inner if isinstance(method, Monitor) else state)
        estimates.append(estimate)
    watch = method if isinstance(method, Monitor) else None
    found = trajectory(at, rows, estimates, robot, watch, per_row["mask"])
    if near is not None:
        found.details["too_near"] = np.array(hidden)
    return found, states


class NearMagnets:
    """Which readings are taken too close to a magnet for its field to be known, at the last estimate.

    Where the multipoles do not describe the field, a reading would pull the estimate anywhere: it is left out.
    """

    def __init__(self, sensing: Any, q: Array) -> None:
        self.sensing, self.q = sensing, q

    @classmethod
    def of(cls, robot: Robot | None, n_readings: int, q0: Any = None) -> NearMagnets | None:
        """Return it for a robot, or nothing if no reading comes so close within the bounds."""
        if robot is None or robot.lower is None or robot.upper is None or n_readings != robot.n_readings:
            return None
        if robot.model is not None or not robot.magnets:
            return None
        sensing, middle = robot.sensing(), (robot.lower + robot.upper) / 2
        if not sensing.too_near(evenly(robot.lower, robot.upper, _SHAPES)).any():
            return None
        given = q0 if q0 is not None else robot.start if robot.start is not None else middle
        return cls(sensing, np.asarray(given, dtype=float))

    def readings(self) -> Array:
        """Return which readings to leave out ``[..., s]``."""
        return self.sensing.too_near(np.nan_to_num(self.q))


def trajectory(
    at: Any, readings: Any, estimates: Sequence[Estimate], robot: Any, monitor: Any, mask: Any = None
) -> Trajectory:
    """Put estimates of rows together, with what a monitor said of them."""
    from repro.estimators.monitor import SAID, STATUS

    q, covariance, u_hat, chi2, dof, missing, rest = zip(*estimates, strict=True)
    own = [name for name in rest[0] if monitor is None or name not in SAID]
    details = {name: np.array([row[name] for row in rest]) for name in own}
    if monitor is not None:  # a frame that comes again adds nothing to a filter, and is there all the same
        details |= monitor.stacked(rest)
        there = np.isfinite(readings) & (True if mask is None else mask)
        details["left_out"] = details["left_out"] & there
        missing = (~there | details["left_out"]).sum(-1)
    return Trajectory(
        np.array(at),
        np.array(q),
        None if covariance[0] is None else np.array(covariance),
        np.array(u_hat),
        np.array(chi2),
        np.array(dof),
        np.array(missing),
        details,
        None if monitor is None else np.array(STATUS)[details.pop("status")],
        details.pop("suspects", None),
        np.array(readings),
        robot,
    )


def _times(n: int, times: Any, rate_hz: float | None, owner: str, *, needed: bool) -> Array:
    if times is not None:
        at = numbers(times, "times", owner, (n,))
        late = np.flatnonzero(np.diff(at) <= 0)
        if len(late):
            k = late[0]
            raise bad_input("times", owner, "increasing [s]", f"{at[k + 1]} after {at[k]} in row {k + 1}")
        return at
    if rate_hz is None and needed:
        raise bad_input("times, rate_hz", owner, "given for a filter, one of the two", "neither")
    rate = 1.0 if rate_hz is None else rate_hz
    require(0 < numbers(rate, "rate_hz", owner, ()) < np.inf, "rate_hz", owner, "positive", rate)
    return np.arange(n) / rate


def _with_bar(n: int, label: str | None) -> Any:
    if label is None:
        return range(n)
    from rich.progress import track as bar

    return bar(range(n), description=label)


def incoming(u: Any, mask: Any, owner: str, n: int | None = None) -> Array:
    """Return readings as float64 with NaN for every missing one; refuse another number of readings.

    Raises
    ------
    InputError
        If ``u`` holds no numbers, has another width than ``n``, or the mask does not fit.
    """
    if not (type(u) is np.ndarray and u.dtype == np.float64):
        u = numbers(u, "u", owner, finite=False)
    if u.ndim == 0 or (n is not None and u.shape[-1] != n):
        words = "of shape (..., s)" if n is None else f"{n} readings (last dimension)"
        raise bad_input("u", owner, words, f"shape {u.shape}")
    if mask is not None:
        use = array(mask, "mask", owner)
        if use.dtype != np.bool_ or use.shape[-1:] != u.shape[-1:]:
            words = f"true or false for each of {u.shape[-1]} readings"
            raise bad_input("mask", owner, words, f"{use.dtype} of shape {use.shape}")
        u = np.where(use, u, np.nan)
    return u


def start(q0: Any, n_q: int, owner: str) -> Array:
    """Return a start configuration ``[..., n_q]`` as float64, or refuse it."""
    return numbers(q0, "q0", owner, (..., n_q))


def described(
    sensing: Any, lower: Any, upper: Any, noise: Any, owner: str
) -> tuple[Robot | None, Any, Any, Any, Any]:
    """Return the robot behind a sensor model if there is one, the model, and what is not given as the robot has it.

    Raises
    ------
    InputError
        If bounds or noise are neither given nor stated by a robot.
    """
    robot = sensing if isinstance(sensing, Robot) else getattr(sensing, "robot", None)
    robot = getattr(getattr(sensing, "sensing", None), "robot", robot)  # of errors that wander
    if isinstance(sensing, Robot):
        require(sensing.n_q, "robot", owner, "one with a coordinate", "none")
        sensing = sensing.sensing()
    found = []
    for name, value in (("lower", lower), ("upper", upper), ("noise", noise)):
        stated = "total_noise" if name == "noise" else name
        value = getattr(robot, stated, None) if value is None else value
        found.append(value)
        require(value is not None, name, owner, "given, or stated by the robot", "neither")
    return robot, sensing, *found


def fixed_coordinates(lower: Array, upper: Array) -> Array | None:
    """Return what equal bounds fix ``[n_q]``, NaN for the other coordinates; ``None`` if they fix nothing."""
    fixed = lower == upper
    return np.where(fixed, lower, np.nan) if fixed.any() else None


def information_of_bounds(lower: Array, upper: Array, free: Array) -> Array:
    """Return the inverse variance of every coordinate between its bounds, zero where they fix it.

    It is that of a uniform distribution, over a whole turn for a free angle.
    """
    width = np.where(free, 2 * np.pi, upper - lower)
    return np.divide(12.0, width**2, out=np.zeros(len(width)), where=upper > lower)


def each(x: Array, batch: tuple[int, ...], *own: int) -> Array:
    """Return what each member of a batch has, one after the other ``[members, *own]``; copied only if shared."""
    shape = (*batch, *own)
    return (x if x.shape == shape else np.broadcast_to(x, shape)).reshape(-1, *own)


def evenly(lower: Array, upper: Array, n: int) -> Array:
    """Return ``n`` points that fill a box evenly ``[n, n_q]``: an additive recurrence, the middle first."""
    golden, count = 2.0, len(lower)
    for _ in range(60):  # the root of x^(n_q + 1) = x + 1
        golden = (1 + golden) ** (1 / (count + 1))
    share = (0.5 + np.arange(n)[:, None] * golden ** -np.arange(1.0, count + 1)) % 1.0
    return lower + share * (upper - lower)


def known_coordinates(known: Any, n_q: int, owner: str, fixed: Array | None = None) -> Array | None:
    """Return known coordinates ``[..., n_q]``, NaN for those to be estimated; infinity is refused."""
    if known is None:
        return fixed
    values = numbers(known, "known", owner, (..., n_q), finite=False)
    require(not np.isinf(values).any(), "known", owner, "finite, or NaN for unknown", "infinity")
    return values if fixed is None else np.where(np.isnan(values), fixed, values)


def conditioned(x: Array, C: Array, known: Array) -> tuple[Array, Array]:
    """Return mean and covariance, given the coordinates that are known."""
    given = ~np.isnan(known)
    rows, columns = given[..., :, None], given[..., None, :]
    inverse = np.linalg.pinv(np.where(rows & columns, C, 0.0), rcond=1e-12, hermitian=True)
    gain = np.where(columns, C, 0.0) @ inverse
    off = np.where(given, known - x, 0.0)
    moved = x + (gain @ off[..., None])[..., 0]
    return np.where(given, known, moved), np.where(~rows & ~columns, C - gain @ C, 0.0)


class CallableModel:
    """Any callable as a sensor model: how it takes batches and where its slopes come from is found out once."""

    compiled = False
    rotations = ()

    def __init__(self, sensing: Any, middle: Array, width: Array, owner: str) -> None:
        self.sensing, self._step, self.owner = sensing, 6e-6 * width, owner
        nearby = np.stack([middle, middle + 0.01 * width])
        single = [self._one(q) for q in nearby]
        self.n_readings = len(single[0])
        self.batched = self._matches(sensing, nearby, np.stack(single))
        self._slopes = getattr(sensing, "linearise", None)
        turned = nearby + 1e-20j * self._step
        self.complex = self._slopes is None and self._matches(
            lambda q: np.imag(self._called(q, complex)) / 1e-20,
            turned,
            np.stack([self._called(q + self._step) - self._called(q - self._step) for q in nearby]) / 2,
            1e-5,
        )

    def _one(self, q: Array) -> Array:
        try:
            u = np.asarray(self.sensing(q), dtype=float)
        except Exception as error:  # whatever a model raises is said in one line
            expected, words = f"a callable of {len(q)} coordinates", f"{type(error).__name__}: {error}"
            if hasattr(self.sensing, "state_dict"):
                expected += (
                    " and arrays: of a torch module, lambda q: module(torch.as_tensor(q)).detach().numpy()"
                )
                expected += " after module.double()"
            raise bad_input("sensing", self.owner, expected, words) from error
        require(u.ndim == 1, "sensing", self.owner, "one that returns readings [s]", f"shape {u.shape}")
        return u

    @staticmethod
    def _matches(call: Callable[[Array], Any], q: Array, expected: Array, tolerance: float = 1e-9) -> bool:
        try:
            found = np.asarray(call(q))
        except Exception:  # it does not take this: there is another way
            return False
        close = found.shape == expected.shape and np.isrealobj(found)
        return close and bool(
            np.allclose(found, expected, tolerance, tolerance * np.abs(expected).max(), True)
        )

    def _called(self, q: Array, dtype: Any = float) -> Array:
        if q.ndim == 1 or self.batched:
            return np.asarray(self.sensing(q), dtype=dtype)
        return np.stack([np.asarray(self.sensing(x), dtype=dtype) for x in q])

    def __call__(self, q: Array) -> Array:
        """Return readings ``[n, s]`` at configurations ``[n, n_q]``."""
        return self._called(q)

    def linearise(self, q: Array) -> tuple[Array, Array]:
        """Return readings ``[n, s]`` and slopes ``[n, s, n_q]``."""
        if self._slopes is not None:
            pairs = [self._slopes(q)] if self.batched else [self._slopes(x) for x in q]
            u, J = (
                np.concatenate([np.reshape(x[i], (-1, *np.shape(x[i])[-1 - i :])) for x in pairs])
                for i in (0, 1)
            )
            return np.asarray(u, dtype=float), np.asarray(J, dtype=float)
        n, n_q = q.shape
        moves = np.diag(self._step)
        if self.complex:
            u: Any = self._called((q[:, None] + 1e-14j * moves).reshape(-1, n_q), complex).reshape(n, n_q, -1)
            return np.ascontiguousarray(u[:, 0].real), np.swapaxes(u.imag, 1, 2) / (1e-14 * self._step)
        around = np.concatenate([q[:, None], q[:, None] + moves, q[:, None] - moves], axis=1)
        u = self._called(around.reshape(-1, n_q)).reshape(n, 2 * n_q + 1, -1)
        slopes = (u[:, 1 : n_q + 1] - u[:, n_q + 1 :]) / (2 * self._step[:, None])
        return u[:, 0], np.swapaxes(slopes, 1, 2)

    @staticmethod
    def difference(u: Array, u_hat: Array) -> Array:
        """Return what was read beyond what was predicted, NaN where nothing was read."""
        return np.where(np.isfinite(u), u, np.nan) - u_hat


def model_of(sensing: Any, lower: Array, upper: Array, owner: str) -> Any:
    """Return a sensor model with ``linearise``, ``difference`` and ``rotations``: itself, or a wrapper.

    Raises
    ------
    InputError
        If it is no callable, fails, or has another number of coordinates than the bounds.
    """
    require(callable(sensing), "sensing", owner, "a callable from q to readings", type(sensing).__name__)
    say_that_kernels_compile()
    if hasattr(sensing, "compiled"):
        expected = f"bounds of its {sensing.n_q} coordinates"
        require(len(lower) == sensing.n_q, "lower, upper", owner, expected, f"{len(lower)}")
        return sensing
    width = np.where(upper > lower, upper - lower, 1.0)
    return CallableModel(sensing, (lower + upper) / 2, width, owner)


def parts_of(robot: Robot | None, noise: Any, n_readings: int) -> tuple[Array, Array]:
    """Return which part every reading belongs to, and which never stay the same: their noise is above their step."""
    if robot is None or robot.n_readings != n_readings:
        return np.arange(n_readings), np.ones(n_readings, dtype=bool)
    noise = noise if robot.noise is None else robot.noise
    return robot.parts, np.broadcast_to(noise >= robot.resolution, (n_readings,))


def _each_of(function: Any, x: Any, *others: Any) -> Any:
    """Apply a function to all arrays and numbers of states or estimates of one kind."""
    if isinstance(x, dict):
        return {name: _each_of(function, y, *(other[name] for other in others)) for name, y in x.items()}
    if isinstance(x, tuple):
        return type(x)(*(_each_of(function, *values) for values in zip(x, *others, strict=True)))
    return function(x, *others)


def member(x: Any, k: Any) -> Any:
    """Return one robot of a batch of states or estimates."""
    return _each_of(lambda y: y[k] if isinstance(y, np.ndarray) else y, x)


def with_member(x: Any, k: Any, y: Any) -> Any:
    """Return a batch with one robot exchanged."""

    def exchanged(old: Any, new: Any) -> Any:
        if not isinstance(old, np.ndarray):
            return new
        old = old.copy()
        old[k] = new
        return old

    return y if k == () else _each_of(exchanged, x, y)


def chosen(condition: Array, x: Any, y: Any) -> Any:
    """Return a batch of the robots of one where a condition holds, else of another."""

    def where(old: Any, new: Any) -> Any:
        return np.where(condition[(...,) + (None,) * (np.ndim(old) - condition.ndim)], new, old)[()]

    return _each_of(where, y, x)


def grown(estimate: Estimate, added: Any, factor: Any = 1.0) -> Estimate:
    """Return an estimate whose covariance is multiplied by a factor, with another one added."""
    C: Any = estimate.covariance
    return estimate._replace(covariance=factor * C + added)
