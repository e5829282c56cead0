"""How far the readings of a robot's model may be off: after a calibration, and with networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.model_error import WhiteError
from edition1.kinematics.robot import Robot
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.sensing.weights import read_manifest


@dataclass(frozen=True)
class CalibrationError:
    r"""Covariance :math:`J_z S J_z^T` of readings that a calibration leaves uncertain.

    :math:`S` is the posterior covariance of all its parameters, :math:`J_z` the derivatives of the readings by them
    in closed form, made anew for every configuration by a compiled kernel.

    Parameters
    ----------
    robot, moments, gain
        As drawn; gain in unit/mT.
    calibration
        What was found.
    """

    robot: Robot
    moments: Float[Tensor, "*m terms"]
    gain: Float[Tensor, " s"]
    calibration: RobotCalibration

    @cached_property
    def _slopes(self) -> Any:
        from edition1.kernels._placement import PlacementSlopes  # here: numba takes a second to import

        found = self.calibration
        return PlacementSlopes(self.robot, self.moments, found.parameters, self.gain, found.earth_mt)

    @cached_property
    def _root(self) -> Float[Tensor, "all all"]:
        C = self.calibration.covariance
        size = C.diagonal().clamp_min(torch.finfo(C.dtype).tiny).sqrt()  # of parameters in units far apart
        values, vectors = torch.linalg.eigh(C / size.unsqueeze(-1) / size)
        return size.unsqueeze(-1) * vectors * values.clamp_min(0.0).sqrt()

    def __call__(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch s s"]:
        """Covariance at configurations [unit^2]."""
        J = torch.from_numpy(self._slopes(q.detach().reshape(-1, q.shape[-1]).numpy()))
        J = (J @ self._root).reshape(*q.shape[:-1], *J.shape[1:])
        return J @ J.mT


def network_error(networks: Sequence[Path], robot: Robot, unit: str) -> WhiteError | None:
    """Error of trained networks: the validation error that their manifests state; of others nothing is known.

    Raises
    ------
    InputError
        If what a manifest states is no error.
    """
    if not networks:
        return None
    rmse = [_rmse(path, unit) for path in networks]
    if None in rmse:
        return None
    of_sensor = network_of_sensor(robot, len(networks))
    return WhiteError(torch.tensor([rmse[k] for k in of_sensor], dtype=torch.float64))


def _rmse(path: Path, unit: str) -> float | None:
    key = f"metrics_{unit.lower()}"
    metrics = read_manifest(path).get(key)
    if metrics is None:
        return None
    value = metrics.get("rmse_validation") if isinstance(metrics, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e300:
        expected = f"with the validation error rmse_validation [{unit}] in {key}"
        raise bad_input("manifest", path.with_suffix(".json").name, expected, metrics)
    return float(value)


def network_of_sensor(robot: Robot, networks: int) -> tuple[int, ...]:
    """Which network predicts each sensor: the only one, that of its segment, or its own."""
    n = len(robot.sensors)
    if networks == len(robot.segments):
        return robot.sensors.segment
    return (0,) * n if networks == 1 else tuple(range(n))
