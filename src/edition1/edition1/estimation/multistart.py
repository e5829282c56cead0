"""Cold starts: least squares from many starts, and every minimum that the readings cannot tell from the best."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt

_CHI2_MARGIN = 9.0
"""A minimum whose chi-square exceeds the best by less is not excluded by the readings: three standard deviations."""
_DISTANCE = 3.0
"""Two fits are one minimum if they differ by less than so many standard deviations."""
_FLAT = 1e-3
"""... or by less than this share of the width of the bounds, for fits to readings of almost no noise."""


@dataclass(frozen=True)
class Minima:
    """Minima of the readings' error, the best first.

    Parameters
    ----------
    q
        Fits from all starts, by increasing chi-square.
    chi2
        Sum of squared residuals in units of the noise.
    covariance
        Of each fit.
    candidate
        True for fits that are minima of their own and that the readings do not exclude; always for the best.
    """

    q: Float[Tensor, "*batch starts n_q"]
    chi2: Float[Tensor, "*batch starts"]
    covariance: Float[Tensor, "*batch starts n_q n_q"]
    candidate: Bool[Tensor, "*batch starts"]

    @property
    def count(self) -> Tensor:
        """Number of minima within the noise; above one, the readings do not determine the configuration."""
        return self.candidate.sum(-1)

    def only(self) -> Float[Tensor, "*batch n_q"]:
        """Return the one configuration.

        Raises
        ------
        InputError
            If there is more than one within the noise: the choice is the caller's.
        """
        if bool((self.count > 1).any()):
            several = f"{int(self.count.max())} configurations within the noise"
            raise bad_input("u", "Minima.only", "readings that determine the configuration", several)
        return self.q[..., 0, :]


def search(
    method: LevenbergMarquardt,
    u: Float[Tensor, "*batch s"],
    starts: Float[Tensor, "starts n_q"],
    *,
    mask: Bool[Tensor, "*m s"] | None = None,
) -> Minima:
    """Minimise from every start and sort out what is found.

    Parameters
    ----------
    method
        Sensor model, bounds, noise and number of iterations.
    u
        Readings.
    starts
        Configurations within the bounds, such as from :func:`starts_within`.
    mask
        Sensors in use.

    Raises
    ------
    InputError
        If there is no start, or as the method.

    Examples
    --------
    A sensor that reads the square of a coordinate cannot tell its sign:

    >>> one = torch.ones(1, dtype=torch.float64)
    >>> method = LevenbergMarquardt(lambda q: q**2, -2 * one, 2 * one, noise_mt=0.01)
    >>> found = search(method, one, torch.tensor([[-0.5], [0.5], [1.5]], dtype=torch.float64))
    >>> int(found.count), sorted(found.q[found.candidate].flatten().round(decimals=3).tolist())
    (2, [-1.0, 1.0])
    """
    require(len(starts), "starts", "search", "at least one configuration", "none")
    batch = u.shape[:-1]
    each = u.unsqueeze(-2).expand(*batch, len(starts), -1)
    use = None if mask is None else mask.unsqueeze(-2)
    _, fit = method.step(method.init(starts.expand(*batch, -1, -1)), each, 0.0, mask=use)
    assert fit.covariance is not None
    used = u.shape[-1] - fit.diagnostics["masked"]
    chi2 = fit.diagnostics["rmse"].square() * used / method.noise_mt**2
    chi2, order = chi2.sort(dim=-1)
    q = fit.q.gather(-2, order.unsqueeze(-1).expand_as(fit.q))
    C = fit.covariance.gather(-3, order[..., None, None].expand_as(fit.covariance))
    width = (method.upper - method.lower).to(q)
    candidate = (chi2 - chi2[..., :1]) < _CHI2_MARGIN
    for k in range(1, len(starts)):
        # The same minimum as a better one that stays: within its uncertainty.
        difference = q[..., k : k + 1, :] - q[..., :k, :]
        weighed = torch.linalg.solve(C[..., :k, :, :], difference.unsqueeze(-1)).squeeze(-1)
        near = (difference * weighed).sum(-1) < _DISTANCE**2
        near = near | ((difference.abs() / width).amax(-1) < _FLAT)
        candidate[..., k] &= ~(near & candidate[..., :k]).any(-1)
    return Minima(q, chi2, C, candidate)


def starts_within(
    lower: Float[Tensor, " n_q"], upper: Float[Tensor, " n_q"], count: int, *, seed: int
) -> Float[Tensor, "starts n_q"]:
    """Start configurations that fill a box evenly: the middle, then a scrambled Sobol sequence.

    Parameters
    ----------
    lower, upper
        Bounds.
    count
        Number of starts.
    seed
        Scrambles the sequence: the same seed gives the same bits.

    Raises
    ------
    InputError
        If there is no start.
    """
    require(count >= 1, "count", "starts_within", "at least 1", count)
    sobol = torch.quasirandom.SobolEngine(len(lower), scramble=True, seed=seed)
    middle = torch.full((1, len(lower)), 0.5, dtype=lower.dtype)
    shares = torch.cat([middle, sobol.draw(count - 1, dtype=lower.dtype)])
    return lower + (upper - lower) * shares
