r"""The kinematic relations between sensors and magnets (Baaij et al. 2023, eqs 1-7)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.robot import Robot


@dataclass(frozen=True)
class Relations:
    r"""What a sensor and the magnets of a robot have to do with each other.

    An axisymmetric field depends on nothing else: on the distance :math:`d`, the angle :math:`\alpha` between
    the measurement direction and the axis of the magnet, :math:`\beta` between the measurement direction and
    the vector from magnet to sensor, :math:`\theta` between the axis of the magnet and that vector, and, for
    the Earth field, :math:`\lambda` between the measurement direction and the field.

    Parameters
    ----------
    sensor_axis
        Measurement directions :math:`o_s`, eq. (3), unit vectors in the base frame.
    magnet_axis
        Axes :math:`o_m` of the magnets, eq. (3), unit vectors in the base frame.
    offset
        Vectors ``p`` from magnet to sensor [m], eq. (5), in the base frame.
    earth_axis
        Direction :math:`n_e` of the Earth field in the base frame, a unit vector.
    """

    sensor_axis: Float[Tensor, "*batch s 3"]
    magnet_axis: Float[Tensor, "*batch m 3"]
    offset: Float[Tensor, "*batch s m 3"]
    earth_axis: Float[Tensor, "*earth 3"]

    @property
    def distance(self) -> Float[Tensor, "*batch s m"]:
        """Distance ``d`` between magnet and sensor [m], eq. (5)."""
        return torch.linalg.vector_norm(self.offset, dim=-1)

    def cosines(self) -> Float[Tensor, "*batch s xi"]:
        r"""Relations as :math:`(\cos\lambda, d_1, \cos\alpha_1, \cos\beta_1, \cos\theta_1, d_2, \dots)`.

        Eqs (4)-(6) before the inverse cosine: smooth in the configuration, the straight pose included.
        """
        d = self.distance
        o_s, o_m = self.sensor_axis.unsqueeze(-2), self.magnet_axis.unsqueeze(-3)
        cos_lambda = (self.sensor_axis * self.earth_axis.unsqueeze(-2)).sum(-1)
        cos_alpha = (o_s * o_m).sum(-1)
        cos_beta = (self.offset * o_s).sum(-1) / d
        cos_theta = (self.offset * o_m).sum(-1) / d
        return _stack(cos_lambda, (d, cos_alpha, cos_beta, cos_theta))

    def angles(self) -> Float[Tensor, "*batch s xi"]:
        r"""Relations :math:`\xi = (\lambda, d_1, \alpha_1, \beta_1, \theta_1, d_2, \dots)` of eq. (1) [rad, m].

        Angles have a kink where two directions are parallel (at the straight pose, for one). The derivative
        there is set to zero, the middle of the two sides; the value is exact everywhere.
        """
        o_s, o_m = self.sensor_axis.unsqueeze(-2), self.magnet_axis.unsqueeze(-3)
        angle_lambda = _angle(self.sensor_axis, self.earth_axis.unsqueeze(-2))
        pairs = (_angle(o_s, o_m), _angle(self.offset, o_s), _angle(self.offset, o_m))
        return _stack(angle_lambda, (self.distance, *pairs))


def relations(
    robot: Robot, q: Float[Tensor, "*q n_q"], earth_axis: Float[Tensor, "*earth 3"] | None = None
) -> Relations:
    """Relations between all sensors and all magnets of a robot, eqs (3)-(7).

    Parameters
    ----------
    robot
        With at least one magnet and one sensor.
    q
        Configuration.
    earth_axis
        Direction of the Earth field in the base frame; its length does not matter. The x axis when not
        given: the relation is an input of the networks even without an Earth field.

    Raises
    ------
    InputError
        If the robot has no magnet or no sensor, or the direction is zero.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> straight = relations(pcc_robot(1), torch.zeros(3, dtype=torch.float64))
    >>> straight.distance[:, 0].round(decimals=5)  # of each sensor from the magnet [m]
    tensor([0.0565, 0.0565, 0.0565], dtype=torch.float64)
    """
    if not len(robot.magnets) or not len(robot.sensors):
        counts = f"{len(robot.magnets)} magnets and {len(robot.sensors)} sensors"
        raise bad_input("robot", "relations", "a robot with magnets and sensors", counts)
    T_m, T_s = robot.magnet_and_sensor_poses(q)
    n_e = q.new_tensor([1.0, 0.0, 0.0]) if earth_axis is None else earth_axis.to(q)
    length = torch.linalg.vector_norm(n_e, dim=-1, keepdim=True)
    if earth_axis is not None and not bool((length > 0).all()):
        raise bad_input("earth_axis", "relations", "a direction", earth_axis.tolist())
    offset = T_s[..., :, None, :3, 3] - T_m[..., None, :, :3, 3]
    return Relations(T_s[..., :3, 2], T_m[..., :3, 2], offset, n_e / length)


def _stack(first: Tensor, pairs: tuple[Tensor, ...]) -> Tensor:
    per_magnet = torch.stack(torch.broadcast_tensors(*pairs), dim=-1).flatten(-2)
    batch = torch.broadcast_shapes(first.shape, per_magnet.shape[:-1])
    return torch.cat([first.expand(batch).unsqueeze(-1), per_magnet.expand(*batch, -1)], dim=-1)


def _angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle between vectors from both sine and cosine: accurate near 0 and pi, where acos is not."""
    a, b = torch.broadcast_tensors(a, b)
    cross = torch.linalg.cross(a, b)
    squared = (cross * cross).sum(-1)
    parallel = squared == 0
    sine = torch.where(parallel, 0.0, torch.where(parallel, 1.0, squared).sqrt())
    return torch.atan2(sine, (a * b).sum(-1))
