"""Robots that are not as drawn, and what is measured of them: the setting of our figures beside Baaij et al. 2023."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1.sensing.placement import Tolerances, placed

SENSOR_NOISE_MT = 7.1e-4
L_MAX = 9


@dataclass(frozen=True)
class Config:
    """Settings of the comparison.

    Parameters
    ----------
    draws
        Robots per row, each with its own poses and noise.
    poses
        Calibration poses: random configurations in the training box.
    position_m, rotation_rad
        Noise of a measured pose: standard deviation of the position along, and of the rotation about, each axis.
    iterations
        Levenberg-Marquardt iterations per time step. Every time step starts from the straight pose at mid
        elongation, none from its predecessor; on T2 five iterations and twelve agree in four digits.
    seed
        Of all draws.
    half
        Evaluate on the half lemniscate T2 (for choices) instead of the full one T3.
    """

    draws: int = 10
    poses: int = 100
    position_m: float = 0.2e-3
    rotation_rad: float = math.radians(0.2)
    iterations: int = 5
    seed: int = 0
    half: bool = False

    def __post_init__(self) -> None:
        if self.draws < 1 or self.poses < 1:
            raise bad_input("draws, poses", "Config", "at least 1", (self.draws, self.poses))


def released_moments() -> Float[Tensor, " terms"]:
    """Moments of the ring ``"released"`` up to order ``L_MAX`` [mT m^(l+2)]."""
    return torch.from_numpy(ring("released").multipoles(L_MAX))


@dataclass(frozen=True)
class Session:
    """Draws of one row, batched: true robots, what was measured to calibrate them, what is to be estimated.

    Parameters
    ----------
    true_robot
        Batch of robots. Only the readings come from it.
    poses
        Measured poses of the segments' tips.
    pose_readings
        Readings in these poses [mT].
    q
        True configurations of the trajectory [m], to score the estimates.
    readings
        Readings on the trajectory [mT], time first.
    """

    true_robot: Robot
    poses: Float[Tensor, "draws poses i 4 4"]
    pose_readings: Float[Tensor, "draws poses s"]
    q: Float[Tensor, "t n_q"]
    readings: Float[Tensor, "t draws s"]


def draw_session(
    robot: Robot,
    q: Float[Tensor, "t n_q"],
    pose_box: tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]],
    config: Config,
    *,
    earth_mt: Float[Tensor, " 3"] | None = None,
) -> Session:
    """Draw robots and measurements; every draw has a generator of its own, the same for all rows.

    Offsets and tilts of the magnets (0.5 mm, 2 degrees on each axis) and errors of the sensors (azimuth 1 % of a
    turn, radius 1 %) are uniform within their limits; noise is normal.

    Parameters
    ----------
    robot
        As drawn.
    q
        Trajectory.
    pose_box
        Bounds of the calibration poses.
    config
        Draws, poses, noise of a measured pose, seed.
    earth_mt
        Earth field in the base frame [mT]; none when not given.
    """
    magnet, moments = ring("released"), released_moments()
    limits = Tolerances().of_parameters(robot, len(moments))
    n_m, n_s = len(robot.magnets), len(robot.sensors)
    limits[5 * n_m : 5 * n_m + 4 * n_s].view(n_s, 4)[:, 2:] = (
        0.0  # tilt and gain of the sensors are as drawn,
    )
    limits[5 * n_m + 4 * n_s :] = 0.0  # and so are the moments
    low, high = pose_box
    errors, poses_q, pose_noise, noise = [], [], [], []
    for draw in range(config.draws):
        g = torch.Generator().manual_seed(1000 * config.seed + draw)
        errors.append(limits * (2 * torch.rand(len(limits), generator=g, dtype=torch.float64) - 1))
        uniform = torch.rand(config.poses, robot.n_q, generator=g, dtype=torch.float64)
        poses_q.append(low + (high - low) * uniform)
        pose_noise.append(torch.randn(config.poses, len(robot.segments), 6, generator=g, dtype=torch.float64))
        noise.append(
            SENSOR_NOISE_MT * torch.randn(config.poses + len(q), n_s, generator=g, dtype=torch.float64)
        )
    parts = placed(robot, moments, torch.stack(errors))
    true_robot = replace(robot, magnets=parts.magnets, sensors=parts.sensors)
    at_poses = torch.stack(poses_q, dim=1)
    u_poses = readings(true_robot, at_poses, magnet, earth_mt=earth_mt).transpose(0, 1)
    u = readings(true_robot, q.unsqueeze(1), magnet, earth_mt=earth_mt)
    tips = true_robot.base_poses(at_poses.transpose(0, 1))[..., 1:, :, :]
    both = torch.stack(noise)
    return Session(
        true_robot=true_robot,
        poses=_measured(tips, torch.stack(pose_noise), config),
        pose_readings=u_poses + both[:, : config.poses],
        q=q,
        readings=u + both[:, config.poses :].transpose(0, 1),
    )


def _measured(T: Tensor, noise: Tensor, config: Config) -> Tensor:
    """Poses as a motion capture system sees them: small rotations about, and offsets along, each axis."""
    angle, offset = config.rotation_rad * noise[..., :3], config.position_m * noise[..., 3:]
    turn = se3.rotation_x(angle[..., 0]) @ se3.rotation_y(angle[..., 1]) @ se3.rotation_z(angle[..., 2])
    return se3.pose(T[..., :3, :3] @ turn, T[..., :3, 3] + offset)
