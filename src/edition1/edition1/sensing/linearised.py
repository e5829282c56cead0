r"""Readings of the multipole model together with their derivatives, in closed form.

The reading of a sensor with direction ``o`` is a sum over magnets of functions of three vectors: ``o``, the axis
``m`` of the magnet and the offset ``p`` from magnet to sensor. Their derivatives are the same whatever then moves
the vectors: the configuration of the robot (estimation) or the placement of its parts (calibration).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.robot import Robot
from edition1.sensing._slopes import contract, pair_readings, with_jacobian


@dataclass(frozen=True)
class LinearisedSensing:
    r"""Sensor model ``u = sensing(q)`` of the multipole field whose derivative is known in closed form.

    Equal to :class:`~edition1.sensing.magnetic.MagneticSensing` with a
    :class:`~edition1.sensing.multipole.MultipoleField`, times a gain per sensor. Reverse-mode differentiation
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
        If the robot has no magnets or no sensors, or moments, gains or the Earth field do not fit or are not finite.

    Examples
    --------
    A dipole straight below a sensor that looks down: -2 A_1/d^3 at d = 55 mm:

    >>> from edition1.kinematics.paper_robots import pcc_robot
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
        if self.earth_mt is not None and self.earth_mt.shape[-1:] != (3,):
            raise bad_input(
                "earth_mt", owner, "a vector in the base frame", f"shape {tuple(self.earth_mt.shape)}"
            )
        for name in ("gain", "earth_mt"):
            if (values := getattr(self, name)) is not None:
                se3.require_finite(values, name, owner)

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
