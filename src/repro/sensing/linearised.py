r"""Readings of the multipole model together with their derivatives, in closed form.

The reading of a sensor with direction ``o`` is a sum over magnets of functions of three vectors: ``o``, the axis
``m`` of the magnet and the offset ``p`` from magnet to sensor. Their derivatives are the same whatever then moves
the vectors: the configuration of the robot (estimation) or the placement of its parts (calibration).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.kinematics.motion import backbone_motion
from repro.kinematics.robot import Robot
from repro.sensing.magnets import multipole_polynomials


@dataclass(frozen=True)
class PairReadings:
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
) -> PairReadings:
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
    return PairReadings(
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


@dataclass(frozen=True)
class LinearisedSensing:
    r"""Sensor model ``u = sensing(q)`` of the multipole field whose derivative is known in closed form.

    Equal to :class:`~repro.sensing.magnetic.MagneticSensing` with a
    :class:`~repro.sensing.multipole.MultipoleField`, times a gain per sensor. Reverse-mode differentiation
    (``torch.func.jacrev``) finds the Jacobian already there: estimators become several times faster.

    Parameters
    ----------
    robot
        With its magnets and sensors; a batch of robots broadcasts against the batch of ``q``.
    moments
        Moments :math:`A_1, A_3, ...` [mT m^(l+2)], common to all magnets, with the batch of the robots; with
        ``per_magnet`` a row for each magnet, ``[*batch, m, terms]``.
    gain
        Gain of every sensor; 1 when not given.
    earth_mt
        Earth field in the base frame [mT]; none when not given.
    per_magnet
        Whether each magnet has moments of its own.

    Raises
    ------
    InputError
        If the robot has no magnets or no sensors, or the moments or gains do not fit or are not finite.

    Examples
    --------
    A dipole straight below a sensor that looks down: -2 A_1/d^3 at d = 55 mm:

    >>> from repro.kinematics.paper_robots import pcc_robot
    >>> sensing = LinearisedSensing(pcc_robot(1, 1, radial=0.0), torch.tensor([1e-4], dtype=torch.float64))
    >>> sensing(torch.zeros(3, dtype=torch.float64))
    tensor([-1.2021], dtype=torch.float64)
    """

    robot: Robot
    moments: Float[Tensor, "*moments terms"]
    gain: Float[Tensor, "*batch s"] | None = None
    earth_mt: Float[Tensor, " 3"] | None = None
    per_magnet: bool = False

    def __post_init__(self) -> None:
        owner, n_s = "LinearisedSensing", len(self.robot.sensors)
        if not len(self.robot.magnets) or not n_s:
            counts = f"{len(self.robot.magnets)} magnets and {n_s} sensors"
            raise bad_input("robot", owner, "a robot with magnets and sensors", counts)
        if not self.moments.numel() or not bool(torch.isfinite(self.moments).all()):
            raise bad_input("moments", owner, "finite, at least one", self.moments.tolist())
        n_m = len(self.robot.magnets)
        if self.per_magnet and (self.moments.ndim < 2 or self.moments.shape[-2] != n_m):
            shape = f"shape {tuple(self.moments.shape)}"
            raise bad_input("moments", owner, f"a row for each of {n_m} magnets", shape)
        if self.gain is not None and self.gain.shape[-1:] != (n_s,):
            raise bad_input(
                "gain", owner, f"one for each of {n_s} sensors", f"shape {tuple(self.gain.shape)}"
            )

    @property
    def moment_rows(self) -> Float[Tensor, "*moments m terms"]:
        """Moments [mT m^(l+2)], a row for each magnet or one for all."""
        return self.moments if self.per_magnet else self.moments.unsqueeze(-2)

    def __call__(self, q: Float[Tensor, "*q n_q"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted readings [mT] at configuration ``q``."""
        return with_jacobian(q, self)

    def linearise(
        self, q: Float[Tensor, "*q n_q"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
        """Readings [mT] and their derivatives with respect to ``q`` [mT/m]."""
        n_m = len(self.robot.magnets)
        mounts = self.robot.magnets.joined(self.robot.sensors)
        frames, motion = backbone_motion(self.robot, q, mounts)
        columns = mounts.local[..., 2:].to(q)  # axis and position of every mount
        axis, position = (frames @ columns)[..., :3, :].unbind(-1)
        moved = (motion.flatten(-3, -2) @ columns).unflatten(-2, (-1, 4))
        d_axis, d_position = moved[..., :3, :].unbind(-1)
        offset = position[..., n_m:, None, :] - position[..., None, :n_m, :]
        o, m = axis[..., n_m:, :], axis[..., :n_m, :]
        pairs = pair_readings(self.moment_rows.unsqueeze(-3), o, m, offset)
        u, by_o = pairs.u.sum(-1), pairs.by_sensor_axis.sum(-2)
        if self.earth_mt is not None:
            earth = self.earth_mt.to(q)
            u, by_o = u + o @ earth, by_o + earth
        by_p = pairs.by_offset
        J = (d_axis[..., n_m:, :, :] @ by_o.unsqueeze(-1)).squeeze(-1)
        J = J + (d_position[..., n_m:, :, :] @ by_p.sum(-2).unsqueeze(-1)).squeeze(-1)
        J = J + contract(pairs.by_magnet_axis, d_axis[..., :n_m, :, :])
        J = J - contract(by_p, d_position[..., :n_m, :, :])
        if self.gain is not None:
            u, J = self.gain.to(q) * u, self.gain.to(q).unsqueeze(-1) * J
        return u, J


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
