"""The one loop that runs estimators over recorded readings, forwards, and backwards for filters."""

from __future__ import annotations

from typing import Any

import numpy as np

from repro.common import Array, array, bad_input, is_table, numbers, require
from repro.estimators.base import Estimator, NearMagnets, Watched, robot_of
from repro.estimators.kalman import MotionModel, smoothed
from repro.estimators.monitor import Monitor
from repro.estimators.trajectory import Trajectory, trajectory
from repro.parts import Assembly
from repro.tables import read_readings


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
    robot = robot_of(estimator)
    if robot is not None and is_table(readings):
        readings = read_readings(robot, readings)
    if times is None and rate_hz is None:
        times, rate_hz = _own_times(readings, robot, owner)
    rows = _rows(readings, robot, owner)
    at = _times(
        len(rows), times, rate_hz, owner, needed=isinstance(estimator, Watched) and estimator.needs_time
    )
    given = {name: _per_row(x, name, len(rows), owner) for name, x in (("mask", mask), ("known", known))}

    watch = None
    if monitor is not None and isinstance(estimator, Watched):  # not the estimators of papers
        watch = Monitor(estimator)
    method: Estimator = estimator if watch is None else watch
    state, near = method.init(q0, seed=seed), NearMagnets.of(robot, rows.shape[-1], q0)
    states, estimates, hidden = [], [], []
    for k in _with_bar(len(rows), progress):
        row = rows[k]
        if near is not None:
            hidden.append(near.readings())
            row = np.where(hidden[-1], np.nan, row)
        own = {name: values[k] for name, values in given.items() if values is not None}
        state, estimate = method.step(state, row, float(at[k]), **own)
        if near is not None:
            near.q = estimate.q
        states.append(state if watch is None else state.inner)
        estimates.append(estimate)

    found = trajectory(at, rows, estimates, robot, watch, given["mask"])
    if near is not None:
        found.details["too_near"] = np.array(hidden)
    return found, states


def _rows(readings: Any, robot: Assembly | None, owner: str) -> Array:
    """Return readings ``[t, ..., s]``, NaN for what is missing."""
    rows = numbers(readings, "readings", owner, finite=False)
    if robot is not None and rows.shape[-1:] == (robot.n_readings,):
        rows = np.where(robot.missing(rows) > 0, np.nan, rows)
    else:
        rows = np.where(np.abs(rows) < 1e100, rows, np.nan)  # no sensor can tell more
    require(rows.ndim >= 2 and len(rows), "readings", owner, "of shape (t, ..., s)", f"shape {rows.shape}")
    return rows


def _per_row(values: Any, name: str, n: int, owner: str) -> Array | None:
    """Return what is given for every time step, if anything is."""
    if values is None:
        return None
    found = array(values, name, owner)
    words = f"one row for each of {n} time steps"
    require(found.ndim and len(found) == n, name, owner, words, f"shape {found.shape}")
    return found


def _own_times(readings: Any, robot: Assembly | None, owner: str) -> tuple[Any, float | None]:
    """Return the times of readings, if they have any, and the rate of the robot."""
    times = getattr(readings, "times", None)
    index = getattr(getattr(readings, "index", None), "dtype", np.dtype(int))  # of a data frame without names
    lost = times is None and (index.kind in "fmM" or getattr(readings, "without_times", False))
    words = "given, one of the two: after what was done to the readings their own times are not known"
    require(not lost, "times, rate_hz", owner, words, "neither")
    return times, None if robot is None else robot.rate_hz


def smooth(
    method: Any,
    readings: Any,
    q0: Any = None,
    *,
    times: Any = None,
    rate_hz: float | None = None,
    mask: Any = None,
    known: Any = None,
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
    require(
        isinstance(method, MotionModel), "method", "smooth", "a Kalman or rod filter", type(method).__name__
    )
    found, states = run(
        method, readings, q0, times=times, rate_hz=rate_hz, seed=0, mask=mask, known=known, progress=progress,
        monitor=monitor, owner="smooth",
    )  # fmt: skip
    details = found.details
    back, n = smoothed(method, states, details.get("restarted")), found.q.shape[-1]
    q = np.stack([state.q[..., :n] for state in back])
    P = np.stack([state.covariance[..., :n, :n] for state in back])
    P = P * details["growth"][..., None, None] if "growth" in details else P
    values = {**vars(found), "q": q, "covariance": method.by_bounds(P)}
    return Trajectory(**values)


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
