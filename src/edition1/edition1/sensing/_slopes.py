"""Readings of pairs of magnet and sensor with their derivatives, and how these become slopes by anything."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.sensing._multipoles import multipole_polynomials


@dataclass(frozen=True)
class _PairReadings:
    """Readings of every sensor due to every magnet, and their derivatives.

    Parameters
    ----------
    columns
        Reading per unit of each moment [m^-(l+2)].
    u
        Reading [mT].
    by_sensor_axis, by_magnet_axis
        Derivatives with respect to ``o`` and ``m`` [mT].
    by_offset
        Derivative with respect to ``p`` [mT/m].
    """

    columns: Float[Tensor, "*batch s m terms"]
    u: Float[Tensor, "*batch s m"]
    by_sensor_axis: Float[Tensor, "*batch s m 3"]
    by_magnet_axis: Float[Tensor, "*batch s m 3"]
    by_offset: Float[Tensor, "*batch s m 3"]


def pair_readings(
    moments: Float[Tensor, "*moments terms"],
    sensor_axis: Float[Tensor, "*batch s 3"],
    magnet_axis: Float[Tensor, "*batch m 3"],
    offset: Float[Tensor, "*batch s m 3"],
) -> _PairReadings:
    r"""Readings and derivatives with :math:`u = f\, o \cdot m + g\, o \cdot \hat p`, :math:`c = m \cdot \hat p`.

    Parameters
    ----------
    moments
        :math:`A_1, A_3, ...` [mT m^(l+2)]; leading dimensions broadcast against those of the pairs.
    sensor_axis, magnet_axis
        Unit vectors in one frame.
    offset
        From magnet to sensor [m], in that frame.
    """
    o, m, p = sensor_axis.unsqueeze(-2), magnet_axis.unsqueeze(-3), offset
    d = torch.linalg.vector_norm(p, dim=-1)
    p_hat = p / d.unsqueeze(-1)
    cos_alpha, cos_beta, cos_theta = ((a * b).sum(-1) for a, b in ((o, m), (o, p_hat), (m, p_hat)))
    terms = moments.shape[-1]
    polynomials = _polynomials(terms).to(p)
    powers = torch.cumprod(
        torch.cat([torch.ones_like(p[..., :1]), cos_theta.unsqueeze(-1).expand(*d.shape, 2 * terms - 1)], -1),
        -1,
    )
    f_c, g_c, df_c, dg_c = (powers @ polynomials).unflatten(-1, (4, terms)).unbind(-2)
    order = torch.arange(1, 2 * terms, 2, device=p.device)
    decay = (1 / d).unsqueeze(-1) ** (order + 2)
    weights = moments.to(p) * decay
    columns = decay * (f_c * cos_alpha.unsqueeze(-1) + g_c * cos_beta.unsqueeze(-1))
    f, g = (weights * f_c).sum(-1), (weights * g_c).sum(-1)
    by_theta = ((weights * df_c).sum(-1) * cos_alpha + (weights * dg_c).sum(-1) * cos_beta).unsqueeze(-1)
    by_d = (-(order + 2) * moments.to(p) * columns).sum(-1) / d
    f, g = f.unsqueeze(-1), g.unsqueeze(-1)
    across_o = (o - cos_beta.unsqueeze(-1) * p_hat) / d.unsqueeze(-1)
    across_m = (m - cos_theta.unsqueeze(-1) * p_hat) / d.unsqueeze(-1)
    return _PairReadings(
        columns=columns,
        u=(moments.to(p) * columns).sum(-1),
        by_sensor_axis=f * m + g * p_hat,
        by_magnet_axis=f * o + by_theta * p_hat,
        by_offset=g * across_o + by_theta * across_m + by_d.unsqueeze(-1) * p_hat,
    )


@lru_cache(maxsize=8)
def _polynomials(terms: int) -> Tensor:
    """Columns of :math:`-P'_l`, :math:`P'_{l+1}` and their derivatives, one block of orders after the other."""
    blocks = [torch.from_numpy(p) for p in multipole_polynomials(2 * terms - 1)]
    power = torch.arange(1, 2 * terms, dtype=torch.float64)
    slopes = [torch.nn.functional.pad(p[:, 1:] * power, (0, 1)) for p in blocks]
    return torch.cat(blocks + slopes).T


def contract(gradient: Tensor, motion: Tensor) -> Tensor:
    """Sum over magnets and axes: ``[..., s, m, 3]`` with ``[..., m, n_q, 3]`` to ``[..., s, n_q]``."""
    return gradient.flatten(-2) @ motion.movedim(-2, -1).flatten(-3, -2)


@runtime_checkable
class Linearised(Protocol):
    """A sensor model that knows its Jacobian."""

    def linearise(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Predicted readings and their derivatives by ``q``."""
        ...


def with_jacobian(q: Tensor, sensing: Linearised) -> Tensor:
    """Return readings; their backward pass multiplies with the Jacobian that ``sensing.linearise`` returns."""
    return _WithJacobian.apply(q, sensing)[0]


class _WithJacobian(torch.autograd.Function):
    """Readings whose backward pass multiplies with a Jacobian computed in the forward pass."""

    @staticmethod
    def forward(q: Tensor, sensing: Linearised) -> tuple[Tensor, Tensor]:
        return sensing.linearise(q)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.save_for_backward(output[1])
        ctx.mark_non_differentiable(output[1])
        ctx.shape = inputs[0].shape

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (J,) = ctx.saved_tensors
        return (grads[0].unsqueeze(-2) @ J).squeeze(-2).sum_to_size(ctx.shape), None
