"""What the readings of a described robot do not say about its configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.undetermined import undetermined
from edition1.kinematics.robot import Robot
from edition1.robot_file.imu_readings import Imu, beside_imus
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing


@runtime_checkable
class _Described(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def robot(self) -> Robot: ...
    @property
    def noise(self) -> float: ...
    @property
    def lower(self) -> Tensor: ...
    @property
    def upper(self) -> Tensor: ...
    @property
    def start(self) -> Tensor: ...
    @property
    def imus(self) -> tuple[Imu, ...]: ...
    @property
    def imu_noise(self) -> float: ...
    @property
    def base_orientation(self) -> tuple[float, ...]: ...
    @property
    def networks(self) -> tuple[Path, ...]: ...
    def sensing(self) -> LinearisedSensing | MagneticSensing: ...


def unobserved(found: _Described) -> tuple[str, ...]:
    """Return notes about fewer readings than unknowns, and about what the readings leave open at the start.

    A direction is open if the readings change by less than about half of their noise over half the width of its
    bounds. Robots of IMUs alone have no configuration to determine; of networks only the readings are counted.
    """
    robot = found.robot
    if not len(robot.sensors):
        return ()
    notes = []
    readings, unknowns = len(robot.sensors) + sum(imu.freedoms for imu in found.imus), robot.n_q
    if readings < unknowns:
        notes.append(
            f"{found.name}: {readings} readings for {unknowns} unknowns. Those of one moment do not determine the "
            "configuration; only an estimator that knows how the robot moves, such as kalman, can follow it."
        )
    if not found.networks and (texts := _open(found, found.start)):
        more = "" if _open(found, _bent(found)) else " Bent, they do."
        notes.append(
            f"{found.name}: at the start the readings do not determine, in units of the bounds: "
            f"{'; '.join(texts)}.{more}"
        )
    return tuple(notes)


def _open(found: _Described, q: Tensor) -> list[str]:
    """Combinations of coordinates that the readings leave open at ``q``."""
    sensing, noise = found.sensing(), found.noise
    assert isinstance(sensing, LinearisedSensing)
    if found.imus:
        imus = found.imus, found.imu_noise, found.base_orientation
        _, J = beside_imus(sensing, noise, found.robot, *imus).linearise(q)
    else:
        J = sensing.linearise(q)[1] / noise
    J = J * (found.upper - found.lower) / 2
    covariance = torch.linalg.inv(J.mT @ J + torch.eye(len(q)).to(q))
    return [text.partition(" (")[0] for text in undetermined(found.robot.coordinates, covariance.numpy())]


def _bent(found: _Described) -> Float[Tensor, " n_q"]:
    """Return a configuration without symmetry: every coordinate by another share towards its upper bound."""
    share = 0.2 + 0.5 * (0.618 * torch.arange(1, found.robot.n_q + 1, dtype=torch.float64) % 1)
    return found.start + share * (found.upper - found.start)
