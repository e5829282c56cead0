"""Networks that predict a reading from the relations between a sensor and the magnets."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from repro.errors import bad_input

PAPER_WIDTHS = (96, 256, 64, 24)


class Dropout(nn.Module):
    """Dropout that draws from a generator of its own, so that training never touches the global one."""

    def __init__(self, p: float, generator: torch.Generator) -> None:
        super().__init__()
        self.p, self.generator = p, generator

    def forward(self, x: Tensor) -> Tensor:
        """Zero each element with probability ``p`` in training and scale the rest; identity otherwise."""
        if not self.training:
            return x
        keep = torch.empty_like(x).bernoulli_(1 - self.p, generator=self.generator)
        return x * (keep / (1 - self.p))


def paper_network(n_inputs: int, generator: torch.Generator) -> nn.Sequential:
    """Network of Baaij et al. 2023, section 3.2, inputs as angles.

    A batch norm of the raw inputs, four blocks of dropout (1 %), linear layer, ReLU and batch norm with 96, 256,
    64 and 24 nodes, and a linear layer: 18 layers.

    Parameters
    ----------
    n_inputs
        One plus four for each magnet.
    generator
        Draws the initial weights (the default ones of torch's linear layer) and the dropout.
    """
    layers: list[nn.Module] = [nn.BatchNorm1d(n_inputs)]
    for n_in, n_out in zip((n_inputs, *PAPER_WIDTHS), PAPER_WIDTHS, strict=False):
        layers += [Dropout(0.01, generator), linear(n_in, n_out, generator), nn.ReLU(), nn.BatchNorm1d(n_out)]
    return nn.Sequential(*layers, linear(PAPER_WIDTHS[-1], 1, generator), nn.Flatten(-2))


def linear(n_in: int, n_out: int, generator: torch.Generator) -> nn.Linear:
    """Linear layer with torch's default initialisation, drawn from ``generator``."""
    layer = nn.Linear(n_in, n_out)
    bound = n_in**-0.5
    for p in layer.parameters():
        nn.init.uniform_(p, -bound, bound, generator=generator)
    return layer


class PerSensor(nn.Module):
    """A sensor model made of several: sensor ``j`` is predicted by ``networks[network_of_sensor[j]]``.

    Baaij et al. 2023 train one network per segment (section 3.2) or one per sensor (4.2).

    Parameters
    ----------
    networks
        Each maps rows of relations to one reading.
    network_of_sensor
        Index of the network for every sensor.
    """

    def __init__(self, networks: Sequence[nn.Module], network_of_sensor: Sequence[int]) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        self.network_of_sensor = tuple(network_of_sensor)

    def forward(self, xi: Float[Tensor, "*batch s xi"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted reading of every sensor."""
        if xi.shape[-2] != len(self.network_of_sensor):
            expected = f"relations of {len(self.network_of_sensor)} sensors"
            raise bad_input("xi", "PerSensor", expected, f"shape {tuple(xi.shape)}")
        columns: dict[int, Tensor] = {}
        for k, network in enumerate(self.networks):
            here = [j for j, n in enumerate(self.network_of_sensor) if n == k]
            rows = xi[..., here, :]
            u = network(rows.flatten(0, -2)).unflatten(0, rows.shape[:-1])
            columns.update(zip(here, u.unbind(-1), strict=True))
        return torch.stack([columns[j] for j in range(len(self.network_of_sensor))], dim=-1)
