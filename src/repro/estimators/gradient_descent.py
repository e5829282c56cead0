r"""Gradient descent on the squared error of the readings, as in Baaij et al. 2023, section 2.4."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, bad_input, kernel, numbers, require
from repro.estimators.base import Estimate, each, incoming, known_coordinates, model_of, start
from repro.sensing import difference, evaluate, room_for, unpack


class DescentState(NamedTuple):
    """Where the descent stands: configuration and momentum ``b`` of eq. (11)."""

    q: Array
    momentum: Array


class GradientDescent:
    r"""Estimator of eqs (9) to (12): a few steps of gradient descent at every time step.

    From the last estimate it evaluates the loss, the mean squared error of the readings, ``iterations`` times, with
    an update :math:`b \leftarrow \nabla + \mu b,\ q \leftarrow q - \gamma b` between two evaluations. The iterate
    with the smallest loss is the estimate and the next start. The momentum is carried from one time step to the next,
    as in the released code.

    The gradient is quadratic in the readings, so step sizes belong to a magnet: for readings that are ``c`` times
    smaller, step sizes ``c**2`` times larger give the same iterates. Where a step size is too long for the curvature
    of the loss the descent is chaotic: iterates that differ by rounding end apart.

    Parameters
    ----------
    sensing
        Configuration to readings, as for :class:`repro.LevenbergMarquardt`.
    step_size
        Step size :math:`\gamma` of every coordinate.
    momentum
        Momentum :math:`\mu`.
    iterations
        Evaluations of the loss in each time step.
    noise
        Standard deviation of a reading, one number or one for each. The descent does not need it; without it ``chi2``
        is NaN.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    The loss (u - 2 q)^2 has its minimum at u/2:

    >>> from repro import GradientDescent
    >>> method = GradientDescent(lambda q: 2 * q, step_size=[0.1])
    >>> method.step(method.init([0.0]), [1.0])[1].q.round(3)
    array([0.5])
    """

    def __init__(
        self, sensing: Any, step_size: Any, momentum: float = 0.3, iterations: int = 20, noise: Any = math.nan
    ) -> None:
        owner = "GradientDescent"
        self.step_size = numbers(step_size, "step_size", owner, (None,))
        require((self.step_size >= 0).all(), "step_size", owner, "not negative", step_size)
        require(0 <= momentum < 1, "momentum", owner, "in [0, 1)", momentum)
        require(iterations >= 1, "iterations", owner, "at least 1", iterations)
        self.noise = numbers(noise, "noise", owner, finite=False)
        require(not (self.noise <= 0).any(), "noise", owner, "positive", noise)
        self.momentum, self.iterations, self.n_q = float(momentum), iterations, len(self.step_size)
        # A callable is differentiated over steps of the size of a soft robot's coordinates.
        self.model = model_of(sensing, np.full(self.n_q, -5e-3), np.full(self.n_q, 5e-3), owner)

    def init(self, q0: Any = None, seed: int = 0) -> DescentState:
        """Return the state at ``q0`` ``[..., n_q]``, zero if not given, without momentum. Nothing is random."""
        q = np.zeros(self.n_q) if q0 is None else start(q0, self.n_q, "GradientDescent")
        return DescentState(q, np.zeros_like(q))

    def step(
        self, state: DescentState, u: Any, t: float = 0.0, mask: Any = None, known: Any = None
    ) -> tuple[DescentState, Estimate]:
        """Descend from the last estimate. The details hold ``loss`` and ``best_iteration``.

        Raises
        ------
        InputError
            If there are not as many readings as the model predicts, none is left, or the descent leaves the finite
            numbers.
        """
        u = incoming(u, mask, "GradientDescent", self.model.n_readings)
        known = known_coordinates(known, self.n_q, "GradientDescent")
        held = None if known is None else ~np.isnan(known)
        n, s = self.n_q, u.shape[-1]
        batch = np.broadcast_shapes(state.q.shape[:-1], u.shape[:-1])
        q, b = (each(x, batch, n).copy() for x in state)
        rows = np.ascontiguousarray(each(u, batch, s))
        moves = np.broadcast_to(self.step_size, q.shape).copy()
        if held is not None and known is not None:
            fixed = each(held, batch, n)
            q = np.where(fixed, each(known, batch, n), q)
            moves[fixed], b = 0.0, np.where(fixed, 0.0, b)
        n_used = np.isfinite(rows).sum(-1)
        require((n_used > 0).all(), "u", "GradientDescent", "at least one reading that is finite", "none")
        u_hat, status = np.empty((len(q), s)), np.tile([np.inf, 0.0], (len(q), 1))
        arrays = (q, b, u_hat, status)
        if self.model.compiled:
            _descend(*self.model.packed, rows, moves, self.momentum, self.iterations, *arrays)
        else:
            self._descend_callable(rows, moves, *arrays)
        if not (np.isfinite(q).all() and np.isfinite(b).all() and np.isfinite(status).all()):
            raise bad_input(
                "step_size", "GradientDescent", "small enough for a finite descent", "NaN on the way"
            )
        q, b, u_hat = q.reshape(*batch, n), b.reshape(*batch, n), u_hat.reshape(*batch, s)
        details = {"loss": status[:, 0].reshape(batch), "best_iteration": status[:, 1].reshape(batch)}
        r = self.model.difference(rows, u_hat.reshape(-1, s))
        chi2 = (
            np.nansum((r / self.noise) ** 2, axis=-1)
            if np.isfinite(self.noise).all()
            else np.full(len(r), np.nan)
        )
        dof = np.maximum(n_used.reshape(batch) - (n if held is None else (~held).sum(-1)), 0)
        missing = s - n_used.reshape(batch)[()]
        return DescentState(q, b), Estimate(q, None, u_hat, chi2.reshape(batch)[()], dof, missing, details)

    def _descend_callable(
        self, u: Array, moves: Array, q: Array, b: Array, u_hat: Array, status: Array
    ) -> None:
        x = q.copy()
        for iteration in range(self.iterations):
            hat, J = self.model.linearise(x)
            r = self.model.difference(u, hat)
            last = iteration == self.iterations - 1
            for k in range(len(q)):
                _judge(
                    hat[k],
                    r[k],
                    J[k],
                    moves[k],
                    self.momentum,
                    iteration,
                    last,
                    x[k],
                    q[k],
                    b[k],
                    u_hat[k],
                    status[k],
                )


@kernel(entry=True, allocates=True)
def _descend(ints, floats, weights, u, moves, momentum, iterations, q, b, u_hat, status):
    """Descend for every member of a batch."""
    t = unpack(ints, floats, weights)
    room, n, s = room_for(t), q.shape[1], u.shape[1]
    x, hat, r, J = np.zeros(n), np.zeros(s), np.zeros(s), np.zeros((s, n))
    for k in range(len(q)):
        x[:] = q[k]
        for iteration in range(iterations):
            last = iteration == iterations - 1
            evaluate(t, x, not last, hat, J, room)
            difference(len(t.row_frame), u[k], hat, r, room.T, room.L, room.W)
            _judge(hat, r, J, moves[k], momentum, iteration, last, x, q[k], b[k], u_hat[k], status[k])


@kernel(entry=True)
def _judge(hat, r, J, moves, momentum, iteration, last, x, q, b, u_hat, status):
    """Keep the trial ``x`` if its loss is the smallest so far, and move on unless it is the last."""
    used, loss = 0, 0.0
    for j in range(len(r)):
        if r[j] == r[j]:
            used, loss = used + 1, loss + r[j] * r[j]
    loss /= used
    better = loss < status[0]
    if better:
        status[0], status[1] = loss, iteration
        for j in range(len(hat)):
            u_hat[j] = hat[j]
    for c in range(len(x)):
        if better:
            q[c] = x[c]
        if not last:
            slope = 0.0
            for j in range(len(r)):
                if r[j] == r[j]:
                    slope -= 2.0 / used * r[j] * J[j, c]
            b[c] = momentum * b[c] + (slope if moves[c] > 0.0 else 0.0)  # eq. (11)
            x[c] -= moves[c] * b[c]
