"""The gradient descent of Baaij et al. 2023 (eqs 9-12) compiled: all iterations of a time step in one call."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from edition1.errors import require
from edition1.kernels._motion import array
from edition1.kernels._sensing import CompiledSensing, evaluate, room, rows
from edition1.kernels.compilation import machine_code


def descend(
    sensing: CompiledSensing,
    start: tuple[Tensor, Tensor],
    u: Tensor,
    use: Tensor,
    free: Tensor,
    step_size: Tensor,
    momentum: float,
    iterations: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Descend from one configuration and momentum per member of the batch.

    Parameters
    ----------
    sensing
        Sensor model.
    start
        Configurations and momenta ``[*batch, n_q]``.
    u, use
        Readings ``[*batch, s]``, and which of them to use.
    free
        Coordinates ``[*batch, n_q]`` that are not held.
    step_size, momentum, iterations
        As in :class:`~edition1.estimation.gradient_descent.GradientDescent`.

    Returns
    -------
    tuple
        Best configuration, last momentum, readings predicted at the best configuration, its loss and iteration, in
        the precision of ``start``.

    Raises
    ------
    InputError
        If the readings are not those of the robot, or the descent leaves the finite numbers.
    """
    n_q, n_s = sensing.n_q, sensing.n_sensors
    batch = sensing.batch_of("GradientDescent", start[0], u, use, free)
    q, b, free_ = (rows(x, batch, n_q) for x in (*start, free))
    u_, use_ = (rows(x, batch, n_s) for x in (u, use))
    u_hat, loss, at = np.empty_like(u_), np.empty(len(q)), np.empty(len(q))
    model, options = (sensing.tables, sensing.which(batch)), (array(step_size), float(momentum), iterations)
    lost = _descend(*model, q, b, u_, use_, free_, *options, u_hat, loss, at)
    require(not lost, "q", "Robot", "finite", f"{lost} values that are NaN or infinite")
    found = (torch.from_numpy(x).reshape((*batch, *x.shape[1:])) for x in (q, b, u_hat, loss, at))
    best_q, last_b, best_u, best_loss, best_at = (x.to(start[0]) for x in found)
    return best_q, last_b, best_u, best_loss, best_at


@machine_code()
def _descend(tables, which, q, b, u, use, free, step_size, momentum, iterations, u_best, loss_best, at_best):
    """Descend for every member of a flat batch; ``q``, ``b`` and the last three arguments are overwritten."""
    n_q, n_s = q.shape[1], u.shape[1]
    u_hat, J, x, wanted = np.zeros(n_s), np.zeros((n_s, n_q)), np.zeros(n_q), np.zeros(n_s, dtype=np.bool_)
    space, lost = room(tables), 0
    for i in range(len(q)):
        loss_best[i], at_best[i], weight = math.inf, 0.0, 0.0
        for s in range(n_s):
            wanted[s], u_best[i, s] = use[i, s], u[i, s]
            weight += 1.0 if use[i, s] else 0.0
        for c in range(n_q):
            x[c] = q[i, c]
        for iteration in range(iterations + 1):
            if iteration == iterations:  # what the sensors that are not in use would read at the best
                for s in range(n_s):
                    wanted[s] = not use[i, s]
                for c in range(n_q):
                    x[c] = q[i, c]
            for c in range(n_q):
                lost += not math.isfinite(x[c])
            if lost > 0:
                return lost
            evaluate(tables, which[i], x, wanted, iteration < iterations - 1, u_hat, J, space)
            loss = 0.0
            for s in range(n_s):
                if use[i, s]:
                    loss += (u_hat[s] - u[i, s]) ** 2 / weight
            better = iteration < iterations and loss < loss_best[i]
            if better:
                loss_best[i], at_best[i] = loss, iteration
            for s in range(n_s):
                if wanted[s] and (better or iteration == iterations):
                    u_best[i, s] = u_hat[s]
            for c in range(n_q):
                if better:
                    q[i, c] = x[c]
                if iteration < iterations - 1:
                    slope = 0.0
                    for s in range(n_s):
                        if use[i, s]:
                            slope += 2.0 / weight * (u_hat[s] - u[i, s]) * J[s, c]
                    held = 1.0 if free[i, c] else 0.0
                    b[i, c] = momentum * b[i, c] + held * slope  # eq. (11)
                    x[c] -= held * step_size[c] * b[i, c]
    return lost
