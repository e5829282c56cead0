"""Networks of one size and seed trained side by side by the paper's recipe, with one compiled step.

Networks of the same seed and number of rows start from the same weights and draw the same _dropout: it is drawn once
for all of them. The result is that of :func:`edition1.sensing.training.train_paper` up to rounding, in half the time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters
from tqdm import tqdm

from edition1.kernels._training_step import train_step
from edition1.sensing._paper_training import (
    BATCH,
    EPOCHS,
    SWA_START,
    averaging_share,
    begin_pass,
    first_draws,
    refresh_batch_norm,
    rmse,
)


def train_together(
    sets: Sequence[tuple[Float[Tensor, "rows xi"], Float[Tensor, " rows"]]],
    *,
    seed: int,
    learning_rate: float,
    epochs: int = EPOCHS,
    swa_start: int = SWA_START,
    shuffled: bool = False,
    progress: bool = False,
) -> list[tuple[nn.Sequential, dict[str, float]]]:
    """Train one network on each data set; the networks and their metrics, as of ``train_paper``.

    Parameters
    ----------
    sets
        Relations as angles, and readings; float32, of one number of relations and of rows.
    seed, learning_rate, epochs, swa_start, progress
        As in :func:`edition1.sensing.training.train_paper`.

    shuffled
        With the rows in a new order in every epoch, which is not the paper's recipe.

    Raises
    ------
    FloatingPointError
        If a training diverges.
    """
    n_in = sets[0][0].shape[1]
    network, generator, train, validation = first_draws(len(sets[0][0]), n_in, seed)
    n, rows = len(train), [(xi[train].contiguous(), u[train].contiguous()) for xi, u in sets]
    start = parameters_to_vector(network.parameters()).detach().numpy()
    theta = np.repeat(start[None], len(sets), axis=0)
    average = np.zeros_like(theta)
    widths = (n_in, *(x.out_features for x in network if isinstance(x, nn.Linear) and x.out_features > 1))
    spaces = {size: _workspace(size, widths) for size in {min(BATCH, n), n % BATCH} if size}
    arrays = [(x.numpy(), y.numpy()) for x, y in rows]
    for epoch in tqdm(range(epochs), disable=not progress, mininterval=5):
        if (share := averaging_share(epoch, swa_start)) is not None:
            average += (theta - average) * np.float32(share)
        begin_pass(generator)
        if shuffled:
            order = torch.randperm(n, generator=generator).numpy()
            arrays = [(x.numpy()[order], y.numpy()[order]) for x, y in rows]
        loss = np.zeros(len(sets))
        for first in range(0, n, BATCH):
            size = min(BATCH, n - first)
            kept = _dropout(size, widths, generator)
            for k, (x, y) in enumerate(arrays):
                batch = slice(first, first + size)
                loss[k] += train_step(
                    theta[k], x[batch], y[batch], widths, kept, spaces[size], np.float32(learning_rate)
                )
        if not np.isfinite(loss).all():
            raise FloatingPointError(f"The loss is no longer finite in epoch {epoch}: lower learning_rate.")
        begin_pass(generator)  # of the validation rows
    begin_pass(generator)
    state, found = generator.get_state(), []
    for vector, (xi, u) in zip(average, sets, strict=True):
        network, own, _, _ = first_draws(len(xi), n_in, seed)
        vector_to_parameters(torch.from_numpy(vector), network.parameters())
        own.set_state(state)
        refresh_batch_norm(network, xi[train])
        network.eval()
        errors = {"rmse_train": train, "rmse_validation": validation}
        found.append((network, {name: rmse(network, xi[rows], u[rows]) for name, rows in errors.items()}))
    return found


def _dropout(size: int, widths: tuple[int, ...], generator: torch.Generator) -> tuple[np.ndarray, ...]:
    """Factors of the _dropout, in the order that the network draws them, and ones for the last layer."""
    kept = [torch.empty(size, w).bernoulli_(0.99, generator=generator) / 0.99 for w in widths[:-1]]
    return (*(x.numpy() for x in kept), np.ones((size, widths[-1]), np.float32))


def _workspace(size: int, widths: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Memory of one step, used again by the next."""
    arrays = [np.empty((size, w), np.float32) for w in (*widths[1:], *widths)]
    return (*arrays, np.empty(size * max(widths), np.float32))
