"""Levenberg-Marquardt with bounds, compiled: all iterations of a time step, for a whole batch, in one call.

A prior, as the iterated Kalman filter has one, is further residuals.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from edition1.errors import require
from edition1.kernels._motion import array
from edition1.kernels._sensing import CompiledSensing, evaluate, room, rows
from edition1.kernels.compilation import machine_code

_EPS, _TINY = 2.0**-52, 2.0**-1022
_WELL_DETERMINED = 1e-6
"""Smallest pivot of the scaled information for which its inverse is taken directly."""


def fit(
    sensing: CompiledSensing,
    start: Tensor,
    u: Tensor,
    use: Tensor,
    free: Tensor,
    bounds: tuple[Tensor, Tensor],
    noise_mt: float,
    iterations: int,
    tolerance: float,
    *,
    prior: tuple[Tensor, Tensor] | None = None,
    owner: str = "LevenbergMarquardt",
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    r"""Minimise the squared residuals for every member of a batch.

    Parameters
    ----------
    sensing
        Sensor model.
    start
        Configurations ``[*batch, n_q]``.
    u, use
        Readings ``[*batch, s]``, and which of them to use.
    free
        Coordinates ``[*batch, n_q]`` that are not held.
    bounds, noise_mt, iterations
        As in :class:`~edition1.estimation.levenberg_marquardt.LevenbergMarquardt`.
    tolerance
        A trial step below this share of the width of the bounds ends the iteration.
    prior
        Mean :math:`m` ``[*batch, n_q]``, and :math:`W` ``[*batch, n_q, p]``: :math:`W^T (q - m)` are ``p`` further
        residuals in the unit of the readings.
    owner
        For messages.

    Returns
    -------
    tuple
        Configuration, predicted readings, root-mean-squared residual and iterations, in the precision of ``start``;
        Jacobian in double precision (zero for sensors not in use; then the rows of the prior), covariance and where
        it is one: elsewhere a direction is all but undetermined, and the covariance is left to the caller.

    Raises
    ------
    InputError
        If configurations or readings are not those of the robot, or a trial is not finite.
    """
    n_q, n_s = sensing.n_q, sensing.n_sensors
    mean, W = prior or (start, start.new_zeros(n_q, 0))
    batch = sensing.batch_of(owner, start, u, use, free, mean)
    q, free_, mean_ = (rows(x, batch, n_q) for x in (start, free, mean))
    u_, use_ = rows(u, batch, n_s), rows(use, batch, n_s)
    W_ = array(W.expand(*batch, *W.shape[-2:])).reshape(batch.numel(), *W.shape[-2:])
    n, n_rows = len(q), n_s + W.shape[-1]
    u_hat, rmse, count = np.empty((n, n_rows)), np.empty(n), np.empty(n)
    J, C, determined = np.zeros((n, n_rows, n_q)), np.zeros((n, n_q, n_q)), np.zeros(n, dtype=np.bool_)
    options = (*(array(x) for x in bounds), float(noise_mt), iterations, tolerance)
    data, found = (u_, use_, free_, mean_, W_), (u_hat, rmse, count, J, C, determined)
    lost = _fit(sensing.tables, sensing.which(batch), q, data, options, found)
    require(not lost, "q", "Robot", "finite", f"{lost} values that are NaN or infinite")
    arrays = (q, u_hat[:, :n_s], rmse, count, C, J, determined)
    *estimate, slopes, good = (torch.from_numpy(x).reshape((*batch, *x.shape[1:])) for x in arrays)
    best_q, best_u, error, turns, covariance = (x.to(start) for x in estimate)
    return best_q, best_u, error, turns, slopes, covariance, good


@machine_code()
def _fit(tables, which, q, data, options, found):
    """Fit every member of a flat batch; ``q`` and the arrays of ``found`` are overwritten.

    The rows of a prior stand behind those of the sensors.
    """
    u, use, free, mean, W = data
    low, high, noise, iterations, tolerance = options
    u_best, rmse, count, J_best, C, determined = found
    n_q, n_s, n_rows = q.shape[1], u.shape[1], u_best.shape[1]
    x, g, held = np.zeros(n_q), np.zeros(n_q), np.zeros(n_q, dtype=np.bool_)
    wanted, used = np.zeros(n_s, dtype=np.bool_), np.ones(n_rows, dtype=np.bool_)
    target, u_hat, J = np.zeros(n_rows), np.zeros(n_rows), np.zeros((n_rows, n_q))
    A, L = np.zeros((n_q, n_q)), np.zeros((n_q, n_q))
    space, lost = room(tables), 0
    for i in range(len(q)):
        n_used = n_rows - n_s
        for s in range(n_s):
            wanted[s], used[s], target[s] = use[i, s], use[i, s], u[i, s]
            n_used += 1 if use[i, s] else 0
        for p in range(n_s, n_rows):
            target[p] = 0.0
            for c in range(n_q):
                J[p, c] = W[i, c, p - n_s]
                target[p] += W[i, c, p - n_s] * mean[i, c]
        for c in range(n_q):
            x[c] = q[i, c]
        damping, best, turn, small, final = 1e-3, math.inf, 0, False, False
        while True:
            for c in range(n_q):
                lost += not math.isfinite(x[c])
            if lost > 0:
                return lost
            evaluate(tables, which[i], x, wanted, not final, u_hat[:n_s], J[:n_s], space)
            if final:
                for s in range(n_s):
                    if not use[i, s]:
                        u_best[i, s] = u_hat[s]
                break
            for p in range(n_s, n_rows):
                u_hat[p] = 0.0
                for c in range(n_q):
                    u_hat[p] += W[i, c, p - n_s] * x[c]
            error = 0.0
            for r in range(n_rows):
                if used[r]:
                    error += (target[r] - u_hat[r]) ** 2
            better = turn == 0 or error < best
            if turn > 0:
                damping = min(max(damping / 10.0 if better else damping * 10.0, 1e-12), 1e12)
            if better:
                best = error
                _accept(x, u_hat, J, target, used, q[i], u_best[i], J_best[i], A, g)
            if small or turn == iterations:
                rmse[i], count[i] = math.sqrt(best / n_used), turn
                if n_used == n_rows:
                    break
                final = True
                for s in range(n_s):
                    wanted[s] = not use[i, s]
                for c in range(n_q):
                    x[c] = q[i, c]
                continue
            for c in range(n_q):
                outwards = (q[i, c] <= low[c] and g[c] < 0.0) or (q[i, c] >= high[c] and g[c] > 0.0)
                held[c] = not free[i, c] or outwards
            _solve(A, g, damping, held, L, x)
            small = True
            for c in range(n_q):
                trial = min(max(q[i, c] + x[c], low[c]), high[c]) if free[i, c] else q[i, c]
                small = small and abs(trial - q[i, c]) <= tolerance * (high[c] - low[c])
                x[c] = trial
            turn += 1
        determined[i] = _covariance(J_best[i], free[i], noise, L, C[i])
    return lost


@machine_code()
def _accept(x, u_hat, J, u, use, q, u_best, J_best, A, g):
    """Take over a trial, and make the normal equations there."""
    n_q = len(x)
    for c in range(n_q):
        q[c], g[c] = x[c], 0.0
        for k in range(n_q):
            A[c, k] = 0.0
    for s in range(len(u)):
        if use[s]:
            u_best[s] = u_hat[s]
            r = u[s] - u_hat[s]
            for c in range(n_q):
                J_best[s, c] = J[s, c]
                g[c] += J[s, c] * r
                for k in range(c + 1):
                    A[c, k] += J[s, c] * J[s, k]


@machine_code()
def _solve(A, g, damping, held, L, delta):
    """Damped step for the free coordinates, zero for the others; of ``A`` the lower triangle counts."""
    n, largest = len(g), 0.0
    for c in range(n):
        largest = max(largest, A[c, c])
    floor = _EPS * largest + _TINY
    for c in range(n):
        for k in range(c):
            L[c, k] = 0.0 if held[c] or held[k] else A[c, k]
        L[c, c] = 1.0 if held[c] else A[c, c] + damping * max(A[c, c], floor) + floor
        delta[c] = 0.0 if held[c] else g[c]
    _cholesky(L, floor)
    for c in range(n):
        for k in range(c):
            delta[c] -= L[c, k] * delta[k]
        delta[c] /= L[c, c]
    for c in range(n - 1, -1, -1):
        for k in range(c + 1, n):
            delta[c] -= L[k, c] * delta[k]
        delta[c] /= L[c, c]


@machine_code()
def _cholesky(L, floor):
    """Cholesky factor in place of the lower triangle; return the smallest pivot, ``floor`` at least."""
    smallest = math.inf
    for c in range(len(L)):
        for k in range(c):
            total = L[c, k]
            for r in range(k):
                total -= L[c, r] * L[k, r]
            L[c, k] = total / L[k, k]
        pivot = L[c, c]
        for r in range(c):
            pivot -= L[c, r] * L[c, r]
        pivot = pivot if pivot > floor else floor
        smallest = min(smallest, pivot)
        L[c, c] = math.sqrt(pivot)
    return smallest


@machine_code()
def _covariance(J, free, noise, L, C):
    """Inverse of the information about the free coordinates; false where it is nearly singular."""
    n_s, n = J.shape
    for c in range(n):
        C[c, c] = 0.0
        for s in range(n_s):
            C[c, c] += J[s, c] * J[s, c]
        C[c, c] = math.sqrt(C[c, c]) if free[c] else 1.0  # the unit of each coordinate, for now
        if C[c, c] == 0.0:
            return False
    for c in range(n):
        for k in range(c):
            L[c, k] = 0.0
            if free[c] and free[k]:
                for s in range(n_s):
                    L[c, k] += (J[s, c] / C[c, c]) * (J[s, k] / C[k, k])
        L[c, c] = 1.0
    if not _cholesky(L, 0.0) > _WELL_DETERMINED:
        return False
    for c in range(n):  # the inverse of the factor, in the upper triangle of L
        for k in range(c):
            total = 0.0
            for r in range(k, c):
                total -= L[c, r] * (L[k, r] if r > k else 1.0 / L[k, k])
            L[k, c] = total / L[c, c]
    for c in range(n):
        for k in range(c):
            total = L[k, c] / L[c, c]
            for r in range(c + 1, n):
                total += L[k, r] * L[c, r]
            C[k, c] = noise * noise * total / (C[c, c] * C[k, k]) if free[c] and free[k] else 0.0
    for c in range(n):
        total = 1.0 / (L[c, c] * L[c, c])
        for r in range(c + 1, n):
            total += L[c, r] * L[c, r]
        unit = C[c, c]
        C[c, c] = noise * noise * total / (unit * unit) if free[c] else 0.0
        for k in range(c):
            C[c, k] = C[k, c]
    return True
