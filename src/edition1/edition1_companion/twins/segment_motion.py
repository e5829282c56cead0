r"""How the one robot moves: three trajectories of the same segment, one of them a rod under load (synthetic).

The rod is a Cosserat rod with a rest shape, clamped at its base and at rest under a force on its tip. With the frame
:math:`R(s)`, the position :math:`p(s)`, the constant force :math:`F` and the stiffnesses :math:`K` of bending and
twist and :math:`S` of shear and stretch, both in the frame of the rod,

.. math:: p' = R\,\nu, \qquad R' = R\,[\kappa]_\times, \qquad
          K (\kappa - \kappa^*) = R^T \bigl((p_\mathrm{tip} - p) \times F\bigr), \qquad
          S (\nu - \nu^*) = R^T F .

What drives the segment sets the rest shape :math:`\kappa^*, \nu^*`: without a force it is taken exactly. Frames have
z along the rod; the base frame is that of the clamp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.paper_robots import Dimensions, pcc_robot
from edition1_companion.twins.trajectories import RATE_HZ, STEPS, flower, lemniscate

TRAJECTORIES = ("constant curvature", "affine curvature", "rod under load")
"""The lemniscate T3; the flower with a third of its curvatures (45 degrees at most); and a Cosserat rod that is
driven along T3 and pulled sideways at its tip."""
AFFINE_SCALE = 1 / 3
LOAD_N = 0.5
"""Force on the tip of the rod along x [N]; assumed."""
ROBOT = pcc_robot(1)
"""The segment with the ring of Baaij et al. 2023 and its sensors, as drawn."""
ITERATIONS = 200
TOLERANCE = 1e-12
"""Change of an element in an iteration, of its turn [rad] and of its step over its length, that ends the search."""
SHEAR_FACTOR = 27.0 / 28.0
"""Share of a round section that counts in shear, as in PyElastica."""


@dataclass(frozen=True)
class StaticRod:
    """What the rod is made of.

    Parameters
    ----------
    length_m, radius_m
        Length at rest and radius of the round section [m].
    youngs_modulus_pa
        Young's modulus [Pa]; the shear modulus is a third of it (incompressible).
    elements
        Number of elements, each of constant curvature.
    """

    length_m: float
    radius_m: float
    youngs_modulus_pa: float
    elements: int = 44

    @property
    def bending_stiffness(self) -> float:
        """E I [N m²]."""
        return self.youngs_modulus_pa * math.pi / 4 * self.radius_m**4

    def equilibrium(
        self,
        bend_rad: Float[Tensor, "*batch 2"],
        stretch: Float[Tensor, "*batch"],
        force_n: Float[Tensor, "*f 3"],
    ) -> Float[Tensor, "*batch k 4 4"]:
        """Poses ``T_base_node`` of the ``elements + 1`` nodes, base to tip, at equal distances along the rod at rest.

        Parameters
        ----------
        bend_rad
            Bend vector of the rest shape, an arc of constant curvature: bending angle of its tip towards x and y.
        stretch
            Length of the rest shape over the length of the rod.
        force_n
            Force on the tip in the base frame [N]; broadcasts against the batch.

        Raises
        ------
        InputError
            If the search for equilibrium does not converge: a force too large for such a rod.
        """
        n, h = self.elements, self.length_m / self.elements
        area = math.pi * self.radius_m**2
        bending = bend_rad.new_tensor([1.0, 1.0, 2.0 / 3.0]) * self.bending_stiffness
        shear = self.youngs_modulus_pa / 3 * area * SHEAR_FACTOR
        stretching = bend_rad.new_tensor([shear, shear, self.youngs_modulus_pa * area])
        x, y = (bend_rad / n).unbind(-1)
        rest = torch.stack([-y, x, torch.zeros_like(x)], dim=-1).unsqueeze(-2)  # turn of an element [rad]
        length = torch.stack([torch.zeros_like(x), torch.zeros_like(x), h * stretch], dim=-1).unsqueeze(-2)
        force = force_n.unsqueeze(-2)
        change = math.inf
        turn, step = rest.expand(*x.shape, n, 3), length.expand(*x.shape, n, 3)
        for _ in range(ITERATIONS):
            T, middle, centre = _walked(turn, step)
            moment = torch.linalg.cross((T[..., -1:, :3, 3] - centre), force.expand_as(centre))
            new_turn = rest + h * (middle.mT @ moment.unsqueeze(-1)).squeeze(-1) / bending
            new_step = length + h * (middle.mT @ force.unsqueeze(-1)).squeeze(-1) / stretching
            change = float(torch.maximum((new_turn - turn).abs().max(), (new_step - step).abs().max() / h))
            turn, step = (turn + new_turn) / 2, (step + new_step) / 2
            if change <= TOLERANCE:
                return _walked(turn, step)[0]
        expected = f"small enough for an equilibrium of a rod of E I = {self.bending_stiffness:.3g} N m²"
        raise bad_input("force_n", "StaticRod.equilibrium", expected, f"a change of {change:.1e} at last")


ROD = StaticRod(length_m=Dimensions.LENGTH_M, radius_m=0.011, youngs_modulus_pa=1e6)
"""Rod of the same length; radius of the material and its Young's modulus (a soft silicone) are assumed."""


@dataclass(frozen=True)
class Motion:
    """How the segment moves.

    Parameters
    ----------
    name
        One of :data:`TRAJECTORIES`, or any label.
    time_s
        Times of the steps [s].
    arcs_m
        Distances along the unextended backbone [m], base to tip.
    poses
        Poses ``T_base_backbone`` there.
    q
        Configurations ``(delta_x, delta_y, delta_L)`` [m], where the curvature is constant.
    """

    name: str
    time_s: Float[Tensor, " t"]
    arcs_m: Float[Tensor, " k"]
    poses: Float[Tensor, "t k 4 4"]
    q: Float[Tensor, "t n_q"] | None

    def at(self, arc_m: float) -> Float[Tensor, "t 4 4"]:
        """Poses at one of the arc lengths [m]."""
        ((k,),) = torch.nonzero((self.arcs_m - arc_m).abs() < 1e-9).tolist()
        return self.poses[:, k]


def motion(name: str, *, steps: int = STEPS, load_n: float = LOAD_N) -> Motion:
    """Motion of the segment by its name, one of :data:`TRAJECTORIES`.

    Parameters
    ----------
    name
        Of the trajectory.
    steps
        Time steps; all trajectories take 10 s.
    load_n
        Force on the tip of the rod along x [N]. Without it the rod moves as the segment of constant curvature.
    """
    arcs = torch.linspace(0, Dimensions.LENGTH_M, ROD.elements + 1, dtype=torch.float64)
    v, time = arcs / Dimensions.LENGTH_M, torch.arange(steps, dtype=torch.float64) * (STEPS / RATE_HZ / steps)
    q = lemniscate(1, steps=steps)
    if name == TRAJECTORIES[0]:
        return Motion(name, time, arcs, ROBOT.segments[0].pose(q.unsqueeze(-2), v), q)
    if name == TRAJECTORIES[1]:
        affine = flower(steps=steps) * torch.tensor([AFFINE_SCALE, AFFINE_SCALE, 1.0, 1.0]).double()
        return Motion(
            name, time, arcs, AffineCurvature(Dimensions.LENGTH_M).pose(affine.unsqueeze(-2), v), None
        )
    force = torch.tensor([load_n, 0.0, 0.0], dtype=torch.float64)
    poses = ROD.equilibrium(q[:, :2] / Dimensions.RADIUS_M, 1 + q[:, 2] / Dimensions.LENGTH_M, force)
    return Motion(name, time, arcs, poses, None)


def _walked(turn: Tensor, step: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Poses of the nodes, and frames and positions of the middles of the elements.

    Seen from its middle, an element of constant curvature is symmetric: its chord is the step, shortened across the
    axis of the turn by the sine over the angle of half the turn.
    """
    z = (turn * turn).sum(-1, keepdim=True)
    chord = se3.sinc(z / 4) * step + (1 / 24 - z / 1920) * (turn * step).sum(-1, keepdim=True) * turn
    half, whole = rotation_matrix(turn / 2), rotation_matrix(turn)
    R, p = torch.eye(3).to(turn).expand(*turn.shape[:-2], 3, 3), turn.new_zeros(*turn.shape[:-2], 3)
    poses, middles, centres = [se3.pose(R, p)], [], []
    for k in range(turn.shape[-2]):
        middle = R @ half[..., k, :, :]
        moved = p + (middle @ chord[..., k, :, None]).squeeze(-1)
        middles.append(middle)
        centres.append((p + moved) / 2)
        R, p = R @ whole[..., k, :, :], moved
        poses.append(se3.pose(R, p))
    return torch.stack(poses, dim=-3), torch.stack(middles, dim=-3), torch.stack(centres, dim=-2)


def rotation_matrix(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by a rotation vector [rad] (Rodrigues' formula), exact with its derivatives at zero.

    Examples
    --------
    >>> rotation_matrix(torch.tensor([0.0, 0.0, torch.pi / 2], dtype=torch.float64)).round().abs()
    tensor([[0., 1., 0.],
            [1., 0., 0.],
            [0., 0., 1.]], dtype=torch.float64)
    """
    K, z = cross_matrix(vector), (vector * vector).sum(-1)[..., None, None]
    return torch.eye(3).to(vector) + se3.sinc(z) * K + se3.cosc(z) * K @ K


def cross_matrix(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Matrix of the cross product by a vector."""
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3))
