"""What a weighted cloud of particles says: its mean, its covariance, and whether readings fit it."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.estimation._resampling import effective_sample_size, normalised, weights


class Weighed(NamedTuple):
    """What readings say about a cloud."""

    w: Float[Tensor, "*batch n"]
    """Normalised weights."""
    mean: Float[Tensor, "*batch n_q"]
    covariance: Float[Tensor, "*batch n_q n_q"]
    effective_sample_size: Float[Tensor, "*batch"]
    surprise: Float[Tensor, "*batch"]
    """By how many standard deviations the readings are too unlikely: :func:`surprise`."""
    best_tenth: Float[Tensor, "*batch n_q"] | None
    """Estimate of Mitchell et al. 2021 (:func:`best_tenth`), where it is asked for."""


def weighed(
    q: Float[Tensor, "*batch n n_q"],
    error: Float[Tensor, "*batch n s"],
    use: Bool[Tensor, "*batch s"],
    noise_mt: float,
    *,
    top: bool,
) -> Weighed:
    """Weigh particles by the likelihood of the readings.

    Parameters
    ----------
    q
        Particles.
    error
        Predicted less measured readings of every particle, zero for sensors that are not in use.
    use
        Sensors in use.
    noise_mt
        Standard deviation of a reading.
    top
        Whether the mean of the best tenth is asked for.
    """
    log_w = log_weights(error, noise_mt)
    w = weights(log_w)
    mean, C = _mean_and_covariance(q, w)
    unlikely = surprise(error, use, noise_mt)
    return Weighed(w, mean, C, effective_sample_size(w), unlikely, best_tenth(q, log_w) if top else None)


def log_weights(error: Float[Tensor, "*batch n s"], noise_mt: float | Tensor) -> Float[Tensor, "*batch n"]:
    """Logarithms of normalised weights, for errors of that standard deviation."""
    return normalised((error * error).sum(-1) / (-2 * noise_mt**2))


def _mean_and_covariance(
    q: Float[Tensor, "*batch n n_q"], w: Float[Tensor, "*batch n"]
) -> tuple[Float[Tensor, "*batch n_q"], Float[Tensor, "*batch n_q n_q"]]:
    """Mean and covariance of particles with normalised weights."""
    share = w.unsqueeze(-2)
    mean = share @ q
    centred = q - mean
    return mean.squeeze(-2), (centred.mT * share) @ centred


def best_tenth(q: Float[Tensor, "*batch n 2"], log_w: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch 2"]:
    """Estimate of Mitchell et al. 2021, eqs (3) and (4), from bend vectors.

    Of the 10 % of particles with the largest weights: the mean of the bend angles, towards the circular mean of the
    bend directions. Angles are never negative, so near the straight pose their mean is too large.

    Examples
    --------
    >>> q = torch.tensor([[0.3, 0.0], [0.0, 0.3]] * 10)
    >>> best_tenth(q, torch.zeros(20).index_fill(0, torch.tensor([4, 9]), 1.0)) / 0.3
    tensor([0.7071, 0.7071])
    """
    best = log_w.topk(math.ceil(log_w.shape[-1] / 10), sorted=False).indices
    q = q.gather(-2, best.unsqueeze(-1).expand(*best.shape, 2))
    tiny = torch.finfo(q.dtype).tiny
    angle = torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    direction = (q / angle.clamp_min(tiny)).sum(-2)
    length = torch.linalg.vector_norm(direction, dim=-1, keepdim=True)
    return angle.mean(-2) * direction / length.clamp_min(tiny)


def surprise(
    error: Float[Tensor, "*batch n s"], use: Bool[Tensor, "*batch s"], noise_mt: float
) -> Float[Tensor, "*batch"]:
    r"""How unlikely readings are for a cloud, in standard deviations: about N(0, 1) while it follows them.

    The readings less the mean prediction, squared and normalised by the covariance of the predictions and the
    noise, have a :math:`\chi^2` distribution; the cube root makes it normal (Wilson and Hilferty).

    Parameters
    ----------
    error
        Predicted less measured readings of every particle, zero for sensors that are not in use.
    use
        Sensors in use.
    noise_mt
        Standard deviation of a reading.
    """
    mean = error.mean(-2, keepdim=True)
    centred = error - mean
    S = centred.mT @ centred / error.shape[-2]
    S.diagonal(dim1=-2, dim2=-1).add_(noise_mt**2)
    squared = (mean.squeeze(-2) * torch.linalg.solve(S, mean.mT).squeeze(-1)).sum(-1)
    dof = use.sum(-1)
    spread = 2 / (9 * dof)
    return ((squared / dof) ** (1 / 3) - 1 + spread) / spread.sqrt()
