"""A robot that is held in known poses one after the other, and the table of these poses as measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1.files import write_whole
from edition1.robot_file.robot_file import RobotFile
from edition1_live.robot.calibrate import pose_covariance
from edition1_live.robot.calibration_poses import coordinate_columns, farthest_points

LEAST_POSES = 12
"""Or four for every coordinate, where these are more."""
_SPREAD = 0.9
"""How far from the middle of its bounds a coordinate is held, as a share of the way to them."""
_CANDIDATES = 64
"""Of so many random poses for each that is wanted the ones farthest from each other are taken."""
MOVE_S = 0.5
"""From one pose to the next [s]."""
_SETTLED_S = 0.1
"""Still for so long before it is said [s]."""
LOOK_AHEAD_S = 0.05
"""How far a robot that waits for somebody looks ahead [s]."""
_WINDOW = (0.3, 0.7)
"""The part of the time that a pose is held which goes into the table."""
_LATE_S = 0.3
"""A recording begins about so long before the first reading: an emulated port waits for drivers to settle [s]."""
_POSE_NOISE = (2e-4, math.radians(0.5))
"""How well poses are measured [m, rad]: what ``repro calibrate`` assumes."""

Motion = Iterator[tuple[np.ndarray, np.ndarray]]
"""Times since the board was switched on [s] and configurations, one part of a motion after the other."""


def spread_poses(robot: RobotFile, *, seed: int = 0) -> Float[np.ndarray, "n n_q"]:
    """Return configurations that are far from each other; the first is where estimators start.

    They are four for every coordinate, and at least 12. Each of the others is, of random ones, the farthest from
    those before in widths of the bounds.

    Parameters
    ----------
    robot
        As described.
    seed
        Of the random ones.
    """
    low, high, start = (x.numpy() for x in (robot.lower, robot.upper, robot.start))
    count = max(LEAST_POSES, 4 * len(low))
    random = np.random.default_rng([seed, 4]).uniform(
        -_SPREAD / 2, _SPREAD / 2, (_CANDIDATES * count, len(low))
    )
    first = (start - (low + high) / 2) / (high - low)
    chosen = farthest_points(torch.from_numpy(random), torch.from_numpy(first), count - 1)
    return (low + high) / 2 + (high - low) * np.vstack([first, random[chosen]])


def measured_poses(
    robot: RobotFile, q: Float[np.ndarray, "n n_q"], *, seed: int = 0
) -> Float[np.ndarray, "n n_q"]:
    """Return configurations as somebody measured them: off by as much as ``repro calibrate`` assumes."""
    deviation = pose_covariance(robot, *_POSE_NOISE).diagonal().sqrt().numpy()
    return q + deviation * np.random.default_rng([seed, 5]).standard_normal(q.shape)


def write_poses(
    path: Path, robot: RobotFile, q: Float[np.ndarray, "n n_q"], *, hold_s: float | None = None
) -> None:
    """Write a table of poses, for ``repro calibrate``; with ``start_s`` and ``end_s`` if their times are known.

    Parameters
    ----------
    path
        A new file; one that is there may hold the same table.
    robot
        As described.
    q
        As measured.
    hold_s
        How long each is held [s], as by :func:`held_in_time`.

    Raises
    ------
    InputError
        If there is another file of this name.
    """
    columns = coordinate_columns(robot)
    names, rows = list(columns), q / np.array(list(columns.values()))
    decimals = [3] * len(names)
    if hold_s is not None:
        start_s = _LATE_S + np.arange(len(q)) * (hold_s + MOVE_S)
        names += ["start_s", "end_s"]
        rows = np.column_stack([rows, *(start_s + share * hold_s for share in _WINDOW)])
        decimals += [2, 2]
    lines = [",".join(f"{x:.{n}f}" for x, n in zip(row, decimals, strict=True)) for row in rows]
    text = "\n".join([",".join(names), *lines]) + "\n"
    if path.exists() and path.read_bytes() != text.encode():
        raise bad_input("hold_poses", "repro emulate", "a new file, or the same table", path)
    write_whole(path, text)


def held_in_time(q: Float[np.ndarray, "n n_q"], rate_hz: float, hold_s: float) -> Motion:
    """Hold every pose for ``hold_s``, and move to the next in :data:`MOVE_S`; ends with the last.

    Raises
    ------
    InputError
        If there is no time to hold a pose.
    """
    require(0 < hold_s < math.inf, "hold", "repro emulate", "above zero [s]", hold_s)
    each_s = hold_s + MOVE_S
    first = 0
    for k in range(len(q)):
        last = math.ceil((k + 1) * each_s * rate_hz - 1e-6)
        if k == len(q) - 1:
            last = max(first + 1, last - math.floor(MOVE_S * rate_hz))
        time_s = np.arange(first, last) / rate_hz
        follows = q[min(k + 1, len(q) - 1)]
        yield time_s, _between(q[k], follows, (time_s - k * each_s - hold_s) / MOVE_S)
        first = last


def held_by_hand(
    q: Float[np.ndarray, "n n_q"],
    rate_hz: float,
    told_to_move: Callable[[], bool],
    say: Callable[[int], object],
) -> Motion:
    """Hold every pose until somebody wants the next; the last for ever.

    Parameters
    ----------
    q
        Configurations.
    rate_hz
        Rounds of readings per second.
    told_to_move
        Whether to go on to the next pose; asked all the time while a pose is held and there is a next one.
    say
        Called with the number of a pose, from 0, once it is held.
    """
    size, first = max(1, round(LOOK_AHEAD_S * rate_hz)), 0
    settled = math.ceil(_SETTLED_S / LOOK_AHEAD_S)
    for k in range(len(q)):
        parts = 0
        while True:
            time_s = np.arange(first, first + size) / rate_hz
            first += size
            yield time_s, np.tile(q[k], (size, 1))
            parts += 1
            if parts == settled:
                say(k)
            if parts >= settled and k + 1 < len(q) and told_to_move():
                break
        left = first / rate_hz
        last = first + math.ceil(MOVE_S * rate_hz)
        for begin in range(first, last, size):
            time_s = np.arange(begin, min(begin + size, last)) / rate_hz
            yield time_s, _between(q[k], q[k + 1], (time_s - left) / MOVE_S)
        first = last


def _between(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    """From one pose (share 0 and below) to another (1 and above), with continuous acceleration."""
    s = np.clip(share, 0.0, 1.0)[:, None]
    return a + (b - a) * s**3 * (10 - 15 * s + 6 * s**2)
