"""Weights of particles as logarithms, drawing particles by them, and the random numbers for it."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from edition1.errors import bad_input

SCHEMES = ("multinomial", "systematic")
"""Ways to draw: independently, as in Mitchell et al. 2021, section II-C; or by one comb of equal spacing."""


def normalised(log_weights: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """Log weights whose weights sum to 1, by LogSumExp: eq. (2) of Mitchell et al. 2021.

    Only differences enter: weights far below the smallest positive number lose nothing.

    Examples
    --------
    >>> normalised(torch.tensor([-1e6, -1e6 - 1], dtype=torch.float64)).exp()
    tensor([0.7311, 0.2689], dtype=torch.float64)
    """
    return log_weights.log_softmax(-1)


def weights(log_weights: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """Weights of normalised log weights, with a floor: where squares are denormal numbers, arithmetic is slow."""
    return log_weights.clamp_min(math.log(torch.finfo(log_weights.dtype).tiny) / 2).exp()


def effective_sample_size(w: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch"]:
    r"""Number of equally weighted particles that are worth as much: :math:`1/\sum w^2` of normalised weights.

    Examples
    --------
    >>> effective_sample_size(torch.tensor([0.25, 0.25, 0.25, 0.25]))
    tensor(4.)
    """
    return 1 / (w * w).sum(-1)


def resample(
    w: Float[Tensor, "*batch n"], scheme: str, generator: np.random.Generator
) -> Int[Tensor, "*batch n"]:
    """Indices of the particles that are drawn, each as often as its weight says on average.

    Members of a batch share the random numbers: each draws as it would alone.

    Parameters
    ----------
    w
        Weights; their sum does not matter.
    scheme
        One of :data:`SCHEMES`. A systematic draw takes every particle within one of its expected number of
        times, a multinomial one adds the noise of independent draws.

    Raises
    ------
    InputError
        If the scheme is unknown.
    """
    n = w.shape[-1]
    edges = w.cumsum(-1)
    at = torch.from_numpy(draws(n, scheme, generator)).to(w) * edges[..., -1:]
    # In low precision a point may round up to the last edge.
    return torch.searchsorted(edges, at, right=True).clamp_max(n - 1)


def draws(n: int, scheme: str, generator: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Shares of the sum of all weights at which particles are drawn, increasing.

    Raises
    ------
    InputError
        If the scheme is unknown.
    """
    if scheme == "multinomial":
        return np.sort(generator.random(n))
    if scheme == "systematic":
        return (np.arange(n) + generator.random()) / n
    raise bad_input("scheme", "resample", f"one of {', '.join(map(repr, SCHEMES))}", repr(scheme))


class _Streams(threading.local):
    """A generator for each thread, set anew for every stream: to make one takes ten times as long."""

    def __init__(self) -> None:
        self.generator = np.random.Generator(np.random.Philox(0))
        self.start: Any = self.generator.bit_generator.state


_STREAMS = _Streams()


def stream(seed: int, step: int, *, restart: bool = False) -> np.random.Generator:
    """Return the random numbers of a step: of a restart in it, or of its motion.

    Every step of every seed has a stream of its own, with nothing to carry along. The generator is set to another
    stream by the next call in the same thread.

    Examples
    --------
    >>> round(stream(0, 1).random(), 6), round(stream(0, 2).random(), 6), round(stream(0, 1).random(), 6)
    (0.814434, 0.429156, 0.814434)
    """
    # Philox counts: a key is all there is to set.
    _STREAMS.start["state"]["key"][:] = seed, 2 * step + restart
    _STREAMS.generator.bit_generator.state = _STREAMS.start
    return _STREAMS.generator
