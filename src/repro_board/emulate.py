"""A robot that is not there: how it moves, and what its sensors read when they fail. All of it is synthetic."""

from __future__ import annotations

from typing import Any

import numpy as np

from repro import Robot
from repro.common import Array, numbers, require

SPEED = 0.5
"""Largest speed of every coordinate [widths of its bounds per second]."""
REACH = 0.9
"""How far a coordinate goes from the middle of its bounds, as a share of the way to them."""
_EASE_S = 0.5
"""Time constant with which a motion begins [s]."""
FAULTS = ("missing", "unplugged", "stuck", "saturated", "scaled", "drifting", "spike", "frozen")


def course(robot: Robot, times: Any, *, seed: int = 0) -> Array:
    r"""Return configurations ``[t, n_q]`` of a smooth motion between the bounds of a robot.

    Every coordinate is the sum of two sines, whose frequencies, shares and signs are random. The motion begins at
    rest at the robot's start: its own time is :math:`t - \tau (1 - e^{-t/\tau})`.

    Parameters
    ----------
    robot
        With bounds.
    times
        Since the beginning [s].
    seed
        The same seed gives the same motion at whatever times.

    Raises
    ------
    InputError
        If the robot has no bounds.

    Examples
    --------
    >>> from repro import ConstantCurvature, Robot
    >>> robot = Robot([ConstantCurvature(0.1, 0.02)], lower=[-0.01, -0.01, 0.0], upper=[0.01, 0.01, 0.01])
    >>> course(robot, [0.0, 10.0]).round(4) + 0.0
    array([[0.    , 0.    , 0.005 ],
           [0.0067, 0.0043, 0.0011]])
    """
    if robot.lower is None or robot.upper is None:
        require(False, "robot", "course", "one with bounds", "none stated")
    low, high = np.asarray(robot.lower), np.asarray(robot.upper)
    middle, half = (low + high) / 2, (high - low) / 2
    start = middle if robot.start is None else robot.start
    rng, n = np.random.default_rng(seed), len(low)
    major = REACH * rng.uniform(0.6, 0.8, n)
    share = np.stack([major, REACH - major])
    ratio = np.stack([rng.uniform(0.7, 1.0, n), rng.uniform(1.5, 2.2, n)])
    frequency = (
        2 * SPEED * ratio / (share * ratio).sum(axis=0)
    )  # the speeds of both add up to the limit [rad/s]
    sign = rng.choice([-1.0, 1.0], n)
    away = np.divide(start - middle, REACH * half, out=np.zeros(n), where=half > 0)
    t = numbers(times, "times", "course", (None,))[:, None, None]
    t = t + _EASE_S * np.expm1(-t / _EASE_S)
    sines = share * np.sin(t * frequency + np.arcsin(np.clip(sign * away, -1, 1)))
    return middle + half * sign * sines.sum(axis=1)


def faulty(readings: Any, fault: str, columns: Any, since: int = 0, size: float | None = None) -> Array:
    """Return readings of sensors that fail from one row on; the rows before stay as they are.

    ============ ==================================================================== ==========================
    fault        the columns read from then on                                        ``size``
    ============ ==================================================================== ==========================
    missing      nothing: NaN                                                         –
    unplugged    the same value, as an open input does                                that value, 0
    stuck        what they read in the row before                                     –
    saturated    no more than a limit, on either side of zero                         the limit; else the median
                                                                                      of what they read
    scaled       too much by a share                                                  the share, 0.05
    drifting     an error that grows by the same step in every row                    the step
    spike        one impossible value in that row only                                the value
    frozen       all columns, whatever is named, repeat the row before               –
    ============ ==================================================================== ==========================

    Parameters
    ----------
    readings
        Without a fault ``[t, s]``.
    fault
        One of the table.
    columns
        Readings that fail: one number, several for a whole chip, or a mask ``[s]``.
    since
        First row of the fault.
    size
        As the table says, in the unit of the readings.

    Raises
    ------
    InputError
        If there is no such fault, or it needs a size.

    Examples
    --------
    >>> u = np.arange(8.0).reshape(4, 2)
    >>> faulty(u, "stuck", 1, since=2)[:, 1]
    array([1., 3., 3., 3.])
    """
    owner = "faulty"
    require(fault in FAULTS, "fault", owner, f"one of {', '.join(FAULTS)}", repr(fault))
    u = numbers(readings, "readings", owner, (None, None), finite=False).copy()
    needs = fault in ("drifting", "spike")
    require(size is not None or not needs, "size", owner, f"given for {fault}", "nothing")
    chosen = np.zeros(u.shape[1], dtype=bool)
    chosen[columns] = True
    chosen |= fault == "frozen"
    late, before = u[since:, chosen], u[max(since - 1, 0), chosen]
    if fault == "spike":
        late[:1] = size
    elif fault == "saturated":
        limit = np.nanmedian(np.abs(u[:, chosen]), axis=0) if size is None else size
        late = np.clip(late, -limit, limit)
    else:
        steps = np.arange(1, len(late) + 1)[:, None]
        late = {
            "missing": np.full(late.shape, np.nan),
            "unplugged": np.full(late.shape, size or 0.0),
            "scaled": (1 + (0.05 if size is None else size)) * late,
            "drifting": late + (size or 0.0) * steps,
        }.get(fault, np.broadcast_to(before, late.shape))
    u[since:, chosen] = late
    return u
