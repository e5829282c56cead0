r"""What an imperfect sensor model adds to the uncertainty of any estimator.

A model that was calibrated, or learnt, is wrong by an error that does not change from reading to reading: at a
configuration it has the covariance :math:`E`, between sensors too. What lasts cannot be averaged away: an estimate
with the covariance :math:`C` by noise is wrong by

.. math:: C + G E G^T, \qquad G = (J^T J + \sigma^2 P^{-1})^{-1} J^T ,

where :math:`P` is the variance of a uniform distribution between the bounds, if there are any: as good as
:math:`(J^T J)^{-1} J^T` wherever the readings determine the configuration. A filter gives a single reading less
weight, but it takes in the same error with every reading and in the end follows it as far as least squares does: with
the gain :math:`C J^T/\sigma^2` of one update the Kalman filter would claim a tenth of the variance of its errors.

What the model cannot explain is judged against the same: with the columns of :math:`N` an orthonormal basis of what
no move of the free coordinates changes in the sensors in use, :math:`p = N^T (u - \hat u)`,

.. math:: \chi^2 = p^T (N^T (\sigma^2 I + E) N)^{-1} p

has as many degrees of freedom as :math:`N` has columns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.base import Estimate, Estimator, held, kernel, usable
from edition1.estimation.levenberg_marquardt import jacobian

_RANK = 1e-9
"""A direction counts as determined above this share of the strongest, coordinates scaled alike."""
_FLOOR = 1e-13
"""Of the information about coordinates scaled alike, where there are no bounds."""


@dataclass(frozen=True)
class WithModelError:
    r"""Estimator whose uncertainty holds the error of the sensor model as well.

    State and configuration are those of ``estimator``. To its diagnostics come, in place of its own, ``chi2`` and
    ``dof`` as above, and ``systematic``: :math:`\mathrm{tr}(N^T E N (N^T (\sigma^2 I + E) N)^{-1})` per degree of
    freedom, 0 where the residual can be noise only, near 1 where it is the error of the model (and 0 where ``dof``
    is 0). A coordinate at a bound counts as held there.

    Parameters
    ----------
    estimator
        Any estimator; one without a covariance stays without.
    sensing
        Its sensor model.
    noise
        Standard deviation :math:`\sigma` of a reading, in its unit.
    error
        Covariance ``[*batch, s, s]`` of the readings at configurations that comes from the model, in their unit
        squared.
    bounds
        Bounds of ``q`` at which the estimator stops; none when not given.

    Raises
    ------
    InputError
        If the noise is not positive; in a step if the covariance of the model is not finite or does not fit the
        readings.

    Examples
    --------
    Two sensors of one coordinate, noise 0.1, that share an error of standard deviation 1: the mean of the readings
    has it too, their difference has not.

    >>> from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> twice = lambda q: torch.cat([q, q], -1)
    >>> plain = LevenbergMarquardt(twice, -9 * one, 9 * one, noise_mt=0.1)
    >>> shared = WithModelError(plain, twice, 0.1, lambda q: torch.ones(2, 2, dtype=torch.float64))
    >>> _, estimate = shared.step(shared.init(0 * one, seed=0), 1 + 0.2 * torch.arange(2).double(), 0.0)
    >>> round(float(estimate.covariance), 6), round(float(estimate.diagnostics["chi2"]), 6)
    (1.005, 2.0)
    """

    estimator: Estimator[Any]
    sensing: Callable[[Tensor], Tensor]
    noise: float
    error: Callable[[Tensor], Tensor]
    bounds: tuple[Tensor, Tensor] | None = None

    def __post_init__(self) -> None:
        require(self.noise > 0, "noise", "WithModelError", "positive", self.noise)

    @cached_property
    def _kernel(self) -> Any:
        return kernel(self.sensing)

    def init(self, q0: Tensor, *, seed: int = 0) -> Any:
        """State of the estimator itself."""
        return self.estimator.init(q0, seed=seed)

    def step(
        self, state: Any, u: Tensor, t: float, *, mask: Tensor | None = None, known: Tensor | None = None
    ) -> tuple[Any, Estimate]:
        """Take in the readings ``u`` as the estimator does, and add the error of the model to what it believes."""
        state, found = self.estimator.step(state, u, t, mask=mask, known=known)
        q, batch, n_s = found.q, found.q.shape[:-1], u.shape[-1]
        use, (_, unknown) = usable(u, mask, "WithModelError"), held(q, known)
        E = self.error(q)
        if E.shape[-2:] != (n_s, n_s):
            expected = f"a covariance of {n_s} readings"
            raise bad_input("error", "WithModelError", expected, f"shape {tuple(E.shape)}")
        J = jacobian(self.sensing, q)[1] if self._kernel is None else self._kernel.linearise(q)[1]
        residual = torch.where(use, u - found.u_hat, 0.0)
        data = (q, E.expand(*batch, n_s, n_s), J.expand(*batch, *J.shape[-2:]), residual, use, unknown)
        arrays = [x.detach().numpy() for x in data]
        arrays[3:5] = [np.broadcast_to(x, (*batch, n_s)) for x in arrays[3:5]]
        if not np.isfinite(arrays[1]).all():
            raise bad_input("error", "WithModelError", "finite", "a covariance that is not")
        if batch:
            arrays = [x.reshape(-1, *x.shape[len(batch) :]) for x in arrays]
            members = [_of_member(member, self._box, self.noise) for member in zip(*arrays, strict=True)]
        else:
            members = [_of_member(arrays, self._box, self.noise)]
        tests, added = np.array([x for x, _ in members]), np.array([x for _, x in members])
        values = torch.from_numpy(tests).to(q).reshape(*batch, 3).unbind(-1)
        diagnostics = {**found.diagnostics, **dict(zip(("chi2", "dof", "systematic"), values, strict=True))}
        C = found.covariance
        if C is not None:
            C = C + torch.from_numpy(added).to(C).reshape(C.shape)
        return state, replace(found, covariance=C, diagnostics=diagnostics)

    @cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray] | None:
        return None if self.bounds is None else (self.bounds[0].numpy(), self.bounds[1].numpy())


def _of_member(
    member: Sequence[np.ndarray], box: tuple[np.ndarray, np.ndarray] | None, noise: float
) -> tuple[tuple[float, int, float], np.ndarray]:
    """Chi-square of a residual, its degrees of freedom and systematic share; covariance of ``q`` by the model."""
    q, E, J, r, used, unknown = member
    if not used.all():
        E, J, r = E[used][:, used], J[used], r[used]
    free, prior = unknown, np.zeros(len(q))
    if box is not None:
        free = free & (q > box[0]) & (q < box[1])
        prior = 12 * (noise / (box[1] - box[0])) ** 2
    information = (J * unknown).T @ (J * unknown) + np.diag(prior)
    scale = np.sqrt(information.diagonal())
    scale = np.where(scale > 0, scale, 1.0)
    information = information / np.outer(scale, scale) + _FLOOR * np.eye(len(q))
    G = np.linalg.solve(information, (J * unknown / scale).T) / scale[:, None]
    return _test(E, J if free.all() else J[:, free], r, noise**2), G @ E @ G.T


def _test(E: np.ndarray, J: np.ndarray, r: np.ndarray, variance: float) -> tuple[float, int, float]:
    """Chi-square of a residual, its degrees of freedom, and the share that is the error of the model."""
    scale = np.sqrt((J * J).sum(0))
    U, strength, _ = np.linalg.svd(J / np.where(scale > 0, scale, 1.0))
    N = U[:, int((strength > _RANK * strength.max(initial=0.0)).sum()) :]
    if not N.shape[1]:
        return 0.0, 0, 0.0
    p, model = N.T @ r, N.T @ E @ N
    solved = np.linalg.solve(model + variance * np.eye(len(model)), np.column_stack([p, model]))
    return float(p @ solved[:, 0]), len(p), float(np.trace(solved[:, 1:]) / len(p))


@dataclass(frozen=True)
class WhiteError:
    """Covariance of readings whose model errs independently from sensor to sensor and place to place.

    Parameters
    ----------
    rmse
        Root mean square error of the model for every sensor [unit].
    """

    rmse: Float[Tensor, " s"]

    def __call__(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch s s"]:
        """Covariance at configurations [unit^2]."""
        return torch.diag(self.rmse.square()).expand(*q.shape[:-1], len(self.rmse), len(self.rmse))
