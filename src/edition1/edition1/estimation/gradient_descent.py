r"""Gradient descent on the readings' error, as in Baaij et al. 2023 (section 2.4, eqs 9-12)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import Estimate, check_start, held, kernel, redundancy, usable


@dataclass(frozen=True)
class _GradientState:
    """Where the descent stands: configuration and momentum ``b`` of eq. (11)."""

    q: Float[Tensor, "*batch n_q"]
    momentum: Float[Tensor, "*batch n_q"]


@dataclass(frozen=True)
class GradientDescent:
    r"""Estimator of eqs (9)-(12): a few steps of gradient descent at every time step.

    ``iterations`` evaluations of the loss are ``iterations - 1`` updates; the iterate with the smallest loss is
    the estimate and the next start.

    The gradient is quadratic in the field, so step sizes belong to a magnet: for readings that are ``c`` times
    smaller, step sizes ``c**2`` times larger give the same iterates (for the ring ``"published"`` about 16 times
    those for ``"released"``).

    Parameters
    ----------
    sensing
        Configuration to predicted readings, batched and differentiable; as of :func:`edition1.kernels.compiled` it is
        many times faster. One step then agrees to rounding where the descent is stable. Where a step size is too long
        for the curvature of the loss, iterates that differ by rounding part, and the two end apart: neither is then
        the right one.
    step_size
        Step size gamma for every coordinate.
    momentum
        Momentum mu.
    iterations
        Evaluations of the loss in each time step.
    carry_momentum
        Keep the momentum from one time step to the next, as the released code does; else start at zero.
    noise_mt
        Standard deviation of a reading, in its unit. The descent does not need it; without it ``chi2`` is NaN.

    Raises
    ------
    InputError
        If a step size is negative, the momentum is not in [0, 1), there is no iteration, or the noise is not
        positive.

    Examples
    --------
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> method = GradientDescent(lambda q: 2 * q, 0.1 * one)  # the loss is (u - 2 q)^2: a minimum at u / 2
    >>> _, estimate = method.step(method.init(0 * one), one, 0.0)
    >>> round(float(estimate.q), 3)
    0.5
    """

    sensing: Callable[[Tensor], Tensor]
    step_size: Float[Tensor, " n_q"]
    momentum: float = 0.3
    iterations: int = 20
    carry_momentum: bool = True
    noise_mt: float = math.nan

    def __post_init__(self) -> None:
        if bool((self.step_size < 0).any()):
            raise bad_input("step_size", "GradientDescent", "not negative", self.step_size.tolist())
        if not 0 <= self.momentum < 1:
            raise bad_input("momentum", "GradientDescent", "in [0, 1)", self.momentum)
        if self.iterations < 1:
            raise bad_input("iterations", "GradientDescent", "at least 1", self.iterations)
        if self.noise_mt <= 0:
            raise bad_input("noise_mt", "GradientDescent", "positive", self.noise_mt)

    @cached_property
    def _kernel(self) -> Any:
        return kernel(self.sensing)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> _GradientState:
        """State at ``q0`` with no momentum; nothing is random, the seed has no effect."""
        check_start(q0, None, "GradientDescent", n_q=len(self.step_size))
        return _GradientState(q0, torch.zeros_like(q0))

    def step(
        self,
        state: _GradientState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[_GradientState, Estimate]:
        """Descend from the last estimate; ``loss`` [mT^2] and ``best_iteration`` are in the diagnostics."""
        use = usable(u, mask, "GradientDescent")
        q, b = state.q, state.momentum if self.carry_momentum else torch.zeros_like(state.momentum)
        q, free = held(q, known)
        if self._kernel is not None:
            from edition1.kernels._descent import descend

            options = (self.step_size, self.momentum, self.iterations)
            q, b, u_hat, loss, best_at = descend(self._kernel, (q, b), u, use, free, *options)
        else:
            q, b, u_hat, loss, best_at = self._descend(q, b, u, use, free)
        diagnostics = {
            "loss": loss,
            "best_iteration": best_at,
            "masked": (~use).sum(-1),
            "chi2": loss * use.sum(-1) / self.noise_mt**2,
            "dof": redundancy(use.sum(-1), free),
        }
        return _GradientState(q, b), Estimate(q, None, u_hat, diagnostics)

    def _descend(
        self, q: Tensor, b: Tensor, u: Tensor, use: Tensor, free: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Best configuration, last momentum, then prediction, loss and iteration of the best."""
        target = torch.where(use, u, 0.0)
        weight = use.to(u) / use.sum(-1, keepdim=True)  # in the precision of the readings, not in single
        step = self.step_size.to(q) * free
        best_q, best_u, best_loss, best_at = (
            q,
            u,
            torch.full_like(q[..., 0], torch.inf),
            torch.zeros_like(q[..., 0]),
        )
        for iteration in range(self.iterations):
            last = iteration == self.iterations - 1
            with torch.set_grad_enabled(not last):
                q = q.detach().requires_grad_(not last)
                u_hat = self.sensing(q)
                loss = (weight * (u_hat - target) ** 2).sum(-1)  # eq. (9) over the sensors in use
            better = loss.detach() < best_loss
            best_loss = torch.where(better, loss.detach(), best_loss)
            best_at = torch.where(better, iteration, best_at)
            best_q = torch.where(better.unsqueeze(-1), q.detach(), best_q)
            best_u = torch.where(better.unsqueeze(-1), u_hat.detach(), best_u)
            if not last:
                (gradient,) = torch.autograd.grad(loss.sum(), q)
                b = self.momentum * b + gradient * free  # eq. (11)
                q = q.detach() - step * b
        return best_q, b, best_u, best_loss, best_at
