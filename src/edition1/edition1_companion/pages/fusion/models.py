r"""Sensor models of one robot with magnets and IMUs: configuration, slow errors and stray field to readings.

The IMUs at its ends read the rotation vector of one seen from the other. With their orientations :math:`R_i` in the
base frame a reading is

.. math:: u = \log(e^{[l]_\times} R_1^T R_2\, e^{[r]_\times}),

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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.linearised import LinearisedSensing
from edition1_companion.twins.calibration_session import released_moments
from edition1_companion.twins.segment_motion import ROBOT, cross_matrix, rotation_matrix

_SWITCH = 1e-2
_ASINC = [math.comb(2 * k, k) / (4**k * (2 * k + 1)) for k in range(10)]
"""Coefficients of asin(n)/n, a series in n^2."""
_SERIES_BELOW = 1.0
"""Squared angle [rad^2] below which the series is summed."""
_CUBIC = [(-1) ** k / math.factorial(2 * k + 3) for k in range(10)]
"""Coefficients of (x - sin x)/x^3, a series in x^2."""


@dataclass(frozen=True)
class Magnets:
    """The ring's sensors as a model of ``(q, ..., stray field)``, whatever stands between.

    Parameters
    ----------
    stray
        Whether the last three coordinates are a field in the base frame [mT].
    """

    stray: bool

    def __call__(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted readings [mT]."""
        return self.linearise(x)[0]

    def linearise(
        self, x: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n"]]:
        """Predicted readings [mT] and their derivatives."""
        u, J = ring_model().linearise(x[..., :3])
        J = torch.nn.functional.pad(J, (0, x.shape[-1] - 3))
        if self.stray:
            turn, by_q = _turn(x[..., :3])
            direction, stray = ROBOT.sensors.local[:, :3, 2].to(x), x[..., -3:]
            axes = direction @ turn.mT
            u = u + (axes @ stray.unsqueeze(-1)).squeeze(-1)
            # (e x o) . b = e . (o x b)
            by_turn = torch.linalg.cross(axes, stray.unsqueeze(-2).expand_as(axes))
            unseen = J.new_zeros(*J.shape[:-1], J.shape[-1] - 6)
            J = J + torch.cat([by_turn @ by_q, unseen, axes], dim=-1)
        return u, J


@dataclass(frozen=True)
class Imus:
    """The IMUs as a model of ``(q, constant, wandering, mounting, ...)``: three errors of three components.

    Parameters
    ----------
    held
        Whether ``q`` has no elongation: it is held in the middle.
    """

    held: bool

    def __call__(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch s"]:
        """Return the predicted rotation vector [rad]."""
        return self.linearise(x)[0]

    def linearise(
        self, x: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n"]]:
        """Predicted rotation vector [rad] and its derivatives."""
        n = 2 if self.held else 3
        turn, by_q = _turn(x[..., :n])
        left, right = x[..., n : n + 3] + x[..., n + 3 : n + 6], x[..., n + 6 : n + 9]
        lead = rotation_matrix(left)
        u = rotation_vector(lead @ turn @ rotation_matrix(right))
        # Turns on the left of the reading by each of them, and from turns to the components of the vector.
        slopes = torch.cat([lead @ by_q, left_jacobian(left), lead @ turn @ left_jacobian(right)], dim=-1)
        by_q, by_left, by_right = torch.linalg.solve(left_jacobian(u), slopes).split([n, 3, 3], -1)
        J = torch.cat([by_q, by_left, by_left, by_right], dim=-1)
        return u, torch.nn.functional.pad(J, (0, x.shape[-1] - n - 9))


@cache
def ring_model() -> Any:
    """The ring's sensors as drawn, compiled."""
    return compiled(LinearisedSensing(ROBOT, released_moments()))


def _turn(q: Tensor) -> tuple[Tensor, Tensor]:
    """Orientation of the tip, and how the coordinates turn it: its rotation vector is linear in them."""
    chart = (
        q.new_tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])[:, : q.shape[-1]]
        / Dimensions.RADIUS_M
    )
    vector = q @ chart.mT
    return rotation_matrix(vector), left_jacobian(vector) @ chart


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
    K, z = cross_matrix(vector), (vector * vector).sum(-1)[..., None, None]
    small = z < _SERIES_BELOW
    near = torch.where(small, z, 0.0)
    far = torch.where(small, 1.0, z)
    cubic = torch.where(small, _series(_CUBIC, near), (1 - se3.sinc(far)) / far)
    return torch.eye(3).to(vector) + se3.cosc(z) * K + cubic * K @ K


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
    return 2 * v * torch.where(small, _series(_ASINC, near), torch.atan2(n, w) / n)


def _series(coefficients: Sequence[float], x: Tensor) -> Tensor:
    total = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
