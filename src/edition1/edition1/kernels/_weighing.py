"""What readings say about a cloud of particles, compiled for one cube on a bent arc: `particle_cloud.weighed`."""

from __future__ import annotations

import math

import numpy as np

from edition1.kernels._bend_series import series_field
from edition1.kernels.compilation import machine_code

_FLOOR = math.sqrt(2.0**-1022)
"""Smallest weight: its square is no denormal number."""
_LOG_FLOOR = math.log(_FLOOR)


@machine_code(reorder=True)
def weigh(q, u, use, noise, coefficients, reach, keep, w, mean, C, ess, unlikely, top):
    """Weigh every member of a flat batch; the last six arguments are overwritten."""
    n = q.shape[1]
    x, y, d, e, scratch = np.empty(n), np.empty(n), np.empty(n), np.empty((3, n)), np.empty((5, n))
    for m in range(len(q)):
        for i in range(n):
            x[i], y[i], d[i] = q[m, i, 0], q[m, i, 1], 0.0
        series_field(x, y, coefficients, reach, scratch, e)
        for s in range(3):
            if use[m, s]:
                reading, error = u[m, s], e[s]
                for i in range(n):
                    error[i] -= reading
                    d[i] += error[i] * error[i]
            else:
                e[s] = 0.0
        unlikely[m] = _surprise(e, use[m], noise)
        total, least, share_of, scale = 0.0, np.min(d), w[m], -0.5 / (noise * noise)
        for i in range(n):
            share_of[i] = math.exp(max(scale * (d[i] - least), _LOG_FLOOR))
            total += share_of[i]
        squares, mean_x, mean_y, scale = 0.0, 0.0, 0.0, 1.0 / total
        for i in range(n):
            share = max(scale * share_of[i], _FLOOR)
            share_of[i] = share
            squares += share * share
            mean_x += share * x[i]
            mean_y += share * y[i]
        xx, xy, yy = 0.0, 0.0, 0.0
        for i in range(n):
            share, off_x, off_y = share_of[i], x[i] - mean_x, y[i] - mean_y
            xx += share * off_x * off_x
            xy += share * off_x * off_y
            yy += share * off_y * off_y
        ess[m], mean[m, 0], mean[m, 1] = 1.0 / squares, mean_x, mean_y
        C[m, 0, 0], C[m, 0, 1], C[m, 1, 0], C[m, 1, 1] = xx, xy, xy, yy
        if keep > 0:
            _best(x, y, d, keep, top[m])


@machine_code(reorder=True)
def _surprise(e, use, noise):
    """By how many standard deviations the readings are too unlikely: see ``particle_cloud.surprise``."""
    n, dof = e.shape[1], 0
    m, S = np.empty(3), np.empty((3, 3))
    for s in range(3):
        dof += 1 if use[s] else 0
        m[s] = np.sum(e[s]) / n
    for s in range(3):
        for t in range(s + 1):
            total, m_s, m_t = 0.0, m[s], m[t]
            for i in range(n):
                total += (e[s, i] - m_s) * (e[t, i] - m_t)
            S[s, t] = total / n + (noise * noise if s == t else 0.0)
    squared = 0.0
    for s in range(3):  # Cholesky's factor in place, and the square of its inverse times the mean
        for t in range(s + 1):
            for k in range(t):
                S[s, t] -= S[s, k] * S[t, k]
            S[s, t] = S[s, t] / S[t, t] if t < s else math.sqrt(S[s, s])
        for t in range(s):
            m[s] -= S[s, t] * m[t]
        m[s] /= S[s, s]
        squared += m[s] * m[s]
    spread = 2.0 / (9.0 * dof)
    return ((squared / dof) ** (1.0 / 3.0) - 1.0 + spread) / math.sqrt(spread)


@machine_code(reorder=True)
def _best(x, y, d, keep, top):
    """Mean angle towards the mean direction of the ``keep`` best particles: see ``particle_cloud.best_tenth``."""
    limit, ties = _smallest(d, keep)
    angle, direction_x, direction_y = 0.0, 0.0, 0.0
    for i in range(len(d)):
        if d[i] > limit or (d[i] == limit and ties <= 0):
            continue
        ties -= 1 if d[i] == limit else 0
        length = math.sqrt(x[i] * x[i] + y[i] * y[i])
        angle += length
        if length > 0.0:
            direction_x += x[i] / length
            direction_y += y[i] / length
    length = math.sqrt(direction_x * direction_x + direction_y * direction_y)
    share = angle / keep / length if length > 0.0 else 0.0
    top[0], top[1] = share * direction_x, share * direction_y


@machine_code(reorder=True)
def _smallest(d, keep):
    """Limit below which ``keep`` numbers lie, and how many of those at the limit count as well."""
    # Halving takes a few passes without branches; those of a sorting algorithm are a guess each, on a new cloud.
    low, high = np.min(d), np.max(d)
    for _ in range(64):
        middle, below = 0.5 * (low + high), 0
        for i in range(len(d)):
            below += 1 if d[i] < middle else 0
        if below == keep:
            return middle, 0
        if below < keep:
            low = middle
        else:
            high = middle
    limit, ties = np.partition(d, keep - 1)[keep - 1], keep  # some are equal, or all but equal
    for i in range(len(d)):
        ties -= 1 if d[i] < limit else 0
    return limit, ties
