r"""A segment of constant curvature in the Delta-parametrisation (Baaij et al. 2023, appendix A.1).

The printed eq. (15) has a factor ``1/v`` in the position that is right at the tip (``v = 1``) only; without
it the backbone has the length it must have. This module and every number of the companion use

.. math:: p(q, v) = \frac{d (L_0 + \delta L)}{\Delta^2}
          [\Delta_x (1 - C_v),\ \Delta_y (1 - C_v),\ \Delta S_v]^T .
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input


@dataclass(frozen=True)
class ConstantCurvature:
    r"""One segment of constant curvature and constant elongation.

    The configuration is :math:`q = (\Delta_x, \Delta_y, \delta L)` [m], eq. (14): with the radius ``d`` of
    the segment, :math:`\Delta/d` is the bending angle of its tip, towards ``(Delta_x, Delta_y)``.

    Parameters
    ----------
    length
        Unextended length :math:`L_0` [m].
    radius
        Radius ``d`` [m].

    Raises
    ------
    InputError
        If the length or the radius is not positive.

    Examples
    --------
    A quarter circle of length 0.11 m ends at (2 L/pi, 0, 2 L/pi):

    >>> segment = ConstantCurvature(length=0.11, radius=0.022)
    >>> q = torch.tensor([0.022 * torch.pi / 2, 0.0, 0.0], dtype=torch.float64)
    >>> segment.pose(q, torch.tensor(1.0))[:3, 3]
    tensor([0.0700, 0.0000, 0.0700], dtype=torch.float64)
    """

    length: float
    radius: float

    def __post_init__(self) -> None:
        for name in ("length", "radius"):
            if not getattr(self, name) > 0:
                raise bad_input(name, "ConstantCurvature", "positive [m]", getattr(self, name))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the configuration variables."""
        return ("delta_x", "delta_y", "delta_L")

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        return 3

    def pose(self, q: Float[Tensor, "*q 3"], v: Float[Tensor, "*v"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose ``T_base_v`` of the backbone frame at ``v``, eq. (15) with the misprint corrected.

        Parameters
        ----------
        q
            Configuration [m].
        v
            Backbone coordinate, 0 at the base and 1 at the tip; broadcasts against the batch of ``q``.
            It is material: it moves with the elongation.

        Returns
        -------
        Tensor
            Rigid motions from the frame at ``v`` to the base frame of the segment; positions in m.

        Raises
        ------
        InputError
            If the last dimension of ``q`` is not 3, or ``q`` is not finite.
        """
        if q.shape[-1:] != (self.n_q,):
            raise bad_input("q", "ConstantCurvature.pose", "of last dimension 3", f"shape {tuple(q.shape)}")
        se3.require_finite(q, "q", "ConstantCurvature.pose")
        v = v.to(q)
        ax, ay, dL = (q / q.new_tensor([self.radius, self.radius, 1.0])).unbind(-1)
        a2 = ax * ax + ay * ay
        s = v * se3.sinc(v * v * a2)  # sin(v theta)/theta
        c = v * v * se3.cosc(v * v * a2)  # (1 - cos(v theta))/theta^2
        L = self.length + dL
        xy = -ax * ay * c
        rotation = torch.stack(
            [1 - ax * ax * c, xy, ax * s, xy, 1 - ay * ay * c, ay * s, -ax * s, -ay * s, 1 - a2 * c], dim=-1
        ).unflatten(-1, (3, 3))
        position = torch.stack([L * ax * c, L * ay * c, L * s], dim=-1)
        return se3.pose(rotation, position)

    def configuration(self, T_base_tip: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 3"]:
        """Configuration whose tip has this pose: the closed-form inverse of :meth:`pose` at ``v = 1``.

        The direction and angle of bending come from the tangent (third column of the rotation), the length
        from the distance between base and tip. A twist about the tangent, which no constant-curvature
        segment has, is ignored; so is the direction of the position, which the tangent already gives.

        Parameters
        ----------
        T_base_tip
            Pose of the tip in the base frame of the segment; position in m. Bending below pi.

        Raises
        ------
        InputError
            If the matrix is not a finite rigid motion, or the tangent points straight back (bending by pi,
            where the direction of bending is no longer determined).
        """
        owner = "ConstantCurvature.configuration"
        if T_base_tip.shape[-2:] != (4, 4):
            raise bad_input("T_base_tip", owner, "of shape (..., 4, 4)", f"shape {tuple(T_base_tip.shape)}")
        se3.require_finite(T_base_tip, "T_base_tip", owner)
        R, p = T_base_tip[..., :3, :3], T_base_tip[..., :3, 3]
        defect = (R.transpose(-1, -2) @ R - torch.eye(3).to(R)).detach().abs()
        if bool((torch.linalg.det(R.detach()) < 0).any()):
            raise bad_input("T_base_tip", owner, "a rigid motion", "a reflection")
        if bool((defect > (1e-3 if R.dtype == torch.float32 else 1e-6)).any()):
            raise bad_input("T_base_tip", owner, "a rigid motion", f"R^T R - 1 of {float(defect.max()):.1e}")
        cos = R[..., 2, 2]
        if bool((cos <= -1 + 1e-9).any()):
            smallest = float(cos.detach().min())
            raise bad_input("T_base_tip", owner, "of a tip bent by less than pi", f"R33 = {smallest}")
        a = R[..., :2, 2] * se3.acosc(cos).unsqueeze(-1)
        chord = (2 * se3.cosc((a * a).sum(-1))).sqrt()  # |p|/L of a circular arc
        dL = torch.linalg.vector_norm(p, dim=-1) / chord - self.length
        return torch.cat([a * self.radius, dL.unsqueeze(-1)], dim=-1)
