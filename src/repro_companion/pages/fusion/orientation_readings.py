r"""What two orientation sensors on a robot read together: the rotation vector of one seen from the other.

With the orientations :math:`R_i` of the sensors in the base frame, a reading is

.. math:: u = \log(e^{[l]_\times} R_i^T R_{i+1}\, e^{[r]_\times}),

where ``l`` is what the heading and the tilt of both sensors and the mounting of the first add up to, and ``r`` the
mounting of the second. Rotation vectors shorter than :math:`\pi` are a chart of the rotations: a filter may subtract
predicted from measured ones. A small turn :math:`\epsilon` between them, on the left, is
:math:`u - \hat u = J_l^{-1}(\hat u)\,\epsilon`: along the vector as it is, across it larger by
:math:`(\theta/2)/\sin(\theta/2)` (and turned by half the angle), 1.03 at 45 and 1.11 at 90 degrees. A white noise
of the orientation is therefore taken a little too small across the vector; the slow errors ``l`` and ``r`` enter
exactly.

For a constant-curvature segment :math:`\log R(q) = (-\Delta_y, \Delta_x, 0)/d`: linear in the bending, blind to the
elongation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from repro import se3
from repro.errors import bad_input
from repro.kinematics.motion import backbone_motion
from repro.kinematics.mounts import Mounts
from repro.kinematics.robot import Robot

_SWITCH = 1e-2
# asin(n)/n as a series of z = n^2: each coefficient from the one before it.
_ASINC = [1.0]
for _k in range(1, 10):
    _ASINC.append(_ASINC[-1] * (2 * _k - 1) ** 2 / (2 * _k * (2 * _k + 1)))
_CUBIC = tuple((-1) ** k / math.factorial(2 * k + 3) for k in range(10))


def rotation_matrix(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by a rotation vector [rad], exact with its derivatives at zero.

    Examples
    --------
    >>> rotation_matrix(torch.tensor([0.0, 0.0, torch.pi / 2], dtype=torch.float64)).round().abs()
    tensor([[0., 1., 0.],
            [1., 0., 0.],
            [0., 0., 1.]], dtype=torch.float64)
    """
    K, z = _cross(vector), (vector * vector).sum(-1)[..., None, None]
    return torch.eye(3).to(vector) + se3.sinc(z) * K + se3.cosc(z) * K @ K


def left_jacobian(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    r"""Turn on the left of a rotation when its rotation vector changes: :math:`\epsilon = J_l(u)\,du`.

    :math:`J_l = 1 + (1 - \cos\theta)/\theta^2\,[u]_\times + (\theta - \sin\theta)/\theta^3\,[u]_\times^2`.

    Examples
    --------
    >>> left_jacobian(torch.zeros(3))
    tensor([[1., 0., 0.],
            [0., 1., 0.],
            [0., 0., 1.]])
    """
    K, z = _cross(vector), (vector * vector).sum(-1)[..., None, None]
    small = z < se3.SERIES_SWITCH
    near = torch.where(small, z, 0.0)
    series = torch.full_like(z, _CUBIC[-1])
    for coefficient in reversed(_CUBIC[:-1]):
        series = series * near + coefficient
    far = torch.where(small, 1.0, z)
    cubic = torch.where(small, series, (1 - se3.sinc(far)) / far)
    return torch.eye(3).to(vector) + se3.cosc(z) * K + cubic * K @ K


def between_errors(
    turn: Float[Tensor, "*batch 3 3"],
    by_q: Float[Tensor, "*batch 3 n_q"],
    left: Float[Tensor, "*batch 3"],
    right: Float[Tensor, "*batch 3"],
) -> tuple[
    Float[Tensor, "*batch 3"],
    Float[Tensor, "*batch 3 n_q"],
    Float[Tensor, "*batch 3 3"],
    Float[Tensor, "*batch 3 3"],
]:
    r"""Rotation vector :math:`\log(e^{[l]_\times} R\, e^{[r]_\times})` [rad] and its derivatives.

    Parameters
    ----------
    turn
        The rotation ``R``.
    by_q
        Its turn on the left per unit of every coordinate [rad].
    left, right
        Rotation vectors of the errors [rad].
    """
    lead, trail = rotation_matrix(left), rotation_matrix(right)
    u = rotation_vector(lead @ turn @ trail)
    slopes = torch.cat([lead @ by_q, left_jacobian(left), lead @ turn @ left_jacobian(right)], dim=-1)
    found = torch.linalg.solve(left_jacobian(u), slopes).split([by_q.shape[-1], 3, 3], -1)
    return u, *found


def _cross(vector: Tensor) -> Tensor:
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3))


def rotation_vector(R: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    r"""Rotation vector [rad] of a rotation, the shortest: the inverse of :func:`rotation_matrix` below :math:`\pi`.

    Exact to rounding at zero and near :math:`\pi`, where the skew part of the matrix vanishes: it goes through the
    quaternion, taken from the row :math:`4 q_i\, q` of the matrix :math:`4 q q^T` that has the largest norm.

    Parameters
    ----------
    R
        Rotations; rows and columns orthonormal to rounding.

    Examples
    --------
    >>> rotation_vector(se3.rotation_x(torch.tensor(3.0, dtype=torch.float64)))
    tensor([3., 0., 0.], dtype=torch.float64)
    """
    (a, b, c), (d, e, f), (g, h, i) = ((x for x in row.unbind(-1)) for row in R.unbind(-2))
    rows = [
        [1 + a - e - i, b + d, c + g, h - f],
        [b + d, 1 - a + e - i, f + h, c - g],
        [c + g, f + h, 1 - a - e + i, d - b],
        [h - f, c - g, d - b, 1 + a + e + i],
    ]
    outer = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    largest = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    q = outer.gather(-2, largest[..., None, None].expand(*outer.shape[:-2], 1, 4)).squeeze(-2)
    q = q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)
    q = torch.where(q[..., 3:] < 0, -q, q)  # q and -q: the shorter way round
    v, w = q[..., :3], q[..., 3:]
    z = (v * v).sum(-1, keepdim=True)
    small = z < _SWITCH
    n = torch.where(small, 1.0, z).sqrt()
    near = torch.where(small, z, 0.0)
    series = torch.full_like(z, _ASINC[-1])
    for coefficient in reversed(_ASINC[:-1]):
        series = series * near + coefficient
    return 2 * v * torch.where(small, series, torch.atan2(n, w) / n)


@dataclass(frozen=True)
class OrientationReadings:
    """Sensor model ``u = sensing(q)``: the rotation vectors between neighbouring orientation sensors.

    Parameters
    ----------
    robot
        Its kinematics.
    imus
        Mounts of the sensors, at least two, from base to tip; their frames are those of the mounts.

    Raises
    ------
    InputError
        If there are fewer than two sensors.

    Examples
    --------
    A segment bent by 1 rad towards x turns its tip about y:

    >>> from repro.kinematics.mounts import magnet_mounts
    >>> from repro.kinematics.paper_robots import pcc_robot
    >>> sensing = OrientationReadings(pcc_robot(1), magnet_mounts([0, 0], [0.0, 0.11]))
    >>> sensing(torch.tensor([0.022, 0.0, 0.003], dtype=torch.float64))
    tensor([0., 1., 0.], dtype=torch.float64)
    """

    robot: Robot
    imus: Mounts

    def __post_init__(self) -> None:
        if len(self.imus) < 2:
            raise bad_input("imus", "OrientationReadings", "at least two sensors", len(self.imus))

    def __call__(
        self,
        q: Float[Tensor, "*batch n_q"],
        left: Float[Tensor, "*batch n"] | None = None,
        right: Float[Tensor, "*batch n"] | None = None,
    ) -> Float[Tensor, "*batch s"]:
        """Return the predicted rotation vectors [rad], one after the other.

        Parameters
        ----------
        q
            Configuration.
        left, right
            Rotation vectors [rad] of the errors ``l`` and ``r``, three for each reading of three; none when not
            given.

        Raises
        ------
        InputError
            If an error does not have as many components as the readings.
        """
        R = self.robot.mount_poses(q, self.imus)[..., :3, :3]
        turn = R[..., :-1, :, :].mT @ R[..., 1:, :, :]
        first, last = (self._error(name, error, q) for name, error in (("left", left), ("right", right)))
        return rotation_vector(rotation_matrix(first) @ turn @ rotation_matrix(last)).flatten(-2)

    def linearise(
        self,
        q: Float[Tensor, "*batch n_q"],
        left: Float[Tensor, "*batch n"] | None = None,
        right: Float[Tensor, "*batch n"] | None = None,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Readings [rad], and their derivatives by ``q`` ``[*batch, s, n_q]``, and by the errors ``[*batch, s, s]``.

        Parameters are those of a call. In closed form, many times cheaper than differentiating one.
        """
        T, dT = backbone_motion(self.robot, q, self.imus)
        local = self.imus.local.to(q)[..., :3, :3]
        R, dR = T[..., :3, :3] @ local, dT[..., :3, :3] @ local.unsqueeze(-3)
        below, above = R[..., :-1, :, :], R[..., 1:, :, :]
        turn = below.mT @ above
        moved = dR[..., :-1, :, :, :].mT @ above.unsqueeze(-3) + below.mT.unsqueeze(-3) @ dR[..., 1:, :, :, :]
        W = moved @ turn.mT.unsqueeze(-3)
        by_q = torch.stack([W[..., 2, 1], W[..., 0, 2], W[..., 1, 0]], dim=-2)
        first, last = (self._error(name, error, q) for name, error in (("left", left), ("right", right)))
        u, by_q, by_left, by_right = between_errors(turn, by_q, first, last)
        return u.flatten(-2), by_q.flatten(-3, -2), _blocks(by_left), _blocks(by_right)

    def _error(self, name: str, error: Tensor | None, q: Tensor) -> Tensor:
        n = len(self.imus) - 1
        if error is None:
            return q.new_zeros(n, 3)
        if error.shape[-1] != 3 * n:
            received = f"shape {tuple(error.shape)}"
            raise bad_input(name, "OrientationReadings", f"of last dimension {3 * n}", received)
        return error.unflatten(-1, (n, 3))


def _blocks(slopes: Tensor) -> Tensor:
    """Matrices ``[..., n, 3, 3]`` along the diagonal of one ``[..., 3 n, 3 n]``: each pair has errors of its own."""
    n = slopes.shape[-3]
    spread = slopes.unsqueeze(-2) * torch.eye(n).to(slopes)[:, None, :, None]
    return spread.flatten(-2).flatten(-3, -2)
