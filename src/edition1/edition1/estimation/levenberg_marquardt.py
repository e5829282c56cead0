r"""Nonlinear least squares on the readings' error: Levenberg-Marquardt with bounds and a covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.estimation._step import TOLERANCE
from edition1.estimation.base import Estimate, check_start, held, kernel, redundancy, usable


@dataclass(frozen=True)
class LeastSquaresState:
    """Where the next step starts: the last estimate."""

    q: Float[Tensor, "*batch n_q"]


@dataclass(frozen=True)
class LevenbergMarquardt:
    r"""Estimator that minimises the sum of squared residuals within a box.

    Each iteration solves :math:`(J^T J + \lambda\,\mathrm{diag}(J^T J))\,\delta = J^T r` for the coordinates that no
    bound holds, and accepts a step that lowers the error. The covariance is
    :math:`\sigma^2 (J^T J)^{-1}` at the estimate, for white noise of standard deviation :math:`\sigma` on every
    reading: it is the Cramer-Rao bound of the model, and huge along directions that the readings do not determine.

    Parameters
    ----------
    sensing
        Configuration to predicted readings, batched and differentiable; as of :func:`edition1.kernels.compiled` it is
        many times faster, and the same to rounding.
    lower, upper
        Bounds of ``q``.
    noise_mt
        Standard deviation of a reading, in its unit.
    iterations
        Largest number of iterations in a time step; fewer when all of the batch has converged.

    Raises
    ------
    InputError
        If the bounds are not finite and ordered, the noise is not positive, or there is no iteration.

    Examples
    --------
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> method = LevenbergMarquardt(lambda q: 2 * q, -one, one, noise_mt=0.01)
    >>> _, estimate = method.step(method.init(0 * one), one, 0.0)
    >>> float(estimate.q), float(estimate.covariance.sqrt())  # a reading of 1, the noise halved
    (0.5, 0.005)
    """

    sensing: Callable[[Tensor], Tensor]
    lower: Float[Tensor, " n_q"]
    upper: Float[Tensor, " n_q"]
    noise_mt: float = 1.0
    iterations: int = 30

    def __post_init__(self) -> None:
        if self.lower.shape != self.upper.shape or not bool((self.lower < self.upper).all()):
            bounds = (self.lower.tolist(), self.upper.tolist())
            raise bad_input("lower, upper", "LevenbergMarquardt", "ordered bounds", bounds)
        # steps are told small by the width of the bounds
        se3.require_finite(self.lower, "lower", "LevenbergMarquardt")
        se3.require_finite(self.upper, "upper", "LevenbergMarquardt")
        require(self.noise_mt > 0, "noise_mt", "LevenbergMarquardt", "positive", self.noise_mt)
        require(self.iterations >= 1, "iterations", "LevenbergMarquardt", "at least 1", self.iterations)

    @cached_property
    def _kernel(self) -> Any:
        return kernel(self.sensing)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> LeastSquaresState:
        """State at ``q0``; nothing is random, the seed has no effect."""
        check_start(q0, (self.lower, self.upper), "LevenbergMarquardt", n_q=len(self.lower))
        return LeastSquaresState(q0)

    def step(
        self,
        state: LeastSquaresState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[LeastSquaresState, Estimate]:
        """Minimise from the last estimate; ``rmse``, ``iterations`` and ``at_bound`` are in the diagnostics, too."""
        use = usable(u, mask, "LevenbergMarquardt")
        low, high = self.lower.to(state.q), self.upper.to(state.q)
        q, free = held(state.q, known)
        if self._kernel is not None:
            q, u_hat, rmse, count, C = self._fit_compiled(q, u, use, free, low, high)
        else:
            q, u_hat, rmse, count, C = self._fit(q, u, use, free, low, high)
        used, bound = use.sum(-1), (q <= low) | (q >= high)
        diagnostics = {
            "rmse": rmse,
            "iterations": count,
            "at_bound": bound.any(-1),
            "masked": use.shape[-1] - used,
            "chi2": (rmse / self.noise_mt).square() * used,
            "dof": redundancy(used, free & ~bound),
        }
        return LeastSquaresState(q), Estimate(q, C, u_hat, diagnostics)

    def _fit_compiled(
        self, q: Tensor, u: Tensor, use: Tensor, free: Tensor, low: Tensor, high: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        from edition1.kernels._least_squares import fit

        options = (self.noise_mt, self.iterations, TOLERANCE)
        q, u_hat, rmse, count, J, C, determined = fit(self._kernel, q, u, use, free, (low, high), *options)
        if not bool(determined.all()):
            rest = ~determined
            C[rest] = covariance(J[rest].to(q), self.noise_mt, free.expand_as(q)[rest])
        return q, u_hat, rmse, count, C

    def _fit(
        self, q: Tensor, u: Tensor, use: Tensor, free: Tensor, low: Tensor, high: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Configuration, predicted readings, residual, iterations, covariance."""
        u_hat, J = jacobian(self.sensing, q)
        r, J = _residual(u, u_hat, use), J * use.unsqueeze(-1)
        damping = torch.full_like(q[..., :1], 1e-3)
        done = torch.zeros_like(damping, dtype=torch.bool)
        count = torch.zeros_like(q[..., 0])
        for _ in range(self.iterations):
            g = (J.mT @ r.unsqueeze(-1)).squeeze(-1)
            held = ~free | ((q <= low) & (g < 0)) | ((q >= high) & (g > 0))
            delta = _solve(J.mT @ J, g, damping, ~held)
            trial = torch.where(free, torch.clamp(q + delta, low, high), q)
            small = ((trial - q).abs() <= TOLERANCE * (high - low)).all(-1, keepdim=True)
            u_trial, J_trial = jacobian(self.sensing, trial)
            r_trial = _residual(u, u_trial, use)
            better = ((r_trial * r_trial).sum(-1, keepdim=True) < (r * r).sum(-1, keepdim=True)) & ~done
            count += (~done).squeeze(-1)
            q = torch.where(better, trial, q)
            u_hat, r = torch.where(better, u_trial, u_hat), torch.where(better, r_trial, r)
            J = torch.where(better.unsqueeze(-1), J_trial * use.unsqueeze(-1), J)
            damping = torch.where(better, damping / 10, damping * 10).clamp(1e-12, 1e12)
            done = done | small
            if bool(done.all()):
                break
        rmse = ((r * r).sum(-1) / use.sum(-1)).sqrt()
        return q, u_hat, rmse, count, covariance(J, self.noise_mt, free)


def jacobian(
    sensing: Callable[[Tensor], Tensor], q: Float[Tensor, "*batch n_q"]
) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
    """Readings and their derivatives by ``torch.func.jacrev``.

    Members of a batch do not depend on each other, so the derivative of the sum over the batch holds that of
    every member: one reverse pass per sensor serves all.
    """

    def summed(x: Tensor) -> tuple[Tensor, Tensor]:
        u = sensing(x)
        return u.reshape(-1, u.shape[-1]).sum(0), u

    J, u = torch.func.jacrev(summed, has_aux=True)(q)
    return u.detach(), J.detach().movedim(0, -2)


def covariance(
    J: Float[Tensor, "*batch s n_q"], noise_mt: float, free: Bool[Tensor, "*batch n_q"] | None = None
) -> Float[Tensor, "*batch n_q n_q"]:
    r"""Covariance :math:`\sigma^2 (J^T J)^{-1}` of a least-squares estimate; zero for coordinates that are held.

    Directions without information (relative eigenvalues below the rounding of the dtype) get the variance that
    belongs to that rounding: large, but finite.
    """
    if free is not None:
        J = J * free.unsqueeze(-2)
    scale = torch.linalg.vector_norm(J, dim=-2)
    scale = torch.where(scale > 0, scale, 1.0)
    information = (J / scale.unsqueeze(-2)).mT @ (J / scale.unsqueeze(-2))
    values, vectors = torch.linalg.eigh(information)
    values = values.clamp_min(torch.finfo(J.dtype).eps * J.shape[-1])
    C = noise_mt**2 * (vectors / values.unsqueeze(-2)) @ vectors.mT
    C = C / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    if free is not None:
        C = C * (free.unsqueeze(-1) & free.unsqueeze(-2))
    return C


def _residual(u: Tensor, u_hat: Tensor, use: Tensor) -> Tensor:
    return torch.where(use, u - u_hat, 0.0)


def _solve(A: Tensor, g: Tensor, damping: Tensor, free: Tensor) -> Tensor:
    """Damped step for the free coordinates, zero for the others."""
    both = free.unsqueeze(-1) & free.unsqueeze(-2)
    diagonal = A.diagonal(dim1=-2, dim2=-1)
    floor = torch.finfo(A.dtype).eps * diagonal.amax(-1, keepdim=True) + torch.finfo(A.dtype).tiny
    scale = torch.maximum(diagonal, floor)
    damped = torch.where(both, A, 0.0) + torch.diag_embed(torch.where(free, damping * scale + floor, 1.0))
    return torch.linalg.solve(damped, torch.where(free, g, 0.0).unsqueeze(-1)).squeeze(-1)
