"""A lost particle filter starts again: particles from everywhere, contracted to the readings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation._particle_cloud import log_weights
from edition1.estimation._resampling import resample, weights
from edition1.estimation.regions import Region

_TEMPERATURES = 12
"""Passes over the readings, from flat weights to the likelihood."""


def contracted(
    q: Float[Tensor, "*batch n n_q"],
    hold: Callable[[Tensor], Tensor],
    error: Callable[[Tensor], Tensor],
    region: Region,
    noise_mt: float,
    generator: np.random.Generator,
) -> Float[Tensor, "*batch n n_q"]:
    """Contract particles to the readings as the weights sharpen.

    Each of several configurations that explain the readings keeps particles.

    Parameters
    ----------
    q
        Particles from all over the region.
    hold
        Puts coordinates that are known at their values.
    error
        Predicted less measured readings of particles.
    region
        Where particles may be.
    noise_mt
        Standard deviation of a reading.
    generator
        Draws and moves the particles.
    """
    n, n_q = q.shape[-2:]
    width, first = q.std(-2, keepdim=True), torch.empty(())
    for k in range(_TEMPERATURES):
        q = hold(q)
        difference = error(q)
        if k == 0:
            first = (difference * difference).mean((-1, -2)).sqrt().clamp_min(noise_mt).unsqueeze(-1)
        share = (noise_mt / first) ** ((k + 1) / _TEMPERATURES)  # of the first width of the likelihood
        w = weights(log_weights(difference, share * first))
        q = q.gather(-2, resample(w, "systematic", generator).unsqueeze(-1).expand_as(q))
        jitter = torch.from_numpy(generator.standard_normal((n, n_q))).to(q)
        spread = q + share.unsqueeze(-1) * width * jitter
        q = torch.where(region.contains(spread).unsqueeze(-1), spread, q)
    return hold(q)
