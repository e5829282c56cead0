"""Training of networks in torch: the paper's recipe, and a fast one of ours.

A network maps the relations of one sensor, eq. (1) of Baaij et al. 2023, to its reading. Weights are written as
safetensors, which :func:`.load_network` reads without torch. Training draws from torch's own generator, as the
authors' program does, and leaves the generator as it was.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import Progress
from safetensors.torch import save
from torch import Tensor, nn

from repro.common import Array, numbers, require, whole

PAPER_BATCH, FAST_BATCH = 650, 1000


def paper_network(n_inputs: int) -> nn.Sequential:
    """Return the network of Baaij et al. 2023, section 3.2, before training. Its inputs are relations as angles.

    A batch norm of the raw inputs comes first. Four blocks of dropout (1 %), linear layer, ReLU and batch norm have
    96, 256, 64 and 24 nodes. A linear layer makes the reading.

    Parameters
    ----------
    n_inputs
        Number of relations: one plus four for each magnet.

    Examples
    --------
    >>> paper_network(5)(torch.ones(650, 5)).shape
    torch.Size([650])
    """
    layers: list[nn.Module] = [nn.BatchNorm1d(n_inputs)]
    for n_in, n_out in ((n_inputs, 96), (96, 256), (256, 64), (64, 24)):
        layers += [nn.Dropout(0.01), nn.Linear(n_in, n_out), nn.ReLU(), nn.BatchNorm1d(n_out)]
    return nn.Sequential(*layers, nn.Linear(24, 1), nn.Flatten(-2))


class FastNetwork(nn.Module):
    """Our network: two layers of 64 nodes with SiLU, on relations as cosines, so that it is smooth in them.

    Inputs and output are scaled by constants that are stored with the weights. Without batch norm and dropout a row
    is predicted the same in training and afterwards.

    Parameters
    ----------
    n_inputs
        Number of relations: one plus four for each magnet.
    """

    def __init__(self, n_inputs: int) -> None:
        super().__init__()
        self.centre, self.spread = nn.Buffer(torch.zeros(n_inputs)), nn.Buffer(torch.ones(n_inputs))
        self.offset, self.scale = nn.Buffer(torch.zeros(())), nn.Buffer(torch.ones(()))
        hidden = nn.Linear(n_inputs, 64), nn.SiLU(), nn.Linear(64, 64), nn.SiLU()
        self.layers = nn.Sequential(*hidden, nn.Linear(64, 1))

    def forward(self, cosines: Tensor) -> Tensor:
        """Return the reading predicted for every row of relations."""
        u = self.layers((cosines - self.centre) / self.spread).squeeze(-1)
        return self.offset + self.scale * u


def train_paper(
    xi: Any,
    u: Any,
    seed: int,
    learning_rate: float,
    checkpoint: str | Path,
    *,
    epochs: int = 250,
    swa_start: int = 125,
    progress: str | None = None,
) -> tuple[nn.Sequential, dict[str, float], Array]:
    """Train one network as the published ones were trained.

    Stochastic gradient descent without momentum lowers the mean squared error at a constant learning rate, in batches
    of 650 rows whose order never changes. The weights at the beginning of each epoch from the 125th on are averaged,
    and one more pass over the rows then computes the statistics of the batch norms. (Section 3.2 of the paper names
    cosine annealing; the training state that the authors released shows the constant rate.)

    The split of the rows, the initial weights and the dropout come from one stream of random numbers, as in the
    released code. A seed is therefore a split, which all networks with as many rows share.

    After every epoch the state is written to ``checkpoint``, whole or not at all. A later call with the same
    arguments goes on from there and comes to the same bits as one that was never interrupted.

    Parameters
    ----------
    xi
        Relations as angles ``[rows, 1 + 4 magnets]``; used as float32.
    u
        Readings ``[rows]``, in any unit.
    seed
        Draws the split, the initial weights and the dropout.
    learning_rate
        0.18 for constant curvature, 0.15 for affine curvature, 5e-5 for the experiments in mV.
    checkpoint
        File for the state between runs.
    epochs
        Passes over the data, 250 in the paper.
    swa_start
        The epoch from which on weights are averaged, 125 in the paper.
    progress
        Label of a progress bar with the error; none if not given.

    Returns
    -------
    network
        The averaged network in evaluation mode.
    errors
        Its root-mean-squared errors ``rmse_train`` and ``rmse_validation`` [unit of ``u``].
    losses
        The mean squared errors of every epoch ``[epochs, 2]``: on the training rows while the weights move, and on
        the validation rows afterwards.

    Raises
    ------
    InputError
        If there are fewer than four rows, the last batch would have one row, the numbers do not fit or are not
        finite; if averaging would not begin; if the checkpoint is of another training or of more epochs.
    FloatingPointError
        If the loss does not stay finite.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> xi = np.random.default_rng(0).random((1000, 5))
    >>> state = Path(mkdtemp()) / "state"
    >>> network, errors, losses = train_paper(xi, xi.sum(1), 0, 0.1, state, epochs=2, swa_start=1)
    >>> losses.shape
    (2, 2)
    """
    xi, u = _rows(xi, u, "train_paper")
    require(1 <= swa_start <= epochs, "swa_start", "train_paper", f"1 to {epochs}, the epochs", swa_start)
    checkpoint, first = Path(checkpoint), swa_start - 1
    n_train = len(u) - int(0.3 * len(u))
    words = f"so many that batches of {PAPER_BATCH} do not leave a single row, which no batch norm takes"
    require(n_train % PAPER_BATCH != 1, "rows of xi", "train_paper", words, len(u))
    content = repr((seed, learning_rate, swa_start)).encode() + xi.numpy().tobytes() + u.numpy().tobytes()
    run = hashlib.sha256(content).hexdigest()
    with torch.random.fork_rng(devices=[]), Progress(disable=progress is None) as bar:
        torch.manual_seed(seed)
        order = torch.randperm(len(u))
        network = paper_network(xi.shape[1])
        _begin_pass()  # the released program checks two batches of validation rows first
        x, y, x_val, y_val = xi[order[:n_train]], u[order[:n_train]], xi[order[n_train:]], u[order[n_train:]]
        average = [p.detach().clone() for p in network.parameters()]
        losses = torch.empty(0, 2, dtype=torch.float64)
        if checkpoint.exists():
            state = torch.load(checkpoint, weights_only=True)
            words = "of the same rows, seed and learning rate, and of no more epochs (or not there)"
            same = state["run"] == run and len(state["losses"]) <= epochs
            require(same, "checkpoint", "train_paper", words, f"{checkpoint}, which is another training's")
            average, losses = state["average"], state["losses"]
            network.load_state_dict(state["network"])
            torch.set_rng_state(state["generator"])
        optimiser = torch.optim.SGD(network.parameters(), lr=learning_rate)
        task = bar.add_task(progress or "", total=epochs, completed=len(losses))
        for epoch in range(len(losses), epochs):
            if epoch >= first:
                for mean, p in zip(average, network.parameters(), strict=True):
                    mean.lerp_(p.detach(), 1 / (epoch - first + 1))
            _begin_pass()
            network.train()
            total = 0.0
            for a, b in zip(x.split(PAPER_BATCH), y.split(PAPER_BATCH), strict=True):
                total += _step(network(a), b, optimiser) * len(a)
            mse = total / len(x)
            if not math.isfinite(mse):
                raise FloatingPointError(
                    f"The loss is no longer finite in epoch {epoch}: lower learning_rate."
                )
            _begin_pass()
            network.eval()
            losses = torch.cat([losses, losses.new_tensor([[mse, _rmse(network, x_val, y_val) ** 2]])])
            checkpoint.parent.mkdir(parents=True, exist_ok=True)
            with whole(checkpoint, "train", new=False) as partial:
                weights = {"network": network.state_dict(), "average": average}
                torch.save(
                    {**weights, "losses": losses, "generator": torch.get_rng_state(), "run": run}, partial
                )
            bar.update(task, advance=1, description=f"{progress}: error {mse**0.5:.4f}")
        with torch.no_grad():
            for mean, p in zip(average, network.parameters(), strict=True):
                p.copy_(mean)
        _begin_pass()
        torch.optim.swa_utils.update_bn(x.split(PAPER_BATCH), network.train())
    network.eval()
    errors = {"rmse_train": _rmse(network, x, y), "rmse_validation": _rmse(network, x_val, y_val)}
    return network, errors, losses.numpy()


def train_fast(
    cosines: Any, u: Any, seed: int, *, epochs: int = 10, progress: str | None = None
) -> tuple[FastNetwork, dict[str, float]]:
    """Train our network, in seconds; nothing is kept between runs.

    AdamW lowers the mean squared error of the scaled readings in batches of 1000 rows, drawn again in every epoch.
    The learning rate rises to 0.01 over 30 % of the steps and falls to nearly zero.

    Parameters
    ----------
    cosines
        Relations as cosines ``[rows, 1 + 4 magnets]``; used as float32.
    u
        Readings ``[rows]``, in any unit.
    seed
        Draws the initial weights, the batches and the split.
    epochs
        Passes over the 70 % of the rows that train.
    progress
        Label of a progress bar with the error; none if not given.

    Returns
    -------
    network
        The network in evaluation mode.
    errors
        Its root-mean-squared errors ``rmse_train`` and ``rmse_validation`` [unit of ``u``].

    Raises
    ------
    InputError
        If there are fewer than four rows, or the numbers do not fit or are not finite.

    Examples
    --------
    >>> cosines = np.random.default_rng(0).random((4000, 5))
    >>> network, errors = train_fast(cosines, cosines[:, 0] * cosines[:, 1], seed=0)
    >>> round(errors["rmse_validation"], 2)
    0.04
    """
    cosines, u = _rows(cosines, u, "train_fast")
    with torch.random.fork_rng(devices=[]), Progress(disable=progress is None) as bar:
        torch.manual_seed(seed)
        order = torch.randperm(len(u))
        torch.manual_seed(seed)  # the split and the rest do not share their draws
        network = FastNetwork(cosines.shape[1])
        train, validation = order[round(0.3 * len(u)) :], order[: round(0.3 * len(u))]
        x, y = cosines[train], u[train]
        network.centre.copy_(x.mean(0))
        network.offset.copy_(y.mean())
        for constant, spread in ((network.spread, x.std(0)), (network.scale, y.std())):
            constant.copy_(torch.where(spread > 0, spread, 1.0))
        inputs = (x - network.centre) / network.spread  # once, not in every step
        outputs = ((y - network.offset) / network.scale).unsqueeze(-1)
        optimiser = torch.optim.AdamW(network.parameters(), lr=1e-2, fused=True)
        steps = epochs * math.ceil(len(x) / FAST_BATCH)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 1e-2, total_steps=steps)
        task = bar.add_task(progress or "", total=epochs)
        for _ in range(epochs):
            total = 0.0
            for rows in torch.randperm(len(x)).split(FAST_BATCH):
                total += _step(network.layers(inputs[rows]), outputs[rows], optimiser) * len(rows)
                schedule.step()
            error = float(network.scale) * (total / len(x)) ** 0.5
            bar.update(task, advance=1, description=f"{progress}: error {error:.5f}")
    network.eval()
    errors = {"rmse_train": _rmse(network, x, y)}
    return network, errors | {"rmse_validation": _rmse(network, cosines[validation], u[validation])}


def _rows(xi: Any, u: Any, owner: str) -> tuple[Tensor, Tensor]:
    """Return relations and readings as float32, or refuse them."""
    xi = numbers(xi, "xi", owner, (None, None))
    require(len(xi) >= 4, "rows of xi", owner, "at least 4", len(xi))
    u = numbers(u, "u", owner, (len(xi),))
    return torch.from_numpy(xi.astype(np.float32)), torch.from_numpy(u.astype(np.float32))


def _begin_pass() -> None:
    """Draw the number that torch's loader of batches draws at the beginning of a pass over the rows."""
    torch.empty((), dtype=torch.int64).random_()


def _step(predicted: Tensor, u: Tensor, optimiser: torch.optim.Optimizer) -> float:
    """Move the weights once; return the mean squared error before."""
    loss = nn.functional.mse_loss(predicted, u)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    optimiser.step()
    return float(loss.detach())


def _rmse(network: nn.Module, x: Tensor, y: Tensor) -> float:
    with torch.no_grad():
        pairs = zip(x.split(20_000), y.split(20_000), strict=True)
        squared = sum(float(((network(a) - b) ** 2).sum()) for a, b in pairs)
    return (squared / len(y)) ** 0.5


def save_network(network: nn.Module, path: str | Path, manifest: Mapping[str, Any]) -> None:
    """Write weights, and beside them a manifest (``.json``) that says what they are; each whole or not at all.

    Parameters
    ----------
    network
        Its parameters and buffers are written.
    path
        Ends in ``.safetensors``. It appears last: where it is, the manifest is too.
    manifest
        What can be said of the training: recipe, seeds, data, errors. The hash of the weights and the versions of
        torch, NumPy and magpylib are added.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    weights = save({name: value.contiguous() for name, value in network.state_dict().items()})
    versions = {name: version(name) for name in ("torch", "numpy", "magpylib")}
    full = {**manifest, "weights_sha256": hashlib.sha256(weights).hexdigest(), "versions": versions}
    # A line for each entry: the losses of 250 epochs would be 500 lines otherwise.
    entries = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in full.items())
    for file, content in ((path.with_suffix(".json"), f"{{\n{entries}\n}}\n".encode()), (path, weights)):
        with whole(file, "save_network", new=False) as partial:
            partial.write_bytes(content)
