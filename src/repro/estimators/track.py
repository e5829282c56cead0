"""Estimates over time, and the one loop that makes them: forwards over readings, and backwards for filters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from repro.common import Array, array, bad_input, is_table, numbers, require
from repro.estimators.base import Estimate, Estimator, NearMagnets, Watched, robot_of
from repro.estimators.kalman import MotionModel, smoothed
from repro.estimators.monitor import SAID, STATUS, TRUSTED, Monitor
from repro.parts import Assembly
from repro.plots import plot_shape
from repro.readings import read_readings

_FITTING = tuple(STATUS[number] for number in TRUSTED)
"""What the monitor says of rows whose readings fit, by name."""
_UNMOVED = 1e-9
"""Slope of the tip [m per unit of a coordinate] that is rounding."""
_AT_ONCE = 256
"""So many estimates are held before their arrays are written: as objects they take ten times as much memory."""


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
        rows = "".join(f"; {n} row{'s' * int(n > 1)} {name}" for name, n in counts.items())
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
        return self.robot.units

    def to_frame(self) -> Any:
        """Return a data frame with names and units: ``time_s``, coordinates, tip, deviations, fit, status, suspects.

        The last column names the coordinates that touch a bound of the robot.

        A coordinate such as ``delta_x_1_mm`` has the standard deviation ``delta_x_1_sd_mm``. The tip is in the base
        frame: ``tip_x_mm`` and so on. Where nothing shows a coordinate its deviation is infinite, and so are those
        of the tip along the axes in which this coordinate moves it. Where a shape is not known, its tip is NaN.

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
                C = _carried(np.where(known[:, None, None], self.covariance, 0.0), G)
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
        return plot_shape(self, axes)


def _counted(names: Iterable[str], counts: Iterable[int]) -> str:
    return ", ".join(
        f"{name} in {k} row{'s' * int(k > 1)}" for name, k in zip(names, counts, strict=True) if k
    )


def _carried(C: Array, G: Array) -> Array:
    """Return covariances behind slopes ``[t, m, n]``, infinite along axes that an open coordinate moves."""
    open_ = np.isinf(np.diagonal(C, axis1=1, axis2=2))
    known = ~(open_[:, :, None] | open_[:, None, :])
    found = G @ np.where(known, C, 0.0) @ np.swapaxes(G, 1, 2)
    moved = (np.abs(G) * open_[:, None, :] > _UNMOVED).any(axis=2)
    found[:, *np.diag_indices(G.shape[1])] += np.where(moved, np.inf, 0.0)
    return found


def _listed(names: Sequence[str], marks: Array) -> Array:
    """Return the names that are marked ``[t, n]`` in every row, as a text."""
    return np.array([", ".join(n for n, mark in zip(names, row, strict=True) if mark) for row in marks])


def trajectory(
    at: ArrayLike,
    readings: ArrayLike,
    estimates: Sequence[Estimate],
    robot: Assembly | None,
    monitor: Monitor | None,
    mask: Array | None = None,
) -> Trajectory:
    """Put estimates of rows together, with what a monitor said of them."""
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


def track(
    estimator: Estimator,
    readings: Any,
    q0: ArrayLike | None = None,
    *,
    times: ArrayLike | None = None,
    rate_hz: float | None = None,
    seed: int = 0,
    mask: ArrayLike | None = None,
    known: ArrayLike | None = None,
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
    require(isinstance(estimator, Estimator), "estimator", "track", "an estimator", type(estimator).__name__)
    rows = _rows_of(estimator, readings, times, rate_hz, mask, known, "track")
    return _run(estimator, rows, q0, seed, progress, monitor, "track")[0]


class _Rows(NamedTuple):
    """What a run goes over: readings, times, and where given masks and known coordinates, one row each."""

    u: Array
    t: Array
    given: dict[str, Array]
    robot: Assembly | None


def _rows_of(
    estimator: Estimator,
    readings: Any,
    times: ArrayLike | None,
    rate_hz: float | None,
    mask: ArrayLike | None,
    known: ArrayLike | None,
    owner: str,
) -> _Rows:
    """Read what is given to a run."""
    robot = robot_of(estimator)
    if robot is not None and is_table(readings):
        readings = read_readings(robot, readings)
    if times is None and rate_hz is None:
        times, rate_hz = _own_times(readings, robot, owner)
    u = _readings(readings, robot, owner)
    needed = isinstance(estimator, Watched) and estimator.needs_time
    at = _times(len(u), times, rate_hz, owner, needed=needed)
    given = {
        name: _per_row(x, name, len(u), owner)
        for name, x in (("mask", mask), ("known", known))
        if x is not None
    }
    return _Rows(u, at, given, robot)


def _run(
    estimator: Estimator,
    rows: _Rows,
    q0: ArrayLike | None,
    seed: int,
    progress: str | None,
    monitor: str | None,
    owner: str,
) -> tuple[Trajectory, list[Any]]:
    """Return the estimates, and the states for ``smooth`` alone: the loop of ``track`` and of ``smooth``."""
    require(monitor in ("auto", None), "monitor", owner, '"auto" or None', repr(monitor))
    watch = None
    if monitor is not None and isinstance(estimator, Watched):  # not the estimators of papers
        watch = Monitor(estimator)
    method: Estimator = estimator if watch is None else watch
    state, near = method.init(q0, seed=seed), NearMagnets.of(rows.robot, rows.u.shape[-1], q0)
    given, n, times = rows.given, len(rows.u), rows.t.tolist()
    states, estimates, hidden = [], [], []
    found: dict[str, Any] = {}
    for k in with_bar(n, progress):
        u = rows.u[k]
        if near is not None:
            hidden.append(near.readings())
            u = np.where(hidden[-1], np.nan, u)
        state, estimate = method.step(state, u, times[k], **{name: x[k] for name, x in given.items()})
        if near is not None:
            near.q = estimate.q
        if owner == "smooth":
            states.append(state if watch is None else state.inner)
        estimates.append(estimate)
        if len(estimates) == _AT_ONCE or k == n - 1:
            some = slice(k + 1 - len(estimates), k + 1)
            mask = given["mask"][some] if "mask" in given else None
            part = trajectory(rows.t[some], rows.u[some], estimates, rows.robot, watch, mask)
            _write(found, vars(part), some, n)
            if near is not None:
                _write(found["details"], {"too_near": np.array(hidden)}, some, n)
            estimates, hidden = [], []
    return Trajectory(**{**found, "times": np.array(rows.t), "readings": rows.u, "robot": rows.robot}), states


def _write(arrays: dict[str, Any], part: dict[str, Any], some: slice, n: int) -> None:
    """Write some rows into the arrays of all ``n`` rows, which the first ones make."""
    for name, values in part.items():
        if isinstance(values, dict):
            _write(arrays.setdefault(name, {}), values, some, n)
        elif isinstance(values, np.ndarray) and name not in ("times", "readings"):
            room = arrays.get(name, np.empty((n, *values.shape[1:]), values.dtype))
            arrays[name] = room.astype(np.result_type(room, values), copy=False)
            arrays[name][some] = values
        else:
            arrays[name] = values


def _readings(readings: Any, robot: Assembly | None, owner: str) -> Array:
    """Return readings ``[t, ..., s]``, NaN for what is missing."""
    rows = numbers(readings, "readings", owner, finite=False)
    if robot is not None and rows.shape[-1:] == (robot.n_readings,):
        rows = np.where(robot.missing(rows) > 0, np.nan, rows)
    else:
        rows = np.where(np.abs(rows) < 1e100, rows, np.nan)  # no sensor can tell more
    require(rows.ndim >= 2 and len(rows), "readings", owner, "of shape (t, ..., s)", f"shape {rows.shape}")
    return rows


def _per_row(values: ArrayLike, name: str, n: int, owner: str) -> Array:
    """Return what is given for every time step."""
    found = array(values, name, owner)
    words = f"one row for each of {n} time steps"
    require(found.ndim and len(found) == n, name, owner, words, f"shape {found.shape}")
    return found


def _own_times(readings: Any, robot: Assembly | None, owner: str) -> tuple[Array | None, float | None]:
    """Return the times of readings, if they have any, and the rate of the robot."""
    times = getattr(readings, "times", None)
    index = getattr(getattr(readings, "index", None), "dtype", np.dtype(int))  # of a data frame without names
    lost = times is None and (index.kind in "fmM" or getattr(readings, "without_times", False))
    words = "given, one of the two: after what was done to the readings their own times are not known"
    require(not lost, "times, rate_hz", owner, words, "neither")
    return times, None if robot is None else robot.rate_hz


def smooth(
    method: object,
    readings: Any,
    q0: ArrayLike | None = None,
    *,
    times: ArrayLike | None = None,
    rate_hz: float | None = None,
    mask: ArrayLike | None = None,
    known: ArrayLike | None = None,
    progress: str | None = None,
    monitor: str | None = "auto",
) -> Trajectory:
    """Run a filter over recorded readings, then backwards: the sibling of :func:`repro.track`.

    The predicted readings, ``chi2``, the details, ``status`` and ``suspects`` are those of the filter.

    Parameters
    ----------
    method
        A Kalman or rod filter.
    readings, q0, times, rate_hz, mask, known, progress, monitor
        As for :func:`repro.track`.

    Raises
    ------
    InputError
        If the estimator does not say how its state moves, or as :func:`repro.track`.

    Examples
    --------
    A coordinate that was read at both ends of a second was halfway in its middle:

    >>> from repro import KalmanFilter
    >>> method = KalmanFilter(lambda q: q, [-9.0], [9.0], noise=1e-4, acceleration=[1.0], velocity=[100.0])
    >>> smooth(method, [[0.0], [np.nan], [1.0]], [0.0], times=[0.0, 0.5, 1.0]).q.ravel().round(3) + 0.0
    array([0. , 0.5, 1. ])
    """
    if not (isinstance(method, MotionModel) and isinstance(method, Estimator)):
        raise bad_input("method", "smooth", "a Kalman or rod filter", type(method).__name__)
    rows = _rows_of(method, readings, times, rate_hz, mask, known, "smooth")
    found, states = _run(method, rows, q0, 0, progress, monitor, "smooth")
    details = found.details
    back, n = smoothed(method, states, details.get("restarted")), found.q.shape[-1]
    q = np.stack([state.q[..., :n] for state in back])
    P = np.stack([state.covariance[..., :n, :n] for state in back])
    P = P * details["growth"][..., None, None] if "growth" in details else P
    values = {**vars(found), "q": q, "covariance": method.by_bounds(P)}
    return Trajectory(**values)


def _times(n: int, times: ArrayLike | None, rate_hz: float | None, owner: str, *, needed: bool) -> Array:
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


def with_bar(n: int, label: str | None) -> Iterable[int]:
    """Return the numbers below ``n``, with a progress bar if it has a label."""
    if label is None:
        return range(n)
    from rich.progress import track as bar

    return bar(range(n), description=label)
