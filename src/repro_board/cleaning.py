"""What no robot reads and no pose explains: spikes, frozen poses, rows that are not whole. All of it is told."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from repro.common import Array, require
from repro.robot import Robot
from repro_board.report import some

SPIKE = 6.0
"""A sample farther from the median than so many deviations is left out."""


def averaged(
    robot: Robot, t: Array, u: Array, windows: Array, where: Sequence[str]
) -> tuple[Array, list[str]]:
    """Return the mean readings of every held pose, NaN where there are none, and what was left out."""
    means, spikes, moved, noise = [], [], [], np.nan_to_num(np.asarray(robot.total_noise, dtype=float))
    for (begin, end), place in zip(windows, where, strict=True):
        if not math.isfinite(begin + end):
            means.append(np.full(u.shape[1], np.nan))
            continue
        rows = np.flatnonzero((t >= begin - 1e-9) & (t <= end + 1e-9))
        span = f"within the readings, {t[0]:g} to {t[-1]:g} s after the first"
        span += " (start_board_s and start_unix_s are times of other clocks)"
        require(len(rows), "pose", f"{place},", span, f"none from {begin:g} to {end:g} s")
        x = np.ma.masked_invalid(u[rows])
        middle = np.ma.median(x, axis=0)
        off = np.abs(x - middle)
        x[off > SPIKE * np.maximum(1.4826 * np.ma.median(off, axis=0), noise)] = np.ma.masked
        for row, j in np.argwhere(x.mask & np.isfinite(u[rows])):
            seen = f"{u[rows[row], j]:.4g}, not {middle[j]:.4g}"
            spikes.append(f"{robot.names[j]} at {t[rows[row]]:g} s ({seen})")
        moved += [place] if (x.std(axis=0) > 5 * noise).any() else []
        means.append(x.mean(axis=0).filled(np.nan))
    remarks = {f"Readings that do not fit their hold, and are left out: {len(spikes)}": spikes}
    remarks |= {f"Poses in which the readings were not still: {len(moved)}": moved}
    return np.array(means), [f"{text}: {some(names)}." for text, names in remarks.items() if names]


def complete(x: Array, what: str, owner: str, labels: Sequence[str], least: int) -> Array:
    """Return which rows are complete; refuse too few, and say what is missing most often."""
    missing = np.isnan(x)
    whole = np.asarray(~missing.any(axis=1))
    received = f"{whole.sum()} of {len(x)}, most often without {labels[int(missing.sum(0).argmax())]}"
    require(whole.sum() >= least, what, owner, f"complete in {least} rows or more", received)
    return whole


def repeats(q: Array) -> Array:
    """Return which poses ``[t]`` equal the one before."""
    return np.concatenate([[False], (q[1:] == q[:-1]).all(1)])


def frozen(q: Array, times: Array, t: Array, u: Array, noise: Array) -> Array:
    """Return which poses ``[t]`` repeat the one before while the readings move."""
    same, found = repeats(q), np.zeros(len(q), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([same, [False]]).astype(int), prepend=0))
    for begin, end in edges.reshape(-1, 2):
        first, last = np.searchsorted(t, [times[begin - 1], times[end - 1]])
        beside = int(last - first < 3)  # a short hold has too few readings of its own
        x = u[max(first - beside, 0) : last + beside]
        x = x[np.isfinite(x).all(1)]
        found[begin:end] = len(x) > 1 and (np.ptp(x, axis=0) > SPIKE * noise).any()
    return found


def orientations(robot: Robot, u: Array, k: int) -> tuple[Array, slice]:
    """Return rows and columns of what an IMU has measured."""
    first = robot.n_readings - 3 * (len(robot.imus) - k)
    columns = slice(first, first + 3)
    return np.flatnonzero(np.isfinite(u[:, columns]).all(1)), columns


def unwrapped(robot: Robot, u: Array) -> Array:
    """Return readings with orientations relative to their mean: no rotation vector jumps by a turn."""
    u = u.copy()
    for k in range(len(robot.imus)):
        rows, columns = orientations(robot, u, k)
        if len(rows):
            turns = Rotation.from_rotvec(u[rows, columns])
            u[rows, columns] = (turns.mean().inv() * turns).as_rotvec()
    return u


def without_spikes(robot: Robot, q: Array, u: Array, t: Array, lines: list[str]) -> Array:
    """Return readings ``[t, s]`` without those far beyond what the robot should read in its poses: errors of the bus.

    Orientations are whole, or missing.
    """
    u, n = u.copy(), robot.n_magnetic
    drawn = robot.sensing()(q[np.isfinite(q).all(1)])[:, :n]
    off = np.abs(u[:, :n] - np.nanmedian(u[:, :n], axis=0))
    usual = np.maximum(SPIKE * 1.4826 * np.nanmedian(off, axis=0), 2 * np.ptp(drawn, axis=0))
    far = off > np.maximum(usual, SPIKE * np.nan_to_num(np.asarray(robot.total_noise, dtype=float))[:n])
    u[:, :n][far] = np.nan
    if (rows := far.any(1)).any():
        when = some([f"{x:.2f} s" for x in t[rows & ~np.roll(rows, 1)]])
        what = "Readings far beyond all others, left out of lag and calibration"
        lines.append(f"{what}: {far.sum()} in {rows.sum()} of {len(u)} rows, from {when}.")
    return u


def alike(q: Array, u: Array) -> Array:
    """Return which rows go with the others: their readings are a smooth function of the pose."""
    x, low, up = (q - q.mean(0)) / np.maximum(q.std(0), 1e-12), *np.triu_indices(q.shape[1])
    columns = np.column_stack([np.ones(len(q)), x, x[:, low] * x[:, up]])[:, : len(q) // 4]
    there = np.asarray(np.isfinite(u).all(1))
    keep, v = there, u / u[there].std(0).clip(1e-12)
    for _ in range(5):
        size = np.linalg.norm(v - columns @ np.linalg.lstsq(columns[keep], v[keep])[0], axis=1)
        keep = there & (size <= SPIKE * np.median(size[keep]))
    return keep | ~there
