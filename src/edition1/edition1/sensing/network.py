"""Networks that predict a reading from the relations between a sensor and the magnets."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.errors import bad_input

_PAPER_WIDTHS = (96, 256, 64, 24)


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


class _SignedExponential(nn.Module):
    r"""Last layer :math:`y = \operatorname{sign}(x) e^{|x|}` of section 4.2; no value is between -1 and 1."""

    def forward(self, x: Tensor) -> Tensor:
        """Apply the function to each element."""
        return x.sign() * x.abs().exp()


def paper_network(
    n_inputs: int, generator: torch.Generator, *, exponential_head: bool = False
) -> nn.Sequential:
    """Network of Baaij et al. 2023, section 3.2, inputs as angles.

    A batch norm of the raw inputs, four blocks of dropout (1 %), linear layer, ReLU and batch norm with 96, 256,
    64 and 24 nodes, and a linear layer: 18 layers.

    Parameters
    ----------
    n_inputs
        One plus four for each magnet.
    generator
        Draws the initial weights (the default ones of torch's linear layer) and the dropout.
    exponential_head
        Add the signed exponential as a last layer (section 4.2).

    Examples
    --------
    >>> network = paper_network(5, torch.Generator().manual_seed(0))
    >>> network(torch.ones(650, 5)).shape
    torch.Size([650])
    """
    layers: list[nn.Module] = [nn.BatchNorm1d(n_inputs)]
    for n_in, n_out in zip((n_inputs, *_PAPER_WIDTHS), _PAPER_WIDTHS, strict=False):
        layers += [
            Dropout(0.01, generator),
            _linear(n_in, n_out, generator),
            nn.ReLU(),
            nn.BatchNorm1d(n_out),
        ]
    layers += [_linear(_PAPER_WIDTHS[-1], 1, generator), nn.Flatten(-2)]
    return nn.Sequential(*layers, *([_SignedExponential()] if exponential_head else []))


def _linear(n_in: int, n_out: int, generator: torch.Generator) -> nn.Linear:
    """Linear layer with torch's default initialisation, drawn from ``generator``."""
    # Made without values: the usual construction would draw from the global generator.
    layer = nn.Linear(n_in, n_out, device="meta").to_empty(device="cpu")
    bound = n_in**-0.5
    for p in layer.parameters():
        nn.init.uniform_(p, -bound, bound, generator=generator)
    return layer


class CosineNetwork(nn.Module):
    """Network on relations as cosines, smooth in the configuration: a multilayer perceptron with SiLU.

    Inputs are standardised and the output is scaled by constants stored with the weights (buffers). Without batch
    norm and dropout a row is predicted the same in training and in evaluation.

    Parameters
    ----------
    n_inputs
        One plus four for each magnet.
    generator
        Draws the initial weights.
    widths
        Nodes of the hidden layers.
    """

    centre: Tensor
    spread: Tensor
    offset: Tensor
    scale: Tensor

    def __init__(self, n_inputs: int, generator: torch.Generator, widths: Sequence[int] = (64, 64)) -> None:
        super().__init__()
        self.register_buffer("centre", torch.zeros(n_inputs))
        self.register_buffer("spread", torch.ones(n_inputs))
        self.register_buffer("offset", torch.zeros(()))
        self.register_buffer("scale", torch.ones(()))
        layers: list[nn.Module] = []
        for n_in, n_out in zip((n_inputs, *widths), widths, strict=False):
            layers += [_linear(n_in, n_out, generator), nn.SiLU()]
        self.layers = nn.Sequential(*layers, _linear(widths[-1], 1, generator))

    def standardise(self, cosines: Float[Tensor, "rows xi"], u: Float[Tensor, " rows"]) -> None:
        """Take the constants from training rows: mean and standard deviation of the inputs and the readings."""
        self.centre.copy_(cosines.mean(0))
        self.offset.copy_(u.mean())
        for buffer, spread in ((self.spread, cosines.std(0)), (self.scale, u.std())):
            buffer.copy_(torch.where(spread > 0, spread, 1.0))

    def forward(self, cosines: Float[Tensor, "*batch xi"]) -> Float[Tensor, "*batch"]:
        """Return the predicted reading for every row of relations."""
        if cosines.shape[-1] != len(self.centre):
            expected = f"of last dimension {len(self.centre)}"
            raise bad_input("cosines", "CosineNetwork", expected, f"shape {tuple(cosines.shape)}")
        u = self.layers((cosines - self.centre) / self.spread).squeeze(-1)
        return self.offset + self.scale * u


class DipoleResidual(nn.Module):
    r"""The exact field of dipoles, and a network for what is missing.

    .. math:: u = B_e \cos\lambda
              + \sum_k A_k \frac{3\cos\theta_k \cos\beta_k - \cos\alpha_k}{d_k^3} + \mathrm{network}(\xi)

    This is the first term of :mod:`edition1.sensing.multipole`; the higher ones, a tenth of the reading or less, are
    left to the network.

    Parameters
    ----------
    coefficients
        Earth field :math:`B_e` [mT], then the dipole moments :math:`A_k` [mT m^3] of the magnets.
    residual
        Network for the rest, with the same inputs.
    """

    coefficients: Tensor

    def __init__(self, coefficients: Float[Tensor, " terms"], residual: CosineNetwork) -> None:
        super().__init__()
        self.register_buffer("coefficients", coefficients)
        self.residual = residual

    @staticmethod
    def terms(cosines: Float[Tensor, "*batch xi"]) -> Float[Tensor, "*batch terms"]:
        """Factors of the coefficients: the reading is linear in them."""
        d, cos_alpha, cos_beta, cos_theta = cosines[..., 1:].unflatten(-1, (-1, 4)).unbind(-1)
        return torch.cat([cosines[..., :1], (3 * cos_theta * cos_beta - cos_alpha) / d**3], dim=-1)

    def forward(self, cosines: Float[Tensor, "*batch xi"]) -> Float[Tensor, "*batch"]:
        """Return the predicted reading for every row of relations."""
        rest = self.residual(cosines)  # first: it checks the width
        return self.terms(cosines) @ self.coefficients + rest


class PerSensor(nn.Module):
    """A sensor model made of several: sensor ``j`` is predicted by ``networks[network_of_sensor[j]]``.

    Baaij et al. 2023 train one network per segment (section 3.2) or one per sensor (4.2).

    Parameters
    ----------
    networks
        Each maps rows of relations to one reading.
    network_of_sensor
        Index of the network for every sensor.

    Raises
    ------
    InputError
        If an index points at no network; on a call, if the relations are of another robot.
    """

    def __init__(self, networks: Sequence[nn.Module], network_of_sensor: Sequence[int]) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        self.network_of_sensor = tuple(network_of_sensor)
        self.n_inputs = _n_inputs(networks[0]) if networks else None
        if not set(self.network_of_sensor) <= set(range(len(networks))):
            expected = f"indices of {len(networks)} networks"
            raise bad_input("network_of_sensor", "PerSensor", expected, self.network_of_sensor)

    def forward(self, xi: Float[Tensor, "*batch s xi"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted reading of every sensor."""
        wanted = (len(self.network_of_sensor), self.n_inputs or xi.shape[-1])
        if xi.shape[-2:] != wanted:
            expected = f"of last dimensions {wanted} (sensors, relations)"
            raise bad_input("xi", "PerSensor", expected, f"shape {tuple(xi.shape)}")
        columns: dict[int, Tensor] = {}
        for k, network in enumerate(self.networks):
            here = [j for j, n in enumerate(self.network_of_sensor) if n == k]
            rows = xi[..., here, :]
            u = network(rows.flatten(0, -2)).unflatten(0, rows.shape[:-1])
            columns.update(zip(here, u.unbind(-1), strict=True))
        return torch.stack([columns[j] for j in range(len(self.network_of_sensor))], dim=-1)


def _n_inputs(network: nn.Module) -> int | None:
    """Width of the relations that a network takes, read off its first layer; none if it has no such layer."""
    for m in network.modules():
        if isinstance(m, nn.BatchNorm1d):
            return m.num_features
        if isinstance(m, nn.Linear):
            return m.in_features
    return None
