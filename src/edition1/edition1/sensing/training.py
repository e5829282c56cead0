"""How the networks of Baaij et al. 2023 were trained (recipe ``"paper"``): a plain, resumable loop."""

from __future__ import annotations

import hashlib
import math
import os
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from tqdm import tqdm

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.sensing._paper_training import (
    BATCH,
    EPOCHS,
    SWA_START,
    VALIDATION_SHARE,
    averaging_share,
    batches,
    begin_pass,
    first_draws,
    refresh_batch_norm,
    rmse,
)

SPLIT = (
    "p = torch.randperm(rows) after torch.manual_seed(seed); p[:rows - int(0.3 rows)] train, "
    "in this order and never shuffled; the rest validate"
)
"""Which rows train, in which order: as in the released code, for the manifests."""


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
    unit: str = "mT",
    progress: bool = True,
) -> tuple[nn.Sequential, dict[str, float], Float[Tensor, "epochs 2"]]:
    """Train one network as the published ones were trained.

    SGD without momentum at a constant learning rate on the raw mean squared error, batches of 650 in the order
    of the split, never shuffled. The weights at the beginning of each epoch from the 125th on are averaged (SWA);
    the result is the average after one more pass that refreshes the batch-norm statistics. The released training
    state shows this constant rate; section 3.2 names cosine annealing.

    Split, initial weights and dropout come from one stream of random numbers, as in the released code (see
    :func:`first_draws`). As the order of the rows never changes, the last batches of an epoch are always the same
    rows, and all networks of one seed with as many rows have them in common: the split is a part of the result.

    After every epoch the state goes to ``checkpoint`` (written whole or not at all), and a later call with the
    same arguments goes on from there: at most the running epoch is lost, and the result has the same bits.

    Parameters
    ----------
    xi
        Relations as angles, float32.
    u
        Readings.
    seed
        Draws the split, the initial weights and the dropout.
    learning_rate
        0.18 for constant curvature, 0.15 for affine curvature.
    checkpoint
        File for the state between runs.
    exponential_head
        With the last layer of section 4.2: see :func:`~edition1.sensing.network.paper_network`.
    epochs, swa_start
        250 and 125 in the paper.
    unit
        Unit of the readings, for the progress bar.
    progress
        Show a progress bar with the losses.

    Returns
    -------
    nn.Sequential, dict, Tensor
        The averaged network in evaluation mode; its root-mean-squared errors ``rmse_train`` and ``rmse_validation``
        [unit of ``u`` ]; and the mean squared errors of every epoch on the training rows (with dropout, while the
        weights move) and on the validation rows (at its end).

    Raises
    ------
    InputError
        If relations and readings are not finite float32 numbers of as many rows, at least 4, or a batch would have
        one row only; if the checkpoint is of another training, or of more epochs.
    FloatingPointError
        If the loss does not stay finite.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> xi = torch.rand(2000, 5, generator=torch.Generator().manual_seed(0))
    >>> options = {"seed": 0, "learning_rate": 0.1, "epochs": 2, "swa_start": 1, "progress": False}
    >>> network, errors, losses = train_paper(xi, xi.sum(1), checkpoint=Path(mkdtemp()) / "state", **options)
    >>> losses.shape
    torch.Size([2, 2])
    """
    _check_rows(xi, u)
    network, generator, train, validation = first_draws(
        len(xi), xi.shape[-1], seed, exponential_head=exponential_head
    )
    average = [p.detach().clone() for p in network.parameters()]
    x, y, x_val, y_val = xi[train], u[train], xi[validation], u[validation]
    optimiser = torch.optim.SGD(network.parameters(), lr=learning_rate)
    # What the state in the file must have come from; the number of epochs may grow.
    settings = (seed, learning_rate, swa_start, BATCH, SPLIT) + (("head",) if exponential_head else ())
    content = hashlib.sha256(repr(settings).encode())
    content.update(xi.numpy().tobytes() + u.numpy().tobytes())
    run = content.hexdigest()
    curve = _resume(checkpoint, network, average, generator, run)
    start = len(curve)
    require(start <= epochs, "epochs", "train_paper", f"at least {start}, which the checkpoint has", epochs)
    bar = tqdm(range(start, epochs), initial=start, total=epochs, disable=not progress, mininterval=5)
    for epoch in bar:
        if (share := averaging_share(epoch, swa_start)) is not None:
            with torch.no_grad():
                for a, p in zip(average, network.parameters(), strict=True):
                    a.lerp_(p, share)
        begin_pass(generator)
        loss = _epoch(network, optimiser, x, y)
        if not math.isfinite(loss):
            raise FloatingPointError(f"The loss is no longer finite in epoch {epoch}: lower learning_rate.")
        begin_pass(generator)
        network.eval()
        loss_validation = rmse(network, x_val, y_val) ** 2
        curve = torch.cat([curve, curve.new_tensor([[loss, loss_validation]])])
        bar.set_postfix({f"rmse_{unit}": f"{loss**0.5:.4f}"})
        _save(checkpoint, network, average, generator, curve, run)
    with torch.no_grad():
        for a, p in zip(average, network.parameters(), strict=True):
            p.copy_(a)
    begin_pass(generator)
    refresh_batch_norm(network, x)
    network.eval()
    metrics = {"rmse_train": rmse(network, x, y), "rmse_validation": rmse(network, x_val, y_val)}
    return network, metrics, curve


def _check_rows(xi: Tensor, u: Tensor) -> None:
    """Refuse rows that cannot be trained on."""
    owner, dtype = "train_paper", torch.float32
    if xi.ndim != 2 or u.shape != xi.shape[:1] or xi.dtype != dtype or u.dtype != dtype:
        received = f"{xi.dtype} of shape {tuple(xi.shape)}, {u.dtype} of shape {tuple(u.shape)}"
        raise bad_input("xi, u", owner, "float32 of shapes [rows, k] and [rows]", received)
    se3.require_finite(xi, "xi", owner)
    se3.require_finite(u, "u", owner)
    rows = len(xi)
    n_train = rows - int(VALIDATION_SHARE * rows)
    # batch norm takes no single row; fewer than four leave none to validate
    if rows < 4 or n_train % BATCH == 1:
        expected = (
            f"at least 4, of which those that train fill batches of {BATCH} with more than one left over"
        )
        raise bad_input("rows of xi", owner, expected, rows)


def _epoch(network: nn.Module, optimiser: torch.optim.Optimizer, x: Tensor, y: Tensor) -> float:
    network.train()
    total = 0.0
    for a, b in batches(x, y, BATCH):
        optimiser.zero_grad(set_to_none=True)
        loss = nn.functional.mse_loss(network(a), b)
        loss.backward()
        optimiser.step()
        total += float(loss.detach()) * len(a)
    return total / len(x)


def _save(
    path: Path, network: nn.Module, average: list[Tensor], generator: torch.Generator, curve: Tensor, run: str
) -> None:
    state = {f"network.{k}": v for k, v in network.state_dict().items()}
    state |= {f"average.{k}": a for k, a in enumerate(average)}
    state |= {"generator": generator.get_state(), "curve": curve}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    save_file(state, partial, metadata={"run": run})
    os.replace(partial, path)


def _resume(
    path: Path, network: nn.Module, average: list[Tensor], generator: torch.Generator, run: str
) -> Float[Tensor, "epochs 2"]:
    """Fill in the state of the file, if there is one; return the losses of the epochs behind it."""
    if not path.exists():
        return torch.empty(0, 2, dtype=torch.float64)
    with safe_open(path, framework="pt") as file:
        about = file.metadata() or {}
    if about.get("run") != run:
        expected = "of the same data, seed and learning rate (or not there)"
        raise bad_input("checkpoint", "train_paper", expected, f"another training's: {path.name}")
    state = load_file(path)
    network.load_state_dict(
        {k.removeprefix("network."): v for k, v in state.items() if k.startswith("network.")}
    )
    for k, a in enumerate(average):
        a.copy_(state[f"average.{k}"])
    generator.set_state(state["generator"])
    return state["curve"]
