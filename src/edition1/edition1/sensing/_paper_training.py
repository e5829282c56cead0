"""The draws, averages and errors of a training by the paper's recipe."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.sensing.network import paper_network

BATCH = 650


EPOCHS = 250


SWA_START = 125


VALIDATION_SHARE = 0.3


def first_draws(
    rows: int, n_inputs: int, seed: int, *, exponential_head: bool = False
) -> tuple[nn.Sequential, torch.Generator, Tensor, Tensor]:
    """What the released code draws before the first epoch, from one stream of random numbers.

    First the split of the rows, then the weights of the network, layer by layer; then the number that a check of two
    batches of validation rows takes. The dropout draws what follows.

    Returns
    -------
    nn.Sequential, torch.Generator, Tensor, Tensor
        The network, the stream that its dropout goes on with, and the rows that train and that validate: see
        :data:`edition1.sensing.training.SPLIT`.
    """
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(rows, generator=generator)
    n_train = rows - int(VALIDATION_SHARE * rows)
    network = paper_network(n_inputs, generator, exponential_head=exponential_head)
    begin_pass(generator)
    return network, generator, order[:n_train], order[n_train:]


def begin_pass(generator: torch.Generator) -> None:
    """Draw the number that torch's loader of batches draws whenever it is gone through anew."""
    torch.empty((), dtype=torch.int64).random_(generator=generator)


def averaging_share(epoch: int, swa_start: int) -> float | None:
    """Share of the weights at the beginning of an epoch (from 0) in their average so far; none before averaging."""
    first = max(swa_start - 1, 0)
    return None if epoch < first else 1 / (epoch - first + 1)


def rmse(network: nn.Module, x: Float[Tensor, "rows xi"], y: Float[Tensor, " rows"]) -> float:
    """Root-mean-squared error of a network in its present mode [unit of ``y`` ]."""
    with torch.no_grad():
        squared = sum(float(((network(a) - b) ** 2).sum()) for a, b in batches(x, y, 20_000))
    return (squared / len(y)) ** 0.5


def batches(x: Tensor, y: Tensor, size: int) -> Iterator[tuple[Tensor, Tensor]]:
    for start in range(0, len(x), size):
        yield x[start : start + size], y[start : start + size]


def refresh_batch_norm(network: nn.Module, x: Tensor) -> None:
    """One pass over the training rows that replaces running statistics by plain averages over the batches."""
    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm1d)]
    momenta = [m.momentum for m in norms]
    for m in norms:
        m.reset_running_stats()
        m.momentum = None
    network.train()
    with torch.no_grad():
        for a, _ in batches(x, x, BATCH):
            network(a)
    for m, momentum in zip(norms, momenta, strict=True):
        m.momentum = momentum
