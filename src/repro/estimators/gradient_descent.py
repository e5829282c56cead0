r"""Gradient descent on the squared error of the readings, as in Baaij et al. 2023, section 2.4."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.common import Array, kernel, numbers, require
from repro.estimators.base import (
    Estimate,
    check_free,
    each,
    incoming,
    known_coordinates,
    model_of,
    robot_of,
    start,
)
from repro.parts import Assembly
from repro.sensing import Sensing, evaluate, network_for, residuals, room_for, sensing_of, unpack

_ABSURD = 1e3
"""Residuals so many times as large as what the model predicts, which no iterate makes smaller, are no readings."""


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

    A row without a reading has no estimate, nor one whose readings are absurd or lead out of the finite numbers: its
    ``q`` is NaN, its readings count as left out, and the next row starts where this one did.

    Parameters
    ----------
    sensing
        Configuration to readings, as for :class:`repro.LevenbergMarquardt`. With a robot the descent begins at its
        start, or in the middle of its bounds, stays within these, and leaves fixed coordinates as they are.
    step_size
        Step size :math:`\gamma`, one number for each coordinate; or one for all, where a robot is known.
    momentum
        Momentum :math:`\mu`.
    iterations
        Evaluations of the loss in each time step.
    noise
        Standard deviation of a reading, one number or one for each; that of the robot if not given. The descent does
        not need it; without it ``chi2`` is NaN.

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
        self,
        sensing: Any,
        step_size: ArrayLike,
        momentum: float = 0.3,
        iterations: int = 20,
        noise: ArrayLike | None = None,
    ) -> None:
        owner = "GradientDescent"
        n = sensing.n_q if isinstance(sensing, Assembly | Sensing) else 0
        moves = numbers(step_size, "step_size", owner)
        fits = moves.shape in ((), (n,)) if n else moves.ndim == 1
        words = f"for each of {n} coordinates, or one for all" if n else "for each coordinate"
        require(fits, "step_size", owner, f"one number {words}", step_size)
        self.step_size = np.full(n or len(moves), moves)
        require((self.step_size >= 0).all(), "step_size", owner, "not negative", step_size)
        require(0 <= momentum < 1, "momentum", owner, "in [0, 1)", momentum)
        require(iterations >= 1, "iterations", owner, "at least 1", iterations)
        self.momentum, self.iterations, self.n_q = float(momentum), iterations, len(self.step_size)
        robot = sensing if isinstance(sensing, Assembly) else None
        noise = robot.total_noise if noise is None and robot is not None else noise
        self.noise = numbers(math.nan if noise is None else noise, "noise", owner, finite=False)
        require(not (self.noise <= 0).any(), "noise", owner, "positive", noise)
        model = sensing if robot is None else sensing_of(robot)
        # A callable is differentiated over steps of the size of a soft robot's coordinates.
        self.model = model_of(model, np.full(self.n_q, -5e-3), np.full(self.n_q, 5e-3), owner)
        self.robot = robot_of(self.model)
        low, high = np.repeat([[-np.inf], [np.inf]], self.n_q, axis=1)
        if robot is not None and robot.lower is not None and robot.upper is not None:
            check_free(robot, owner)
            low, high = robot.lower, robot.upper
        self.angles = FreeAngles(() if robot is None else self.model.rotations, low, high)
        self._limits = np.where(self.angles.free, [[-np.inf], [np.inf]], [low, high])
        self._fixed = np.where(low == high, low, np.nan)
        middle = (np.maximum(low, -1e9) + np.minimum(high, 1e9)) / 2  # zero without bounds
        self._start = middle if robot is None or robot.start is None else robot.start

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> DescentState:
        """Return the state at ``q0`` ``[..., n_q]``, without momentum. Nothing is random.

        Without ``q0`` it is where the robot starts, or the middle of its bounds; zero without a robot.
        """
        q = self._start if q0 is None else start(q0, self.n_q, "GradientDescent")
        inside = (self._limits[0] <= q) & (q <= self._limits[1])
        require(inside.all(), "q0", "GradientDescent", "within the bounds", q.tolist())
        return DescentState(q, np.zeros_like(q))

    def step(
        self,
        state: DescentState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[DescentState, Estimate]:
        """Descend from the last estimate. The details hold ``loss``, ``best_iteration`` and ``left_out``.

        Raises
        ------
        InputError
            If there are not as many readings as the model predicts, or the descent leaves the finite numbers by its
            step size.
        """
        owner, n = "GradientDescent", self.n_q
        u = incoming(u, mask, owner, self.model.n_readings)
        batch, s = np.broadcast_shapes(state.q.shape[:-1], u.shape[:-1]), u.shape[-1]
        given: Any = known_coordinates(known, n, owner, self._fixed)
        known = each(given, batch, n)
        q, b, free = *(each(x, batch, n) for x in state), np.isnan(known)
        q, b, moves = np.where(free, q, known), np.where(free, b, 0.0), free * self.step_size
        rows = np.ascontiguousarray(each(u, batch, s))
        q, later, u_hat, status, lost = self._descended_or_left(q, b, rows, moves)
        q, there = self.angles.wrapped(q), np.isfinite(rows)
        n_used, r = np.where(lost, 0, there.sum(1)), self.model.difference(rows, u_hat)
        chi2 = np.nansum((r / self.noise) ** 2, axis=-1)
        chi2 = chi2 if np.isfinite(self.noise).all() else np.full(len(r), np.nan)

        def shaped(x: Array) -> Array:
            return x.reshape((*batch, *x.shape[1:]))[()]

        details = {"loss": status[:, 0], "best_iteration": status[:, 1], "left_out": there & lost[:, None]}
        estimate = Estimate(
            shaped(np.where(lost[:, None], np.nan, q)),
            None,
            shaped(u_hat),
            shaped(chi2),
            shaped(np.maximum(n_used - free.sum(1), 0)),
            shaped(s - n_used),
            {name: shaped(x) for name, x in details.items()},
        )
        return DescentState(shaped(q), shaped(later)), estimate

    def _descended_or_left(
        self, before: Array, b: Array, rows: Array, moves: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return what a descent finds, and which rows it leaves where they were: their readings are absurd."""
        q, later, u_hat, status = self._descended(before, b, rows, moves)
        absurd = (status[:, 1] == 0) & (status[:, 0] > _ABSURD**2 * np.square(u_hat).mean(1))
        lost = absurd | ~np.isfinite(np.hstack([q, later, status])).all(1)
        if lost.any():  # if readings near those of the start lead astray too, it is not the row
            near = 1.01 * self.model.linearise(before[lost])[0]
            again = np.hstack(self._descended(before[lost], 0.0 * b[lost], near, moves[lost]))
            small = "small enough for a finite descent"
            require(np.isfinite(again).all(), "step_size", "GradientDescent", small, "NaN on the way")
            q[lost], later[lost], u_hat[lost] = before[lost], b[lost], np.nan
        return q, later, u_hat, status, lost

    def _descended(self, q: Array, b: Array, rows: Array, moves: Array) -> tuple[Array, Array, Array, Array]:
        """Return configuration, momentum, readings there, and loss with its iteration, of every member."""
        found = (q.copy(), b.copy(), np.empty_like(rows), np.tile([np.inf, 0.0], (len(q), 1)))
        if self.model.compiled:
            settings = (self._limits, self.momentum, self.iterations)
            _descend(*self.model.packed, self.model.work(), rows, moves, *settings, *found)
        else:
            self._descend_callable(rows, moves, *found)
        return found

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
                    self._limits,
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
def _descend(ints, floats, weights, kinds, work, u, moves, limits, momentum, iterations, q, b, u_hat, status):
    """Descend for every member of a batch."""
    t, n, s = unpack(ints, floats), q.shape[1], u.shape[1]
    network, room = network_for(t, weights), room_for(t, work)
    x, hat, r, J = np.zeros(n), np.zeros(s), np.zeros(s), np.zeros((s, n))
    for k in range(len(q)):
        x[:] = q[k]
        for iteration in range(iterations):
            last = iteration == iterations - 1
            evaluate(kinds, network, t, x, not last, hat, J, room)
            residuals(kinds, t, u[k], hat, r, room)
            _judge(hat, r, J, moves[k], limits, momentum, iteration, last, x, q[k], b[k], u_hat[k], status[k])


@kernel(entry=True)
def _judge(hat, r, J, moves, limits, momentum, iteration, last, x, q, b, u_hat, status):
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
            if x[c] < limits[0, c] or x[c] > limits[1, c]:  # a bound stops it
                x[c], b[c] = min(max(x[c], limits[0, c]), limits[1, c]), 0.0
