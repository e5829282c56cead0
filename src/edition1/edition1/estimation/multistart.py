"""Where least squares starts if nothing is known yet."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require


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
