"""How the one robot moves: three trajectories of the same segment (synthetic)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from repro.kinematics.affine_curvature import AffineCurvature
from repro.kinematics.paper_robots import LENGTH_M, RADIUS_M, pcc_robot
from repro.kinematics.trajectories import RATE_HZ, STEPS, flower, lemniscate
from repro_companion.twins.static_rod import StaticRod

TRAJECTORIES = ("constant curvature", "affine curvature", "rod under load")
"""The lemniscate T3; the flower with a third of its curvatures (45 degrees at most); and a Cosserat rod that is
driven along T3 and pulled sideways at its tip."""
AFFINE_SCALE = 1 / 3
LOAD_N = 0.5
"""Force on the tip of the rod along x [N]; assumed."""
ROD = StaticRod(length_m=LENGTH_M, radius_m=0.011, youngs_modulus_pa=1e6)
"""Rod of the same length; radius of the material and its Young's modulus (a soft silicone) are assumed."""
ROBOT = pcc_robot(1)
"""The segment with the ring of Baaij et al. 2023 and its sensors, as drawn."""


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
    arcs = torch.linspace(0, LENGTH_M, ROD.elements + 1, dtype=torch.float64)
    v, time = arcs / LENGTH_M, torch.arange(steps, dtype=torch.float64) * (STEPS / RATE_HZ / steps)
    q = lemniscate(1, steps=steps)
    if name == TRAJECTORIES[0]:
        return Motion(name, time, arcs, ROBOT.segments[0].pose(q.unsqueeze(-2), v), q)
    if name == TRAJECTORIES[1]:
        affine = flower(steps=steps) * torch.tensor([AFFINE_SCALE, AFFINE_SCALE, 1.0, 1.0]).double()
        return Motion(name, time, arcs, AffineCurvature(LENGTH_M).pose(affine.unsqueeze(-2), v), None)
    force = torch.tensor([load_n, 0.0, 0.0], dtype=torch.float64)
    poses = ROD.equilibrium(q[:, :2] / RADIUS_M, 1 + q[:, 2] / LENGTH_M, force)
    return Motion(name, time, arcs, poses, None)
