"""Networks on cosines in seconds (recipe ``"fast"``): AdamW, a one-cycle learning rate, shuffled batches.

A network takes a few seconds, so that nothing is kept between runs: an interrupted training starts again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from tqdm import tqdm

from edition1.errors import bad_input
from edition1.sensing._paper_training import VALIDATION_SHARE, rmse
from edition1.sensing.network import CosineNetwork, DipoleResidual

_BATCH = 1000
_EPOCHS = 10
_LEARNING_RATE = 1e-2


def _split_rows(n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Random rows for training (70 %) and validation (30 %): the seed of a network also splits its data."""
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    n_validation = round(n * VALIDATION_SHARE)
    return order[n_validation:], order[:n_validation]


def epochs_of_steps(steps: int, rows: int) -> int:
    """Return how many passes over the rows that train (70 % of all) are at least so many steps.

    Examples
    --------
    >>> epochs_of_steps(100, 3000)
    34
    """
    batches = -(-7 * rows // (10 * _BATCH))
    return -(-steps // batches)


def train_fast(
    cosines: Float[Tensor, "rows xi"],
    u: Float[Tensor, " readings"],
    *,
    seed: int,
    widths: Sequence[int] = (64, 64),
    epochs: int = _EPOCHS,
    learning_rate: float = _LEARNING_RATE,
    progress: bool = True,
) -> tuple[CosineNetwork, dict[str, float]]:
    """Train a network on cosines.

    The mean squared error of the scaled readings by AdamW in batches of 1000, drawn anew in every epoch; the
    learning rate rises to its maximum over 30 % of the steps and falls to nearly zero (one cycle).

    Parameters
    ----------
    cosines
        Relations as cosines.
    u
        Readings [mT].
    seed
        Draws the initial weights, the batches and the split: the same seed gives the same bits.
    widths
        Nodes of the hidden layers.
    epochs
        Passes over the training rows (70 %).
    learning_rate
        The largest of the cycle.
    progress
        Show a progress bar with the loss.

    Returns
    -------
    CosineNetwork, dict
        The network in evaluation mode, float32 (``.double()`` for estimation), and its root-mean-squared errors
        [mT] ``rmse_train`` and ``rmse_validation``.

    Raises
    ------
    InputError
        If the numbers of relations and readings differ, or there are fewer than four rows.
    FloatingPointError
        If the training diverges.
    """
    if len(cosines) != len(u) or len(u) < 4:
        raise bad_input("u", "train_fast", f"one for each of {len(cosines)} rows, at least 4", len(u))
    generator = torch.Generator().manual_seed(seed)
    network = CosineNetwork(cosines.shape[-1], generator, widths)
    train, validation = _split_rows(len(u), seed)
    network.standardise(cosines[train], u[train])
    x, y = cosines[train].float(), u[train].float()
    _fit(network, x, y, generator, epochs, learning_rate, progress)
    network.eval()
    x_val, y_val = cosines[validation].float(), u[validation].float()
    return network, {"rmse_train": rmse(network, x, y), "rmse_validation": rmse(network, x_val, y_val)}


def train_dipole_residual(
    cosines: Float[Tensor, "rows xi"],
    u: Float[Tensor, " readings"],
    *,
    seed: int,
    widths: Sequence[int] = (32, 32),
    epochs: int = _EPOCHS,
    learning_rate: float = _LEARNING_RATE,
    progress: bool = True,
) -> tuple[DipoleResidual, dict[str, float]]:
    """Fit dipole moments and the Earth field by linear least squares, then train a network on the remainder.

    Least squares, because gradient steps crawl on terms that are nearly collinear. The moments are those that leave
    the smallest remainder, some percent off the true ones: they take over part of the higher multipoles. Parameters
    and errors are those of :func:`train_fast`; the fit uses the rows that train the network.
    """
    train, _ = _split_rows(len(u), seed)
    terms = DipoleResidual.terms(cosines.double())
    unit = terms[train].square().mean(0).sqrt()  # the columns differ by ten orders of magnitude
    # NumPy's: torch's least squares do not give the same bits twice, and the training makes more of them.
    columns, wanted = (terms[train] / unit).numpy(), u[train].double().numpy()
    coefficients = torch.from_numpy(np.linalg.lstsq(columns, wanted, rcond=None)[0]) / unit
    residual, metrics = train_fast(
        cosines,
        (u - terms @ coefficients).to(u),
        seed=seed,
        widths=widths,
        epochs=epochs,
        learning_rate=learning_rate,
        progress=progress,
    )
    return DipoleResidual(coefficients.float(), residual).eval(), metrics


def _fit(
    network: CosineNetwork,
    x: Tensor,
    y: Tensor,
    generator: torch.Generator,
    epochs: int,
    learning_rate: float,
    progress: bool,
) -> None:
    x = (x - network.centre) / network.spread  # once, not in every step
    y = ((y - network.offset) / network.scale).unsqueeze(-1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=learning_rate, fused=True)
    steps = epochs * math.ceil(len(x) / _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, learning_rate, total_steps=steps)
    bar = tqdm(range(epochs), disable=not progress)
    for epoch in bar:
        total = torch.zeros(())
        for rows in torch.randperm(len(x), generator=generator).split(_BATCH):
            optimiser.zero_grad(set_to_none=True)
            loss = nn.functional.mse_loss(network.layers(x[rows]), y[rows])
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.detach() * len(rows)
        mean = float(total) / len(x)
        if not math.isfinite(mean):
            raise FloatingPointError(f"The loss is no longer finite in epoch {epoch}: lower learning_rate.")
        bar.set_postfix(rmse_mT=f"{float(network.scale) * mean**0.5:.5f}")
