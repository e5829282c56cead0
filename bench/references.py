"""References of the benchmark: plain code, written from the papers' equations, that computes what ours computes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import magpylib as magpy
import numpy as np
import torch
from edition1.estimation.imu_selection import Selection
from edition1.kinematics.paper_robots import Dimensions
from edition1.kinematics.robot import Robot
from edition1.sensing.magnets import _MT_PER_T, Cube, Ring
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp
from torch import Tensor

Model = Callable[[Tensor], Tensor]


def objects_per_configuration(
    robot: Robot, q: Float[Tensor, "n n_q"], magnet: Ring, *, together: bool = True
) -> Float[np.ndarray, "n s"]:
    """Readings [mT] by magpylib objects that are posed anew for every configuration.

    Parameters
    ----------
    robot, q, magnet
        As in :func:`edition1.sensing.magnetic.readings`.
    together
        One ``getB`` for all sensors of a configuration; else one for every sensor.
    """
    outer = magpy.magnet.Cylinder(
        polarization=(0, 0, magnet.polarisation_mt / _MT_PER_T),
        dimension=(magnet.outer_diameter, magnet.height),
    )
    bore = magpy.magnet.Cylinder(
        polarization=(0, 0, -magnet.polarisation_mt / _MT_PER_T),
        dimension=(magnet.inner_diameter, magnet.height),
    )
    rows = []
    for T_m, T_s in zip(robot.magnet_poses(q).numpy(), robot.sensor_poses(q).numpy(), strict=True):
        sources = []
        for T in T_m:
            turn = Rotation.from_matrix(T[:3, :3])
            sources += [part.copy(position=T[:3, 3], orientation=turn) for part in (outer, bore)]
        sensors = [magpy.Sensor(position=T[:3, 3], orientation=Rotation.from_matrix(T[:3, :3])) for T in T_s]
        if together:
            rows.append(magpy.getB(sources, sensors, sumup=True)[:, 2])
        else:
            rows.append([magpy.getB(sources, sensor, sumup=True)[2] for sensor in sensors])
    return _MT_PER_T * np.array(rows)


def cube_fields(q: Float[np.ndarray, "n 2"], length: float, cube: Cube) -> Float[np.ndarray, "n 3"]:
    """Flux density [mT] at the base of bent arcs with a cube at their tips, vectorised over all, by magpylib.

    Parameters
    ----------
    q
        Bend vectors [rad], not zero.
    length
        Length of the arc [m].
    cube
        The magnet.
    """
    phi = np.linalg.norm(q, axis=1, keepdims=True)
    position = length / phi * np.concatenate([q / phi * (1 - np.cos(phi)), np.sin(phi)], axis=1)
    turn = Rotation.from_rotvec(np.stack([-q[:, 1], q[:, 0], np.zeros(len(q))], axis=1))
    return turn.apply(cube.field(turn.inv().apply(-position)))


def chain_by_equations(
    orientations: Float[np.ndarray, "samples imus 4"], chosen: Selection
) -> Float[np.ndarray, "samples joints 3"]:
    """Joints of the PCC-extended chain of Martin et al. 2022 by a plain loop over equations (3) to (5)."""
    n, samples = chosen.sub_links, []
    for q in orientations:
        joints = [np.zeros(3)]
        for k, length in enumerate(chosen.link_lengths):
            between = Slerp([0.0, 1.0], Rotation.from_quat(q[k : k + 2]))
            for j in range(n):
                joints.append(joints[-1] + between((2 * j + 1) / (2 * n)).apply([0.0, 0.0, length / n]))
        samples.append(np.array(joints))
    return np.array(samples)


def chain_vectorised(
    orientations: Float[np.ndarray, "samples imus 4"], chosen: Selection
) -> Float[np.ndarray, "samples joints 3"]:
    """Joints of the PCC-extended chain by the same equations in NumPy, all samples and links at once."""
    a, b, n = orientations[:, :-1], orientations[:, 1:], chosen.sub_links
    cosine = (a * b).sum(-1)
    b = np.where(cosine[..., None] < 0, -b, b)  # by the shorter way round
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))[..., None]
    sine = np.where(angle > 1e-9, np.sin(angle), 1.0)
    lengths, steps = np.array(chosen.link_lengths)[:, None] / n, []
    for t in (np.arange(n) + 0.5) / n:
        first = np.where(angle > 1e-9, np.sin((1 - t) * angle) / sine, 1 - t)
        second = np.where(angle > 1e-9, np.sin(t * angle) / sine, t)
        x, y, z, w = np.moveaxis(first * a + second * b, -1, 0)
        steps.append(
            lengths * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
        )
    joints = np.stack(steps, axis=2).reshape(len(a), -1, 3).cumsum(1)
    return np.concatenate([np.zeros_like(joints[:, :1]), joints], axis=1)


def readings_by_equations(q: Float[Tensor, " n_q"], models: Sequence[Model]) -> Float[Tensor, " s"]:
    """Readings of the robot of Baaij et al. 2023, eqs (1) to (8), pair by pair.

    Parameters
    ----------
    q
        Configuration of segments with three sensors each; all bent, where the equations divide by the bending.
    models
        One for each segment: from one row of relations as angles to a reading.
    """
    base, magnets, sensors = torch.eye(4, dtype=q.dtype), [], []
    for segment in q.reshape(-1, 3):
        magnets.append(base @ _backbone(segment, Dimensions.MAGNET_AXIAL_M / Dimensions.LENGTH_M))
        base = base @ _backbone(segment, 1.0)
        for j in range(3):
            phi = 2 * math.pi * j / 3
            offset = q.new_tensor(
                [
                    Dimensions.SENSOR_RADIAL_M * math.cos(phi),
                    Dimensions.SENSOR_RADIAL_M * math.sin(phi),
                    0.0,
                    1.0,
                ]
            )
            sensors.append((-base[:3, 2], (base @ offset)[:3]))
    u = []
    for j, (o_s, x) in enumerate(sensors):
        xi = [torch.acos(o_s[0])]
        for T in magnets:
            p, o_m = x - T[:3, 3], T[:3, 2]
            d = torch.linalg.vector_norm(p)
            xi += [d, torch.acos(o_s @ o_m), torch.acos(o_s @ p / d), torch.acos(o_m @ p / d)]
        u.append(models[j // 3](torch.stack(xi).unsqueeze(0))[0].to(q))
    return torch.stack(u)


def cosines_of(angles: Float[Tensor, "*batch xi"]) -> Float[Tensor, "*batch xi"]:
    """Relations as cosines; every fourth but the first is a distance."""
    distance = torch.arange(angles.shape[-1]) % 4 == 1
    return torch.where(distance, angles, angles.cos())


def _backbone(segment: Float[Tensor, " 3"], v: float) -> Float[Tensor, "4 4"]:
    """Pose at the coordinate ``v`` of a segment, eqs (14) and (15) with the factor of (15) that fits v < 1."""
    x, y, dL = segment.unbind()
    bend = torch.sqrt(x * x + y * y)
    cosine, sine = torch.cos(v * bend / Dimensions.RADIUS_M), torch.sin(v * bend / Dimensions.RADIUS_M)
    n_x, n_y, r = x / bend, y / bend, Dimensions.RADIUS_M * (Dimensions.LENGTH_M + dL) / bend
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    entries = (
        *(1 + n_x * n_x * (cosine - 1), n_x * n_y * (cosine - 1), n_x * sine, r * n_x * (1 - cosine)),
        *(n_x * n_y * (cosine - 1), 1 + n_y * n_y * (cosine - 1), n_y * sine, r * n_y * (1 - cosine)),
        *(-n_x * sine, -n_y * sine, cosine, r * sine),
        *(zero, zero, zero, one),
    )
    return torch.stack(entries).reshape(4, 4)
