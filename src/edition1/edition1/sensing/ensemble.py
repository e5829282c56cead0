"""Networks of several seeds as one sensor model: every layer of all of them is one batched product."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.errors import bad_input
from edition1.sensing.network import CosineNetwork, paper_network

_Layers = list[tuple[Tensor, Tensor]]
"""Weights ``[out, in]`` and biases ``[out]`` of linear layers, first to last."""


def _fold_batch_norm(network: nn.Sequential) -> _Layers:
    """Linear layers, with ReLU between them, that equal a network of the paper in evaluation mode.

    With its running statistics a batch norm is linear: it becomes part of the linear layer behind it. Folded in
    double precision, returned in the precision of the network.

    Parameters
    ----------
    network
        From :func:`~edition1.sensing.network.paper_network`.

    Raises
    ------
    InputError
        If the layers are not those of a network of the paper.
    """
    kinds = [type(m).__name__ for m in network]
    if kinds != [type(m).__name__ for m in paper_network(1, torch.Generator())]:
        raise bad_input("network", "SeedEnsemble", "a network of the paper", ", ".join(kinds))
    layers: _Layers = []
    gain = shift = torch.empty(0)
    for m in network:
        if isinstance(m, nn.BatchNorm1d):
            mean, variance = m.get_buffer("running_mean").double(), m.get_buffer("running_var").double()
            gain = m.weight.detach() / (variance + m.eps).sqrt()
            shift = m.bias.detach() - gain * mean
        elif isinstance(m, nn.Linear):  # always behind a batch norm
            W, b = m.weight.detach().double(), m.bias.detach().double()
            layers.append(((W * gain).to(m.weight), (b + W @ shift).to(m.weight)))
    return layers


def _fold_scaling(network: CosineNetwork) -> _Layers:
    """Linear layers, with SiLU between them, that equal a network on cosines: its constants are folded in."""
    layers = [(m.weight.detach(), m.bias.detach()) for m in network.layers if isinstance(m, nn.Linear)]
    W = layers[0][0].double() / network.spread
    b = layers[0][1] - W @ network.centre.double()
    layers[0] = (W.to(network.centre), b.to(network.centre))
    W, b = layers[-1]
    layers[-1] = (W * network.scale, b * network.scale + network.offset)
    return layers


class SeedEnsemble(nn.Module):
    """Models like :class:`~edition1.sensing.network.PerSensor`, one for each seed, in one batch.

    A call costs little more than that of a single network. The weights are constants: derivatives are those with
    respect to the relations. It computes in the precision of the weights (``.double()`` for estimation by least
    squares) and returns that of the relations.

    Parameters
    ----------
    networks
        ``networks[seed][k]``: networks of the paper, taken in evaluation mode, or networks on cosines.
    network_of_sensor
        Index ``k`` of the network of every sensor, the same for all seeds.

    Raises
    ------
    InputError
        If the networks differ in architecture, or an index points at none; on a call, if the relations are of
        another robot or another number of seeds.
    """

    def __init__(self, networks: Sequence[Sequence[nn.Module]], network_of_sensor: Sequence[int]) -> None:
        super().__init__()
        folded = [[_fold(network) for network in seed] for seed in networks]
        architectures = {(f, *(tuple(W.shape) for W, _ in layers)) for seed in folded for f, layers in seed}
        counts = {len(seed) for seed in networks}
        if len(counts) != 1 or len(architectures) != 1:
            expected = "equally many networks of one architecture for every seed"
            raise bad_input("networks", "SeedEnsemble", expected, f"{counts} and {architectures}")
        n = counts.pop()
        if not network_of_sensor or not set(network_of_sensor) <= set(range(n)):
            raise bad_input(
                "network_of_sensor", "SeedEnsemble", f"indices of {n} networks", network_of_sensor
            )
        self.activation = folded[0][0][0]
        # A slot is one product: all sensors of a network if each network has as many, else each sensor alone.
        used = sorted(set(network_of_sensor))
        equal = len({list(network_of_sensor).count(k) for k in used}) == 1
        slots = used if equal else list(network_of_sensor)
        order = sorted(range(len(network_of_sensor)), key=lambda j: network_of_sensor[j])
        self.order = order if equal and order != sorted(order) else None
        self.n_slots, self.n_sensors = len(slots), len(network_of_sensor)
        first = folded[0][0][1]
        self.n_seeds, self.n_layers, self.n_inputs = len(networks), len(first), first[0][0].shape[1]
        for k in range(self.n_layers):
            W = torch.stack([seed[i][1][k][0].T for seed in folded for i in slots])
            b = torch.stack([seed[i][1][k][1] for seed in folded for i in slots])
            self.register_buffer(f"weight_{k}", W)
            self.register_buffer(f"bias_{k}", b.unsqueeze(-2))

    def forward(self, xi: Float[Tensor, "seeds *batch s xi"]) -> Float[Tensor, "seeds *batch s"]:
        """Return the predicted reading of every sensor; the first dimension is the seed."""
        wanted = (self.n_seeds, self.n_sensors, self.n_inputs)
        if (xi.shape[0], *xi.shape[-2:]) != wanted:
            expected = f"of first and last dimensions {wanted} (seeds, sensors, relations)"
            raise bad_input("xi", "SeedEnsemble", expected, f"shape {tuple(xi.shape)}")
        grouped = (xi if self.order is None else xi[..., self.order, :]).unflatten(-2, (self.n_slots, -1))
        grouped = grouped.movedim(-3, 1)
        x = grouped.reshape(self.n_seeds * self.n_slots, -1, self.n_inputs).to(self.get_buffer("weight_0"))
        for k in range(self.n_layers):
            x = torch.baddbmm(self.get_buffer(f"bias_{k}"), x, self.get_buffer(f"weight_{k}"))
            if k < self.n_layers - 1:
                x = self.activation(x)
        u = x.to(xi).reshape(grouped.shape[:-1]).movedim(1, -2).flatten(-2)
        return u if self.order is None else u[..., [self.order.index(j) for j in range(self.n_sensors)]]


def _fold(network: nn.Module) -> tuple[Callable[[Tensor], Tensor], _Layers]:
    if isinstance(network, CosineNetwork):
        return nn.functional.silu, _fold_scaling(network)
    if isinstance(network, nn.Sequential):
        return torch.relu, _fold_batch_norm(network)
    expected = "networks of the paper or on cosines"
    raise bad_input("networks", "SeedEnsemble", expected, type(network).__name__)
