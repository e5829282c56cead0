"""How the networks of Baaij et al. 2023 were trained (recipe ``"paper"``): a plain, resumable loop."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from tqdm import tqdm

from repro.errors import bad_input
from repro.sensing.network import paper_network

BATCH = 650
EPOCHS = 250
SWA_START = 125
VALIDATION_SHARE = 0.3


def split_rows(n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Random rows for training (70 %) and validation (30 %): the seed of a network also splits its data."""
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    n_validation = round(n * VALIDATION_SHARE)
    return order[n_validation:], order[:n_validation]


def train_paper(
    xi: Float[Tensor, "rows xi"],
    u: Float[Tensor, " rows"],
    *,
    seed: int,
    learning_rate: float,
    checkpoint: Path,
    exponential_head: bool = False,
    epochs: int = EPOCHS,
    swa_start: int = SWA_START,
    progress: bool = True,
) -> tuple[nn.Sequential, dict[str, float]]:
    """Train one network as the published ones were trained.

    SGD without momentum at a constant learning rate on the raw mean squared error, batches of 650 in the order
    of the split, never shuffled. From epoch 125 on the weights at the end of each epoch are averaged (SWA); the
    result is the average after one more pass that refreshes the batch-norm statistics. The released training
    state shows this constant rate; section 3.2 names cosine annealing.

    After every epoch the state goes to ``checkpoint`` (written whole or not at all), and a later call with the
    same arguments goes on from there: at most the running epoch is lost, and the result has the same bits.

    Parameters
    ----------
    xi
        Relations as angles, float32.
    u
        Readings [mT].
    seed
        Draws the initial weights, the dropout and the split.
    learning_rate
        0.18 for constant curvature, 0.15 for affine curvature.
    checkpoint
        File for the state between runs.
    exponential_head
        With the last layer of section 4.2: see :func:`~repro.sensing.network.paper_network`.
    epochs, swa_start
        250 and 125 in the paper.
    progress
        Show a progress bar with the losses.

    Returns
    -------
    nn.Sequential, dict
        The averaged network in evaluation mode, and its root-mean-squared errors [mT] ``rmse_train`` and
        ``rmse_validation``.
    """
    generator = torch.Generator().manual_seed(seed)
    network, average = (
        paper_network(xi.shape[-1], generator, exponential_head=exponential_head) for _ in range(2)
    )
    train, validation = split_rows(len(xi), seed)
    x, y, x_val, y_val = xi[train], u[train], xi[validation], u[validation]
    optimiser = torch.optim.SGD(network.parameters(), lr=learning_rate)
    # What the state in the file must have come from; the number of epochs may grow.
    settings = (seed, learning_rate, swa_start, BATCH) + (("head",) if exponential_head else ())
    content = hashlib.sha256(repr(settings).encode())
    content.update(xi.numpy().tobytes() + u.numpy().tobytes())
    run = content.hexdigest()
    start = _resume(checkpoint, network, average, run)
    bar = tqdm(range(start, epochs), initial=start, total=epochs, disable=not progress, mininterval=5)
    for epoch in bar:
        # From seed and epoch alone, so that an epoch does not depend on how the ones before it were run.
        generator.manual_seed((seed << 32) + epoch)
        loss = _epoch(network, optimiser, x, y)
        if not math.isfinite(loss):
            raise FloatingPointError(f"The loss is no longer finite in epoch {epoch}: lower learning_rate.")
        n_averaged = epoch - swa_start
        if n_averaged >= 0:
            with torch.no_grad():
                for a, p in zip(average.parameters(), network.parameters(), strict=True):
                    a += (p - a) / (n_averaged + 1)
        bar.set_postfix(rmse_mT=f"{loss**0.5:.4f}")
        _save(checkpoint, network, average, {"epoch": str(epoch + 1), "run": run})
    generator.manual_seed((seed << 32) + epochs)
    refresh_batch_norm(average, x)
    average.eval()
    metrics = {"rmse_train": rmse(average, x, y), "rmse_validation": rmse(average, x_val, y_val)}
    return average, metrics


def rmse(network: nn.Module, x: Float[Tensor, "rows xi"], y: Float[Tensor, " rows"]) -> float:
    """Root-mean-squared error of a network in its present mode [unit of ``y`` ]."""
    with torch.no_grad():
        squared = sum(float(((network(a) - b) ** 2).sum()) for a, b in _batches(x, y, 20_000))
    return (squared / len(y)) ** 0.5


def _batches(x: Tensor, y: Tensor, size: int) -> Iterator[tuple[Tensor, Tensor]]:
    for start in range(0, len(x), size):
        yield x[start : start + size], y[start : start + size]


def _epoch(network: nn.Module, optimiser: torch.optim.Optimizer, x: Tensor, y: Tensor) -> float:
    network.train()
    total = 0.0
    for a, b in _batches(x, y, BATCH):
        optimiser.zero_grad(set_to_none=True)
        loss = nn.functional.mse_loss(network(a), b)
        loss.backward()
        optimiser.step()
        total += float(loss.detach()) * len(a)
    return total / len(x)


def refresh_batch_norm(network: nn.Module, x: Tensor) -> None:
    """One pass over the training rows that replaces running statistics by plain averages over the batches."""
    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm1d)]
    momenta = [m.momentum for m in norms]
    for m in norms:
        m.reset_running_stats()
        m.momentum = None
    network.train()
    with torch.no_grad():
        for a, _ in _batches(x, x, BATCH):
            network(a)
    for m, momentum in zip(norms, momenta, strict=True):
        m.momentum = momentum


def _save(path: Path, network: nn.Module, average: nn.Module, about: dict[str, str]) -> None:
    state = {f"network.{k}": v for k, v in network.state_dict().items()}
    state |= {f"average.{k}": v for k, v in average.state_dict().items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    save_file(state, partial, metadata=about)
    os.replace(partial, path)


def _resume(path: Path, network: nn.Module, average: nn.Module, run: str) -> int:
    if not path.exists():
        return 0
    with safe_open(path, framework="pt") as file:
        about = file.metadata() or {}
    if about.get("run") != run:
        expected = "of the same data, seed and learning rate (or not there)"
        raise bad_input("checkpoint", "train_paper", expected, f"another training's: {path.name}")
    state = load_file(path)
    for name, module in (("network.", network), ("average.", average)):
        module.load_state_dict({k.removeprefix(name): v for k, v in state.items() if k.startswith(name)})
    return int(about["epoch"])
